"""What a master decides before a run; `sweep.py` carries it out at every step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from orchestrator.system.dependencies import sequence
from orchestrator.system.system import Connection, Port, System


@dataclass(frozen=True)
class Outlook:
    """What `foresight.py` works with.

    leads   so many components step first: their future depends on no other component
    open    components that declare to tell how their states and outputs change
    all     there are no others, but for those that lead
    heard   inputs that a state depends on, or an output that feeds another component
    lag     steps for which a linearisation is kept
    """

    leads: int
    open: frozenset[str]
    all: bool
    heard: frozenset[Port]
    lag: int


@dataclass(frozen=True)
class Plan:
    """One way to take all components over a step.

    turns        the components, by number, in the order in which they step
    moved        the connections whose inputs move inside the step; the others are held
    order        degree at which a source is continued that has not stepped yet
    degree       degree at which both ends of a source are connected that has
    sequential   the inputs of a component know what the sources before it in the order have done
    passes       how often the step is computed at most; more than once needs rollback
    tolerance    a further pass is made while the last one changed a signal by more, as a share of its
                 magnitude
    corrected    continued sources get back what they lost, see `Signal.give_back`
    watches      the inputs that do not move are watched too, for the estimate of the error
    repeated     the components, by number, that further passes compute again
    notes        what to tell the user
    outlook      inputs are foretold from linearisations
    """

    turns: Sequence[int]
    moved: Sequence[Connection]
    order: int
    degree: int
    sequential: bool = False
    passes: int = 1
    tolerance: float = 0.0
    corrected: bool = False
    watches: bool = False
    repeated: frozenset[int] = frozenset()
    notes: tuple[str, ...] = ()
    outlook: Outlook | None = None

    @property
    def sloped(self) -> bool:
        """Are the slopes of sources wanted?"""
        return self.order > 0 or self.degree > 1 or self.corrected or self.watches

    def asks(self, component: str) -> bool:
        """Are the slopes of the outputs of this component wanted?"""
        known = self.outlook is not None and self.outlook.all and component in self.outlook.open
        return self.sloped and not known


def turns(system: System) -> list[int]:
    """The order, by number, in which components step one after the other."""
    places = {name: i for i, name in enumerate(system.components)}
    return [places[name] for name in sequence(system)]


def unsettled(system: System, order: Sequence[int]) -> frozenset[int]:
    """The components, by number, that a second pass can change when they step in this order.

    These are fed by one that does not step before them, or by one that a second pass changes.
    """
    names, wires = list(system.components), system.connections
    turn = {names[k]: i for i, k in enumerate(order)}
    found = {c.target.component for c in wires if turn[c.source.component] >= turn[c.target.component]}
    while more := {c.target.component for c in wires if c.source.component in found} - found:
        found |= more
    return frozenset(map(names.index, found))
