"""Communication points: an integer step count times the step, and which of them are recorded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import isfinite, ulp

from orchestrator.base.coupling import OVERRIDE_HINT
from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace
from orchestrator.ssp.system import System

STEP = 1e-3  # [s], when nobody suggests one
NEAR = 1e-9  # of the record step: a step that short is noise
RESOLVED = 1000  # of the smallest differences of times: equal steps are equal to 0.1 %
MOST = 10**12  # steps: some weeks of the fastest FMUs
RECORD = 5e-3  # [s], record interval of the command line: 200 Hz, the sampling rate of the paper


@dataclass(frozen=True)
class Grid:
    """Point n is start + n * step, n = 0..steps; every `every`-th and the last are recorded. Times in [s].

    A run with steps of its own choice hits all points and events; `first` is the step that it tries first.

    free      it has points nowhere else: every communication point is recorded
    events    times at which a scenario has a corner, increasing
    least     the shortest step that its times can tell [s]; 0: unknown
    """

    start: float
    step: float
    steps: int
    every: int = 1
    notes: tuple[str, ...] = ()
    first: float = 0.0
    free: bool = False
    events: tuple[float, ...] = ()
    least: float = 0.0

    @property
    def stop(self) -> float:
        return self.start + self.steps * self.step

    @property
    def rows(self) -> int:
        """How many points are recorded."""
        return self.steps // self.every + 1 + (self.steps % self.every > 0)

    def finer(self) -> Grid:
        """Half the step, the same points recorded."""
        points = replace(self, step=self.step / 2, steps=2 * self.steps, every=2 * self.every)
        return divided(points, self.events)

    def coarser(self) -> Grid:
        """Twice the step, recorded at as many of the same points as it has, and at its own last one."""
        every = self.every if self.every % 2 else self.every // 2
        return divided(replace(self, step=2 * self.step, steps=self.steps // 2, every=every), self.events)


def grid(
    system: System,
    scenario: Trace | None,
    step: float | None,
    start: float | None,
    stop: float | None,
    record_step: float | None = None,
) -> Grid:
    """The communication points from what the user gave and, where nothing was given, what is suggested."""
    begin, end = _span(system, scenario, start, stop)
    with _with_place(system, step):
        step = step_length(system, step)
        points = _whole_steps(begin, end, step)
    points = replace(points, every=_every(record_step, step))
    return points if scenario is None else replace(points, notes=points.notes + _held(points, scenario))


def free_grid(
    system: System,
    scenario: Trace | None,
    first: float | None,
    start: float | None,
    stop: float | None,
    record_step: float | None,
    events: Iterable[float],
) -> Grid:
    """The points that a run with steps of its own choice has to hit; `first` [s]: the step to try first."""
    begin, end = _span(system, scenario, start, stop)
    whole = _whole_steps(begin, end, end - begin)
    points = whole if record_step is None else _whole_steps(begin, end, record_step, "record step")
    inside = tuple(_apart((t for t in events if begin < t < points.stop), points))
    first = step_length(system, first)
    _positive("step", first)
    if system.coupling is not None:
        _check_steps("largest step", begin, end, system.coupling.step_limits[1])
    points = replace(points, first=first, free=record_step is None, events=inside)
    return points if scenario is None else replace(points, notes=points.notes + _held(points, scenario))


def divided(points: Grid, corners: Iterable[float]) -> Grid:
    """Equal steps, but for those that have a corner inside."""
    return replace(
        points, events=tuple(_apart((t for t in corners if points.start < t < points.stop), points))
    )


def _apart(events: Iterable[float], points: Grid) -> Iterator[float]:
    """Without those that are a point of the grid or the event before, but for rounding."""
    least, last = NEAR * points.step, points.start
    for t in events:
        nearest = points.start + round((t - points.start) / points.step) * points.step
        if abs(t - nearest) > least and t - last > least:
            yield t
            last = t


def _span(
    system: System, scenario: Trace | None, start: float | None, stop: float | None
) -> tuple[float, float]:
    """Start and stop time [s]."""
    begin = next((t for t in (start, system.start) if t is not None), 0.0)
    end = stop
    if end is None and scenario is not None and len(scenario.time) > 1 and scenario.time[-1] > begin:
        end = float(scenario.time[-1])
    if end is None:
        end = system.stop
    if end is None:
        stops = (c.interface.stop for c in system.components.values())
        end = max((t for t in stops if t is not None), default=None)
    if end is None:
        raise Problem("no stop time: neither the system nor its FMUs suggest one, give --stop")
    for name, value in (("start time", begin), ("stop time", end)):
        if not isfinite(value):
            raise Problem(f"{name}: expected a finite time, got {value:g} s")
    if not end > begin:
        raise Problem(f"stop time: expected more than the start time {begin:g} s, got {end:g} s")
    return begin, end


def step_length(system: System, step: float | None) -> float:
    """The step [s] given, else what the system suggests, else the smallest that an FMU does, else 1 ms."""
    if step is not None:
        return step
    if system.refusal:
        raise Problem(f"{system.refusal}; {OVERRIDE_HINT}")
    if system.step is not None:
        return system.step
    return min((c.interface.step for c in system.components.values() if c.interface.step), default=STEP)


@contextmanager
def _with_place(system: System, step: float | None) -> Iterator[None]:
    """A Problem with the step names its place in the file that suggests it."""
    try:
        yield
    except Problem as problem:
        place = system.suggestion.location
        if step is not None or system.step is None or not place:
            raise
        raise Problem(f"{place}: {problem}; {OVERRIDE_HINT}") from None


def _least(start: float, stop: float) -> float:
    """The shortest step [s] that times from start to stop can tell."""
    return RESOLVED * ulp(max(abs(start), abs(stop)))


def thinned(step: float) -> float | None:
    """Record interval [s] of the command line: the most steps that fit into 5 ms; None: every step."""
    if not 0 < step < RECORD:
        return None
    return int(RECORD / step + 1e-6) * step


def _every(record_step: float | None, step: float) -> int:
    """How many steps lie between recorded points."""
    if record_step is None:
        return 1
    ratio = record_step / step
    every = round(ratio) if isfinite(ratio) else 0
    if every < 1 or abs(ratio - every) > 1e-6 * every:
        raise Problem(f"record step: expected a multiple of the step {step:g} s, got {record_step:g} s")
    return every


def _held(points: Grid, scenario: Trace) -> tuple[str, ...]:
    """What to say when the run is longer than its scenario."""
    first, last = float(scenario.time[0]), float(scenario.time[-1])
    notes = []
    if points.start < first - points.step:
        notes.append(f"the scenario begins at {first:g} s; until there its first values are held")
    if points.stop > last + points.step:
        notes.append(f"the scenario ends at {last:g} s; after that its last values are held")
    return tuple(notes)


def _positive(name: str, step: float) -> None:
    if not isfinite(step):
        raise Problem(f"{name}: expected a finite time, got {step:g} s")
    if not step > 0:
        raise Problem(f"{name}: expected a positive time, got {step:g} s")


def _check_steps(name: str, start: float, end: float, step: float) -> None:
    """Refuse steps that are too short for the times of a run, or too many."""
    resolved, fewest = _least(start, end), (end - start) / MOST
    if step < resolved:
        least = f"expected at least {resolved:.3g} s, the times of the run can tell no less"
        raise Problem(f"{name}: {least}, got {step:g} s")
    if step < fewest:
        raise Problem(f"{name}: expected at least {fewest:.3g} s, for at most {MOST:g} steps, got {step:g} s")


def _whole_steps(start: float, end: float, step: float, name: str = "step") -> Grid:
    _positive(name, step)
    _check_steps(name, start, end, step)
    steps = int((end - start) / step + 1e-6)
    if steps < 1:
        raise Problem(f"{name}: expected at most the time from {start:g} to {end:g} s, got {step:g} s")
    reached = start + steps * step
    points = Grid(start, step, steps, least=_least(start, end))
    if abs(end - reached) > 1e-6 * step:
        note = f"{end - start:g} s is no multiple of the {name}: the run ends at {reached:.9g} s"
        return replace(points, notes=(note,))
    return points
