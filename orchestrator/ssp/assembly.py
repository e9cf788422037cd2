"""Systems from FMU files and connections given in Python, and what makes a connection fit.

The variables of a system as text: name, unit and description, as its FMUs declare them.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.units import DeclaredUnit, Linear, conversion
from orchestrator.fmi.description import Value, Variable, read_interface
from orchestrator.ssp.system import Component, Connection, Port, System

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


KINDS = ("input", "output", "parameter")
WIDTH = 100  # characters

Entry = tuple[str, DeclaredUnit | None, str]  # name, unit, description


def lines(system: System, kind: str | None = None) -> Iterator[str]:
    """Inputs and outputs of the system, then outputs, inputs and parameters of each FMU; or only one kind."""
    if kind not in (None, *KINDS):
        raise Problem(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    alone = len(system.components) == 1 and not system.inputs  # its own table says it all
    if kind in (None, "input") and not alone:
        yield from _table(f"{system.name}: inputs for --set and scenarios", _inlets(system))
    if kind in (None, "output"):
        yield from _table(f"{system.name}: outputs of the system", _outlets(system))
    for component in system.components.values():
        if kind is None and component.interface.text:
            yield from textwrap.wrap(f"{component.name}: {component.interface.text}", WIDTH)
            yield ""
        for wanted in ("output", "input", "parameter"):
            if kind in (None, wanted):
                yield from _table(f"{component.name}: {wanted}s", _variables(system, component, wanted))
        if kind is None and component.interface.refused:
            yield from textwrap.wrap(f"{component.name}: {component.interface.left_out}", WIDTH)
            yield ""


def _inlets(system: System) -> list[Entry]:
    """Inputs of the system and component inputs that nothing feeds, told by the first target of each."""
    found = []
    for inlet in (*system.inputs.values(), *system.open.values()):
        ports = [port for port, _ in inlet.targets]
        told = [system.variable(ports[0]).text, f"to {', '.join(map(str, ports))}"] if ports else []
        found.append((inlet.name, inlet.unit, "; ".join(filter(None, told))))
    return found


def _outlets(system: System) -> list[Entry]:
    found = []
    for outlet in system.outputs.values():
        told = [system.variable(outlet.source).text, f"from {outlet.source}"]
        found.append((outlet.name, outlet.unit, "; ".join(filter(None, told))))
    return found


def _variables(system: System, component: Component, causality: str) -> list[Entry]:
    """The variables of one component; of a connected input also what feeds it."""
    fed = {c.target: c.source for c in system.connections}
    found = []
    for v in component.interface.of(causality):
        port = Port(component.name, v.name)
        told = [v.text, f"from {fed[port]}" if port in fed else ""]
        found.append((str(port), v.unit, "; ".join(filter(None, told))))
    return found


def _table(title: str, entries: list[Entry]) -> Iterator[str]:
    """Three columns; a description that needs more room goes on below itself."""
    if not entries:
        return
    yield title
    name_width = max(len(name) for name, _, _ in entries)
    unit_width = max(len(unit.name) if unit else 1 for _, unit, _ in entries)
    room = max(WIDTH - name_width - unit_width - 6, 30)
    for name, unit, text in entries:
        first, *rest = textwrap.wrap(text, room, break_on_hyphens=False) or [""]
        head = f"  {name:<{name_width}}  {unit.name if unit else '-':<{unit_width}}  "
        yield (head + first).rstrip()
        yield from (" " * len(head) + line for line in rest)
    yield ""
