"""In which order outputs become known at a communication point, from the declared direct feed-through.

An output without feed-through is known right after the step. One with feed-through is known once the
inputs it depends on are set. Outputs that depend on each other in a circle are one `Knot`, which
`coupling/loop.py` unties: it solves a loop of declared feed-through. Where a circle exists only because an
FMU does not declare its dependencies it carries values round, and solves only if they do not settle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from orchestrator.errors import Problem
from orchestrator.system.graph import components
from orchestrator.system.knots import Feedthrough, Knot
from orchestrator.system.system import Connection, Port, System


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
