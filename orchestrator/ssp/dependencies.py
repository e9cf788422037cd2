"""Direct feed-through between components: the order in which outputs become known, and algebraic loops.

An output without feed-through is known right after the step, one with feed-through once the inputs that it
depends on are set. Outputs that depend on each other are a `DependencyCycle`. Where the FMUs declare these
dependencies it is an algebraic loop, which is solved. Where an FMU does not, values are carried round first,
and the loop is solved only if they do not settle (`engine/algebraic_loop.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

from orchestrator.base.errors import Problem
from orchestrator.ssp.system import Connection, Port, System

SHOWN = 6  # connections in a text


@dataclass(frozen=True)
class DependencyCycle:
    """Outputs that depend on each other in a circle: an algebraic loop, or perhaps one.

    connections   of Real values from outputs of the cycle to inputs that its outputs depend on
    declared      the FMUs declare these dependencies; else some declare none, and there may be no loop at all
    rounds        how often its outputs are read where some signals are not Real, so not solved for; else 1
    discrete      an output in a circle of declared dependencies that is not Real
    passes        how often values are carried round before a loop is supposed; 0 where one is declared
    text          the loop, to begin a note or a message
    """

    connections: tuple[Connection, ...]
    declared: bool
    rounds: int
    discrete: Port | None
    passes: int
    text: str


@dataclass(frozen=True)
class OutputOrder:
    """When outputs are read at a communication point, in stages counted from 0.

    stages   output -> its stages
    notes    remarks for the user
    cycles   with their stages; nothing else reads their outputs and sets their inputs
    """

    stages: Mapping[Port, tuple[int, ...]]
    notes: tuple[str, ...] = ()
    cycles: tuple[tuple[DependencyCycle, tuple[int, ...]], ...] = ()

    @property
    def count(self) -> int:
        return max((s[-1] for s in self.stages.values()), default=-1) + 1


def output_order(system: System) -> OutputOrder:
    """The stages of all outputs of the system during the run."""
    feedthrough = Feedthrough(system)
    graph = feedthrough.graph
    stages: dict[Port, tuple[int, ...]] = {}
    notes: list[str] = []
    cycles: list[tuple[DependencyCycle, tuple[int, ...]]] = []
    for group in strongly_connected(graph):
        first = 1 + max((stages[p][-1] for y in group for p in graph[y] if p not in group), default=-1)
        cycle = feedthrough.cycle(group)
        when = tuple(range(first, first + (cycle.rounds if cycle else 1)))
        stages |= dict.fromkeys(group, when)
        if cycle is None:
            continue
        if cycle.discrete:
            kind = system.variable(cycle.discrete).kind
            got = f"expected Real signals, to be solved for, got {kind} {cycle.discrete}"
            raise Problem(f"{cycle.text}: {got}")
        if cycle.rounds > 1:
            notes.append(
                f"{cycle.text}; its signals that are not Real are read {cycle.rounds} times per step"
            )
        cycles += [(cycle, when)] if cycle.connections else []
    return OutputOrder(stages, tuple(notes), tuple(cycles))


class Feedthrough:
    """Direct dependencies of a system.

    graph   output -> outputs that it depends on through connections
    """

    def __init__(self, system: System, initially: bool = False) -> None:
        """initially: those of initialisation mode, else those of the run."""
        self._system, self._initially = system, initially
        source = {c.target: c.source for c in system.connections}
        self.graph: dict[Port, list[Port]] = {}
        for component in system.components.values():
            for v in component.interface.variables.values():
                if v.causality in ("output", "calculatedParameter"):
                    output = Port(component.name, v.name)
                    self.graph[output] = [source[u] for u in sorted(self.depends(output)) if u in source]

    def depends(self, output: Port) -> set[Port]:
        """The variables of its own component that an output depends on; all where the FMU does not say."""
        interface = self._system.components[output.component].interface
        known = interface.initial_knowns if self._initially else interface.direct_inputs
        return {Port(output.component, name) for name in known(output.variable)}

    def declares(self, output: Port) -> bool:
        """Does the FMU declare what an output depends on?"""
        interface = self._system.components[output.component].interface
        declared = interface.initial_dependencies if self._initially else interface.feedthrough
        return declared.get(output.variable) is not None

    def cycle(self, group: list[Port]) -> DependencyCycle | None:
        """The cycle of a strongly connected group of outputs; None where the output does not depend on
        itself."""
        if not _circular(self.graph, group):
            return None
        declared = {y: [p for p in self.graph[y] if p in group and self.declares(y)] for y in group}
        circles = [g for g in strongly_connected(declared) if _circular(declared, g)]
        involved = sorted({y.component for y in group})
        discrete = [y for y in group if not self._real(y)]
        needed = set().union(*map(self.depends, group))
        inside = [c for c in self._system.connections if c.source in group and c.target in needed]
        return DependencyCycle(
            connections=tuple(c for c in inside if self._real(c.source)),
            declared=bool(circles),
            rounds=len(involved) + 1 if discrete else 1,
            discrete=next((y for g in circles for y in g if y in discrete), None),
            passes=0 if circles else len(involved) + 1,
            text=self._loop_text(circles[0], inside) if circles else self._silent_text(group, involved),
        )

    def _real(self, port: Port) -> bool:
        return self._system.variable(port).is_real

    def _loop_text(self, group: list[Port], inside: list[Connection]) -> str:
        """The connections of a loop, beginning with one way round."""
        first = [self._connection(*pair) for pair in pairwise(_way_round(self.graph, group))]
        names = [str(c) for c in dict.fromkeys([*first, *inside])]
        more = f", and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        return f"algebraic loop {', '.join(names[:SHOWN])}{more}"

    def _silent_text(self, group: list[Port], involved: list[str]) -> str:
        silent = ", ".join(sorted(str(y) for y in group if not self.declares(y)))
        message = f"{silent}: direct dependencies are not declared"
        return f"{message}, which would make an algebraic loop of {' and '.join(involved)}"

    def _connection(self, source: Port, output: Port) -> Connection:
        """The connection by which `source` reaches `output`."""
        known = self.depends(output)
        return next(c for c in self._system.connections if c.source == source and c.target in known)


# ---- graphs; NetworkX has these, too, but takes longer to import than a short run ----------------------

Graph = Mapping[Port, Iterable[Port]]  # node -> nodes that must be known before


def strongly_connected(graph: Graph) -> list[list[Port]]:
    """Strongly connected groups, each after the groups it depends on (Tarjan 1972, doi 10.1137/0201010)."""
    index: dict[Port, int] = {}
    low: dict[Port, int] = {}
    stack: list[Port] = []  # visited nodes that are in no group yet
    grouped: set[Port] = set()
    groups: list[list[Port]] = []

    def visit(node: Port) -> tuple[Port, Iterator[Port]]:
        index[node] = low[node] = len(index)
        stack.append(node)
        return node, iter(graph[node])

    for root in graph:
        path = [] if root in index else [visit(root)]
        while path:
            node, rest = path[-1]
            for before in rest:
                if before not in index:
                    path.append(visit(before))
                    break
                if before not in grouped:
                    low[node] = min(low[node], index[before])
            else:
                path.pop()
                if path:
                    parent = path[-1][0]
                    low[parent] = min(low[parent], low[node])
                if low[node] == index[node]:
                    start = stack.index(node)
                    groups.append(stack[start:])
                    grouped.update(stack[start:])
                    del stack[start:]
    return groups


def _circular(graph: Graph, group: list[Port]) -> bool:
    """Do the nodes of a strongly connected group depend on themselves?"""
    return len(group) > 1 or group[0] in graph[group[0]]


def _way_round(graph: Graph, group: list[Port]) -> list[Port]:
    """One way round in a circular group; it ends where it begins, and each node needs the one before it."""
    path, inside = [group[0]], set(group)
    while True:
        before = next(p for p in graph[path[-1]] if p in inside)
        if before in path:
            return [*path[path.index(before) :], before][::-1]
        path.append(before)
