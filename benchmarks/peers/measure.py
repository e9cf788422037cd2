"""Runs everything in turns: one run of each job, then one more of each, and so on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from benchmarks.peers.cases import Case
from benchmarks.peers.settings import USUAL, Setting
from benchmarks.peers.tools import Run, Spent, find

BUDGET = 20.0  # s; a job whose runs took longer together is not repeated any more
LOST = 1.0  # where an error is larger the run is lost


@dataclass
class Job:
    """One setting in one case at one step, and what its runs gave.

    clock    which time counts: wall or cpu
    runs     time of each run
    error    infinite where the run is lost, None where nothing is recorded
    """

    case: Case
    setting: Setting
    value: float
    record: bool = True
    clock: str = "wall"
    runs: list[Spent] = field(default_factory=list)
    steps: int = 0
    error: float | None = None
    failed: str = ""

    @property
    def per_step(self) -> float:
        """Time of a step [us], median of the runs."""
        return (
            1e6 * median(getattr(run, self.clock) for run in self.runs) / self.steps if self.runs else np.nan
        )

    @property
    def per_second(self) -> float:
        """Time for a simulated second [ms], median of the runs."""
        return self.per_step * 1e-3 * self.steps / self.case.stop

    def repeat(self) -> None:
        """One more run; one that failed is not tried again."""
        if self.failed or sum(run.wall for run in self.runs) > BUDGET:
            return
        record = self.case.recorded if self.record else ()
        options = {**self.setting.options, self.setting.vary: self.value}
        if self.setting.vary != "step":  # steps of different lengths
            options["record_step"] = self.case.sample
        try:
            run = find(self.setting.tool)(
                self.case.system, self.case.stop, record, self.case.judged, **options
            )
        except Exception as problem:  # each tool has its own kinds; what fails is told, the others go on
            self.failed = f"{type(problem).__name__}: {problem}"
            self.error = np.inf if self.record else None
            return
        self.runs.append(run.spent)
        self.steps = run.steps
        if self.record and self.error is None:
            self.error = _judge(self.case, run)


def _judge(case: Case, run: Run) -> float:
    if not all(np.isfinite(values).all() for values in run.signals.values()):
        return np.inf
    error = case.error(run.time, run.signals)
    return error if error < LOST else np.inf


def jobs(case: Case, settings: Iterable[Setting], clock: str) -> Iterator[Job]:
    """All of a case."""
    for setting in settings:
        for value in setting.values.get(case.name, ()):
            yield Job(case, setting, value, clock=clock)
            if setting.vary == "step" and value == USUAL:
                yield Job(case, setting, value, record=False, clock=clock)


@dataclass(frozen=True)
class Equal:
    """What a setting needs for an error: a value of its option, and time for a simulated second [ms]."""

    value: float
    per_second: float


def at_error(found: Iterable[Job], target: float) -> Equal | None:
    """Between the last job that is good enough, coming from the finest, and the next; None if none is.

    Straight lines in logarithms; where the next one is lost, or there is none, the last good one counts.
    One job alone says nothing.
    """
    good: Job | None = None
    ran = sorted((j for j in found if j.record and j.runs), key=lambda j: j.value)
    for job in ran if len(ran) > 1 else ():
        error = job.error if job.error is not None else np.inf
        if error > target:
            if good is None:
                return None
            if not np.isfinite(error):
                break
            share = np.log(target / good.error) / np.log(error / good.error)
            return Equal(*(float(a ** (1 - share) * b**share) for a, b in _pairs(good, job)))
        good = job
    return Equal(good.value, good.per_second) if good else None


def _pairs(one: Job, other: Job) -> tuple[tuple[float, float], tuple[float, float]]:
    return (one.value, other.value), (one.per_second, other.per_second)
