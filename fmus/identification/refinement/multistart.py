"""Does the result depend on where the search began? The same search from random starts, on fewer samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.gauss_newton import INTERRUPTED, Options
from fmus.identification.refinement.problem import EstimationProblem, MeasuredRun
from fmus.identification.refinement.refine import Refined, compiled, refine
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]

SPREAD = 0.25  # of z: half width of the range of a start, unless two standard deviations of a prior are more
EVERY, ITERATIONS = 4, 25  # samples, of which one is taken; iterations of a search
_SAME = 1.0  # standard deviations within which two results are the same


@dataclass(frozen=True)
class RandomStart:
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

    starts: tuple[RandomStart, ...]
    share: float
    spread: dict[str, float]
    interrupted: bool = False


def from_random_starts(refined: Refined, count: int = 8, spread: float = SPREAD) -> Starts:
    """Search again from `count` starts, within `spread` about the value or in a wider prior.

    The data are thinned to every fourth sample; the reference is the result on the same data, begun at the
    optimum.
    """
    problem = thinned(refined.problem, EVERY)
    simulator = compiled(problem)
    options = Options(iterations=ITERATIONS, model_error=any(refined.floor.values()))
    rng = np.random.default_rng(0)
    starts: list[RandomStart] = []
    ends: list[Array] = []
    interrupted = False

    def search(z: Array) -> Refined:
        one = refine(problem, simulator, options=options, start=z)
        if one.reason == INTERRUPTED:  # which ends all of them, not this one
            raise KeyboardInterrupt
        return one

    try:
        best = search(refined.z)
        sd = best.statistics.sd(best.robust)
        for _ in range(count):
            z = random_start(problem, rng, spread)
            try:
                one = search(z)
            except Problem:  # the model cannot be simulated from there
                start = RandomStart(problem.by_name(z), {}, float("inf"), float("nan"), 0)
            else:
                apart = float(np.max(np.abs(one.z - best.z) / sd))
                size, steps = one.history[-1].residual, len(one.history)
                start = RandomStart(problem.by_name(z), one.values, apart, size, steps)
                if apart < _SAME:
                    ends.append(one.z)
            starts.append(start)
    except KeyboardInterrupt:
        interrupted = True
    middle, slopes = refined.problem.values_of(refined.z), refined.problem.slopes(refined.z)
    deviation = np.std(ends, axis=0) if ends else np.full(len(middle), np.nan)
    relative = np.abs(deviation * slopes) / np.where(middle == 0, np.nan, np.abs(middle))
    spreads = dict(zip(problem.names, relative.tolist(), strict=True))
    return Starts(tuple(starts), len(ends) / max(1, len(starts)), spreads, interrupted)


def random_start(problem: EstimationProblem, rng: np.random.Generator, spread: float) -> Array:
    """z drawn evenly from a range about the value, or from a prior that reaches farther, inside the bounds.

    A narrow prior pulls the search back all the same; starts as narrow would say nothing about the search.
    """
    sd = np.array([f.z_sd for f in problem.free])
    drawn = problem.initial() + np.where(
        np.isfinite(sd) & (2 * sd > spread),
        np.clip(rng.standard_normal(len(sd)), -2, 2) * np.where(np.isfinite(sd), sd, 0),
        rng.uniform(-spread, spread, len(sd)),
    )
    return np.asarray(np.clip(drawn, *problem.bounds()))


def thinned(problem: EstimationProblem, every: int) -> EstimationProblem:
    """The same problem on every so many samples."""

    def run(one: MeasuredRun) -> MeasuredRun:
        keep = slice(None, None, every)
        return replace(
            one,
            **{name: getattr(one, name)[keep] for name in ("time", "measured", "weight", "compared")},
            inputs={name: u[keep] for name, u in one.inputs.items()},
            input_noise={},
            guess={name: x[keep] for name, x in one.guess.items()},
        )

    return replace(problem, training=tuple(map(run, problem.training)), held_out=())
