"""Systems from FMU files and connections given in Python, and what makes a connection fit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.system.description import read_interface
from orchestrator.system.interface import Value, Variable
from orchestrator.system.system import Component, Connection, Port, System
from orchestrator.units import Linear, conversion

SOURCES = ("output", "calculatedParameter")
TARGETS = ("input", "parameter")


def assemble(
    fmus: Mapping[str, str | Path],
    connections: Iterable[str | Sequence[str | float]] = (),
    start: Mapping[str, Value | str] | None = None,
    name: str = "system",
) -> System:
    """A system from FMU files and connections.

    fmus          component name -> path of the .fmu file
    connections   "a.y -> b.u", or (source, target), or (source, target, factor, offset) with
                  target = factor * source + offset after the unit conversion
    start         component.variable -> value
    """
    components = {n: open_component(n, Location(Path(p))) for n, p in fmus.items()}
    system = System(name, components)
    notes: list[str] = []
    joined = []
    for entry in connections:
        given = [e.strip() for e in entry.split("->")] if isinstance(entry, str) else list(entry)
        if len(given) not in (2, 3, 4):
            raise Problem(f"connection {entry!r}: expected 'a.y -> b.u' or (source, target, factor, offset)")
        linear = Linear(*(float(x) for x in given[2:]))
        joined.append(join(system, system.port(str(given[0])), system.port(str(given[1])), linear, notes))
    whole = replace(system, connections=check_single(joined), notes=tuple(notes))
    return whole.with_start(start or {})


def open_component(name: str, fmu: Location, exchange: bool = False) -> Component:
    """A component from its FMU, which takes part by Co-Simulation or by Model Exchange."""
    return Component(name, read_interface(fmu, exchange), fmu)


def join(system: System, source: Port, target: Port, after: Linear, notes: list[str]) -> Connection:
    """A checked connection with unit conversion; remarks go to `notes`."""
    plain = connection(system, source, target, after)
    units = system.variable(source).unit, system.variable(target).unit
    labels = [
        f"{port} {unit}" if unit else str(port) for port, unit in zip((source, target), units, strict=True)
    ]
    linear, note = conversion(*units, " -> ".join(labels))
    notes.extend([note] if note else [])
    return replace(plain, map=linear.then(after))


def connection(system: System, source: Port, target: Port, linear: Linear) -> Connection:
    """A connection whose causality and types fit."""
    result, y, u = Connection(source, target, linear), system.variable(source), system.variable(target)
    if y.causality not in SOURCES or u.causality not in TARGETS:
        raise Problem(f"{result}: expected an output and an input, got {y.causality} and {u.causality}")
    if family(y) != family(u) or y.kind == "String":
        raise Problem(f"{result}: variables of type {y.kind} and {u.kind} cannot be connected")
    if not y.is_real and not (linear.factor.is_integer() and linear.offset.is_integer()):
        told = f"{linear.factor:g} and {linear.offset:g}"
        raise Problem(f"{result}: expected whole factor and offset, got {told}")
    return result


def check_single(connections: Iterable[Connection]) -> tuple[Connection, ...]:
    """The connections, after checking that no input is fed twice."""
    seen: dict[Port, Connection] = {}
    for c in connections:
        if c.target in seen:
            raise Problem(f"{c.target} is fed twice, by {seen[c.target].source} and by {c.source}")
        seen[c.target] = c
    return tuple(seen.values())


def family(variable: Variable) -> str:
    """The types that may be connected: alike, and integers with enumerations."""
    return "Integer" if variable.kind == "Enumeration" else variable.kind
