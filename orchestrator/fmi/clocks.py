"""Clocks of FMI 3.0 for Co-Simulation: their calls, and the times of those that tick by time."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.numerals import integer
from orchestrator.fmi.calls import Call
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.instance import CallFailed, FmuInstance
from orchestrator.fmi.messages import FATAL, WARNING

UNKNOWN, CHANGED = 0, 2  # fmi3IntervalNotYetKnown, fmi3IntervalChanged
APERIODIC = ("changing", "countdown")  # clocks whose interval may be 0
FORMS = "Decimal", "Fraction"  # of the calls that tell intervals and shifts


class ClockCalls:
    """The calls of the clocks of an FMU.

    first_ticks   of clocks that declare no interval: interval, and time from the start to the first tick [s]
    """

    def __init__(self, fmu: FmuInstance, name: str) -> None:
        """`name`: of its component, for messages."""
        self._fmu, self._name = fmu, name
        self.first_ticks = dict[str, tuple[Fraction, Fraction]]()
        self._calls = dict[tuple[str, str], tuple[Call, Sequence[Any]]]()

    def tick(self, clock: FmuVariable) -> None:
        """Let an input clock tick, in event mode."""
        self._call("SetClock", clock, ctypes.c_bool)[0]()

    def ticks(self, clock: FmuVariable) -> bool:
        """Does an output clock tick?"""
        call, (ticks,) = self._call("GetClock", clock, ctypes.c_bool)
        call()
        return bool(ticks[0])

    def _call(self, function: str, clock: FmuVariable, *types: Any) -> tuple[Call, Sequence[Any]]:
        """A bound call of a clock, made once, and its arguments; what the FMU does not write is NaN or 0."""
        if (function, clock.name) not in self._calls:
            references = self._fmu.references([clock.reference])
            start = function == "SetClock"
            arguments = [(type_ * 1)(np.nan if type_ is ctypes.c_double else start) for type_ in types]
            call = self._fmu.bound(function, *references, *arguments, variables=[clock.name])
            self._calls[function, clock.name] = call, arguments
        return self._calls[function, clock.name]

    def interval(self, clock: FmuVariable) -> tuple[int, Fraction]:
        """fmi3IntervalQualifier and interval of a clock [s], as a fraction if the FMU has them."""
        interval, qualifier = self._seconds(clock, "Interval", ctypes.c_int)
        return qualifier[0], interval

    def shift(self, clock: FmuVariable) -> Fraction:
        """Time from the start to the first tick of a periodic clock [s]."""
        declared = clock.fraction("shift")
        if declared is not None or not any(self._fmu.library.has(f"GetShift{form}") for form in FORMS):
            return declared or Fraction(0)
        shift, _ = self._seconds(clock, "Shift")
        if shift < 0:
            expected = "expected a shift of 0 s or more"
            raise Problem(f"{self._name}.{clock.name}: {expected}, got {float(shift):.9g} s")
        return shift

    def _seconds(self, clock: FmuVariable, what: str, *more: Any) -> tuple[Fraction, Any]:
        """Interval or shift of a clock [s], exact as the FMU gives it, and the last of the other results."""
        exact = clock.declares("supportsFraction")
        types: Sequence[Any] = (ctypes.c_uint64,) * 2 if exact else (ctypes.c_double,)
        call, results = self._call(f"Get{what}{FORMS[exact]}", clock, *types, *more)
        call()
        if more and results[-1][0] == UNKNOWN:
            return Fraction(0), results[-1]
        if exact and results[1][0]:
            return Fraction(results[0][0], results[1][0]), results[-1]
        if exact or not np.isfinite(seconds := results[0][0]):
            expected = f"expected {'a shift' if what == 'Shift' else 'an interval'} in seconds"
            got = f"{results[0][0]}/0" if exact else seconds
            raise Problem(f"{self._name}.{clock.name}: {expected}, got {got}")
        return Fraction(repr(seconds)), results[-1]

    def ask(self, inputs: Iterable[FmuVariable]) -> None:
        """At the end of initialisation mode: intervals that are not declared (FMI 3.0.2, 2.2.8.3)."""
        for v in (v for v in inputs if v.kind == "Clock" and not v.is_triggered_input):
            kind = v.get("intervalVariability")
            if kind not in APERIODIC and v.fraction("interval") is not None:
                continue
            try:
                qualifier, interval = self.interval(v)
            except CallFailed as failed:
                if kind != "countdown" or failed.status == FATAL:  # some tell it in event mode only
                    raise
                qualifier, self._fmu.worst = UNKNOWN, WARNING
            if qualifier == UNKNOWN and kind not in APERIODIC:
                expected = "expected an interval in initialisation mode, got not yet known"
                raise Problem(f"{self._name}.{v.name}: {expected}")
            if qualifier == CHANGED or (qualifier != UNKNOWN and kind != "countdown"):
                self.first_ticks[v.name] = interval, interval if kind in APERIODIC else self.shift(v)


@dataclass(eq=False)
class Timed:
    """An input clock that ticks by time.

    port             names it
    interval, next   its interval and its next tick [s], exact; None: not known
    time             of the next tick [s]; infinite if it is not known
    """

    port: Any
    calls: ClockCalls
    clock: FmuVariable
    interval: Fraction | None = None
    next: Fraction | None = None
    time: float = np.inf

    def schedule(self, tick: Fraction | None) -> None:
        """Set its next tick [s]."""
        self.next, self.time = tick, np.inf if tick is None else float(tick)

    @property
    def kind(self) -> str:
        """The variability of its interval."""
        return self.clock.get("intervalVariability")

    def is_asked(self, ticked: bool) -> bool:
        """Is the FMU asked for its interval after an instant? A declared one may change after a tick only."""
        if self.kind == "changing":
            return ticked or self.next is None
        is_open = self.kind == "tunable" and (ticked or self.clock.fraction("interval") is None)
        return is_open or self.kind == "countdown"


class Schedule:
    """The clocks of a run that tick by time, from a start time [s] on."""

    def __init__(self, start: float) -> None:
        self._start, self._timed, self._due = Fraction(repr(start)), list[Timed](), list[Timed]()

    def add(self, port: Any, calls: ClockCalls, clock: FmuVariable) -> None:
        """Add a clock, if it ticks by time, with its first tick; an aperiodic one may tell it later."""
        if clock.causality != "input" or clock.is_triggered_input:
            return
        begun = Timed(port, calls, clock)
        interval, shift = calls.first_ticks.get(clock.name, (None, Fraction(0)))
        if interval is None and begun.kind not in APERIODIC:
            interval, shift = clock.fraction("interval"), clock.fraction("shift") or shift
        if interval is not None:
            self._set_interval(begun, interval)
            begun.schedule(self._start + shift)
        self._timed.append(begun)

    def _set_interval(self, c: Timed, interval: Fraction) -> None:
        if interval < 0 or (interval == 0 and c.kind not in APERIODIC):
            least = "0 s or more" if c.kind in APERIODIC else "above 0 s"
            raise Problem(f"{c.port}: expected an interval {least}, got {float(interval):.9g} s")
        c.interval = interval

    @property
    def next(self) -> float:
        """Time of the next tick [s]; infinite if there is none."""
        return min((c.time for c in self._timed), default=np.inf)

    def begin(self, t: float, tolerance: float) -> list[Any]:
        """The clocks that are due first at a time [s], and those due with them.

        Only the tick of the first one counts, not the time, which may be that of a communication point.
        """
        near = [(c, c.next) for c in self._timed if c.next is not None and c.time <= t + 2 * tolerance]
        first = min((tick for c, tick in near if c.time <= t + tolerance), default=None)
        self._now = Fraction(t) if first is None else first
        self._due = [
            c for c, tick in near if first is not None and (tick == first or tick - first <= tolerance)
        ]
        return [c.port for c in self._due]

    def finish(self) -> None:
        """After an instant: when do its clocks tick next?"""
        for c in self._timed:
            ticked, goes_on, changed = c in self._due, c.kind != "countdown", False
            if c.is_asked(ticked):
                qualifier, interval = c.calls.interval(c.clock)
                goes_on = goes_on and not (c.kind == "changing" and qualifier == UNKNOWN)
                changed = qualifier == CHANGED and (c.kind != "tunable" or interval != c.interval)
                if changed:
                    self._set_interval(c, interval)
            if c.interval is not None and (changed or (ticked and goes_on)):
                now = c.next if ticked and c.next is not None else self._now
                c.schedule(now + c.interval)  # a new interval begins now
            elif ticked:
                c.schedule(None)

    def saved(self) -> list[Any]:
        """Intervals and next ticks, for a saved run."""
        return [[str(c.interval), str(c.next)] for c in self._timed]

    def resume(self, saved: list[Any]) -> None:
        """Go on from a saved run."""
        for c, texts in zip(self._timed, saved, strict=True):
            parts = (text != "None" and [*map(integer, text.split("/"))] for text in texts)
            c.interval, tick = (Fraction(*numbers) if numbers else None for numbers in parts)
            c.schedule(tick)
