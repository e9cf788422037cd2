"""How long a communication step is, when it follows from an estimate of its error.

The estimate of a step says how far the inputs that the components worked with were from the truth, see
`Signal.deviation`; e is the worst of them over the tolerance. A step with e <= 1 is good. The next one
follows from the last two by a proportional-integral law (Gustafsson 1991, ACM Trans. Math. Softw. 17(4),
533-554),

    h_next = h (1/c)^(0.3/k) (c_before/c)^(0.4/k),      c = e / 0.8^k,

where k is the power of h that the estimate goes with. Where the components can go back, a step with e > 1 is
repeated with a shorter one; where they cannot, it stands, and only the next one is shorter.

One communication step as a plan says: the reference for native/sweep.c, which does the same in C.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from orchestrator.engine.component import Part
from orchestrator.engine.input_signal import DRIVEN
from orchestrator.engine.linear_prediction import Foresight
from orchestrator.engine.masters import Plan
from orchestrator.engine.network import Network
from orchestrator.engine.wiring import Link
from orchestrator.fmi.calls import Call

INTEGRAL, PROPORTIONAL = 0.3, 0.4  # exponents of the law, over k
SAFETY = 0.8  # of the step at which the error would just do
SHRINK, GROW = 0.2, 2.0  # limits of a change
REPEATED = 0.9  # at most this much of a step that was not good
NEARLY = 1.0 - 1e-9  # of what is left: a step that long is meant to end there
TINY, HUGE = 1e-10, 1e10  # limits of c: no error at all, and none that can be told


class Pace:
    """Chooses the next step and judges the last one.

    power       k
    smallest    a step is not made shorter than this [s]; an error above the tolerance then stands
    largest     nor longer than this [s], but for the rounding of times: a share of 1e-9
    repeats     the components can go back
    """

    def __init__(self, first: float, power: int, smallest: float, largest: float, repeats: bool) -> None:
        self.h, self.power, self.repeats = min(max(first, smallest), largest), power, repeats
        self.smallest, self.largest = smallest, largest
        self.before = 0.0  # c of the step before; 0: none
        self._uncut = 0.0  # what the step would have been without an end to hit; 0: it was not cut

    def length(self, room: float) -> float:
        """The next step [s] when the next time to hit is `room` [s] away."""
        self._uncut = 0.0
        if self.h >= room * NEARLY:
            self._uncut = self.h
            return room
        return room / 2.0 if 2.0 * self.h > room else self.h

    def good(self, e: float, h: float) -> bool:
        """Judge the step of length h [s] with the error e, a share of the tolerance; False: repeat it."""
        c = min(max(e, TINY), HUGE) / SAFETY**self.power if isfinite(e) else HUGE
        k = float(self.power)
        if not e <= 1.0 and self.repeats and h > self.smallest:
            self.h = max(h * min(REPEATED, max(SHRINK, (1.0 / c) ** (1.0 / k))), self.smallest)
            self.before = 0.0
            return False
        if self.before == 0.0:
            change = (1.0 / c) ** (1.0 / k)
        else:
            change = (1.0 / c) ** (INTEGRAL / k) * (self.before / c) ** (PROPORTIONAL / k)
        fresh = h * min(max(change, SHRINK), GROW)
        if e <= 1.0:
            fresh = max(fresh, self._uncut)
        self.h = min(max(fresh, self.smallest), self.largest)
        self.before = c
        return True


class Sweep:
    """Takes the components of a network over a step.

    turns       the components, by number, in the order in which they step
    foresight   of the inputs, where the plan wants it
    passes      how many passes the last step took
    """

    def __init__(self, network: Network, plan: Plan) -> None:
        self.network, self.plan, self.turns = network, plan, list(plan.turns)
        self.passes = 0
        network.move(plan)
        self.foresight = Foresight(network, plan.outlook, plan.turns) if plan.outlook else None
        self._arrange()

    def _arrange(self) -> None:
        """Give the components what they need when they step one by one."""
        if not self.plan.sequential:
            return
        network = self.network
        for k, calls in enumerate(newest(network, self.turns)):
            network.parts[k].newest = calls
        for k, name in enumerate(network.slaves):
            last = self.foresight is not None and k == self.turns[-1]  # nobody waits for it
            network.parts[k].reads = [] if last else network.read_again(name)

    def begin(self, t: float) -> None:
        """Once all components are initialised, at t [s]: find out what they tell."""
        if self.foresight:
            self.network.exchange(t)
            self.turns = self.foresight.begin()
            self._arrange()

    @property
    def notes(self) -> tuple[str, ...]:
        """What to tell the user."""
        return self.foresight.notes if self.foresight else ()

    def accept(self, h: float) -> None:
        """The step of length h stands."""
        self.network.accept(h)
        if self.foresight:
            self.foresight.accept(h)

    def step(self, t: float, h: float) -> None:
        """From t to t + h [s]; then all outputs are to be exchanged."""
        network, plan = self.network, self.plan
        network.ahead(t, h)
        for n in range(plan.passes):
            self._pass(t, h, n)
            self.passes = n + 1
            if plan.passes > 1:
                network.untie(h)
                if not self._miss(h) > plan.tolerance:
                    break
        for part in () if plan.sequential else network.parts:
            if part.tell:
                part.finish(h)  # slopes of outputs may follow from theirs

    @property
    def power(self) -> int:
        """The power of the step that the estimate of the error goes with."""
        if self.plan.passes > 1:
            return self.plan.degree + 1
        order = max((s.order for s in self.network.signals), default=0)
        return order + (2 if self.plan.corrected else 1)

    def error(self, h: float) -> float:
        """How far the inputs of the step were from the truth: the worst, as a share of its magnitude."""
        worst, repeated = 0.0, self.plan.passes > 1
        for s in self.network.signals:
            by_mean = self.plan.corrected and s.maker != DRIVEN
            off = s.defect(h) if by_mean else s.deviation(h, repeated)
            worst = _worse(worst, s.share(off))
        return worst

    def power_error(self, h: float) -> float:
        """The same as power: what the errors of effort and flow of the worst bond amount to, as a share."""
        worst, repeated = 0.0, self.plan.passes > 1
        for effort, flow in self.network.bonds:
            power = effort.value1 * flow.deviation(h, repeated) - flow.value1 * effort.deviation(h, repeated)
            size = effort.magnitude() * flow.magnitude()
            worst = _worse(worst, abs(power) / size if size > 0.0 else 0.0)
        return worst

    def _pass(self, t: float, h: float, n: int) -> None:
        """All components once."""
        network, plan = self.network, self.plan
        stepped = set[int]()
        for i, k in enumerate(self.turns):
            part = network.parts[k]
            if self.foresight and i == self.foresight.leads:
                self.foresight.look(h)
            if n and k not in plan.repeated:
                continue  # nothing changes what it did
            self._shape(part, h, stepped if n == 0 else None)
            if n:
                part.restore()
            for call in part.newest:
                call()
            part.advance(t, h)
            if plan.sequential:
                part.finish(h)
                part.read()
                network.arrive(h, k)
                stepped.add(k)

    def _shape(self, part: Part, h: float, stepped: set[int] | None) -> None:
        """Make the polynomials of a component's inputs; stepped: whose end is known, None: everybody's."""
        length = self.network.length
        for s in part.signals:
            if s.maker == DRIVEN:
                continue
            ended = stepped is None or (s.maker in stepped and not s.tied)
            if s.foreseen:
                if stepped is not None and ended:
                    s.hit(h)
            elif s.wanted and ended:
                s.interpolate(self.plan.degree, h, length)
            else:
                s.predict(h, length)
                if self.plan.corrected and s.wanted:
                    s.give_back(h, length)

    def _miss(self, h: float) -> float:
        """What another pass could change, at most: see `Signal.miss`."""
        worst = 0.0
        for s in self.network.signals:
            if s.maker != DRIVEN:
                worst = _worse(worst, s.miss(h))
        return worst


def _worse(a: float, b: float) -> float:
    """The larger of two errors; one that is no number is worse than any."""
    return a if b <= a or a != a else b


def newest(network: Network, turns: Sequence[int]) -> list[list[Call]]:
    """Of each component, the calls that set inputs which cannot move to the newest value of their source."""
    names, moving = list(network.slaves), network.moving | network.carried
    found: list[list[Call]] = [[] for _ in names]
    for i, k in enumerate(turns):
        early = {names[j] for j in turns[:i]}
        fed = [c for c in network.connections if c.target.component == names[k]]
        held = [c for c in fed if c.source.component in early and c.target not in moving]
        for bank in (network.real, network.whole):
            links = [c for c in held if network.bank(c.target) is bank]
            blocks = [b for b in bank.blocks if set(b.ports) & {c.target for c in links}]
            found[k] += [Link(bank, links), *(network.writer(bank, b) for b in blocks)] if links else []
    return found
