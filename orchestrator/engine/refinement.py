"""Runs at shorter and shorter steps: errors that follow from the changes between them, and when to stop.

`error_estimate` compares a run with those at half and at twice its step, an accuracy without directional
derivatives each run with the one before, and `reference` without Model Exchange halves the step until the
error is small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf

from orchestrator.base.errors import Problem
from orchestrator.data.trace import SAME_TIME
from orchestrator.engine.job import Job
from orchestrator.engine.result import Interrupted, Result, RunFailed, SignalError, changes
from orchestrator.ssp.dependencies import late_effects

MASTER_ORDER = 4.0  # of convergence; a larger measured order is a coincidence
STAGNATION = 0.7  # a run hardly helps if it leaves more than this fraction of the least error


def compared(runs: Iterable[Result]) -> Iterator[Result]:
    """Each run but the last, with its changes to the next one, and orders from the one before, as errors."""
    coarse = last = None
    for finer in runs:
        if last is not None:
            yield last.noted(errors=changes(coarse, last, finer))
        coarse, last = last, finer


def estimated_error(change: SignalError, ratio: float = 2.0) -> float:
    """RMS error, over range, of a run that changes by this much at a shorter step; NaN is infinite.

    ratio   of its step to the shorter one
    """
    order = min(max(change.order or 1.0, 1.0), MASTER_ORDER)
    error = change.rms * ratio**order / (ratio**order - 1)
    return error if error == error else inf


@dataclass
class Progress:
    """The least error of several runs, and how many of the last ones hardly helped."""

    least: float = inf
    idle: int = 0

    def add(self, error: float, counts: bool = True) -> bool:
        """Is the error of a run the least one? counts: a run that hardly helps is idle."""
        self.idle = self.idle + 1 if counts and error > STAGNATION * self.least else 0
        less = error < self.least
        self.least = min(error, self.least)
        return less


def with_error_estimate(job: Job, result: Result, repeated: Callable[[Job], Result]) -> Result:
    """A complete run with error estimates on its card, or with a note if a further run fails.

    If the run itself has estimated its errors, there are no further runs; repeated: makes one.
    """
    if late := late_effects(job.system, job.coupling):
        reason = f"effects of {late} may come up to a step late, also in a run at half the step"
        return replace(result, errors=None).noted(f"no error estimate: {reason}", errors=())
    if result.card.errors_of_inputs:
        return result
    times = job.times
    short = result.card.simulated < (1.0 - SAME_TIME) * (times.stop - times.start)
    if short and job.until is not None:
        return result.noted("no error estimate: the run ended before its stop time")
    if times.free:
        reason = "two adaptive runs have common times only with a record step; set --record-step"
        return result.noted(f"no error estimate: {reason}")
    adaptive = job.coupling.adaptive is not None
    runs = [result]
    try:
        runs.append(repeated(job.stricter() if adaptive else replace(job, times=times.finer())))
        if not adaptive and times.steps >= 4:
            with suppress(RunFailed):
                runs.insert(0, repeated(replace(job, times=times.coarser())))
    except Problem as failed:
        setting = "a tenth of the tolerance" if adaptive else "half the step"
        return result.noted(f"no error estimate, the run at {setting} failed: {failed}")
    except Interrupted as interrupted:
        raise Interrupted(result, str(interrupted)) from None
    *coarser, own, finer = [len(run.events) for run in runs]
    if own != finer:
        reason = f"{own} events, and {finer} in the run to compare with"
        return result.noted(f"no error estimate: {reason}", errors=())
    runs = runs[1:] if coarser and coarser[0] != own else runs
    *_, estimated = compared(runs)
    return estimated if estimated.card.errors else estimated.noted("no error estimate: no output changes")
