"""From chains of connectors to direct connections between components, with one linear map each."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.errors import Problem, suggest
from orchestrator.system.ssd import Flat, Hop, Node
from orchestrator.system.system import Port, System
from orchestrator.units import IDENTITY, Linear, Unit, conversion


@dataclass(frozen=True)
class Wire:
    """The way from `nodes[0]` to the component connector `nodes[-1]`; hops[i] leads to nodes[i + 1]."""

    nodes: tuple[Node, ...]
    hops: tuple[Hop, ...]

    @property
    def source(self) -> Port:
        return Port(*self.nodes[0])

    @property
    def target(self) -> Port:
        return Port(*self.nodes[-1])

    def map(self, flat: Flat, system: System, notes: list[str]) -> Linear:
        """The map over the whole way, unit conversions included."""
        first = self.nodes[0]
        start = flat.units.get(first)
        if first.owner not in flat.sources:
            return self.map_from(flat, system, first, start, notes)
        unit = system.variable(Port(*first)).unit
        linear, note = conversion(unit, start, str(first))
        notes.extend([note] if note else [])
        return linear.then(self.map_from(flat, system, first, start or unit, notes))

    def map_from(self, flat: Flat, system: System, node: Node, unit: Unit | None, notes: list[str]) -> Linear:
        """The map from a connector on the way, whose value is in `unit`, to the variable at the end."""
        at = self.nodes.index(node)
        own = system.variable(self.target).unit if self.nodes[-1].owner in flat.sources else None
        where = f"{self._label(flat, system, 0)} -> {self._label(flat, system, -1)}"
        linear = IDENTITY
        for hop, after in zip(self.hops[at:], self.nodes[at + 1 :], strict=True):
            declared = flat.units.get(after) or (own if after == self.nodes[-1] else None)
            if not hop.suppressed:
                linear = linear.then(_noted(unit, declared, where, notes))
            unit = declared or unit
            linear = linear.then(hop.map)
        return linear.then(_noted(flat.units.get(self.nodes[-1]), own, where, notes))

    def _label(self, flat: Flat, system: System, which: int) -> str:
        node = self.nodes[which]
        unit = flat.units.get(node)
        if node.owner in flat.sources:
            unit = system.variable(Port(*node)).unit
        return f"{node} {unit}" if unit else str(node)


def _noted(source: Unit | None, target: Unit | None, where: str, notes: list[str]) -> Linear:
    linear, note = conversion(source, target, where)
    notes.extend([note] if note else [])
    return linear


def find_wires(flat: Flat, system: System) -> list[Wire]:
    """The way to every fed component connector, and to every output of the outermost system."""
    ends = [n for n in flat.hops if n.owner in flat.sources]
    ends += [n for n in flat.connectors("", "output", "calculatedParameter") if n in flat.hops]
    wires = [_follow(flat, end) for end in ends]
    for node in dict.fromkeys(n for wire in wires for n in wire.nodes):
        _check(flat, system, node)
    return wires


def _follow(flat: Flat, end: Node) -> Wire:
    nodes, hops = [end], list[Hop]()
    while nodes[0] in flat.hops:
        hops.insert(0, flat.hops[nodes[0]])
        if hops[0].source in nodes:
            raise Problem(f"connection to {end}: the connectors form a circle at {hops[0].source}")
        nodes.insert(0, hops[0].source)
    return Wire(tuple(nodes), tuple(hops))


def _check(flat: Flat, system: System, node: Node) -> None:
    """A connector of a component must be a variable of its FMU."""
    if node.owner not in flat.sources:
        return
    interface = system.components[node.owner].interface
    interface.allow(node.connector, f"connection to {node}")
    variables = interface.variables
    if node.connector not in variables:
        fmu = flat.sources[node.owner]
        close = suggest(node.connector, variables)
        raise Problem(f"connection to {node}: {fmu} has no variable {node.connector!r}{close}")
