"""Integration of a plant over its events; `reference` and components in Model Exchange are integrated here.

The method of a subclass begins anew at every event:

    time event       announced by an FMU
    state event      an event indicator changes its sign; located to rounding
    step event       an FMU asks for it after an accepted step
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.engine.plant import Plant
from orchestrator.fmi.instance import CallFailed
from orchestrator.fmi.messages import ERROR
from orchestrator.ssp.system import Port

MAX_EVENTS = 1000  # at one time
NAMED_EVENTS = 10  # whose signals a message names


class Solver(Protocol):
    """Steps of a method: `advance` takes one, up to its target at most; `inside` interpolates in the last.

    advance   returns time [s], states, True for a state event
    """

    def advance(self) -> tuple[float, Array, bool]: ...
    def inside(self, t: float) -> Array: ...


def known(plant: Plant, t: float, indicators: Array) -> Array:
    """Event indicators at a time [s] of a state that a solver has accepted, none of which may be NaN."""
    if not (lost := np.isnan(indicators)).any():
        return indicators
    counts = {name: slave.interface.event_indicators for name, slave in plant.slaves.items()}
    names = [f"{name}: event indicator {k + 1}" for name, count in counts.items() for k in range(count)]
    raise Problem(f"{names[int(lost.argmax())]}: expected a finite value, got nan at t = {t:.9g} s")


class Integration:
    """Integrates a plant; a subclass is told on the way.

    tolerance   relative; absolute: times the magnitude of a state
    same        times that are closer are equal [s]
    counts      evaluations, Jacobians, indicators, steps, events
    sampled     external inputs that are not continuous: their changes are events
    happened    times of the events [s], each with the signals, not continuous, that changed
    broken      an FMU has failed, which forbids further calls (FMI 2.0.5, 2.1.3), or the user has interrupted
    """

    sampled: Sequence[Port] = ()

    def __init__(self, plant: Plant, tolerance: float, same: float) -> None:
        self.plant, self.tolerance, self.same = plant, tolerance, same
        self.counts = Counter[str]()
        self.problem: BaseException | None = None
        self.broken, self.happened = False, list[tuple[float, tuple[str, ...]]]()
        self._at: tuple[float, bytes] = (np.nan, b"")

    # ---- for subclasses

    def solver(self, t: float, x: Array, target: float) -> Solver:
        """A solver that begins at a time [s] and a state."""
        raise NotImplementedError

    def check(self, t: float) -> None:
        """Called before each step."""

    def evaluate(self, t: float, x: Array) -> None:
        """Evaluate the plant at a time [s] and a state."""
        self.plant.settle_at(t, x)

    def stepped(self, solver: Solver, t: float) -> None:
        """The solver has stepped to t [s]."""

    def changed(self, t: float) -> None:
        """An external input has changed, or has jumped, at a time [s]."""

    def arrived(self, t: float, x: Array) -> None:
        """At a time that ended an integration; after its event, if there is one."""

    def next_point(self) -> float:
        """The next time [s] at which a plant without states is evaluated."""
        return np.inf

    def set_discrete(self, t: float) -> None:
        """Set external inputs that are not continuous, in event mode."""

    # ---- the equations

    def settle(self, t: float, x: Array) -> None:
        """Evaluate the plant at a time [s] and a state, unless that was the last one."""
        at = (t, x.tobytes())
        if at == self._at:
            return
        self._at = (np.nan, b"")
        self.evaluate(t, x)
        self._at = at

    def guarded(self, count: str, values: Callable[[], Array], t: float, x: Array, into: Array) -> None:
        """NaN instead of an exception: the solver then takes a shorter step, or fails."""
        into[:] = np.nan
        if self.broken:
            return
        try:
            self.counts[count] += 1
            self.settle(t, x)
            into[:] = values()
        except BaseException as problem:
            self.problem = problem
            failed = isinstance(problem, CallFailed) and problem.status >= ERROR
            self.broken = failed or not isinstance(problem, Exception)

    def rates(self, t: float, x: Array, into: Array) -> None:
        """The time derivatives of the states."""
        self.guarded("evaluations", lambda: self.plant.f, t, x, into)

    def jacobian(self, t: float, x: Array, _: Array, into: Array) -> None:
        """The derivatives of the rates with respect to the states."""
        self.guarded("Jacobians", lambda: self.plant.matrices().a, t, x, into)

    def failed(self, t: float, reason: str) -> BaseException:
        """Why the solver failed after a time [s]."""
        where = f"{self.plant.system.name}: the solver failed after t = {t:.9g} s"
        return self.problem or Problem(f"{where}: {reason.rstrip('.')}; a larger tolerance may help")

    # ---- the integration

    def run(
        self, t: float, x: Array, stop: float, changes: Sequence[float] = (np.inf,)
    ) -> tuple[float, Array]:
        """Integrate to `stop` [s], or until a component ends the simulation; returns time and states.

        changes   times at which the slope of an input jumps, and at last infinity
        """
        repeated = 0
        while self.before(t, stop) and not self.plant.ended:
            self.check(t)
            begin, change = t, changes[bisect_right(changes, t + self.same)]
            ends = stop, self.plant.next_event, change
            target = max(end for end in ends if self.equal(end, min(ends)))
            if self.before(t, target):
                t, x, event = self._advance(t, x, target)
            else:
                t, event = max(t, target), True
            if self.equal(t, change):
                self._at = (np.nan, b"")
                self.changed(t)
            event |= self.equal(t, self.plant.next_event) or bool(self.sampled and self.equal(t, change))
            repeated = 1 if self.before(begin, t) else repeated + 1
            if repeated > MAX_EVENTS:
                names = dict.fromkeys(name for _, causes in self.happened[-NAMED_EVENTS:] for name in causes)
                expected = f"expected at most {MAX_EVENTS} events at one time"
                which = f": {', '.join(names)}" if names else ""
                raise Problem(f"{self.plant.system.name}: t = {t:.9g} s: {expected}{which}")
            if event:
                x = self.event(t, x)
            self.arrived(t, x)
        return t, x

    def _advance(self, t: float, x: Array, target: float) -> tuple[float, Array, bool]:
        """Integrate to `target` [s], the first event or the end; returns time, states, True for an event."""
        if not len(x):
            return self._without_states(t, x, target)
        solver = self.solver(t, x, target)
        while self.before(t, target):
            self.check(t)
            t, x, root = solver.advance()
            self.counts["steps"] += 1
            self.stepped(solver, t)
            self._at = (np.nan, b"")
            event = self.plant.completed_step(t, x) or root
            if event and not root:
                after = self._step_event(t, x)
                if after is None:
                    continue
                return t, after, False
            if event or self.plant.ended:
                return t, x, event
        return target, x, False

    def _step_event(self, t: float, x: Array) -> Array | None:
        """The states after an event that a component asks for after a step; None if it changes nothing."""
        self.settle(t, x)
        f, next_event = self.plant.f.copy(), self.plant.next_event
        after = self.event(t, x)
        self.settle(t, after)
        same = np.array_equal(after, x) and np.array_equal(self.plant.f, f)
        if not same or self.plant.next_event != next_event or self.plant.ended:
            return after
        self.happened.pop()
        return None

    def _without_states(self, t: float, x: Array, target: float) -> tuple[float, Array, bool]:
        """Outputs alone over the recorded points; an event between two of them is located to rounding."""
        before = self._sides(t, x)
        while self.before(t, target):
            begin, t = t, min(self.next_point(), target)
            event = bool((self._sides(t, x) != before).any())
            while event and begin < (middle := 0.5 * (begin + t)) < t:
                begin, t = (begin, middle) if (self._sides(middle, x) != before).any() else (middle, t)
            known(self.plant, t, self._indicators(t, x))
            event |= self.plant.completed_step(t, x)
            if event or self.plant.ended:
                return t, x, event
            self.arrived(t, x)
        return target, x, False

    def _sides(self, t: float, x: Array) -> NDArray[np.bool_]:
        """The event indicators that are positive."""
        return self._indicators(t, x) > 0.0

    def _indicators(self, t: float, x: Array) -> Array:
        self.settle(t, x)
        return self.plant.indicators()

    def event(self, t: float, x: Array) -> Array:
        """Event mode at a time; the states after it."""
        self.counts["events"] += 1
        self.settle(t, x)
        self.plant.event(partial(self.set_discrete, t))
        self.happened.append((t, tuple(dict.fromkeys(self.plant.changed))))
        self._at = (np.nan, b"")
        return self.plant.x.copy()

    def before(self, a: float, b: float) -> bool:
        """Is a time earlier than another, and not the same?"""
        return a < b - self.same

    def equal(self, a: float, b: float) -> bool:
        """Are two times the same?"""
        return not (self.before(a, b) or self.before(b, a))
