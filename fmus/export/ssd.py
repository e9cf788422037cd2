"""SystemStructure.ssd of an SSP."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lxml import etree

from fmus.export import ssb
from fmus.export.geometry import Box, Point, bends, boxes
from fmus.export.sspxml import REAL, add, root, text, units
from fmus.export.ssv import write_parameters
from fmus.export.structure import Element, Structure, split
from fmus.export.vendor import NAMESPACES, annotate


def description(s: Structure) -> bytes:
    """The file."""
    element = root("ssd:SystemStructureDescription", s.version, NAMESPACES, name=s.name)
    system = add(element, "ssd:System", name=s.name)
    if s.inputs:
        _system_inputs(system, s)
    _bindings(system, s)
    parent = add(system, "ssd:Elements")
    placed = boxes(s)
    for name, component in s.elements.items():
        _component(parent, s, name, component, placed[name])
    _connections(system, s, bends(s, placed))
    if s.version != "1.0":  # OMSimulator 3.0 opens no SSP 1.0 with a SignalDictionary or a SystemGeometry
        dictionary = add(add(system, "ssd:SignalDictionaries"), "ssd:SignalDictionary", name=ssb.NAME)
        dictionary.set("source", f"resources/{ssb.FILE}")
    units(element, "ssd", [e.description for e in s.elements.values()])
    experiment = add(element, "ssd:DefaultExperiment", startTime=0.0, stopTime=float(s.stop))
    annotate(system, experiment, s.step)
    return text(element)


def _system_inputs(system: etree._Element, s: Structure) -> None:
    """Connectors of the system."""
    connectors = add(system, "ssd:Connectors")
    for i, port in enumerate(s.inputs):
        place = (0.0, (i + 1) / (len(s.inputs) + 1))
        _connector(connectors, s.version, port, "input", s.variable(port).unit, place)


def _bindings(system: etree._Element, s: Structure) -> None:
    """Start values of the system's inputs (a tool that got none would feed zeros), and the chosen sets."""
    if s.inputs or s.bound:
        holder = add(system, "ssd:ParameterBindings")
    if s.inputs:
        _inline(
            holder, s.version, s.name, {p: float(s.variable(p).start) for p in s.inputs}, _units(s, s.inputs)
        )
    for name in s.bound:
        add(holder, "ssd:ParameterBinding", source=f"resources/{name}.ssv")


def _units(s: Structure, ports: Sequence[str] | Mapping[str, object]) -> dict[str, str | None]:
    return {port: s.variable(port).unit for port in ports}


def _component(parent: etree._Element, s: Structure, name: str, element: Element, box: Box) -> None:
    component = add(
        parent,
        "ssd:Component",
        name=name,
        type="application/x-fmu-sharedlibrary",
        source=f"resources/{name}.fmu",
        implementation="CoSimulation",
        description=element.description.description or None,
    )
    if element.inputs or element.outputs:
        connectors = add(component, "ssd:Connectors")
        for kind, names in (("input", element.inputs), ("output", element.outputs)):
            for v in names:
                _connector(connectors, s.version, v, kind, element.variables[v].unit, box.connector(v))
    add(component, "ssd:ElementGeometry", **dict(zip(("x1", "y1", "x2", "y2"), box.corners, strict=True)))
    values = {split(port)[1]: value for port, value in s.start.items() if split(port)[0] == name}
    if values:
        named = {v: element.variables[v].unit for v in values}
        _inline(add(component, "ssd:ParameterBindings"), s.version, name, values, named)


def _connector(
    parent: etree._Element, version: str, name: str, kind: str, unit: str | None, place: Point
) -> None:
    connector = add(parent, "ssd:Connector", name=name, kind=kind)
    add(connector, f"ssc:{REAL[version]}", unit=unit or None)
    add(connector, "ssd:ConnectorGeometry", x=place[0], y=place[1])


def _inline(
    bindings: etree._Element,
    version: str,
    name: str,
    values: Mapping[str, float],
    named: Mapping[str, str | None],
) -> None:
    """A binding that holds its values itself."""
    holder = add(add(bindings, "ssd:ParameterBinding"), "ssd:ParameterValues")
    write_parameters(
        add(holder, "ssv:ParameterSet", version=version, name=f"{name}_start"), version, values, named
    )


def _connections(
    system: etree._Element, s: Structure, waypoints: Mapping[tuple[str, str], Sequence[Point]]
) -> None:
    if not s.wires:
        return
    parent = add(system, "ssd:Connections")
    for source, end in s.wires:
        first = (None, source) if source in s.inputs else split(source)
        names = dict(
            zip(
                ("startElement", "startConnector", "endElement", "endConnector"),
                (*first, *split(end)),
                strict=True,
            )
        )
        connection = add(parent, "ssd:Connection", **names)
        points = waypoints.get((source, end))
        if points:
            xs, ys = (" ".join(f"{p[i]:.6g}" for p in points) for i in (0, 1))
            add(connection, "ssd:ConnectionGeometry", pointsX=xs, pointsY=ys)
