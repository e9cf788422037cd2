"""Writes a system of connected FMUs as an .ssp file (SSP 1.0)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
from lxml import etree

from fmus.contract import ModelError
from fmus.export.model_description import package_version
from fmus.export.package import pack
from fmus.export.vendor import NAMESPACES, annotate

_SSP = "http://ssp-standard.org/SSP1/SystemStructure"
_NAMESPACES = {"ssc": f"{_SSP}Common", "ssd": f"{_SSP}Description", "ssv": f"{_SSP}ParameterValues"}
_SCALE = {"factor": 1.0, "offset": 0.0}  # value in base units = factor * value + offset
_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_WIDTH, _GAP, _PITCH = 60.0, 60.0, 4.0  # of the diagram [mm]


@dataclass(frozen=True)
class _Element:
    """A component to be: its description and the connectors to show, by name."""

    description: Any
    variables: Mapping[str, Any]
    inputs: Sequence[str]
    outputs: Sequence[str]


def write_ssp(
    path: Path,
    name: str,
    fmus: Mapping[str, Path],
    connections: Sequence[tuple[str, str]],
    inputs: Mapping[str, Sequence[str]] | None = None,
    start: Mapping[str, float] | None = None,
    stop: float = 10.0,
    resources: Mapping[str, bytes] | None = None,
    step: float = 1e-3,
) -> Path:
    """Write the system `name` to `path` and return it.

    fmus         component -> its .fmu file
    connections  ("swing.swing_torque", "manipulator.swing_torque"): output to input
    inputs       input of the system -> inputs of components that it feeds; starts with the value of the first
    start        "component.variable" -> start value
    stop         stop time of the default experiment [s]
    resources    name under resources/ -> content of the file
    step         communication step [s]; tools that read no vendor annotation find it in the FMUs
    """
    inputs, start, resources = inputs or {}, start or {}, resources or {}
    descriptions = {c: fmpy.read_model_description(str(file), validate=False) for c, file in fmus.items()}
    variables = {c: {v.name: v for v in d.modelVariables} for c, d in descriptions.items()}
    wires = [*connections, *((name, end) for name, ends in inputs.items() for end in ends)]
    _check(name, variables, wires, inputs)
    _check_start(name, variables, start)
    elements = {c: _element(c, d, variables[c], wires) for c, d in descriptions.items()}
    root = _description(name, elements, wires, inputs, start, stop, step)
    content = {
        "SystemStructure.ssd": etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    }
    content |= {f"resources/{c}.fmu": Path(file).read_bytes() for c, file in fmus.items()}
    content |= {f"resources/{n}": data for n, data in resources.items()}
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    pack(path, content)
    return path


# ---- checks ----------------------------------------------------------------------------------------


def _split(port: str) -> tuple[str, str]:
    component, _, variable = port.partition(".")
    return component, variable


def _variable(system: str, variables: Mapping[str, Mapping[str, Any]], port: str, causality: str) -> Any:
    component, variable = _split(port)
    if component not in variables:
        raise ModelError(f"{system}: {port} names no component, expected one of {', '.join(variables)}")
    found = variables[component].get(variable)
    if found is None or found.causality != causality:
        got = "no such variable" if found is None else f"causality {found.causality}"
        raise ModelError(f"{system}: {port} has {got}, expected an {causality} of {component}")
    return found


def _check(
    system: str,
    variables: Mapping[str, Mapping[str, Any]],
    wires: Sequence[tuple[str, str]],
    inputs: Mapping[str, Sequence[str]],
) -> None:
    fed: dict[str, str] = {}
    for source, end in wires:
        target = _variable(system, variables, end, "input")
        if end in fed:
            raise ModelError(
                f"{system}: {end} is connected to {fed[end]} and to {source}, expected one source"
            )
        fed[end] = source
        first = inputs[source][0] if source in inputs else source
        unit = _variable(system, variables, first, "input" if source in inputs else "output").unit
        if unit != target.unit:
            raise ModelError(
                f"{system}: {source} is in {unit}, {end} in {target.unit}; expected the same unit"
            )


def _check_start(system: str, variables: Mapping[str, Mapping[str, Any]], start: Mapping[str, float]) -> None:
    for port in start:
        component, variable = _split(port)
        if variable not in variables.get(component, {}):
            raise ModelError(f"{system}: start value of {port}, which is no variable of a component")


# ---- SystemStructure.ssd ---------------------------------------------------------------------------


def _tag(name: str) -> str:
    prefix, local = name.split(":")
    return f"{{{_NAMESPACES[prefix]}}}{local}"


def _add(parent: etree._Element, tag: str, /, **attributes: object) -> etree._Element:
    texts = {key: f"{v:.17g}" if isinstance(v, float) else str(v) for key, v in attributes.items()}
    return etree.SubElement(parent, _tag(tag), texts)


def _element(
    name: str, description: Any, variables: Mapping[str, Any], wires: Sequence[tuple[str, str]]
) -> _Element:
    """Shown are all outputs, and the inputs that are connected: the others keep their start value."""
    fed = {end for _, end in wires}
    return _Element(
        description,
        variables,
        [v.name for v in variables.values() if v.causality == "input" and f"{name}.{v.name}" in fed],
        [v.name for v in variables.values() if v.causality == "output"],
    )


def _description(
    name: str,
    elements: Mapping[str, _Element],
    wires: Sequence[tuple[str, str]],
    inputs: Mapping[str, Sequence[str]],
    start: Mapping[str, float],
    stop: float,
    step: float,
) -> etree._Element:
    root = etree.Element(_tag("ssd:SystemStructureDescription"), nsmap=_NAMESPACES | NAMESPACES)
    root.attrib.update(
        {"version": "1.0", "name": name, "generationTool": f"harvester-cosim {package_version()}"}
    )
    system = _add(root, "ssd:System", name=name)
    if inputs:
        _system_inputs(system, name, elements, inputs)
    parent = _add(system, "ssd:Elements")
    corners = _layout(elements, wires, inputs)
    for component, element in elements.items():
        _component(parent, component, element, corners[component], start)
    connections = _add(system, "ssd:Connections") if wires else system
    for source, end in wires:
        _connection(connections, source, end, inputs)
    _units(root, elements)  # no SystemGeometry: OMSimulator 3.0 refuses it
    experiment = _add(root, "ssd:DefaultExperiment", startTime=0.0, stopTime=float(stop))
    annotate(system, experiment, step)
    return root


def _system_inputs(
    system: etree._Element,
    name: str,
    elements: Mapping[str, _Element],
    inputs: Mapping[str, Sequence[str]],
) -> None:
    """Connectors of the system and their start values: a tool that got none would feed zeros."""
    connectors = _add(system, "ssd:Connectors")
    first = {
        port: elements[_split(ends[0])[0]].variables[_split(ends[0])[1]] for port, ends in inputs.items()
    }
    for i, (port, variable) in enumerate(first.items()):
        _connector(connectors, port, "input", variable.unit, 0.0, (i + 1) / (len(inputs) + 1))
    _start_values(system, name, first, {port: float(v.start) for port, v in first.items()})


def _component(
    parent: etree._Element,
    name: str,
    element: _Element,
    corners: tuple[float, float, float, float],
    start: Mapping[str, float],
) -> None:
    component = _add(
        parent,
        "ssd:Component",
        name=name,
        type="application/x-fmu-sharedlibrary",
        source=f"resources/{name}.fmu",
        implementation="CoSimulation",
    )
    connectors = _add(component, "ssd:Connectors")
    for kind, names, x in (("input", element.inputs, 0.0), ("output", element.outputs, 1.0)):
        for i, variable in enumerate(names):
            unit = element.variables[variable].unit
            _connector(connectors, variable, kind, unit, x, 1 - (i + 1) / (len(names) + 1))
    if not len(connectors):
        component.remove(connectors)
    _add(component, "ssd:ElementGeometry", **dict(zip(("x1", "y1", "x2", "y2"), corners, strict=True)))
    values = {_split(port)[1]: value for port, value in start.items() if _split(port)[0] == name}
    if values:
        _start_values(component, name, element.variables, values)


def _connector(parent: etree._Element, name: str, kind: str, unit: str | None, x: float, y: float) -> None:
    connector = _add(parent, "ssd:Connector", name=name, kind=kind)
    _add(connector, "ssc:Real", **({"unit": unit} if unit else {}))
    _add(connector, "ssd:ConnectorGeometry", x=x, y=y)


def _start_values(
    parent: etree._Element, name: str, variables: Mapping[str, Any], values: Mapping[str, float]
) -> None:
    binding = _add(_add(parent, "ssd:ParameterBindings"), "ssd:ParameterBinding")
    holder = _add(binding, "ssd:ParameterValues")
    parameters = _add(_add(holder, "ssv:ParameterSet", version="1.0", name=f"{name}_start"), "ssv:Parameters")
    for variable, value in values.items():
        unit = variables[variable].unit
        parameter = _add(parameters, "ssv:Parameter", name=variable)
        _add(parameter, "ssv:Real", value=float(value), **({"unit": unit} if unit else {}))


def _connection(parent: etree._Element, source: str, end: str, inputs: Mapping[str, Sequence[str]]) -> None:
    ends: dict[str, object] = {}
    if source in inputs:
        ends["startConnector"] = source
    else:
        ends["startElement"], ends["startConnector"] = _split(source)
    ends["endElement"], ends["endConnector"] = _split(end)
    _add(parent, "ssd:Connection", **ends)


def _units(root: etree._Element, elements: Mapping[str, _Element]) -> None:
    found = {u.name: u for e in elements.values() for u in e.description.unitDefinitions}
    if not found:
        return
    parent = _add(root, "ssd:Units")
    for name in sorted(found):
        base = found[name].baseUnit
        exponents = {k: getattr(base, k) for k in _BASE if base is not None and getattr(base, k)}
        scale = {k: getattr(base, k) for k, v in _SCALE.items() if base is not None and getattr(base, k) != v}
        _add(_add(parent, "ssc:Unit", name=name), "ssc:BaseUnit", **exponents, **scale)


def _layout(
    elements: Mapping[str, _Element], wires: Sequence[tuple[str, str]], inputs: Mapping[str, Sequence[str]]
) -> dict[str, tuple[float, float, float, float]]:
    """Corners x1, y1, x2, y2 of each component: those fed by the system left, the others right of them."""
    first = {_split(end)[0] for source, end in wires if source in inputs}
    corners, height = {}, [0.0, 0.0]
    for name, element in elements.items():
        column = 0 if name in first or not first else 1
        x, y = column * (_WIDTH + _GAP), height[column]
        size = _PITCH * (max(len(element.inputs), len(element.outputs)) + 1)
        corners[name] = (x, y, x + _WIDTH, y + size)
        height[column] += size + _GAP / 2
    return corners
