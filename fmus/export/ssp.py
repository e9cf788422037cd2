"""SystemStructure.ssd of an SSP.

Writes a system of connected FMUs as an .ssp file: SSP 1.0, or 2.0 for FMUs of FMI 3.0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from lxml import etree

from fmus.export import ssp_xml
from fmus.export.diagram import Box, Point, bends, boxes
from fmus.export.package import pack
from fmus.export.ssp_structure import Element, Sets, Structure, check, read_elements, split
from fmus.export.ssp_xml import (
    REAL,
    VENDOR_NAMESPACES,
    add,
    annotate,
    parameter_set,
    root,
    text,
    units,
    write_parameters,
)
from orchestrator.base.errors import Problem


def description(s: Structure) -> bytes:
    """The file."""
    element = root("ssd:SystemStructureDescription", s.version, VENDOR_NAMESPACES, name=s.name)
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
        dictionary = add(add(system, "ssd:SignalDictionaries"), "ssd:SignalDictionary", name=ssp_xml.NAME)
        dictionary.set("source", f"resources/{ssp_xml.FILE}")
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
    sets: Sets | None = None,
    bound: Sequence[str] = (),
    columns: Sequence[Sequence[str]] = (),
    version: str = "1.0",
) -> Path:
    """Write the system `name` to `path` and return it.

    fmus         component -> its .fmu file
    connections  ("swing.swing_torque", "manipulator.swing_torque"): output to input
    inputs       input of the system -> inputs of components that it feeds; starts with the value of the first
    start        "component.variable" -> start value
    stop         stop time of the default experiment [s]
    resources    name under resources/ -> content of the file
    step         communication step [s]; tools that read no vendor annotation find it in the FMUs
    sets         name of a parameter set -> its values by "component.variable"
    bound        names of the sets that hold where nobody chooses others
    columns      components of the diagram, column by column from the left
    version      of SSP: 1.0, or 2.0, whose types are those of FMI 3.0
    """
    inputs = inputs or {}
    if version not in REAL:
        raise Problem(f"{name}: SSP version {version!r}, expected one of {', '.join(REAL)}")
    wires = [*connections, *((port, end) for port, ends in inputs.items() for end in ends)]
    elements = read_elements(fmus, wires)
    s = Structure(name, elements, wires, inputs, start or {}, sets or {}, bound, columns, stop, step, version)
    check(s)
    content = {
        "SystemStructure.ssd": description(s),
        f"resources/{ssp_xml.FILE}": ssp_xml.signal_dictionary(s),
    }
    content |= {f"resources/{c}.fmu": Path(file).read_bytes() for c, file in fmus.items()}
    content |= {f"resources/{n}.ssv": parameter_set(s, n, values) for n, values in s.sets.items()}
    content |= {f"resources/{n}": data for n, data in (resources or {}).items()}
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    pack(path, content)
    return path
