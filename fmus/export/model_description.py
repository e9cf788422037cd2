"""XML files of an FMU: modelDescription.xml of FMI 2.0 and 3.0, and two files of FMI 3.0.

These are sources/buildDescription.xml and terminalsAndIcons/terminalsAndIcons.xml, which describes the
terminals of a subsystem and the size of its icon.
"""

from collections.abc import Mapping, Sequence

from lxml import etree

from fmus.contract import Subsystem
from fmus.export.c_code import DEFAULT_TOLERANCE
from fmus.export.interface import Interface, Variable, dependencies, initial_dependencies
from orchestrator.base.errors import Problem
from orchestrator.base.units import display_conversion, normalised, parse_unit
from orchestrator.base.xml import Element, generation_tool, package_version, shortest_decimal, xml_text

COPYRIGHT = "Copyright (c) 2026 the harvester-cosim authors"  # as in LICENSE
TOOL = "harvester-cosim"  # in vendor annotations and terminal kinds
PARAMETERS = f"{TOOL}.parameters"  # annotation of the parameters whose values are not the shipped ones
LOG_CATEGORIES = {
    "logEvents": "Function calls",
    "logStatusWarning": "Warnings",
    "logStatusDiscard": "Values that could not be computed",
    "logStatusError": "Errors",
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
# FMI version -> element -> attributes of FMUs with compiled C code
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
        # after each step of the importer's solver the FMU checks the requirements of the model
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
# group of unknowns in FMI 2 -> each unknown with its dependencies, each with its dependenciesKind
Unknowns = Mapping[str, Sequence[tuple[Variable, Sequence[tuple[Variable, str]]]]]
_UNKNOWN_3 = {  # group -> element of FMI 3
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

    token          the GUID (FMI 2) or instantiation token (FMI 3)
    step, stop     default experiment [s]
    sources        C files to compile, for FMI 2; FMI 3 lists them in buildDescription.xml
    capabilities   ModelExchange and CoSimulation -> attributes; default: those of an FMU with C code
    structure      unknowns and dependencies for ModelStructure; default: derived from the equations
    """
    version = {"fmiVersion": "2.0", "guid": token, "numberOfEventIndicators": "0"}
    if fmi == 3:
        version = {"fmiVersion": "3.0", "instantiationToken": token}
    attributes = {
        "modelName": interface.name,
        "description": interface.description,
        "version": package_version(),
        "generationTool": generation_tool(),
        "author": "the harvester-cosim authors",
        "copyright": COPYRIGHT,
        "license": "MIT",
        "variableNamingConvention": "flat",
    }
    root = etree.Element("fmiModelDescription", attributes | version)
    for element, flags in (capabilities or CAPABILITIES[fmi]).items():
        type_element = etree.SubElement(root, element, modelIdentifier=interface.name, **flags)
        if sources and fmi == 2:
            files = etree.SubElement(type_element, "SourceFiles")
            for name in sources:
                etree.SubElement(files, "File", name=name)
    _units(root, interface, fmi)
    categories = etree.SubElement(root, "LogCategories")
    for name, text in LOG_CATEGORIES.items():
        etree.SubElement(categories, "Category", name=name, description=text)
    times = {"startTime": 0.0, "stopTime": stop, "tolerance": DEFAULT_TOLERANCE, "stepSize": step}
    etree.SubElement(
        root, "DefaultExperiment", {name: shortest_decimal(value) for name, value in times.items()}
    )
    if fmi == 2:
        _input_annotations(root, interface, fmi)
        _parameter_annotations(root, interface, fmi)
    _variables(root, interface, fmi)
    _structure(root, unknowns(interface) if structure is None else structure, fmi)
    if fmi == 3:
        _input_annotations(root, interface, fmi)
        _parameter_annotations(root, interface, fmi)
    return xml_text(root)


def _units(root: Element, interface: Interface, fmi: int) -> None:
    """UnitDefinitions with all units of the variables; in FMI 3 time is a variable and needs its unit."""
    names = {v.quantity.unit for v in interface.variables} | ({"s"} if fmi == 3 else set())
    definitions = etree.SubElement(root, "UnitDefinitions") if names else root
    for name in sorted(names):
        unit = etree.SubElement(definitions, "Unit", name=name)
        etree.SubElement(unit, "BaseUnit", base_unit(name))
        if display_unit := display_conversion(name):
            symbol, factor = display_unit
            etree.SubElement(unit, "DisplayUnit", name=symbol, factor=shortest_decimal(factor))


def base_unit(unit: str) -> dict[str, str]:
    """Attributes of FMI's and SSP's BaseUnit element."""
    parsed = parse_unit(unit)
    if normalised(unit) != unit:  # other tools read only this spelling
        raise Problem(f'unit "{unit}": expected "{normalised(unit)}"')
    attributes = {name: str(n) for name, n in parsed.base().items()}
    return attributes if parsed.factor == 1.0 else attributes | {"factor": shortest_decimal(parsed.factor)}


def _input_annotations(root: Element, interface: Interface, fmi: int) -> None:
    """A vendor annotation of the inputs: which is the time derivative of which, and which are optional.

    The attribute `derivative` of FMI 2.0 would declare the former, but tools such as OMSimulator count all
    variables that have it as derivatives of states, and find more states than the FMU has. In FMI 3.0 the
    attribute is used. An optional input has the text of `Quantity.optional`.
    """
    rates = [(v.name, v.quantity.rate) for v in interface.inputs if v.quantity.rate and fmi == 2]
    optional = [(v.name, v.quantity.optional) for v in interface.inputs if v.quantity.optional]
    if not rates and not optional:
        return
    container = _annotation(root, fmi, TOOL, "Inputs")
    for name, rate in rates:
        etree.SubElement(container, "InputDerivative", input=name, derivative=rate)
    for name, meaning in optional:
        etree.SubElement(container, "OptionalInput", input=name, without=meaning)


def _parameter_annotations(root: Element, interface: Interface, fmi: int) -> None:
    """A vendor annotation of the parameters with other values than the shipped FMU, and of their file."""
    by_file: dict[tuple[str, str], dict[str, float]] = {}
    for name, number in interface.not_shipped.items():
        if number.shipped is not None:
            by_file.setdefault(number.file, {})[name] = number.shipped
    if not by_file:
        return
    container = _annotation(root, fmi, PARAMETERS, "ParameterSets")
    for (file, sha256), shipped in by_file.items():
        element = etree.SubElement(container, "ParameterSet", file=file, sha256=sha256)
        for name, value in shipped.items():
            etree.SubElement(element, "Parameter", name=name, shipped=shortest_decimal(value))


def _annotation(root: Element, fmi: int, name: str, content: str) -> Element:
    """An element in an annotation of this project; the schema of FMI 2.0 allows one child of Tool."""
    parent, tag, key = (
        ("VendorAnnotations", "Tool", "name") if fmi == 2 else ("Annotations", "Annotation", "type")
    )
    annotations = root.find(parent)
    if annotations is None:
        annotations = etree.SubElement(root, parent)
    return etree.SubElement(etree.SubElement(annotations, tag, {key: name}), content)


def _variables(root: Element, interface: Interface, fmi: int) -> None:
    parent = etree.SubElement(root, "ModelVariables")
    # a model by hand has states without derivatives
    derivative_of = {dx.name: x for dx, x in zip(interface.derivatives, interface.states, strict=False)}
    if fmi == 3:
        derivative_of |= {v.quantity.rate: v for v in interface.inputs if v.quantity.rate}
    for v in interface.variables:
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.quantity.text}
        attributes |= _causality(v)
        derivative = {"derivative": _index(derivative_of[v.name], fmi)} if v.name in derivative_of else {}
        if fmi == 2:
            scalar = etree.SubElement(parent, "ScalarVariable", attributes)
            etree.SubElement(scalar, "Real", _real_attributes(v) | derivative)
        else:
            intermediate = {} if v.kind in ("FIXED", "TUNABLE") else {"intermediateUpdate": "true"}
            etree.SubElement(parent, "Float64", attributes | intermediate | derivative | _real_attributes(v))
    if fmi == 3:  # time is appended as the last variable
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


def _index(v: Variable, fmi: int) -> str:
    """How attributes refer to a variable: by its index from 1 in FMI 2, by its value reference in FMI 3."""
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


def _real_attributes(v: Variable) -> dict[str, str]:
    """Attributes of a real variable: units, bounds, nominal and start value."""
    q = v.quantity
    display_unit = display_conversion(q.unit)
    nominal = None if q.nominal == 1.0 else q.nominal
    values = {"min": q.minimum, "max": q.maximum, "nominal": nominal, "start": v.start}
    return (
        {"unit": q.unit}
        | ({"displayUnit": display_unit[0]} if display_unit else {})
        | {name: shortest_decimal(value) for name, value in values.items() if value is not None}
    )


def unknowns(interface: Interface) -> Unknowns:
    """Outputs, Derivatives and InitialUnknowns, each with its dependencies."""
    current, initial = dependencies(interface), initial_dependencies(interface)
    calculated = [v for v in interface.states if v.kind == "CALCULATED_STATE"]
    initial_unknowns = sorted(
        [*calculated, *interface.derivatives, *interface.outputs], key=lambda v: v.reference
    )
    return {
        "Outputs": [(v, current[v.name]) for v in interface.variables if v.output],
        "Derivatives": [(v, current[v.name]) for v in interface.derivatives],
        "InitialUnknowns": [(v, initial[v.name]) for v in initial_unknowns],
    }


def _structure(root: Element, unknown: Unknowns, fmi: int) -> None:
    structure = etree.SubElement(root, "ModelStructure")
    for group, rows in unknown.items():
        if not rows:
            continue
        parent = etree.SubElement(structure, group) if fmi == 2 else structure
        for v, knowns in rows:
            knowns = sorted(knowns, key=lambda pair: pair[0].reference)
            attributes = {
                "index" if fmi == 2 else "valueReference": _index(v, fmi),
                "dependencies": " ".join(_index(known, fmi) for known, _ in knowns),
                "dependenciesKind": " ".join(kind for _, kind in knowns),
            }
            etree.SubElement(parent, "Unknown" if fmi == 2 else _UNKNOWN_3[group], attributes)


def build_description(name: str, sources: Sequence[str]) -> bytes:
    """sources/buildDescription.xml: the C files to compile."""
    root = etree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = etree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = etree.SubElement(configuration, "SourceFileSet", language="C99")
    for source in sources:
        etree.SubElement(files, "SourceFile", name=source)
    return xml_text(root)


_SQUARE = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}  # extent of the icon
_MM_PER_UNIT = "0.1"  # so the icon is 20 mm wide


def terminals(sub: Subsystem, interface: Interface) -> bytes:
    """terminalsAndIcons.xml; raises Problem for a terminal member that is not an input or output."""
    root = etree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    drawing = etree.SubElement(root, "GraphicalRepresentation")
    etree.SubElement(drawing, "CoordinateSystem", _SQUARE, suggestedScalingFactorTo_mm=_MM_PER_UNIT)
    etree.SubElement(drawing, "Icon", _SQUARE)
    parent = etree.SubElement(root, "Terminals") if sub.terminals else root
    visible = {v.name for v in interface.variables if v.output or v.kind == "INPUT"}
    for terminal in sub.terminals:
        kind = f"{TOOL}.{terminal.kind}"
        attributes = {"name": terminal.name, "matchingRule": "plug", "terminalKind": kind}
        element = etree.SubElement(parent, "Terminal", attributes | {"description": terminal.text})
        for member in terminal.members:
            if member.variable not in visible:
                raise Problem(
                    f"{sub.name}: terminal {terminal.name}: {member.variable} is not an input or output"
                )
            # FMI: a flow variable, whose sum over a connection is zero, is inflow or outflow
            attributes = {
                "variableName": member.variable,
                "memberName": member.name,
                "variableKind": f"{member.flow}flow" if member.flow else "signal",
            }
            etree.SubElement(element, "TerminalMemberVariable", attributes)
    return xml_text(root)
