"""`assemble`: makes a system from FMU files and connections; and checks of a connection."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.options import Seconds, seconds
from orchestrator.base.units import LinearTransformation, conversion
from orchestrator.fmi.description import FmuVariable, Value, read_interface
from orchestrator.ssp.coupling import Coupling, Suggestion
from orchestrator.ssp.system import Component, Connection, Inlet, Port, System

SOURCES = ("output", "calculatedParameter")
TARGETS = ("input", "parameter")


def assemble(
    fmus: Mapping[str, str | Path],
    connections: Iterable[str | Sequence[str | float]] = (),
    start: Mapping[str, Value | str] | None = None,
    name: str = "system",
    inputs: Mapping[str, Sequence[str]] | None = None,
    stop: Seconds = None,
    step: Seconds = None,
    shared: Mapping[str, Sequence[str]] | None = None,
    exchange: bool = False,
) -> System:
    """A system from FMU files and connections.

    fmus          component name -> path of the .fmu file
    connections   "a.y -> b.u", or (source, target), or (source, target, factor, offset) with
                  target = factor * source + offset after the unit conversion
    start         component.variable -> value
    inputs        input of the system -> component inputs that it feeds; the first one gives the unit
    stop          default stop time of a run [s], or with a unit, such as "2 s"
    step          default communication step of a run [s], or with a unit, with Gauss-Seidel
    shared        parameter -> components in which a parameter of this name is the same physical quantity
    exchange      read the FMUs for Model Exchange; default: for Co-Simulation, as `run` needs
    """
    components = {n: open_component(n, Location(Path(p)), exchange) for n, p in fmus.items()}
    system = System(name, components)
    notes: list[str] = []
    checked = []
    for entry in connections:
        parts = [e.strip() for e in entry.split("->")] if isinstance(entry, str) else list(entry)
        if len(parts) not in (2, 3, 4):
            raise Problem(f"connection {entry!r}: expected 'a.y -> b.u' or (source, target, factor, offset)")
        linear = LinearTransformation(*(float(x) for x in parts[2:]))
        ends = system.port(str(parts[0])), system.port(str(parts[1]))
        checked.append(_connect(system, *ends, linear, notes))
    inlets = {n: _inlet(system, n, ends, notes) for n, ends in (inputs or {}).items()}
    _check_one_source(checked, inlets)
    length = seconds(step, "step")
    suggestion = Suggestion() if length is None else Suggestion(Coupling("gauss-seidel"), length)
    system = replace(
        system,
        connections=tuple(checked),
        inputs=inlets,
        stop=seconds(stop, "stop"),
        suggestion=suggestion,
        notes=tuple(notes),
        shared={parameter: tuple(names) for parameter, names in (shared or {}).items()},
    ).with_start(start or {}, origin="")
    system.check_sharing()
    return system


def open_component(name: str, fmu: Location, exchange: bool = False) -> Component:
    """A component from its FMU; exchange: for Model Exchange, not Co-Simulation."""
    return Component(name, read_interface(fmu, exchange), fmu)


def _connect(
    system: System, source: Port, target: Port, after: LinearTransformation, notes: list[str]
) -> Connection:
    """A checked connection with unit conversion."""
    plain = check_connection(system, source, target, after)
    units = system.variable(source).unit, system.variable(target).unit
    labels = [f"{p} {unit}" if unit else str(p) for p, unit in zip((source, target), units, strict=True)]
    linear, note = conversion(*units, " -> ".join(labels))
    notes.extend([note] if note else [])
    return replace(plain, map=linear.then(after))


def _inlet(system: System, name: str, targets: Sequence[str], notes: list[str]) -> Inlet:
    """An input of the system, with unit conversions."""
    ports = [system.port(target) for target in targets]
    for port in ports:
        if (causality := system.variable(port).causality) != "input":
            raise Problem(f"{name} -> {port}: expected an input, got {causality}")
    unit = system.variable(ports[0]).unit
    maps = [conversion(unit, system.variable(p).unit, f"{name} {unit} -> {p}") for p in ports]
    notes.extend(note for _, note in maps if note)
    return Inlet(name, unit, tuple((port, linear) for port, (linear, _) in zip(ports, maps, strict=True)))


def check_connection(system: System, source: Port, target: Port, linear: LinearTransformation) -> Connection:
    """A connection; raises Problem if causalities or types do not fit."""
    connection, y, u = Connection(source, target, linear), system.variable(source), system.variable(target)
    if y.causality not in SOURCES or u.causality not in TARGETS:
        raise Problem(f"{connection}: expected an output and an input, got {y.causality} and {u.causality}")
    if connectable_type(y) != connectable_type(u) or y.kind == "String":
        raise Problem(f"{connection}: variables of type {y.kind} and {u.kind} cannot be connected")
    if not y.is_real and not (linear.factor.is_integer() and linear.offset.is_integer()):
        got = f"{linear.factor:g} and {linear.offset:g}"
        raise Problem(f"{connection}: expected integer factor and offset, got {got}")
    return connection


def _check_one_source(connections: Iterable[Connection], inlets: Mapping[str, Inlet]) -> None:
    """Refuse a component input with two sources."""
    source_of: dict[Port, object] = {}
    feeds = [(c.target, c.source) for c in connections]
    for target, source in [*feeds, *((port, i.name) for i in inlets.values() for port, _ in i.targets)]:
        if target in source_of:
            raise Problem(f"{target}: expected one source, got {source_of[target]} and {source}")
        source_of[target] = source


def connectable_type(variable: FmuVariable) -> str:
    """The type for connections: equal types may be connected; enumerations count as integers."""
    return "Integer" if variable.kind == "Enumeration" else variable.kind
