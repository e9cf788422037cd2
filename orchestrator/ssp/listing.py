"""The variables of a system as text: name, unit and description, as its FMUs declare them."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from orchestrator.base.errors import Problem
from orchestrator.base.units import DeclaredUnit
from orchestrator.ssp.system import Component, Port, System

KINDS = ("input", "output", "parameter")
WIDTH = 100  # characters

Entry = tuple[str, DeclaredUnit | None, str]  # name, unit, description


def lines(system: System, kind: str | None = None) -> Iterator[str]:
    """Inputs and outputs of the system, then outputs, inputs and parameters of each FMU; or only one kind."""
    if kind not in (None, *KINDS):
        raise Problem(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    alone = len(system.components) == 1 and not system.inputs  # the table of its FMU holds the same inputs
    if kind in (None, "input") and not alone:
        yield from _table(f"{system.name}: inputs for --set and scenarios", _inlets(system))
    if kind in (None, "output"):
        outputs = [
            (o.name, o.unit, _description(system, o.source, f"from {o.source}"))
            for o in system.outputs.values()
        ]
        yield from _table(f"{system.name}: outputs of the system", outputs)
    for component in system.components.values():
        if kind is None and component.interface.description:
            yield from textwrap.wrap(f"{component.name}: {component.interface.description}", WIDTH)
            yield ""
        for wanted in ("output", "input", "parameter"):
            if kind in (None, wanted):
                yield from _table(f"{component.name}: {wanted}s", _variables(system, component, wanted))
        if kind is None and component.interface.unsupported:
            yield from textwrap.wrap(f"{component.name}: {component.interface.unsupported_note}", WIDTH)
            yield ""


def _description(system: System, port: Port, connected: str) -> str:
    """The description of a variable and what it is connected to."""
    return "; ".join(filter(None, [system.variable(port).description, connected]))


def _inlets(system: System) -> list[Entry]:
    """Inputs of the system, and component inputs that nothing feeds, with the description of their first
    target."""
    found = []
    for inlet in (*system.inputs.values(), *system.open.values()):
        ports = [port for port, _ in inlet.targets]
        text = _description(system, ports[0], f"to {', '.join(map(str, ports))}") if ports else ""
        found.append((inlet.name, inlet.unit, text))
    return found


def _variables(system: System, component: Component, causality: str) -> list[Entry]:
    """The variables of one component; for a connected input also its source."""
    source = {c.target: c.source for c in system.connections}
    ports = [(Port(component.name, v.name), v.unit) for v in component.interface.of(causality)]
    return [
        (str(port), unit, _description(system, port, f"from {source[port]}" if port in source else ""))
        for port, unit in ports
    ]


def _table(title: str, entries: list[Entry]) -> Iterator[str]:
    """Three columns; a long description continues on the next lines."""
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
