"""modelDescription.xml of FMI 2.0 for an interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version

from lxml import etree

from fmus.export.codegen import DEFAULT_TOLERANCE
from fmus.export.interface import Interface, Variable, dependencies, initial_dependencies
from fmus.units import display, parse

_LOG_CATEGORIES = {
    "logEvents": "Each call of a function",
    "logStatusWarning": "What needs attention",
    "logStatusDiscard": "Values that could not be computed",
    "logStatusError": "What went wrong",
    "logAll": "All messages",
}
_FLAGS = {
    "needsExecutionTool": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}
_COSIMULATION = {
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "true",
    "maxOutputDerivativeOrder": "1",
    "canRunAsynchronuously": "false",
}


def package_version() -> str:
    """Version of the installed distribution, "0" when it is not installed."""
    try:
        return version("harvester-cosim")
    except PackageNotFoundError:
        return "0"


def model_description(face: Interface, guid: str, sources: Sequence[str], step: float, stop: float) -> bytes:
    """The XML file; `sources` are the C files to compile, step and stop the default experiment [s]."""
    root = etree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=face.name,
        guid=guid,
        description=face.text,
        version=package_version(),
        generationTool=f"harvester-cosim {package_version()}",
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    for element, flags in (("ModelExchange", _FLAGS), ("CoSimulation", _COSIMULATION | _FLAGS)):
        kind = etree.SubElement(root, element, modelIdentifier=face.name, **flags)
        files = etree.SubElement(kind, "SourceFiles")
        for name in sources:
            etree.SubElement(files, "File", name=name)
    _units(root, face)
    categories = etree.SubElement(root, "LogCategories")
    for name, text in _LOG_CATEGORIES.items():
        etree.SubElement(categories, "Category", name=name, description=text)
    etree.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=f"{stop:.17g}",
        tolerance=f"{DEFAULT_TOLERANCE:g}",
        stepSize=f"{step:.17g}",
    )
    index = _variables(root, face)
    _structure(root, face, index)
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)  # type: ignore[no-any-return]


def _units(root: etree._Element, face: Interface) -> None:
    definitions = etree.SubElement(root, "UnitDefinitions")
    for name in sorted({v.quantity.unit for v in face.variables}):
        unit = etree.SubElement(definitions, "Unit", name=name)
        etree.SubElement(unit, "BaseUnit", base_unit(name))
        shown = display(name)
        if shown:
            etree.SubElement(unit, "DisplayUnit", name=shown[0], factor=f"{shown[1]!r}")
    if not len(definitions):
        root.remove(definitions)


def base_unit(unit: str) -> dict[str, str]:
    """Attributes of FMI's and SSP's BaseUnit element."""
    parsed = parse(unit)
    attributes = {name: str(n) for name, n in parsed.base().items()}
    return attributes if parsed.factor == 1.0 else attributes | {"factor": f"{parsed.factor!r}"}


def _variables(root: etree._Element, face: Interface) -> dict[str, int]:
    """Writes the variables; returns their index by name, counted from 1."""
    parent = etree.SubElement(root, "ModelVariables")
    index = {v.name: i for i, v in enumerate(face.variables, start=1)}
    for v in face.variables:
        state = index[v.name.removeprefix("der_")] if v.kind == "DERIVATIVE" else None
        attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.quantity.text}
        element = etree.SubElement(parent, "ScalarVariable", attributes | _causality(v))
        etree.SubElement(element, "Real", _real(v, state))
    return index


def _causality(v: Variable) -> dict[str, str]:
    if v.kind in ("FIXED", "TUNABLE"):
        return {"causality": "parameter", "variability": v.kind.lower(), "initial": "exact"}
    if v.kind == "INPUT":
        return {"causality": "input", "variability": "continuous"}
    return {
        "causality": "output" if v.output else "local",
        "variability": "continuous",
        "initial": "exact" if v.kind == "STATE" else "calculated",
    }


def _real(v: Variable, state: int | None) -> dict[str, str]:
    q = v.quantity
    shown = display(q.unit)
    numbers = {
        "min": q.minimum,
        "max": q.maximum,
        "nominal": None if q.nominal == 1.0 else q.nominal,
        "start": v.start,
    }
    return (
        {"unit": q.unit}
        | ({"displayUnit": shown[0]} if shown else {})
        | {name: f"{value:.17g}" for name, value in numbers.items() if value is not None}
        | ({"derivative": str(state)} if state is not None else {})
    )


def _structure(root: etree._Element, face: Interface, index: Mapping[str, int]) -> None:
    structure = etree.SubElement(root, "ModelStructure")
    running, starting = dependencies(face), initial_dependencies(face)
    outputs = [v for v in face.variables if v.output]
    calculated = [v for v in face.states if v.kind == "CALCULATED_STATE"]
    unknown = {v.reference: v for v in [*calculated, *face.derivatives, *face.outputs]}
    for name, variables, table in (
        ("Outputs", outputs, running),
        ("Derivatives", face.derivatives, running),
        ("InitialUnknowns", [unknown[r] for r in sorted(unknown)], starting),
    ):
        if not variables:
            continue
        parent = etree.SubElement(structure, name)
        for v in variables:
            known = sorted((index[k.name], kind) for k, kind in table[v.name])
            attributes = {
                "index": str(index[v.name]),
                "dependencies": " ".join(str(i) for i, _ in known),
                "dependenciesKind": " ".join(kind for _, kind in known),
            }
            etree.SubElement(parent, "Unknown", attributes)
