"""One step over all unknowns: Gauss-Newton under bounds, as long as the linearisation can be trusted.

A step is judged by its level: the squares of the residuals that are left once the gaps between segments
are closed by the linearisation. Gaps thus count by what they do to the residuals, no penalty has to be
chosen. Where the level does not fall as predicted, parameters are held back [Levenberg, Marquardt] and less
of the step is gone; unlike shortening alone, that slows down only what the data hardly show.

Gauss-Newton until nothing changes any more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fmus.identification.refinement.shooting import (
    Condensed,
    Evaluated,
    Point,
    Shooting,
    condense,
    triangular,
)
from fmus.identification.refinement.simulation import Failed
from fmus.identification.refinement.weights import Priors, Scales, seen

Array = NDArray[np.float64]

STUCK = "no step leads closer"
SMALLEST = 1e-5  # of z: when no change larger than that is trusted, the search gives up
SHORTEST = 1e-4  # fraction of a step, likewise: steps as short as that creep
LARGEST = 10.0  # of z: no more is ever asked for
_STIFF = 1e6  # holds the start of a loose run where it is
_ACCEPTED = 0.01  # share of the predicted fall of the level that a step has to bring
_GOOD = 0.5  # share above which more is trusted the next time


@dataclass(frozen=True)
class Step:
    """Changes of the parameters and, per run and segment, of the start states."""

    dz: Array
    states: tuple[list[Array], ...]


@dataclass(frozen=True)
class Linear:
    """The runs condensed around a point, with the rows of the priors.

    rest   squares of residuals that no change of the unknowns can reach
    """

    runs: tuple[Condensed, ...]
    rows: Array
    rest: float

    def level(self, dz: Array | None = None) -> float:
        """Sum of squares with the gaps closed, after a step if one is given."""
        if dz is not None:
            left = self.rows[:, -1] + self.rows[:, :-1] @ dz
            return float(left @ left) + self.rest
        starts = sum(float(run.top[:, -1] @ run.top[:, -1]) for run in self.runs)
        return float(self.rows[:, -1] @ self.rows[:, -1]) + self.rest + starts

    def step(self, z: Array, bounds: tuple[Array, Array], trust: float) -> Step:
        """Least squares under bounds; `trust` [z] is how far parameters may easily go."""
        back = np.hstack([np.eye(len(z)) / trust, np.zeros((len(z), 1))])
        triangle = triangular(np.vstack([self.rows, back]))
        low, high = np.minimum(bounds[0] - z, 0.0), np.maximum(bounds[1] - z, 0.0)
        dz = lsq_linear(triangle[:, :-1], -triangle[:, -1], (low, high), method="bvls").x
        return Step(dz, tuple(run.states(dz) for run in self.runs))


def linear(old: Evaluated, new: Evaluated, priors: Priors, loose: bool) -> Linear:
    """Linearisation and weights of `old`, residuals and gaps of `new`; loose segments have no gaps."""
    runs, rest = [], 0.0
    for k, segments in enumerate(old.runs):
        projected = [s.projected(n) for s, n in zip(segments, new.runs[k], strict=True)]
        whole = sum(
            float(np.sum((s.factor * n.residual) ** 2)) for s, n in zip(segments, new.runs[k], strict=True)
        )
        rest += max(0.0, whole - sum(float(c @ c) for c in projected))
        locals_ = [s.local for s in segments if s.local is not None]
        known, defects = priors.start_rows(k, new.point.starts[k][0]), new.defects[k]
        if loose:
            locals_, defects = [a.loose() for a in locals_], [0 * d for d in defects]
            known[:, : len(known)] *= _STIFF
        runs.append(condense(locals_, defects, projected, known))
    rows = np.vstack([*(run.bottom for run in runs), priors.parameter_rows(new.point.z)])
    return Linear(tuple(runs), rows, rest)


@dataclass(frozen=True)
class Trust:
    """How much of the linearisation to trust: change of z, fraction of a step."""

    size: float = 1.0
    length: float = 1.0

    def less(self) -> Trust:
        """After a step that did not do what it should."""
        return Trust(self.size / 4, self.length / 2)

    def after(self, whole: float, gain: float) -> Trust:
        """After a step that brought `gain`, of which the whole was to bring `whole`.

        Along the step the level falls by 2 whole t - c t^2; the gain tells c, and c the best fraction t.
        """
        predicted = whole * self.length * (2 - self.length)
        bend = (2 * whole * self.length - gain) / self.length**2
        best = whole / bend if bend > 0 else 1.0
        size = min(LARGEST, 3 * self.size) if gain > _GOOD * predicted else self.size
        return Trust(size, float(np.clip(best, self.length / 2, min(1.0, 2 * self.length))))


def search(
    shooting: Shooting, old: Evaluated, at: Linear, priors: Priors, scales: Scales, trust: Trust
) -> tuple[Evaluated | None, Trust]:
    """The next point, nothing if no step leads closer, and what to trust from there on."""
    bounds, before = shooting.problem.bounds(), at.level()
    while trust.size > SMALLEST and trust.length > SHORTEST:
        step = at.step(old.point.z, bounds, trust.size)
        whole = max(before - at.level(step.dz), 0.0)
        predicted = whole * trust.length * (2 - trust.length)
        try:
            new = shooting.evaluate(shooting.moved(old.point, step.dz, step.states, trust.length), scales)
        except Failed:
            trust = trust.less()
            continue
        gain = before - linear(old, new, priors, shooting.loose).level()
        slack = 1e-9 * before  # rounding and the integrator's error
        if gain > _ACCEPTED * predicted - slack:
            return new, trust.after(whole, gain + slack)
        trust = trust.less()
    return None, trust


def decrement(at: Linear, z: Array, bounds: tuple[Array, Array]) -> float:
    """By how much the best step changes all residuals, in standard deviations."""
    fall = at.level() - at.level(at.step(z, bounds, LARGEST).dz)
    return math.sqrt(max(0.0, fall))


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
