"""Gauss-Newton until nothing changes any more."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fmus.identification.refinement.condense import Condensed
from fmus.identification.refinement.model import Failed
from fmus.identification.refinement.priors import Priors
from fmus.identification.refinement.shooting import Evaluated, Point, Scales, Shooting
from fmus.identification.refinement.step import condensed, search, solve

CLOSED = 1e-4  # nominal values: gaps between segments that do not count
SETTLED = 0.05  # relative change of the scales that does not count


@dataclass(frozen=True)
class Progress:
    """One iteration.

    residual    root mean square of the residuals, 1 if the sensors explain them
    predicted   by how much the step would change all residuals, in standard deviations
    gap         largest one between segments, in nominal values
    length      fraction of the step before that was gone
    """

    iteration: int
    residual: float
    predicted: float
    gap: float
    length: float
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Options:
    """How to search.

    tolerance     the step is done when it changes all residuals together by less, in standard deviations:
                  no parameter then moves by more than this share of its own standard deviation
    model_error   let the model have an error of its own per output, estimated from the residuals
    """

    iterations: int = 40
    tolerance: float = 0.02
    model_error: bool = False


@dataclass(frozen=True)
class Solution:
    """Where the search ended: the last point, its linearisation, why."""

    evaluated: Evaluated
    runs: tuple[Condensed, ...]
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
) -> Solution:
    """Search from a point. An interrupt, or a step that leads nowhere, keeps the best point so far."""
    problem = shooting.problem
    scales = Scales.sensors(len(problem.outputs))
    now = shooting.evaluate(point, scales)
    history: list[Progress] = []
    length, reason, settled = 1.0, f"{options.iterations} iterations", False
    runs = condensed(now, now, priors)
    try:
        for iteration in range(options.iterations):
            step = solve(runs, now.point.z, priors, problem.bounds())
            residual = now.residuals()[0]
            parameters = dict(zip(problem.names, problem.values_of(now.point.z).tolist(), strict=True))
            size = float((residual @ residual / residual.size) ** 0.5)
            history.append(Progress(iteration, size, step.predicted, now.gap(), length, parameters))
            if progress:
                progress(history[-1])
            if settled and step.predicted < options.tolerance and now.gap() < CLOSED:
                reason = ""
                break
            wanted = scales.seen(now, options.model_error)
            settled = (not options.model_error and shooting.loss == "linear") or (
                wanted.change(scales) < SETTLED
            )
            found = search(shooting, now, step, priors, wanted, min(1.0, 4 * length))
            if found.evaluated is None:
                reason = "no part of the step leads closer"
                break
            now, length, scales = found.evaluated, found.length, wanted
            runs = condensed(now, now, priors)
    except KeyboardInterrupt:
        reason = "interrupted"
    return Solution(now, runs, scales, tuple(history), not reason, reason or "converged")


__all__ = ["Failed", "Options", "Progress", "Solution", "minimise"]
