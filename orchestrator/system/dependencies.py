"""In which order outputs become known at a communication point, from the declared direct feed-through.

An output without feed-through is known right after the step. One with feed-through is known once the
inputs it depends on are set. A loop of declared feed-through is an algebraic loop and is refused. A loop
that exists only because an FMU does not declare its dependencies is evaluated in repeated sweeps instead,
which is exact unless it is a true algebraic loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

from orchestrator.errors import Problem
from orchestrator.system.system import Connection, Port, System

Graph = Mapping[Port, Iterable[Port]]  # node -> nodes that must be known before


@dataclass(frozen=True)
class Order:
    """stages[port]: the stages, counted from 0, in which an output is read. `notes`: remarks for the user."""

    stages: Mapping[Port, tuple[int, ...]]
    notes: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        return max((s[-1] for s in self.stages.values()), default=-1) + 1


def output_order(system: System) -> Order:
    """Stages of all outputs of the system during the run."""
    graph = feedthrough(system, lambda c, y: system.components[c].interface.depends(y))
    stages: dict[Port, tuple[int, ...]] = {}
    notes: list[str] = []
    for group in components(graph):
        first = 1 + max((stages[p][-1] for y in group for p in graph[y] if p not in group), default=-1)
        sweeps = _sweeps(system, graph, group, notes)
        for y in group:
            stages[y] = tuple(range(first, first + sweeps))
    return Order(stages, tuple(notes))


def feedthrough(system: System, depends: Callable[[str, str], Iterable[str]]) -> dict[Port, list[Port]]:
    """Output -> outputs that it depends on through connections."""
    source = {c.target: c.source for c in system.connections}
    graph = {}
    for component in system.components.values():
        for v in component.interface.variables.values():
            if v.causality in ("output", "calculatedParameter"):
                inputs = [Port(component.name, u) for u in depends(component.name, v.name)]
                graph[Port(component.name, v.name)] = [source[u] for u in sorted(inputs) if u in source]
    return graph


def _sweeps(system: System, graph: Graph, group: list[Port], notes: list[str]) -> int:
    """How often the outputs of one strongly connected group must be read."""
    if len(group) == 1 and group[0] not in graph[group[0]]:
        return 1
    declared = {
        y: [p for p in graph[y] if p in group]
        if system.components[y.component].interface.feedthrough.get(y.variable) is not None
        else []
        for y in group
    }
    for inner in components(declared):
        if len(inner) > 1 or inner[0] in declared[inner[0]]:
            raise Problem(f"algebraic loop through direct feed-through: {describe(system, declared, inner)}")
    silent = sorted({str(y) for y in group if not declared[y]})
    involved = sorted({y.component for y in group})
    notes.append(
        f"{', '.join(silent)}: direct dependencies are not declared, which would make an algebraic loop of "
        f"{' and '.join(involved)}; their outputs are read {len(involved) + 1} times per step instead"
    )
    return len(involved) + 1


def describe(system: System, graph: Graph, group: list[Port]) -> str:
    """One cycle of a group as connections: 'a.y -> b.u, b.y -> a.u'."""
    path, inside = [group[0]], set(group)
    while True:
        before = next(p for p in graph[path[-1]] if p in inside)
        if before in path:
            cycle = [*path[path.index(before) :], before][::-1]
            break
        path.append(before)
    wires = [_wire(system, a, b) for a, b in pairwise(cycle)]
    return ", ".join(wires)


def _wire(system: System, source: Port, output: Port) -> str:
    """The connection by which `source` reaches `output`."""
    known = system.components[output.component].interface.depends(output.variable)
    for c in system.connections:
        if c.source == source and c.target.component == output.component and c.target.variable in known:
            return str(c)
    return f"{source} -> {output.component}"


def components(graph: Graph) -> list[list[Port]]:
    """Strongly connected groups, each after the groups it depends on (Tarjan's algorithm)."""
    index: dict[Port, int] = {}
    low: dict[Port, int] = {}
    stack: list[Port] = []
    on_stack: set[Port] = set()
    groups: list[list[Port]] = []
    for root in graph:
        work: list[tuple[Port, Iterator[Port]]] = [] if root in index else [(root, iter(()))]
        while work:
            node, remaining = work[-1]
            if node not in index:
                index[node] = low[node] = len(index)
                stack.append(node)
                on_stack.add(node)
                remaining = iter(graph[node])
                work[-1] = (node, remaining)
            for before in remaining:
                if before not in index:
                    work.append((before, iter(())))
                    break
                if before in on_stack:
                    low[node] = min(low[node], index[before])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    groups.append(_pop(stack, on_stack, node))
    return groups


def _pop(stack: list[Port], on_stack: set[Port], node: Port) -> list[Port]:
    """The group that ends with `node`."""
    group: list[Port] = []
    while not group or group[-1] != node:
        group.append(stack.pop())
        on_stack.discard(group[-1])
    return group[::-1]


def sequence(system: System) -> list[str]:
    """Components in the order in which Gauss-Seidel steps them.

    Next comes the component with the fewest inputs that feed through to its outputs and still wait for a
    component not yet stepped; then the one with the fewest waiting inputs; then one that holds its inputs
    before one that interpolates them (which gains from coming later); then the given order.
    """
    direct = {
        Port(c.name, u)
        for c in system.components.values()
        for y in c.interface.of("output")
        for u in c.interface.depends(y.name)
    }
    left, done = list(system.components), list[str]()
    while left:
        best = min(left, key=lambda name: _waiting(system, name, left, direct))
        left.remove(best)
        done.append(best)
    return done


def _waiting(system: System, name: str, left: list[str], direct: set[Port]) -> tuple[int, int, bool]:
    open_: list[Connection] = [
        c for c in system.connections if c.target.component == name and c.source.component in left
    ]
    open_ = [c for c in open_ if c.source.component != name]
    interpolates = system.components[name].interface.sloped
    return sum(c.target in direct for c in open_), len(open_), bool(interpolates)
