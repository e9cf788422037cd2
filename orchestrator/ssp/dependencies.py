"""In which order outputs become known at a communication point, from the declared direct feed-through.

An output without feed-through is known right after the step. One with feed-through is known once the
inputs it depends on are set. Outputs that depend on each other in a circle are one `Knot`, which
`coupling/loop.py` unties: it solves a loop of declared feed-through. Where a circle exists only because an
FMU does not declare its dependencies it carries values round, and solves only if they do not settle.

Groups of a graph that depend on each other in a circle.

Which outputs depend on which others through connections, and where they do so in a circle.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

from orchestrator.base.errors import Problem
from orchestrator.ssp.system import Connection, Port, System


@dataclass(frozen=True)
class Order:
    """stages[port]: the stages, counted from 0, in which an output is read. `notes`: remarks for the user.

    knots   with the stages in which they are untied; nothing else reads their outputs and sets their inputs
    """

    stages: Mapping[Port, tuple[int, ...]]
    notes: tuple[str, ...] = ()
    knots: tuple[tuple[Knot, tuple[int, ...]], ...] = ()

    @property
    def count(self) -> int:
        return max((s[-1] for s in self.stages.values()), default=-1) + 1


def output_order(system: System) -> Order:
    """Stages of all outputs of the system during the run."""
    flow = Feedthrough(system)
    stages: dict[Port, tuple[int, ...]] = {}
    notes: list[str] = []
    knots: list[tuple[Knot, tuple[int, ...]]] = []
    for group in components(flow.graph):
        first = 1 + max((stages[p][-1] for y in group for p in flow.graph[y] if p not in group), default=-1)
        knot = flow.knot(group)
        when = tuple(range(first, first + (knot.rounds if knot else 1)))
        stages |= dict.fromkeys(group, when)
        if knot:
            notes += _checked(system, knot)
            knots += [(knot, when)] if knot.connections else []
    return Order(stages, tuple(notes), tuple(knots))


def _checked(system: System, knot: Knot) -> list[str]:
    """What to say about signals of a knot that are not Real."""
    if knot.discrete:
        kind = system.variable(knot.discrete).kind
        raise Problem(f"{knot.text}: expected Real signals, to be solved for, got {kind} {knot.discrete}")
    if knot.rounds == 1:
        return []
    return [f"{knot.text}; its signals that are not Real are read {knot.rounds} times per step"]


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


Graph = Mapping[Port, Iterable[Port]]  # node -> nodes that must be known before


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


def circular(graph: Graph, group: list[Port]) -> bool:
    """Do the nodes of a strongly connected group depend on themselves?"""
    return len(group) > 1 or group[0] in graph[group[0]]


def circle(graph: Graph, group: list[Port]) -> list[Port]:
    """One way round in a circular group; it ends where it begins, and each node needs the one before it."""
    path, inside = [group[0]], set(group)
    while True:
        before = next(p for p in graph[path[-1]] if p in inside)
        if before in path:
            return [*path[path.index(before) :], before][::-1]
        path.append(before)


SHOWN = 6  # connections in a text


@dataclass(frozen=True)
class Knot:
    """Outputs that depend on each other in a circle: an algebraic loop, or perhaps one.

    connections   of Real values from outputs of the knot to inputs that outputs of the knot depend on
    declared      the FMUs declare these dependencies; else some do not say, and there may be no loop at all
    rounds        how often its outputs are read where signals in it are not Real, which nobody can solve for;
                  else 1
    discrete      an output in a circle of declared dependencies that is not Real
    sweeps        how often values are carried round before a loop is supposed; 0 where one is declared
    text          what it is, to begin a note or a message
    """

    connections: tuple[Connection, ...]
    declared: bool
    rounds: int
    discrete: Port | None
    sweeps: int
    text: str


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
        face = self._system.components[output.component].interface
        known = face.depends_initially if self._initially else face.depends
        return {Port(output.component, name) for name in known(output.variable)}

    def declares(self, output: Port) -> bool:
        """Does the FMU tell what an output depends on?"""
        face = self._system.components[output.component].interface
        return (face.initially if self._initially else face.feedthrough).get(output.variable) is not None

    def knot(self, group: list[Port]) -> Knot | None:
        """What there is to untie in one of the `components` of the graph."""
        if not circular(self.graph, group):
            return None
        declared = {y: self._inside(y, group) if self.declares(y) else [] for y in group}
        circles = [g for g in components(declared) if circular(declared, g)]
        involved = sorted({y.component for y in group})
        discrete = [y for y in group if not self._real(y)]
        needed = set().union(*map(self.depends, group))
        inside = [c for c in self._system.connections if c.source in group and c.target in needed]
        return Knot(
            connections=tuple(c for c in inside if self._real(c.source)),
            declared=bool(circles),
            rounds=len(involved) + 1 if discrete else 1,
            discrete=next((y for g in circles for y in g if y in discrete), None),
            sweeps=0 if circles else len(involved) + 1,
            text=self._loop(circles[0], inside) if circles else self._silence(group, involved),
        )

    def _inside(self, output: Port, group: list[Port]) -> list[Port]:
        return [p for p in self.graph[output] if p in group]

    def _real(self, port: Port) -> bool:
        return self._system.variable(port).is_real

    def _loop(self, group: list[Port], inside: list[Connection]) -> str:
        """The connections of a loop, beginning with one way round."""
        first = [self._wire(*pair) for pair in pairwise(circle(self.graph, group))]
        names = [str(c) for c in dict.fromkeys([*first, *inside])]
        more = f", and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        return f"algebraic loop {', '.join(names[:SHOWN])}{more}"

    def _silence(self, group: list[Port], involved: list[str]) -> str:
        silent = ", ".join(sorted(str(y) for y in group if not self.declares(y)))
        whole = " and ".join(involved)
        told = f"{silent}: direct dependencies are not declared"
        return f"{told}, which would make an algebraic loop of {whole}"

    def _wire(self, source: Port, output: Port) -> Connection:
        """The connection by which `source` reaches `output`."""
        known = self.depends(output)
        return next(c for c in self._system.connections if c.source == source and c.target in known)
