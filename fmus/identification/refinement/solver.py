"""Gauss-Newton until nothing changes any more."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fmus.identification.refinement.priors import Priors
from fmus.identification.refinement.scales import Scales, seen
from fmus.identification.refinement.segments import Evaluated, Point
from fmus.identification.refinement.shooting import Shooting
from fmus.identification.refinement.step import STUCK, Linear, Trust, decrement, linear, search

INTERRUPTED = "interrupted"
CLOSED = 1e-4  # nominal values: gaps between segments that do not count
LOOSE = 3.0  # standard deviations by which loose segments may change at the end
SETTLED = 0.05  # relative change of the scales that does not count


@dataclass(frozen=True)
class Progress:
    """One iteration.

    residual    root mean square of the residuals, 1 if the sensors explain them
    predicted   by how much the best step would change all residuals, in standard deviations
    gap         largest one between segments, in nominal values
    trust       change of z, and fraction of a step, that the linearisation is trusted for
    """

    iteration: int
    residual: float
    predicted: float
    gap: float
    trust: Trust
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Options:
    """How to search.

    tolerance     the search is done when the best step changes all residuals together by less, in standard
                  deviations: no parameter then moves by more than this share of its own
    model_error   let the model have an error of its own per output, estimated from the residuals; none is
                  found where the sensors explain them
    memory        count residuals that last as one, so that slow ones do not outweigh fast ones
    """

    iterations: int = 100
    tolerance: float = 0.1
    model_error: bool = True
    memory: bool = True

    def scales(self, now: Evaluated, far: bool) -> Scales:
        """How much the outputs count at a point."""
        return seen(now.residuals(), self.model_error or far, self.memory and not far)

    def done(self, now: Evaluated, left: float) -> bool:
        """Do the segments meet, and is what is `left` to be gained too little?"""
        return left < self.tolerance and now.gap() < CLOSED


@dataclass(frozen=True)
class Solution:
    """Where the search ended: the last point, its linearisation, why."""

    evaluated: Evaluated
    linear: Linear
    scales: Scales
    history: tuple[Progress, ...]
    converged: bool
    reason: str


def minimise(
    shooting: Shooting,
    point: Point,
    priors: Priors,
    options: Options,
    progress: Callable[[Progress], None] | None = None,
    before: Solution | None = None,
) -> Solution:
    """Search from a point, perhaps after another search that led there.

    An interrupt, or a step that leads nowhere, keeps the best point so far.
    Far from the optimum every output is weighted by its residuals, as if the model had an error of that
    size: no sensor outweighs the others by being precise, and what shows only in details has to wait.
    """
    problem = shooting.problem
    far, trust, reason = True, Trust(), f"{options.iterations} iterations"
    scales = Scales.sensors(len(problem.outputs))
    scales = seen(shooting.evaluate(point, scales, False).residuals(), True, False)
    now = shooting.evaluate(point, scales)
    at = linear(now, now, priors, shooting.loose)
    history = list(before.history) if before else []
    if before and before.reason == INTERRUPTED:
        return Solution(now, at, scales, tuple(history), False, INTERRUPTED)
    try:
        for _ in range(options.iterations):
            left = decrement(at, now.point.z, problem.bounds())
            history.append(_progress(len(history), now, left, trust))
            if progress:
                progress(history[-1])
            wanted = options.scales(now, far)
            settled = wanted.change(scales) < SETTLED
            met = settled and not far and options.done(now, left)
            if left < LOOSE if shooting.loose else met:
                reason = ""
                break
            if far and settled and left < 1:
                far = False
                wanted = options.scales(now, far)
            found, trust = search(shooting, now, at, priors, wanted, trust)
            if found is None:
                reason = STUCK
                break
            now, scales = found, wanted
            at = linear(now, now, priors, shooting.loose)
    except KeyboardInterrupt:
        reason = INTERRUPTED
    return Solution(now, at, scales, tuple(history), not reason, reason or "converged")


def _progress(iteration: int, now: Evaluated, left: float, trust: Trust) -> Progress:
    residual, problem = np.concatenate(now.residuals()), now.problem
    parameters = dict(zip(problem.names, problem.values_of(now.point.z).tolist(), strict=True))
    size = float((residual @ residual / max(1, residual.size)) ** 0.5)
    return Progress(iteration, size, left, now.gap(), trust, parameters)
