"""modelDescription.xml of FMI 2.0 and 3.0, and the files that FMI 3.0 puts beside it.

Those are sources/buildDescription.xml and terminalsAndIcons/terminalsAndIcons.xml: the terminals of a
subsystem, and the size of its icon.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lxml import etree

from fmus.contract import Subsystem
from fmus.export.c_code import DEFAULT_TOLERANCE
from fmus.export.interface import Interface, Variable, dependencies, initial_dependencies
from orchestrator.base.errors import Problem
from orchestrator.base.units import display_conversion, normalised, parse
from orchestrator.base.xml import Element, shortest_decimal
from orchestrator.ssp.xml_writing import generation_tool, package_version, xml_text

COPYRIGHT = "Copyright (c) 2026 the harvester-cosim authors"  # as in LICENSE
TOOL = "harvester-cosim"  # in vendor annotations
LOG_CATEGORIES = {
    "logEvents": "Each call of a function",
    "logStatusWarning": "What needs attention",
    "logStatusDiscard": "Values that could not be computed",
    "logStatusError": "What went wrong",
    "logAll": "All messages",
}
_COMMON = {
    2: {
        "needsExecutionTool": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    },
    3: {
        "needsExecutionTool": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
        "providesAdjointDerivatives": "true",
    },
}
# version of FMI -> element -> attributes, of FMUs with C code
CAPABILITIES: Mapping[int, Mapping[str, Mapping[str, str]]] = {
    2: {
        "ModelExchange": _COMMON[2],
        "CoSimulation": {
            "canHandleVariableCommunicationStepSize": "true",
            "canInterpolateInputs": "true",
            "maxOutputDerivativeOrder": "1",
            "canRunAsynchronuously": "false",
        }
        | _COMMON[2],
    },
    3: {
        # after each step of the importer's solver the FMU checks what its model requires
        "ModelExchange": _COMMON[3] | {"needsCompletedIntegratorStep": "true"},
        "CoSimulation": _COMMON[3]
        | {
            "canHandleVariableCommunicationStepSize": "true",
            "maxOutputDerivativeOrder": "1",
            "providesIntermediateUpdate": "true",
            "canReturnEarlyAfterIntermediateUpdate": "true",
            "hasEventMode": "true",
        },
    },
}
# group of unknowns, as FMI 2 calls it -> each unknown with what it depends on, and FMI's kind of that
Unknowns = Mapping[str, Sequence[tuple[Variable, Sequence[tuple[Variable, str]]]]]
_UNKNOWN_3 = {  # the elements of FMI 3
    "Outputs": "Output",
    "Derivatives": "ContinuousStateDerivative",
    "InitialUnknowns": "InitialUnknown",
}


def model_description(
    interface: Interface,
    fmi: int,
    token: str,
    step: float,
    stop: float,
    sources: Sequence[str] = (),
    capabilities: Mapping[str, Mapping[str, str]] | None = None,
    structure: Unknowns | None = None,
) -> bytes:
    """The content of modelDescription.xml, of FMI 2 or 3.

    token          the GUID, or the instantiation token
    step, stop     default experiment [s]
    sources        C files to compile; FMI 3 has a buildDescription.xml for them
    capabilities   ModelExchange and CoSimulation -> attributes; by default those of an FMU with C code
    structure      the unknowns; by default from the equations
    """
    version = {"fmiVersion": "2.0", "guid": token, "numberOfEventIndicators": "0"}
    if fmi == 3:
        version = {"fmiVersion": "3.0", "instantiationToken": token}
    about = {
        "modelName": interface.name,
        "description": interface.text,
        "version": package_version(),
        "generationTool": generation_tool(),
        "author": "the harvester-cosim authors",
        "copyright": COPYRIGHT,
        "license": "MIT",
        "variableNamingConvention": "flat",
    }
    root = etree.Element("fmiModelDescription", about | version)
    for element, flags in (capabilities or CAPABILITIES[fmi]).items():
        kind = etree.SubElement(root, element, modelIdentifier=interface.name, **flags)
        if sources and fmi == 2:
            _files(etree.SubElement(kind, "SourceFiles"), "File", sources)
    _units(root, interface, fmi)
    categories = etree.SubElement(root, "LogCategories")
    for name, text in LOG_CATEGORIES.items():
        etree.SubElement(categories, "Category", name=name, description=text)
    times = {"startTime": 0.0, "stopTime": stop, "tolerance": DEFAULT_TOLERANCE, "stepSize": step}
    etree.SubElement(
        root, "DefaultExperiment", {name: shortest_decimal(value) for name, value in times.items()}
    )
    if fmi == 2:
        _input_derivatives(root, interface)
    _variables(root, interface, fmi)
    _structure(root, unknowns(interface) if structure is None else structure, fmi)
    return xml_text(root)


def _files(parent: Element, element: str, names: Sequence[str]) -> None:
    for name in names:
        etree.SubElement(parent, element, name=name)


def _units(root: Element, interface: Interface, fmi: int) -> None:
    """All units of the variables; in FMI 3 time is a variable, too."""
    names = {v.quantity.unit for v in interface.variables} | ({"s"} if fmi == 3 else set())
    definitions = etree.SubElement(root, "UnitDefinitions") if names else root
    for name in sorted(names):
        unit = etree.SubElement(definitions, "Unit", name=name)
        etree.SubElement(unit, "BaseUnit", base_unit(name))
        if shown := display_conversion(name):
            etree.SubElement(unit, "DisplayUnit", name=shown[0], factor=shortest_decimal(shown[1]))


def base_unit(unit: str) -> dict[str, str]:
    """Attributes of FMI's and SSP's BaseUnit element."""
    parsed = parse(unit)
    if normalised(unit) != unit:  # what other tools read goes into the file
        raise Problem(f'unit "{unit}": expected "{normalised(unit)}"')
    attributes = {name: str(n) for name, n in parsed.base().items()}
    return attributes if parsed.factor == 1.0 else attributes | {"factor": shortest_decimal(parsed.factor)}


def _input_derivatives(root: Element, interface: Interface) -> None:
    """Which input is the time derivative of which, as an annotation.

    FMI 2.0 has the attribute `derivative` for that, but tools count the variables that carry it as states:
    OMSimulator expects 7 of manipulator.fmu, which has 4.
    """
    pairs = [(v.name, v.quantity.rate) for v in interface.inputs if v.quantity.rate]
    if not pairs:
        return
    tool = etree.SubElement(etree.SubElement(root, "VendorAnnotations"), "Tool", name=TOOL)
    listed = etree.SubElement(tool, "InputDerivatives")  # the schema allows one element in a tool's
    for name, rate in pairs:
        etree.SubElement(listed, "InputDerivative", input=name, derivative=rate)


def _variables(root: Element, interface: Interface, fmi: int) -> None:
    parent = etree.SubElement(root, "ModelVariables")
    derived = {dx.name: x for dx, x in zip(interface.derivatives, interface.states, strict=False)}
    if fmi == 3:
        derived |= {v.quantity.rate: v for v in interface.inputs if v.quantity.rate}
    for v in interface.variables:
        about = {"name": v.name, "valueReference": str(v.reference), "description": v.quantity.text}
        about |= _causality(v)
        derivative = {"derivative": _pointer(derived[v.name], fmi)} if v.name in derived else {}
        if fmi == 2:
            scalar = etree.SubElement(parent, "ScalarVariable", about)
            etree.SubElement(scalar, "Real", _numbers(v) | derivative)
        else:
            moves = {} if v.kind in ("FIXED", "TUNABLE") else {"intermediateUpdate": "true"}
            etree.SubElement(parent, "Float64", about | moves | derivative | _numbers(v))
    if fmi == 3:  # the independent variable follows the last one
        names = {v.name for v in interface.variables}
        time = {
            "name": "independent_time" if "time" in names else "time",
            "valueReference": str(len(interface.variables)),
            "description": "Time",
            "causality": "independent",
            "variability": "continuous",
            "unit": "s",
        }
        etree.SubElement(parent, "Float64", time)


def _pointer(v: Variable, fmi: int) -> str:
    """How others refer to a variable: FMI 2 counts from 1, FMI 3 takes the value reference."""
    return str(v.reference + 1 if fmi == 2 else v.reference)


def _causality(v: Variable) -> dict[str, str]:
    """Attributes causality, variability and initial."""
    if v.kind in ("FIXED", "TUNABLE"):
        return {"causality": "parameter", "variability": v.kind.lower(), "initial": "exact"}
    if v.kind == "INPUT":
        return {"causality": "input", "variability": "continuous"}
    return {
        "causality": "output" if v.output else "local",
        "variability": "continuous",
        "initial": "exact" if v.kind == "STATE" else "calculated",
    }


def _numbers(v: Variable) -> dict[str, str]:
    """Attributes of a real variable: units, bounds, nominal and start value."""
    q = v.quantity
    shown = display_conversion(q.unit)
    nominal = None if q.nominal == 1.0 else q.nominal
    values = {"min": q.minimum, "max": q.maximum, "nominal": nominal, "start": v.start}
    return (
        {"unit": q.unit}
        | ({"displayUnit": shown[0]} if shown else {})
        | {name: shortest_decimal(value) for name, value in values.items() if value is not None}
    )


def unknowns(interface: Interface) -> Unknowns:
    """Outputs, Derivatives and InitialUnknowns, each with what it depends on."""
    running, starting = dependencies(interface), initial_dependencies(interface)
    calculated = [v for v in interface.states if v.kind == "CALCULATED_STATE"]
    first = sorted([*calculated, *interface.derivatives, *interface.outputs], key=lambda v: v.reference)
    return {
        "Outputs": [(v, running[v.name]) for v in interface.variables if v.output],
        "Derivatives": [(v, running[v.name]) for v in interface.derivatives],
        "InitialUnknowns": [(v, starting[v.name]) for v in first],
    }


def _structure(root: Element, unknown: Unknowns, fmi: int) -> None:
    structure = etree.SubElement(root, "ModelStructure")
    for group, rows in unknown.items():
        parent = etree.SubElement(structure, group) if fmi == 2 and rows else structure
        for v, table in rows:
            known = sorted(table, key=lambda pair: pair[0].reference)
            attributes = {
                "index" if fmi == 2 else "valueReference": _pointer(v, fmi),
                "dependencies": " ".join(_pointer(k, fmi) for k, _ in known),
                "dependenciesKind": " ".join(kind for _, kind in known),
            }
            etree.SubElement(parent, "Unknown" if fmi == 2 else _UNKNOWN_3[group], attributes)


def build_description(name: str, compiled: Sequence[str]) -> bytes:
    """sources/buildDescription.xml: the C files to compile."""
    root = etree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = etree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    _files(etree.SubElement(configuration, "SourceFileSet", language="C99"), "SourceFile", compiled)
    return xml_text(root)


_SQUARE = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}  # corners of the icon, in its own units
_MILLIMETRES = "0.1"  # the icon is 20 mm wide


def terminals(sub: Subsystem, interface: Interface) -> bytes:
    """The XML file; Problem for a terminal member that is no input or output."""
    root = etree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    drawing = etree.SubElement(root, "GraphicalRepresentation")
    etree.SubElement(drawing, "CoordinateSystem", _SQUARE, suggestedScalingFactorTo_mm=_MILLIMETRES)
    etree.SubElement(drawing, "Icon", _SQUARE)
    parent = etree.SubElement(root, "Terminals") if sub.terminals else root
    visible = {v.name for v in interface.variables if v.output or v.kind == "INPUT"}
    for terminal in sub.terminals:
        kind = f"harvester-cosim.{terminal.kind}"
        about = {"name": terminal.name, "matchingRule": "plug", "terminalKind": kind}
        element = etree.SubElement(parent, "Terminal", about | {"description": terminal.text})
        for member in terminal.members:
            if member.variable not in visible:
                raise Problem(
                    f"{sub.name}: terminal {terminal.name} has the variable {member.variable}, "
                    "expected an input or an output"
                )
            # FMI's kind: what is balanced over a connection flows in or out, the rest is a signal
            attributes = {
                "variableName": member.variable,
                "memberName": member.name,
                "variableKind": f"{member.flow}flow" if member.flow else "signal",
            }
            etree.SubElement(element, "TerminalMemberVariable", attributes)
    return xml_text(root)
