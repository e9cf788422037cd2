"""Communication points of a run: an integer count times the step, and which points are recorded."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, isfinite, ulp

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array
from orchestrator.data.trace import SAME_TIME, Trace, rounding
from orchestrator.ssp.coupling import OVERRIDE_HINT
from orchestrator.ssp.system import System

DEFAULT_STEP = 1e-3  # [s], without any suggestion
RESOLUTION = 1000  # shortest step over the rounding unit of the times, so that steps are equal to 0.1 %
TIME_TOLERANCE = 1e-11  # of the time of an event [s]
SAME_EVENT = 1e-9  # of the step: corners of a scenario that are closer, such as one at a point, are one
DEFAULT_DURATION = 1.0  # [s], without any suggestion, as in FMPy
MAX_STEPS = 10**12  # some weeks of the fastest FMUs
RECORD_STEP = 5e-3  # [s], of the command line: 200 Hz, the sampling rate of the paper


@dataclass(frozen=True)
class Grid:
    """Point n is start + n * step, n = 0..steps; each `every`-th and the last are recorded. Times in [s].

    Further communication points are at `divided`. An adaptive run hits all of them, and tries a step `first`.

    free            every communication point is recorded, also between points of the grid
    jumps           increasing times at which a scenario jumps
    corners         increasing times at which its slope jumps
    shortest_step   the shortest step that can be represented [s]; 0: unknown
    """

    start: float
    step: float
    steps: int
    every: int = 1
    notes: tuple[str, ...] = ()
    first: float = 0.0
    free: bool = False
    jumps: tuple[float, ...] = ()
    corners: tuple[float, ...] = ()
    shortest_step: float = 0.0

    @property
    def stop(self) -> float:
        return self.start + self.steps * self.step

    def announced_stop(self, parts: int) -> float:
        """The stop time [s] for FMUs, which the last of equal parts of the last step may pass by rounding."""
        last = self.start + (self.steps - 1) * self.step
        return max(self.stop, last + self.step * (parts - 1) / parts + self.step / parts)

    def nearest(self, times: Array) -> Array:
        """The communication points next to times [s]."""
        points: Array = self.start + np.rint((times - self.start) / self.step) * self.step
        return points

    def before(self, times: Array) -> Array:
        """The last communication points before times [s]."""
        points: Array = self.start + np.floor((times - self.start) / self.step) * self.step
        return points

    @property
    def divided(self) -> tuple[float, ...]:
        """Jumps and corners that are no points of the grid; none of the corners that are next to others."""
        tolerance, jumps, kept = SAME_EVENT * self.step, set(self.jumps), list[float]()
        for t in sorted(jumps.union(self.corners)):
            nearest = self.start + round((t - self.start) / self.step) * self.step
            if not self.start < t < self.stop or abs(t - nearest) <= tolerance * (t not in jumps):
                continue
            if kept and t in jumps and kept[-1] not in jumps and t - kept[-1] <= tolerance:
                kept.pop()
            if not kept or t in jumps or t - kept[-1] > tolerance:
                kept.append(t)
        return tuple(kept)

    def aligned(self, times: Array) -> Array:
        """These increasing times [s]; those that equal a communication point up to rounding are that point.

        Of several times that equal one point only the nearest is, both of a jump.
        """
        points = self.nearest(times)
        off, first = np.abs(times - points), np.flatnonzero(np.append(True, points[1:] != points[:-1]))
        least = np.repeat(np.fmin.reduceat(off, first), np.diff(np.append(first, len(off))))
        return np.where((off == least) & (off <= rounding(points, self.step)), points, times)

    @property
    def rows(self) -> int:
        """Number of recorded points."""
        return self.steps // self.every + 1 + (self.steps % self.every > 0)

    def finer(self) -> Grid:
        """The grid with half the step and the same recorded points."""
        return replace(self, step=self.step / 2, steps=2 * self.steps, every=2 * self.every)

    def coarser(self) -> Grid:
        """The grid with twice the step; recorded are the same points if it has them, and its last one."""
        every = self.every if self.every % 2 else self.every // 2
        return replace(self, step=2 * self.step, steps=self.steps // 2, every=every)


def grid(
    system: System,
    scenario: Trace | None,
    step: float | None,
    start: float | None,
    stop: float | None,
    record_step: float | None = None,
    fitted: bool = False,
) -> Grid:
    """The communication points; default values are suggestions of the system and its FMUs.

    Of an adaptive run they are the points that it has to hit, and `step` [s] is the first one to try.

    fitted   shorten equal steps so that they divide the record step, else the time span
    """
    begin, end, notes = time_span(system, scenario, start, stop)
    if system.coupling is None or system.coupling.adaptive is None:
        length = step_length(system, step)
        if fitted:
            whole = record_step or end - begin
            length = whole / ceil(whole / length - SAME_TIME)
        try:
            points = _whole_steps(begin, end, length)
        except Problem as problem:
            location = system.suggestion.location
            if step is not None or system.step is None or not location:
                raise
            raise Problem(f"{location}: {problem}; {OVERRIDE_HINT}") from None
        points = replace(points, every=_steps_per_record(record_step, length))
    else:
        distance, name = (end - begin, "step") if record_step is None else (record_step, "record step")
        points = _whole_steps(begin, end, distance, name)
        first = step_length(system, step)
        _positive("step", first)
        _check_steps("largest step", begin, end, system.coupling.step_limits[1])
        points = replace(points, first=first, free=record_step is None)
    return _noted(replace(points, notes=notes + points.notes), scenario)


def time_span(
    system: System, scenario: Trace | None, start: float | None, stop: float | None
) -> tuple[float, float, tuple[str, ...]]:
    """Start and stop time [s], and a note if nothing suggests a stop time."""
    begin = next((t for t in (start, system.start) if t is not None), 0.0)
    end, hint = stop, ""
    if end is None and scenario is not None and len(scenario.time) > 1 and scenario.time[-1] > begin:
        end = float(scenario.time[-1])
    if end is None:
        end = system.stop
    if end is None:
        stops = (c.interface.stop for c in system.components.values())
        end = max((t for t in stops if t is not None), default=None)
        hint = ", which its FMUs suggest: a stop time is needed"
    notes: tuple[str, ...] = ()
    if end is None:
        end, suggests = begin + DEFAULT_DURATION, "neither the system nor its FMUs suggest a stop time"
        notes = (f"{suggests}: the run ends at {end:g} s",)
    for name, value in (("start time", begin), ("stop time", end)):
        if not isfinite(value):
            raise Problem(f"{name}: expected a finite time, got {value:g} s")
    if not end > begin:
        raise Problem(f"stop time: expected more than the start time {begin:g} s, got {end:g} s{hint}")
    return begin, end, notes


def step_length(system: System, step: float | None) -> float:
    """The given step [s], else the suggestion of the system, else the smallest one of an FMU, else 1 ms."""
    if step is not None:
        return step
    if system.refusal:
        raise Problem(f"{system.refusal}; {OVERRIDE_HINT}")
    if system.step is not None:
        return system.step
    steps = (component.interface.step for component in system.components.values())
    return min(filter(None, steps), default=DEFAULT_STEP)


def _shortest_step(start: float, stop: float) -> float:
    """The shortest step [s] that can be represented at times from start to stop."""
    return RESOLUTION * ulp(max(abs(start), abs(stop)))


def record_interval(step: float) -> float | None:
    """Record step [s] of the command line: the largest multiple of the step up to 5 ms; None: every step."""
    if not 0 < step < RECORD_STEP:
        return None
    return int(RECORD_STEP / step + SAME_TIME) * step


def _steps_per_record(record_step: float | None, step: float) -> int:
    """Number of steps between two recorded points."""
    if record_step is None:
        return 1
    ratio = record_step / step
    every = round(ratio) if isfinite(ratio) else 0
    if every < 1 or abs(ratio - every) > SAME_TIME * every:
        raise Problem(f"record step: expected a multiple of the step {step:g} s, got {record_step:g} s")
    return every


def _noted(points: Grid, scenario: Trace | None) -> Grid:
    """The grid with notes on a run that is longer than its scenario."""
    if scenario is None:
        return points
    first, last = float(scenario.time[0]), float(scenario.time[-1])
    notes = [*points.notes]
    if points.start < first - points.step:
        notes.append(f"the scenario begins at {first:g} s; before that time its first values are held")
    if points.stop > last + points.step:
        notes.append(f"the scenario ends at {last:g} s; after that time its last values are held")
    return replace(points, notes=tuple(notes))


def _positive(name: str, step: float) -> None:
    if not isfinite(step):
        raise Problem(f"{name}: expected a finite time, got {step:g} s")
    if not step > 0:
        raise Problem(f"{name}: expected a positive time, got {step:g} s")


def _check_steps(name: str, start: float, end: float, step: float) -> None:
    """Refuse steps that are too short for the times of a run, or too many."""
    resolution, shortest = _shortest_step(start, end), (end - start) / MAX_STEPS
    if step < resolution:
        expected = f"expected at least {resolution:.3g} s, the resolution of the times of the run"
        raise Problem(f"{name}: {expected}, got {step:g} s")
    if step < shortest:
        expected = f"expected at least {shortest:.3g} s, for at most {MAX_STEPS:g} steps"
        raise Problem(f"{name}: {expected}, got {step:g} s")


def _whole_steps(start: float, end: float, step: float, name: str = "step") -> Grid:
    """The grid of the steps that fit between start and end."""
    _positive(name, step)
    _check_steps(name, start, end, step)
    steps = int((end - start) / step + SAME_TIME)
    if steps < 1:
        raise Problem(f"{name}: expected at most the time from {start:g} to {end:g} s, got {step:g} s")
    points = Grid(start, step, steps, shortest_step=_shortest_step(start, end))
    if abs(end - points.stop) > rounding(end, step):
        note = f"{end - start:g} s is not a multiple of the {name}: the run ends at {points.stop:.9g} s"
        return replace(points, notes=(note,))
    return points
