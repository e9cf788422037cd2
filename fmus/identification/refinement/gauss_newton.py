"""Gauss-Newton under bounds over all unknowns of multiple shooting, as far as the linearisation holds.

A step is judged by its level: the squares of the residuals that are left once the gaps between segments
are closed by the linearisation. Gaps thus count by what they do to the residuals, no penalty has to be
chosen. Where the level does not fall as predicted, parameters are held back [Levenberg, Marquardt] and a
smaller fraction of the step is taken; unlike shortening alone, that slows down only what the data hardly
show.
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
    Iterate,
    Shooting,
    condense,
    triangular,
)
from fmus.identification.refinement.simulation import SimulationFailed
from fmus.identification.refinement.weights import Priors, Scales, estimated_scales, sensor_scales

Array = NDArray[np.float64]

STUCK = "no step leads closer"
INTERRUPTED = "interrupted"
SMALLEST = 1e-5  # of z: when no change larger than that is trusted, the search gives up
SHORTEST = 1e-4  # fraction of a step, likewise: steps as short as that creep
LARGEST = 10.0  # of z: no more is ever asked for
_STIFF = 1e6  # holds the start of a detached run where it is
_ACCEPTED = 0.01  # share of the predicted fall of the level that a step has to bring
_GOOD = 0.5  # share above which more is trusted the next time
CLOSED = 1e-4  # nominal values: gaps between segments that do not count
DETACHED = 3.0  # standard deviations by which detached segments may change at the end
SETTLED = 0.05  # relative change of the scales that does not count


@dataclass(frozen=True)
class CondensedProblem:
    """The runs condensed around an iterate, with the rows of the priors.

    unreachable   squares of residuals that no change of the unknowns can reach
    """

    runs: tuple[Condensed, ...]
    rows: Array
    unreachable: float

    def level(self, dz: Array | None = None) -> float:
        """Sum of squares with the gaps closed, after a step if one is given."""
        if dz is not None:
            left = self.rows[:, -1] + self.rows[:, :-1] @ dz
            return float(left @ left) + self.unreachable
        starts = sum(float(run.top[:, -1] @ run.top[:, -1]) for run in self.runs)
        return float(self.rows[:, -1] @ self.rows[:, -1]) + self.unreachable + starts

    def step(self, z: Array, bounds: tuple[Array, Array], trust: float) -> Array:
        """Least squares under bounds, dz; `trust` [z] is how far parameters may easily go."""
        damping = np.hstack([np.eye(len(z)) / trust, np.zeros((len(z), 1))])
        triangle = triangular(np.vstack([self.rows, damping]))
        low, high = np.minimum(bounds[0] - z, 0.0), np.maximum(bounds[1] - z, 0.0)
        dz: Array = lsq_linear(triangle[:, :-1], -triangle[:, -1], (low, high), method="bvls").x
        return dz


def linearise(old: Evaluated, new: Evaluated, priors: Priors, detached: bool) -> CondensedProblem:
    """CondensedProblem and weights of `old`, residuals and gaps of `new`; detached segments have no gaps."""
    runs, unreachable = [], 0.0
    for k, segments in enumerate(old.runs):
        pairs = list(zip(segments, new.runs[k], strict=True))
        projected = [s.projected(n) for s, n in pairs]
        squares = sum(float(np.sum((s.factor * n.residual) ** 2)) for s, n in pairs)
        unreachable += max(0.0, squares - sum(float(c @ c) for c in projected))
        linear = [s.linear for s in segments if s.linear is not None]
        known, defects = priors.start_rows(k, new.iterate.starts[k][0]), new.defects[k]
        if detached:
            linear, defects = [s.detached() for s in linear], [0 * d for d in defects]
            known[:, : len(known)] *= _STIFF
        runs.append(condense(linear, defects, projected, known))
    rows = np.vstack([*(run.bottom for run in runs), priors.parameter_rows(new.iterate.z)])
    return CondensedProblem(tuple(runs), rows, unreachable)


@dataclass(frozen=True)
class Trust:
    """How much of the linearisation to trust: change of z, fraction of a step."""

    size: float = 1.0
    length: float = 1.0

    def less(self) -> Trust:
        """After a step that did not do what it should."""
        return Trust(self.size / 4, self.length / 2)

    def predicted(self, whole: float) -> float:
        """Fall of the level along the fraction of a step whose whole is predicted to bring `whole`."""
        return whole * self.length * (2 - self.length)

    def after(self, whole: float, gain: float) -> Trust:
        """After a step that brought `gain`, of which the whole was to bring `whole`.

        Along the step the level falls by 2 whole t - c t^2; the gain tells c, and c the best fraction t.
        """
        bend = (2 * whole * self.length - gain) / self.length**2
        best = whole / bend if bend > 0 else 1.0
        size = min(LARGEST, 3 * self.size) if gain > _GOOD * self.predicted(whole) else self.size
        return Trust(size, float(np.clip(best, self.length / 2, min(1.0, 2 * self.length))))


def search(
    shooting: Shooting, old: Evaluated, at: CondensedProblem, priors: Priors, scales: Scales, trust: Trust
) -> tuple[Evaluated | None, Trust]:
    """The next iterate, nothing if no step leads closer, and what to trust from there on."""
    bounds, before, iterate = shooting.problem.bounds(), at.level(), old.iterate
    while trust.size > SMALLEST and trust.length > SHORTEST:
        dz = at.step(iterate.z, bounds, trust.size)
        whole = max(before - at.level(dz), 0.0)
        try:
            states = [run.states(dz) for run in at.runs]
            new = shooting.evaluate(shooting.moved(iterate, dz, states, trust.length), scales)
        except SimulationFailed:
            trust = trust.less()
            continue
        gain = before - linearise(old, new, priors, shooting.detached).level()
        slack = 1e-9 * before  # rounding and the integrator's error
        if gain > _ACCEPTED * trust.predicted(whole) - slack:
            return new, trust.after(whole, gain + slack)
        trust = trust.less()
    return None, trust


@dataclass(frozen=True)
class Iteration:
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
        """How much the outputs count at an iterate."""
        return estimated_scales(now.residuals(), self.model_error or far, self.memory and not far)


@dataclass(frozen=True)
class Solution:
    """Where the search ended: the last iterate, its linearisation, the reason."""

    evaluated: Evaluated
    linear: CondensedProblem
    scales: Scales
    history: tuple[Iteration, ...]
    converged: bool
    reason: str


def minimise(
    shooting: Shooting,
    start: Iterate,
    priors: Priors,
    options: Options,
    progress: Callable[[Iteration], None] | None = None,
    before: Solution | None = None,
) -> Solution:
    """Search from an iterate, perhaps after another search that led there.

    An interrupt, or a step that leads nowhere, keeps the best iterate so far.
    Far from the optimum every output is weighted by its residuals, as if the model had an error of that
    size: no sensor outweighs the others by being precise, and what shows only in details has to wait.
    """
    problem, far, trust = shooting.problem, True, Trust()
    first = shooting.evaluate(start, sensor_scales(len(problem.outputs)), False)
    scales = estimated_scales(first.residuals(), True, False)
    now = shooting.evaluate(start, scales)
    at = linearise(now, now, priors, shooting.detached)
    history = list(before.history) if before else []
    if before and before.reason == INTERRUPTED:
        return Solution(now, at, scales, tuple(history), False, INTERRUPTED)
    reason = f"{options.iterations} iterations"
    try:
        for _ in range(options.iterations):
            # by how much the best step changes all residuals, in standard deviations
            best = at.level(at.step(now.iterate.z, problem.bounds(), LARGEST))
            left = math.sqrt(max(0.0, at.level() - best))
            history.append(_iteration(len(history), now, left, trust))
            if progress:
                progress(history[-1])
            wanted = options.scales(now, far)
            settled = wanted.change(scales) < SETTLED
            done = settled and not far and left < options.tolerance and now.gap() < CLOSED
            if left < DETACHED if shooting.detached else done:
                reason = ""
                break
            if far and settled and left < 1:
                far = False
                wanted = options.scales(now, far)
            new, trust = search(shooting, now, at, priors, wanted, trust)
            if new is None:
                reason = STUCK
                break
            now, scales = new, wanted
            at = linearise(now, now, priors, shooting.detached)
    except KeyboardInterrupt:
        reason = INTERRUPTED
    return Solution(now, at, scales, tuple(history), not reason, reason or "converged")


def _iteration(number: int, now: Evaluated, left: float, trust: Trust) -> Iteration:
    residual = np.concatenate(now.residuals())
    size = float((residual @ residual / max(1, residual.size)) ** 0.5)
    return Iteration(number, size, left, now.gap(), trust, now.problem.by_name(now.iterate.z))
