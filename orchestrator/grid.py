"""Communication points: an integer step count times the step."""

from __future__ import annotations

from dataclasses import dataclass, replace

from orchestrator.errors import Problem
from orchestrator.system import System
from orchestrator.trace import Trace

STEP = 1e-3  # [s], when nobody suggests one


@dataclass(frozen=True)
class Grid:
    """Point n is start + n * step, n = 0..steps. Times in [s]."""

    start: float
    step: float
    steps: int
    notes: tuple[str, ...] = ()

    @property
    def stop(self) -> float:
        return self.start + self.steps * self.step


def grid(
    system: System, scenario: Trace | None, step: float | None, start: float | None, stop: float | None
) -> Grid:
    """The communication points from what the user gave and, where nothing was given, what is suggested."""
    interfaces = [c.interface for c in system.components.values()]
    begin = next((t for t in (start, system.start) if t is not None), 0.0)
    if step is None:
        step = min((i.step for i in interfaces if i.step), default=STEP)
    end = stop
    if end is None and scenario is not None and len(scenario.time) > 1 and scenario.time[-1] > begin:
        end = float(scenario.time[-1])
    if end is None:
        end = system.stop
    if end is None:
        end = max((i.stop for i in interfaces if i.stop is not None), default=None)
    points = _whole_steps(begin, end, step)
    return points if scenario is None else replace(points, notes=points.notes + _held(points, scenario))


def _held(points: Grid, scenario: Trace) -> tuple[str, ...]:
    """What to say when the run is longer than its scenario."""
    first, last = float(scenario.time[0]), float(scenario.time[-1])
    notes = []
    if points.start < first - points.step:
        notes.append(f"the scenario begins at {first:g} s; until there its first values are held")
    if points.stop > last + points.step:
        notes.append(f"the scenario ends at {last:g} s; after that its last values are held")
    return tuple(notes)


def _whole_steps(start: float, end: float | None, step: float) -> Grid:
    if end is None:
        raise Problem("no stop time: neither the system nor its FMUs suggest one, give --stop")
    if not step > 0:
        raise Problem(f"step: expected a positive time, got {step:g} s")
    if not end > start:
        raise Problem(f"stop time: expected more than the start time {start:g} s, got {end:g} s")
    steps = int((end - start) / step + 1e-6)
    if steps < 1:
        raise Problem(f"step: expected at most the time from {start:g} to {end:g} s, got {step:g} s")
    reached = start + steps * step
    if abs(end - reached) > 1e-6 * step:
        note = f"{end - start:g} s is no multiple of the step: the run ends at {reached:.9g} s"
        return Grid(start, step, steps, (note,))
    return Grid(start, step, steps)
