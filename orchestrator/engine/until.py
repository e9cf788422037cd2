"""Ends a run at the first recorded row where a condition holds: `run(..., until=...)`.

The condition is a text, "arm.height < -1.5 m", or a function of the time [s] and of the row, a
mapping from signal to value. A function that returns None only hears of each row. Rows come in blocks, some
of them after the row that ends the run: these are not kept. An exception of the function ends the run, too.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import ulp
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.interrupts import of_user
from orchestrator.base.numerals import finite
from orchestrator.base.signals import matching
from orchestrator.base.text import first_names
from orchestrator.base.units import from_user_unit, number_and_unit
from orchestrator.data.trace_writer import RowLayout, TraceSink
from orchestrator.engine.result import RunEnd
from orchestrator.engine.time_grid import TIME_TOLERANCE
from orchestrator.ssp.system import System

RELATIONS = {"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt}
Row = Mapping[str, float]


@dataclass(frozen=True)
class Comparison:
    """A signal compared with a value in its unit; text: as the user wrote it."""

    text: str
    signal: str
    relation: str
    value: float


Condition: TypeAlias = Comparison | Callable[..., Any]


def condition(system: System, until: str | Callable[[float, Row], Any]) -> Condition:
    """The condition of a run of a system; raises Problem for a text that is none."""
    if not isinstance(until, str):
        return until
    found = re.fullmatch(r"\s*(\S+?)\s*(<=|>=|<|>)\s*(.+)", until)
    if not found:
        expected = "expected SIGNAL < NUMBER, such as arm.height < -1.5 m"
        raise Problem(f"until: {expected}, got {until!r}")
    signals = [str(port) for causality in ("output", "input") for port in system.ports(causality)]
    names = matching(signals, found[1])
    if len(names) != 1:
        got = first_names(names) if names else f"none{suggest(found[1], signals)}"
        raise Problem(f"until {until}: expected one signal, got {got}")
    number, unit = number_and_unit(found[3])
    try:
        value = finite(number)
    except ValueError:
        expected = f"expected a finite number behind {found[2]}"
        raise Problem(f"until {until}: {expected}, got {found[3]!r}") from None
    if unit:
        own = system.variable(system.port(names[0])).unit
        value = from_user_unit(unit, own, f"until {until}")(value)
    return Comparison(until, names[0], found[2], value)


class Until(TraceSink):
    """Passes the rows of a run on to another sink, until the condition holds.

    reached   time of the last row that is kept [s], at which the run is to end; None before
    failure   what a function of the user raised: a Problem, or KeyboardInterrupt
    """

    def __init__(self, when: Condition, sink: TraceSink) -> None:
        self._when, self._sink = when, sink
        self.keeps_errors = sink.keeps_errors
        self.reached: float | None = None
        self.failure: Problem | KeyboardInterrupt | None = None

    def begin(self, layout: RowLayout, rows: int = 0) -> None:
        """Receive the signals."""
        super().begin(layout, rows)
        self._sink.begin(layout, rows)

    def append(self, times: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Receive rows, and keep those up to the one that ends the run."""
        super().append(times, values)
        if self.reached is None:
            n = self._kept(times, values)
            self._sink.append(times[:n], values[:n])

    def append_errors(self, outputs: Any, times: Any, errors: Any) -> None:
        """Pass estimated errors on."""
        self._sink.append_errors(outputs, times, errors)

    def _kept(self, times: NDArray[np.float64], values: NDArray[np.float64]) -> int:
        if isinstance(self._when, Comparison):
            signal = values[:, self.layout.names.index(self._when.signal)]
            holds = np.flatnonzero(RELATIONS[self._when.relation](signal, self._when.value))
            return self._end(times, int(holds[0])) if len(holds) else len(times)
        for n, (time, row) in enumerate(zip(times.tolist(), values.tolist(), strict=True)):
            try:
                if of_user(self._when, time, dict(zip(self.layout.names, row, strict=True))):
                    return self._end(times, n)
            except KeyboardInterrupt as interrupt:
                self.failure = interrupt
            except BaseException as error:  # of the user's function, SystemExit too: the rows are kept
                self.failure = Problem(f"until: the function failed at t = {time:.6g} s: {error!r}")
            if self.failure:
                return self._end(times, n)
        return len(times)

    def _end(self, times: NDArray[np.float64], n: int) -> int:
        self.reached = float(times[n])
        return n + 1

    def ended(self, end: RunEnd) -> RunEnd:
        """How the run ended: complete where the condition holds, also if an FMU failed later in its block."""
        if self.reached is None:
            return end
        interrupted = end.interrupted or isinstance(self.failure, KeyboardInterrupt)
        problem = self.failure if isinstance(self.failure, Problem) else None
        last = self.reached + max(TIME_TOLERANCE, 8 * ulp(self.reached))  # as events near a row are in it
        events = tuple(event for event in end.events if event.time <= last)
        texts = tuple(change for change in end.texts if change[0] <= last)
        end = replace(end, t=self.reached, events=events, texts=texts)
        end = replace(end, problem=problem, interrupted=interrupted, died=False)
        if self.failure:
            return end
        text = self._when.text if isinstance(self._when, Comparison) else "the function says so"
        notes = (*end.notes, f"the run ends at t = {self.reached:.6g} s: {text}")
        return replace(end, notes=notes)
