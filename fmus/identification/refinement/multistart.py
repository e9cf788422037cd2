"""Multistart: the same search from random initial parameters, on fewer samples.

A search first fits predictions, then whole recordings. The second part depends only on the parameters at the
end of the first part. So if the first part ends where that of the reference ended, the search is taken to
lead to the reference, and the second part is left out.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from fmus.identification.refinement.gauss_newton import DETACHED, INTERRUPTED, Solution, minimise
from fmus.identification.refinement.measured_runs import MeasuredRun
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.refine import (
    RefinementResult,
    cut_into_segments,
    fit_predictions,
    result,
)
from fmus.identification.refinement.shooting import Shooting
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

SPREAD = 0.25  # half width of the range of initial z; a prior with a larger 2 sd replaces it
EVERY = 4  # one of so many samples is used
ITERATIONS = 25  # of a search
_SAME = 1.0  # standard deviations within which two results are the same


@dataclass(frozen=True)
class RandomStart:
    """One search from a random start.

    initial    parameters by name
    distance   largest distance from the reference, in standard deviations of the coarse problem; infinite if
               the model cannot be simulated from the start
    joined     its fit of predictions ended at that of the reference, whose end it gets
    """

    initial: dict[str, float]
    distance: float
    residual: float
    iterations: int
    joined: bool = False


@dataclass(frozen=True)
class MultistartResult:
    """The searches from all random starts, and whether an interrupt ended them early."""

    starts: tuple[RandomStart, ...]
    interrupted: bool = False

    @property
    def fraction(self) -> float:
        """Fraction of the starts that led to the reference."""
        return sum(start.distance < _SAME for start in self.starts) / max(1, len(self.starts))


def multistart(refined: RefinementResult, count: int = 8, spread: float = SPREAD) -> MultistartResult:
    """Search again from `count` starts, within `spread` of the initial value or in a wider prior.

    Every fourth sample is used; the reference is the result of a search on the same samples from the optimum.
    """
    problem = subsampled(refined.problem, EVERY)
    rng = np.random.default_rng(0)
    starts: list[RandomStart] = []
    try:
        shooting = cut_into_segments(problem, refined.simulator, refined.z)
        path = fit_predictions(shooting, refined.z)
        best = _whole(shooting, refined.z, path)
        reference = result(shooting, best)
        sd = reference.statistics.sd(reference.robust)
        for _ in range(count):
            z = random_start(problem, rng, spread)
            try:
                shooting = cut_into_segments(problem, refined.simulator, z)
                predictions = fit_predictions(shooting, z)
                joined = _same_end(predictions, path)
                solution = best if joined else _whole(shooting, z, predictions)
            except Problem:  # the model cannot be simulated from there
                starts.append(RandomStart(problem.by_name(z), math.inf, math.nan, 0))
                continue
            distance = float(np.max(np.abs(solution.z - best.z) / sd))
            iterations = len(predictions.history if joined and predictions else solution.history)
            residual = solution.history[-1].residual
            starts.append(RandomStart(problem.by_name(z), distance, residual, iterations, joined))
    except KeyboardInterrupt:
        return MultistartResult(tuple(starts), interrupted=True)
    return MultistartResult(tuple(starts))


def _whole(shooting: Shooting, z: Array, predictions: Solution | None) -> Solution:
    """The fit of whole recordings; an interrupt ends all searches."""
    solution = minimise(shooting, z, ITERATIONS, previous=predictions)
    if solution.reason == INTERRUPTED:
        raise KeyboardInterrupt
    return solution


def _same_end(one: Solution | None, other: Solution | None) -> bool:
    """Have both converged to parameters whose residuals differ by less than the tolerances of both?"""
    if not (one and other and one.converged and other.converged):
        return False
    return float(np.linalg.norm(other.linear.rows[:, :-1] @ (one.z - other.z))) < 2 * DETACHED


def random_start(problem: EstimationProblem, rng: np.random.Generator, spread: float) -> Array:
    """Random z within `spread` of the initial value, or from a prior that is wider, inside the bounds.

    A narrow prior attracts the search from any start; starts drawn from it would not test the search.
    """
    sd = problem.prior_sd()
    z = problem.initial() + np.where(
        np.isfinite(sd) & (2 * sd > spread),
        np.clip(rng.standard_normal(len(sd)), -2, 2) * np.where(np.isfinite(sd), sd, 0),
        rng.uniform(-spread, spread, len(sd)),
    )
    return np.asarray(np.clip(z, *problem.bounds()))


def subsampled(problem: EstimationProblem, every: int) -> EstimationProblem:
    """The same problem with one of `every` samples."""

    def subsample(run: MeasuredRun) -> MeasuredRun:
        return replace(
            run,
            **{name: getattr(run, name)[::every] for name in ("time", "measured", "weight")},
            inputs={name: u[::every] for name, u in run.inputs.items()},
            input_noise={},
            measured_states={name: x[::every] for name, x in run.measured_states.items()},
        )

    return replace(problem, training=tuple(map(subsample, problem.training)), held_out=())
