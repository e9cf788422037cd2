"""Systems from FMU files and connections given in Python, and what makes a connection fit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from orchestrator.base.coupling import Coupling, Suggestion
from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.units import LinearTransformation, conversion
from orchestrator.fmi.description import FmuVariable, Value, read_interface
from orchestrator.ssp.system import Component, Connection, Inlet, Port, System

SOURCES = ("output", "calculatedParameter")
TARGETS = ("input", "parameter")


def assemble(
    fmus: Mapping[str, str | Path],
    connections: Iterable[str | Sequence[str | float]] = (),
    start: Mapping[str, Value | str] | None = None,
    name: str = "system",
    inputs: Mapping[str, Sequence[str]] | None = None,
    stop: float | None = None,
    step: float | None = None,
) -> System:
    """A system from FMU files and connections.

    fmus          component name -> path of the .fmu file
    connections   "a.y -> b.u", or (source, target), or (source, target, factor, offset) with
                  target = factor * source + offset after the unit conversion
    start         component.variable -> value
    inputs        input of the whole system -> component inputs that it feeds; the first one gives the unit
    stop          stop time [s] where a run gives no other
    step          communication step [s] where a run gives no other, with Gauss-Seidel
    """
    components = {n: open_component(n, Location(Path(p))) for n, p in fmus.items()}
    system = System(name, components)
    notes: list[str] = []
    connected = []
    for entry in connections:
        given = [e.strip() for e in entry.split("->")] if isinstance(entry, str) else list(entry)
        if len(given) not in (2, 3, 4):
            raise Problem(f"connection {entry!r}: expected 'a.y -> b.u' or (source, target, factor, offset)")
        linear = LinearTransformation(*(float(x) for x in given[2:]))
        ends = system.port(str(given[0])), system.port(str(given[1]))
        connected.append(_connect(system, *ends, linear, notes))
    inlets = {n: _inlet(system, n, ends, notes) for n, ends in (inputs or {}).items()}
    _check_single(connected, inlets)
    suggestion = Suggestion() if step is None else Suggestion(Coupling("gauss-seidel"), step)
    return replace(
        system,
        connections=tuple(connected),
        inputs=inlets,
        stop=stop,
        suggestion=suggestion,
        notes=tuple(notes),
    ).with_start(start or {})


def open_component(name: str, fmu: Location, exchange: bool = False) -> Component:
    """A component from its FMU, which takes part by Co-Simulation or by Model Exchange."""
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
    """An input of the whole system."""
    ports = [system.port(target) for target in targets]
    for port in ports:
        if (causality := system.variable(port).causality) != "input":
            raise Problem(f"{name} -> {port}: expected an input, got {causality}")
    unit = system.variable(ports[0]).unit
    maps = [conversion(unit, system.variable(p).unit, f"{name} {unit} -> {p}") for p in ports]
    notes.extend(note for _, note in maps if note)
    return Inlet(name, unit, tuple((port, linear) for port, (linear, _) in zip(ports, maps, strict=True)))


def check_connection(system: System, source: Port, target: Port, linear: LinearTransformation) -> Connection:
    """A connection whose causality and types fit."""
    result, y, u = Connection(source, target, linear), system.variable(source), system.variable(target)
    if y.causality not in SOURCES or u.causality not in TARGETS:
        raise Problem(f"{result}: expected an output and an input, got {y.causality} and {u.causality}")
    if family(y) != family(u) or y.kind == "String":
        raise Problem(f"{result}: variables of type {y.kind} and {u.kind} cannot be connected")
    if not y.is_real and not (linear.factor.is_integer() and linear.offset.is_integer()):
        got = f"{linear.factor:g} and {linear.offset:g}"
        raise Problem(f"{result}: expected whole factor and offset, got {got}")
    return result


def _check_single(connections: Iterable[Connection], inlets: Mapping[str, Inlet]) -> None:
    """Refuse a component input that is fed twice."""
    seen: dict[Port, object] = {}
    feeds = [(c.target, c.source) for c in connections]
    for target, source in [*feeds, *((port, i.name) for i in inlets.values() for port, _ in i.targets)]:
        if target in seen:
            raise Problem(f"{target} is fed twice, by {seen[target]} and by {source}")
        seen[target] = source


def family(variable: FmuVariable) -> str:
    """The types that may be connected: equal ones, and integers with enumerations."""
    return "Integer" if variable.kind == "Enumeration" else variable.kind
