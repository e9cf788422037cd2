"""Reading SSP 1.0 and 2.0: a .ssp archive, an unpacked one, a .ssd file, or a single .fmu.

Nested systems (also those in other .ssd and .ssp files) are flattened: components are named by their path,
and each component input is traced back through the connectors of systems to the output that feeds it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.units import IDENTITY, DeclaredUnit, Linear
from orchestrator.ssp.assembly import connection, open_component
from orchestrator.ssp.parameters import apply
from orchestrator.ssp.structure import SINKS, Flat, Node, Wire, find_wires, read_ssd
from orchestrator.ssp.system import Connection, Inlet, Outlet, Port, System

DEFINITION = "SystemStructure.ssd"


def load(path: str | Path, exchange: bool = False) -> System:
    """The system in an .ssp, .ssd or .fmu file, or in a folder with an unpacked SSP or FMU.

    exchange   its FMUs take part by Model Exchange; else by Co-Simulation, as `run` needs them
    """
    file = Location(Path(path))
    suffix = file.path.suffix.lower()
    if not file.path.exists():
        raise Problem(f"{file}: no such file")
    if suffix == ".fmu" or (file.path / "modelDescription.xml").is_file():
        return single(file, exchange)
    if suffix == ".ssp" or file.is_folder:
        return _load_ssd(file.member(DEFINITION), exchange)
    if suffix == ".ssd":
        return _load_ssd(file, exchange)
    raise Problem(f"{file}: expected a .ssp, .ssd or .fmu file")


def single(fmu: Location, exchange: bool = False) -> System:
    """A system of one FMU, whose inputs are those of the system."""
    component = open_component(fmu.path.stem, fmu, exchange)
    inputs = [v for v in component.interface.of("input") if v.kind != "String"]
    inlets = {v.name: Inlet(v.name, v.unit, ((Port(component.name, v.name), IDENTITY),)) for v in inputs}
    start = component.interface.start
    return System(component.name, {component.name: component}, inputs=inlets, start=start, source=fmu)


def _load_ssd(ssd: Location, exchange: bool = False) -> System:
    flat = read_ssd(ssd)
    components = {name: open_component(name, fmu, exchange) for name, fmu in flat.sources.items()}
    try:
        system = _flatten(flat, System(flat.name, components, (), {}, {}, flat.start, flat.stop, ssd))
    except Problem as problem:
        raise Problem(f"{ssd}: {str(problem).removeprefix(f'{ssd}: ')}") from None
    if not components:
        raise Problem(f"{ssd}: the system has no components: expected at least one FMU")
    return replace(system, suggestion=flat.suggestion)


def _flatten(flat: Flat, system: System) -> System:
    """Connections, inlets, outlets and start values of the flat system."""
    notes = list(flat.notes)
    wires = find_wires(flat, system)
    maps = [(wire, wire.map(flat, system, notes)) for wire in wires]
    inputs = {n.connector: _inlet(flat, system, n, maps) for n in flat.connectors("", *SINKS)}
    start = apply(flat, system, wires, notes)
    components = {name: replace(c, start=start[name]) for name, c in system.components.items()}
    return replace(
        system,
        components=components,
        connections=tuple(c for wire, linear in maps for c in _connection(flat, system, wire, linear)),
        inputs=inputs,
        outputs={o.name: o for wire, linear in maps for o in _outlet(flat, system, wire, linear)},
        notes=tuple(dict.fromkeys(notes)),
    )


def _connection(flat: Flat, system: System, wire: Wire, linear: Linear) -> list[Connection]:
    if wire.nodes[0].owner in flat.sources and wire.nodes[-1].owner in flat.sources:
        return [connection(system, wire.source, wire.target, linear)]
    return []


def _outlet(flat: Flat, system: System, wire: Wire, linear: Linear) -> list[Outlet]:
    first, last = wire.nodes[0], wire.nodes[-1]
    if first.owner in flat.sources and last.owner not in flat.sources:
        unit = flat.units.get(last) or system.variable(wire.source).unit
        return [Outlet(last.connector, unit, wire.source, linear)]
    return []


def _inlet(flat: Flat, system: System, node: Node, maps: list[tuple[Wire, Linear]]) -> Inlet:
    """An input of the outermost system; without a unit of its own it has that of the inputs it feeds."""
    targets = tuple(
        (w.target, m) for w, m in maps if w.nodes[0] == node and w.nodes[-1].owner in flat.sources
    )
    units: set[DeclaredUnit | None] = {system.variable(port).unit for port, _ in targets}
    own = flat.units.get(node) or (units.pop() if len(units) == 1 else None)
    return Inlet(node.connector, own, targets)
