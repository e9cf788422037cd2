"""Multistart: the same search from random initial parameters, on fewer samples.

A search first fits predictions, then whole recordings (`Search`). The second part depends only on the
parameters at the end of the first part. So if the first part ends where that of the reference ended, the
search is taken to lead to the reference, and the second part is left out.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fmus.identification.refinement.gauss_newton import DETACHED, INTERRUPTED, Options, Solution
from fmus.identification.refinement.measured_runs import MeasuredRun
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.refine import RefinementResult, Search, compiled
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

SPREAD = 0.25  # half width of the range of initial z; a prior with a larger 2 sd replaces it
EVERY = 4  # one of so many samples is used
ITERATIONS = 25  # of a search
_SAME = 1.0  # standard deviations within which two results are the same


@dataclass(frozen=True)
class RandomStart:
    """One search from a random start.

    initial, estimated   parameters by name; nothing is estimated if the model cannot be simulated from there
    distance             largest distance from the reference, in standard deviations of the coarse problem
    joined               its fit of predictions ended at that of the reference, whose end it gets
    """

    initial: dict[str, float]
    estimated: dict[str, float]
    distance: float
    residual: float
    iterations: int
    joined: bool = False


@dataclass(frozen=True)
class MultistartResult:
    """The searches from all random starts.

    fraction      fraction of the starts that led to the reference
    interrupted   whether an interrupt ended the searches early
    """

    starts: tuple[RandomStart, ...]
    fraction: float
    interrupted: bool = False


def multistart(refined: RefinementResult, count: int = 8, spread: float = SPREAD) -> MultistartResult:
    """Search again from `count` starts, within `spread` of the initial value or in a wider prior.

    Every fourth sample is used; the reference is the result of a search on the same samples from the optimum.
    """
    problem = subsampled(refined.problem, EVERY)
    options = Options(iterations=ITERATIONS, model_error=any(refined.model_error.values()))
    search_from = partial(Search, problem, compiled(problem), options=options)
    rng = np.random.default_rng(0)
    starts: list[RandomStart] = []
    same, interrupted = 0, False

    def uninterrupted(reason: str) -> None:
        if reason == INTERRUPTED:  # ends all searches
            raise KeyboardInterrupt

    try:
        search = search_from(refined.z)
        path = search.fit_predictions()
        best = search.fit_recordings(path)
        uninterrupted(best.reason)
        reference = search.result(best)
        sd = reference.statistics.sd(reference.robust)
        for _ in range(count):
            z = random_start(problem, rng, spread)
            try:
                search = search_from(z)
                predictions = search.fit_predictions()
                joined = _same_end(predictions, path)
                solution = best if joined else search.fit_recordings(predictions)
                uninterrupted(solution.reason)
            except Problem:  # the model cannot be simulated from there
                start = RandomStart(problem.by_name(z), {}, float("inf"), float("nan"), 0)
            else:
                end = solution.evaluation.iterate.z
                residual = solution.history[-1].residual
                distance = float(np.max(np.abs(end - reference.z) / sd))
                iterations = len(predictions.history if joined and predictions else solution.history)
                found = problem.by_name(z), problem.by_name(end)
                start = RandomStart(*found, distance, residual, iterations, joined)
                same += distance < _SAME
            starts.append(start)
    except KeyboardInterrupt:
        interrupted = True
    return MultistartResult(tuple(starts), same / max(1, len(starts)), interrupted)


def _same_end(one: Solution | None, other: Solution | None) -> bool:
    """Have both converged to parameters whose residuals differ by less than the tolerances of both?"""
    if not (one and other and one.converged and other.converged):
        return False
    dz = one.evaluation.iterate.z - other.evaluation.iterate.z
    return float(np.linalg.norm(other.linear.rows[:, :-1] @ dz)) < 2 * DETACHED


def random_start(problem: EstimationProblem, rng: np.random.Generator, spread: float) -> Array:
    """Random z within `spread` of the initial value, or from a prior that is wider, inside the bounds.

    A narrow prior attracts the search from any start; starts drawn from it would not test the search.
    """
    sd = np.array([f.z_sd for f in problem.free])
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
            **{name: getattr(run, name)[::every] for name in ("time", "measured", "weight", "compared")},
            inputs={name: u[::every] for name, u in run.inputs.items()},
            input_noise={},
            measured_states={name: x[::every] for name, x in run.measured_states.items()},
        )

    return replace(problem, training=tuple(map(subsample, problem.training)), held_out=())
