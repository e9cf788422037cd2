"""Tables of the variables of a system for the terminal: name, unit and description from its FMUs."""

import textwrap
from collections.abc import Iterator

from orchestrator.base.errors import Problem
from orchestrator.base.units import DeclaredUnit
from orchestrator.ssp.system import Component, Port, System

KINDS = ("input", "output", "parameter")
WIDTH = 100  # characters

Entry = tuple[str, DeclaredUnit | None, str]  # name, unit, description


def lines(system: System, kind: str | None = None) -> Iterator[str]:
    """Inputs and outputs of the system, then outputs, inputs and parameters of each FMU; or one kind."""
    if kind not in (None, *KINDS):
        raise Problem(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
    single = len(system.components) == 1 and not system.inputs  # the table of its FMU has the same inputs
    if kind in (None, "input") and not single:
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
        for causality in ("output", "input", "parameter"):
            if kind in (None, causality):
                yield from _table(f"{component.name}: {causality}s", _variables(system, component, causality))
        if kind is None and component.interface.unsupported:
            yield from textwrap.wrap(f"{component.name}: {component.interface.unsupported_note}", WIDTH)
            yield ""


def _description(system: System, port: Port, connected: str) -> str:
    """The description of a variable and its connection."""
    return "; ".join(filter(None, [system.variable(port).description, connected]))


def _inlets(system: System) -> list[Entry]:
    """Inputs of the system and component inputs without a source; description: that of the first target."""
    entries = []
    for inlet in (*system.inputs.values(), *system.open.values()):
        ports = [port for port, _ in inlet.targets]
        text = _description(system, ports[0], f"to {', '.join(map(str, ports))}") if ports else ""
        entries.append((inlet.name, inlet.unit, text))
    return entries


def _variables(system: System, component: Component, causality: str) -> list[Entry]:
    """The variables of one component; a connected input also has its source."""
    source = {c.target: c.source for c in system.connections}
    ports = [(Port(component.name, v.name), v.unit) for v in component.interface.of(causality)]
    return [
        (str(port), unit, _description(system, port, f"from {source[port]}" if port in source else ""))
        for port, unit in ports
    ]


def _table(title: str, entries: list[Entry]) -> Iterator[str]:
    """A table with three columns; long descriptions are wrapped."""
    if not entries:
        return
    yield title
    name_width = max(len(name) for name, _, _ in entries)
    unit_width = max(len(unit.name) if unit else 1 for _, unit, _ in entries)
    room = max(WIDTH - name_width - unit_width - 6, 30)
    for name, unit, text in entries:
        first, *more = textwrap.wrap(text, room, break_on_hyphens=False) or [""]
        head = f"  {name:<{name_width}}  {unit.name if unit else '-':<{unit_width}}  "
        yield (head + first).rstrip()
        yield from (" " * len(head) + line for line in more)
    yield ""
