"""The variables of a system as text: name, unit and description, as its FMUs declare them."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from orchestrator.errors import Problem
from orchestrator.system.system import Component, Port, System
from orchestrator.units import Unit

KINDS = ("input", "output", "parameter")
WIDTH = 100  # characters

Entry = tuple[str, Unit | None, str]  # name, unit, description


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
