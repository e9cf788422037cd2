"""modelDescription.xml and sources/buildDescription.xml of FMI 3.0 for an interface."""

from __future__ import annotations

from collections.abc import Sequence

from lxml import etree

from fmus.export.interface import Interface
from fmus.export.model_description import (
    causality,
    default_experiment,
    dependency_lists,
    identity,
    log_categories,
    numbers,
    units,
    unknowns,
)

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
    _variables(root, face)
    _structure(root, face)
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)  # type: ignore[no-any-return]


def _variables(root: etree._Element, face: Interface) -> None:
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


def _structure(root: etree._Element, face: Interface) -> None:
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
