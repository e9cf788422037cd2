"""Does the result depend on where the search began? The same search from random starts, on fewer samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.gauss_newton import INTERRUPTED, Options
from fmus.identification.refinement.problem import EstimationProblem, Run
from fmus.identification.refinement.refine import compiled, refine
from fmus.identification.refinement.result import Refined
from fmus.identification.refinement.simulation import Simulator
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]

SPREAD = 0.25  # of z: half width of the range of a start, unless two standard deviations of a prior are more
_SAME = 1.0  # standard deviations within which two results are the same


@dataclass(frozen=True)
class Start:
    """One search from a random start.

    begun, ended   parameters by name; nothing ended if the model could not be simulated from there
    apart          largest distance from the reference, in standard deviations of the coarse problem
    """

    begun: dict[str, float]
    ended: dict[str, float]
    apart: float
    residual: float
    iterations: int


@dataclass(frozen=True)
class Starts:
    """All of them.

    share         of the starts that led to the reference
    spread        per parameter: standard deviation over these starts' results, relative to the value
    interrupted   were there to be more?
    """

    starts: tuple[Start, ...]
    share: float
    spread: dict[str, float]
    interrupted: bool = False


def from_random_starts(
    refined: Refined,
    simulator: Simulator | None = None,
    *,
    count: int = 8,
    seed: int = 0,
    spread: float = SPREAD,
    every: int = 4,
    iterations: int = 25,
    threads: int = 2,
    progress: Callable[[Start], None] | None = None,
) -> Starts:
    """Search again from `count` starts, within `spread` about the value or in a wider prior.

    The data are thinned to every fourth sample or so; the reference is the result on the same data,
    begun at the optimum.
    """
    problem = coarse(refined.problem, every)
    simulator = simulator or compiled(problem)
    options = Options(iterations=iterations, model_error=any(refined.floor.values()))

    def search(z: Array) -> Refined:
        one = refine(problem, simulator, threads=threads, options=options, start=z)
        if one.reason == INTERRUPTED:  # which ends all of them, not this one
            raise KeyboardInterrupt
        return one

    rng = np.random.default_rng(seed)
    found: list[Start] = []
    ends: list[Array] = []
    interrupted = False
    try:
        best = search(refined.z)
        for _ in range(count):
            start, end = _compared(problem, random_start(problem, rng, spread), best, search)
            found.append(start)
            if start.apart < _SAME and end is not None:
                ends.append(end)
            if progress:
                progress(start)
    except KeyboardInterrupt:
        interrupted = True
    middle = refined.problem.values_of(refined.z)
    deviation = np.std(ends, axis=0) if ends else np.full(len(middle), np.nan)
    slopes = refined.problem.slopes(refined.z)
    relative = np.abs(deviation * slopes) / np.where(middle == 0, np.nan, np.abs(middle))
    spreads = dict(zip(problem.names, relative.tolist(), strict=True))
    return Starts(tuple(found), len(ends) / max(1, len(found)), spreads, interrupted)


def _compared(
    problem: EstimationProblem, z: Array, best: Refined, search: Callable[[Array], Refined]
) -> tuple[Start, Array | None]:
    begun = dict(zip(problem.names, problem.values_of(z).tolist(), strict=True))
    try:
        one = search(z)
    except Problem:  # the model cannot be simulated from there
        return Start(begun, {}, float("inf"), float("nan"), 0), None
    apart = float(np.max(np.abs(one.z - best.z) / best.statistics.sd(best.robust)))
    return Start(begun, one.values, apart, one.history[-1].residual, len(one.history)), one.z


def random_start(problem: EstimationProblem, rng: np.random.Generator, spread: float) -> Array:
    """z drawn evenly from a range about the value, or from a prior that reaches farther, inside the bounds.

    A narrow prior pulls the search back all the same; starts as narrow would say nothing about the search.
    """
    middle = problem.search()
    sd = np.array([f.z_sd for f in problem.free])
    drawn = middle + np.where(
        np.isfinite(sd) & (2 * sd > spread),
        np.clip(rng.standard_normal(len(sd)), -2, 2) * np.where(np.isfinite(sd), sd, 0),
        rng.uniform(-spread, spread, len(sd)),
    )
    low, high = problem.bounds()
    return np.asarray(np.clip(drawn, low, high))


def coarse(problem: EstimationProblem, every: int) -> EstimationProblem:
    """The same problem on every so many samples."""

    def thinned(run: Run) -> Run:
        keep = slice(None, None, every)
        return replace(
            run,
            time=run.time[keep],
            inputs={name: u[keep] for name, u in run.inputs.items()},
            measured=run.measured[keep],
            weight=run.weight[keep],
            compared=run.compared[keep],
            input_noise={},
            guess={name: x[keep] for name, x in run.guess.items()},
        )

    return replace(problem, training=tuple(thinned(run) for run in problem.training), held_out=())
