"""modelDescription.xml of FMI 2.0 for an interface.

modelDescription.xml and sources/buildDescription.xml of FMI 3.0 for an interface.

terminalsAndIcons/terminalsAndIcons.xml of FMI 3.0: the ports of a subsystem, and where its icon goes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lxml import etree

from fmus.contract import Member, Subsystem
from fmus.export.c_code import DEFAULT_TOLERANCE
from fmus.export.interface import Interface, Variable, dependencies, initial_dependencies
from orchestrator.base.errors import Problem
from orchestrator.base.units import display, parse, spelled
from orchestrator.base.xml import digits
from orchestrator.ssp.common import generation_tool, package_version

COPYRIGHT = "Copyright (c) 2026 the harvester-cosim authors"  # as in LICENSE
TOOL = "harvester-cosim"  # in vendor annotations
LOG_CATEGORIES = {
    "logEvents": "Each call of a function",
    "logStatusWarning": "What needs attention",
    "logStatusDiscard": "Values that could not be computed",
    "logStatusError": "What went wrong",
    "logAll": "All messages",
}
FLAGS = {
    "needsExecutionTool": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}
COSIMULATION = {
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "true",
    "maxOutputDerivativeOrder": "1",
    "canRunAsynchronuously": "false",
}
Unknowns = Mapping[str, Sequence[tuple[Variable, Sequence[tuple[Variable, str]]]]]  # by element, with knowns


def identity(face: Interface) -> dict[str, str]:
    """Attributes of the model description, the same in FMI 2 and 3."""
    return {
        "modelName": face.name,
        "description": face.text,
        "version": package_version(),
        "generationTool": generation_tool(),
        "author": "the harvester-cosim authors",
        "copyright": COPYRIGHT,
        "license": "MIT",
        "variableNamingConvention": "flat",
    }


def model_description(face: Interface, guid: str, sources: Sequence[str], step: float, stop: float) -> bytes:
    """The XML file; `sources` are the C files to compile, step and stop the default experiment [s]."""
    kinds = {"ModelExchange": FLAGS, "CoSimulation": COSIMULATION | FLAGS}
    return described(face, guid, kinds, sources, step, stop, unknowns(face))


def described(
    face: Interface,
    guid: str,
    kinds: Mapping[str, Mapping[str, str]],
    sources: Sequence[str],
    step: float,
    stop: float,
    structure: Unknowns,
) -> bytes:
    """The XML file of an FMU with these abilities by kind, and with these unknowns."""
    root = etree.Element(
        "fmiModelDescription",
        identity(face) | {"fmiVersion": "2.0", "guid": guid, "numberOfEventIndicators": "0"},
    )
    for element, flags in kinds.items():
        kind = etree.SubElement(root, element, modelIdentifier=face.name, **flags)
        files = etree.SubElement(kind, "SourceFiles") if sources else kind
        for name in sources:
            etree.SubElement(files, "File", name=name)
    units(root, face)
    log_categories(root)
    default_experiment(root, step, stop)
    _input_derivatives(root, face)
    _structure(root, structure, _variables(root, face))
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)  # type: ignore[no-any-return]


def log_categories(root: etree._Element) -> None:
    """Writes the element LogCategories, the same in FMI 2 and 3."""
    categories = etree.SubElement(root, "LogCategories")
    for name, text in LOG_CATEGORIES.items():
        etree.SubElement(categories, "Category", name=name, description=text)


def default_experiment(root: etree._Element, step: float, stop: float) -> None:
    """Writes the element DefaultExperiment, the same in FMI 2 and 3; step and stop in s."""
    numbers = {"startTime": 0.0, "stopTime": stop, "tolerance": DEFAULT_TOLERANCE, "stepSize": step}
    etree.SubElement(root, "DefaultExperiment", {name: digits(value) for name, value in numbers.items()})


def units(root: etree._Element, face: Interface, *others: str) -> None:
    """Writes the element UnitDefinitions, the same in FMI 2 and 3, of all variables and some others."""
    definitions = etree.SubElement(root, "UnitDefinitions")
    for name in sorted({v.quantity.unit for v in face.variables} | set(others)):
        unit = etree.SubElement(definitions, "Unit", name=name)
        etree.SubElement(unit, "BaseUnit", base_unit(name))
        shown = display(name)
        if shown:
            etree.SubElement(unit, "DisplayUnit", name=shown[0], factor=digits(shown[1]))
    if not len(definitions):
        root.remove(definitions)


def base_unit(unit: str) -> dict[str, str]:
    """Attributes of FMI's and SSP's BaseUnit element."""
    parsed = parse(unit)
    if spelled(unit) != unit:  # what other tools read goes into the file
        raise Problem(f'unit "{unit}": expected "{spelled(unit)}"')
    attributes = {name: str(n) for name, n in parsed.base().items()}
    return attributes if parsed.factor == 1.0 else attributes | {"factor": digits(parsed.factor)}


def _input_derivatives(root: etree._Element, face: Interface) -> None:
    """Which input is the time derivative of which, as an annotation.

    FMI 2.0 has the attribute `derivative` for that, but tools count the variables that carry it as states:
    OMSimulator expects 7 of manipulator.fmu, which has 4.
    """
    pairs = [(v.name, v.quantity.rate) for v in face.inputs if v.quantity.rate]
    if not pairs:
        return
    tool = etree.SubElement(etree.SubElement(root, "VendorAnnotations"), "Tool", name=TOOL)
    listed = etree.SubElement(tool, "InputDerivatives")  # the schema allows one element in a tool's
    for name, rate in pairs:
        etree.SubElement(listed, "InputDerivative", input=name, derivative=rate)


def _variables(root: etree._Element, face: Interface) -> dict[str, int]:
    """Writes the variables; returns their index by name, counted from 1."""
    parent = etree.SubElement(root, "ModelVariables")
    index = {v.name: i for i, v in enumerate(face.variables, start=1)}
    derived = {f"der_{v.name}": index[v.name] for v in face.states}
    for v in face.variables:
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.quantity.text}
        element = etree.SubElement(parent, "ScalarVariable", attributes | causality(v))
        etree.SubElement(element, "Real", _real(v, derived.get(v.name)))
    return index


def causality(v: Variable) -> dict[str, str]:
    """Attributes causality, variability and initial, the same in FMI 2 and 3."""
    if v.kind in ("FIXED", "TUNABLE"):
        return {"causality": "parameter", "variability": v.kind.lower(), "initial": "exact"}
    if v.kind == "INPUT":
        return {"causality": "input", "variability": "continuous"}
    return {
        "causality": "output" if v.output else "local",
        "variability": "continuous",
        "initial": "exact" if v.kind == "STATE" else "calculated",
    }


def _real(v: Variable, derived: int | None) -> dict[str, str]:
    """derived: the index of the state whose time derivative this is."""
    return numbers(v) | ({"derivative": str(derived)} if derived is not None else {})


def numbers(v: Variable) -> dict[str, str]:
    """Attributes of a real variable, the same in FMI 2 and 3."""
    q = v.quantity
    shown = display(q.unit)
    values = {
        "min": q.minimum,
        "max": q.maximum,
        "nominal": None if q.nominal == 1.0 else q.nominal,
        "start": v.start,
    }
    return (
        {"unit": q.unit}
        | ({"displayUnit": shown[0]} if shown else {})
        | {name: digits(value) for name, value in values.items() if value is not None}
    )


def _structure(root: etree._Element, unknown: Unknowns, index: Mapping[str, int]) -> None:
    structure = etree.SubElement(root, "ModelStructure")
    for name, rows in unknown.items():
        parent = etree.SubElement(structure, name) if rows else structure
        for v, table in rows:
            known = sorted((index[k.name], kind) for k, kind in table)
            etree.SubElement(parent, "Unknown", {"index": str(index[v.name])} | dependency_lists(known))


def dependency_lists(known: Sequence[tuple[int, str]]) -> dict[str, str]:
    """Attributes dependencies and dependenciesKind of an unknown."""
    return {
        "dependencies": " ".join(str(i) for i, _ in known),
        "dependenciesKind": " ".join(kind for _, kind in known),
    }


def unknowns(face: Interface) -> Unknowns:
    """Outputs, Derivatives and InitialUnknowns, each with what it depends on."""
    running, starting = dependencies(face), initial_dependencies(face)
    calculated = [v for v in face.states if v.kind == "CALCULATED_STATE"]
    first = sorted([*calculated, *face.derivatives, *face.outputs], key=lambda v: v.reference)
    return {
        "Outputs": [(v, running[v.name]) for v in face.variables if v.output],
        "Derivatives": [(v, running[v.name]) for v in face.derivatives],
        "InitialUnknowns": [(v, starting[v.name]) for v in first],
    }


_FLAGS = {
    "needsExecutionTool": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "providesDirectionalDerivatives": "true",
    "providesAdjointDerivatives": "true",
}
_EXCHANGE = {"needsCompletedIntegratorStep": "true"}  # where the FMU checks what its model requires
_COSIMULATION = {
    "canHandleVariableCommunicationStepSize": "true",
    "maxOutputDerivativeOrder": "1",
    "providesIntermediateUpdate": "true",
    "canReturnEarlyAfterIntermediateUpdate": "true",
    "hasEventMode": "true",
}
_ELEMENTS = {
    "Outputs": "Output",
    "Derivatives": "ContinuousStateDerivative",
    "InitialUnknowns": "InitialUnknown",
}
# available inside a step: what moves
_MOVING = ("INPUT", "STATE", "CALCULATED_STATE", "DERIVATIVE", "OUTPUT")


def model_description3(face: Interface, token: str, step: float, stop: float) -> bytes:
    """The XML file; `token` is the instantiation token, step and stop the default experiment [s]."""
    root = etree.Element(
        "fmiModelDescription",
        identity(face) | {"fmiVersion": "3.0", "instantiationToken": token},
    )
    for element, flags in (("ModelExchange", _FLAGS | _EXCHANGE), ("CoSimulation", _FLAGS | _COSIMULATION)):
        etree.SubElement(root, element, modelIdentifier=face.name, **flags)
    units(root, face, "s")
    log_categories(root)
    default_experiment(root, step, stop)
    _variables3(root, face)
    _structure3(root, face)
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)  # type: ignore[no-any-return]


def _variables3(root: etree._Element, face: Interface) -> None:
    parent = etree.SubElement(root, "ModelVariables")
    derived = {f"der_{v.name}": v.reference for v in face.states}
    derived |= {v.quantity.rate: v.reference for v in face.inputs if v.quantity.rate}
    for v in face.variables:
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.quantity.text}
        attributes |= causality(v)
        if v.kind in _MOVING:
            attributes["intermediateUpdate"] = "true"
        if v.name in derived:
            attributes["derivative"] = str(derived[v.name])
        etree.SubElement(parent, "Float64", attributes | numbers(v))
    _time(parent, face)


def _time(parent: etree._Element, face: Interface) -> None:
    """The independent variable, which FMI 3 wants; its reference follows the last one."""
    names = {v.name for v in face.variables}
    attributes = {
        "name": next(name for name in ("time", "independent_time") if name not in names),
        "valueReference": str(len(face.variables)),
        "description": "Time",
        "causality": "independent",
        "variability": "continuous",
        "unit": "s",
    }
    etree.SubElement(parent, "Float64", attributes)


def _structure3(root: etree._Element, face: Interface) -> None:
    structure = etree.SubElement(root, "ModelStructure")
    for group, rows in unknowns(face).items():
        for v, table in rows:
            known = sorted((k.reference, kind) for k, kind in table)
            attributes = {"valueReference": str(v.reference)} | dependency_lists(known)
            etree.SubElement(structure, _ELEMENTS[group], attributes)


def build_description(name: str, compiled: Sequence[str]) -> bytes:
    """sources/buildDescription.xml: the C files to compile."""
    root = etree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = etree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    group = etree.SubElement(configuration, "SourceFileSet", language="C99")
    for file in compiled:
        etree.SubElement(group, "SourceFile", name=file)
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)  # type: ignore[no-any-return]


_SQUARE = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}  # corners of the icon, in its own units
_MILLIMETRES = "0.1"  # the icon is 20 mm wide


def terminals(sub: Subsystem, face: Interface) -> bytes:
    """The XML file; Problem for a terminal member that is no input or output."""
    root = etree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    drawing = etree.SubElement(root, "GraphicalRepresentation")
    etree.SubElement(drawing, "CoordinateSystem", _SQUARE, suggestedScalingFactorTo_mm=_MILLIMETRES)
    etree.SubElement(drawing, "Icon", _SQUARE)
    parent = etree.SubElement(root, "Terminals") if sub.terminals else root
    inputs = {v.name for v in face.inputs}
    shown = inputs | {v.name for v in face.variables if v.output}
    for terminal in sub.terminals:
        element = etree.SubElement(
            parent,
            "Terminal",
            name=terminal.name,
            matchingRule="plug",
            terminalKind=f"harvester-cosim.{terminal.kind}",
            description=terminal.text,
        )
        for member in terminal.members:
            if member.variable not in shown:
                raise Problem(
                    f"{sub.name}: terminal {terminal.name} has the variable {member.variable}, "
                    "expected an input or an output"
                )
            etree.SubElement(
                element,
                "TerminalMemberVariable",
                variableName=member.variable,
                memberName=member.name,
                variableKind=_kind(member),
            )
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)  # type: ignore[no-any-return]


def _kind(member: Member) -> str:
    """FMI's kind: what is balanced over a connection flows in or out, the rest is a signal."""
    return f"{member.flow}flow" if member.flow else "signal"
