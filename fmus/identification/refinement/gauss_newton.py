"""Gauss-Newton with bounds over all unknowns of multiple shooting, globalised by a trust region.

The merit of an iterate is the sum of squared residuals that remains once the linearisation has closed the
continuity defects between segments. Defects thus count by their effect on the residuals, and no penalty has
to be chosen. If the merit does not decrease as predicted, the step of the parameters is damped [Levenberg,
Marquardt] and a smaller fraction of it is taken. Damping, unlike shortening alone, slows down mainly the
parameters that the data hardly determine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from fmus.identification.refinement.shooting import (
    CondensedRun,
    Evaluation,
    Iterate,
    Priors,
    Scales,
    Shooting,
    condense,
    estimated_scales,
    sensor_scales,
    triangular,
)
from fmus.identification.refinement.simulation import SimulationFailed
from orchestrator.data.table import Array

STUCK = "no step reduces the residuals"
INTERRUPTED = "interrupted"
SMALLEST_RADIUS = 1e-5  # change of z; the search gives up if the linearisation does not hold even for that
SMALLEST_FRACTION = 1e-4  # fraction of a step; the search gives up below
LARGEST_RADIUS = 10.0  # change of z
_STIFF = 1e6  # factor of the prior that fixes the initial state of a detached run
_ACCEPTED = 0.01  # a step is accepted from this fraction of the predicted decrease on
_GOOD = 0.5  # the trust region grows from this fraction on
CLOSED = 1e-4  # nominal values; smaller continuity defects are negligible
DETACHED = 3.0  # standard deviations; tolerance of the search with detached segments
SETTLED = 0.05  # relative change of the scales that is negligible


@dataclass(frozen=True)
class CondensedProblem:
    """The runs condensed around an iterate, with the rows of the priors.

    rows          rows [parameters | residual]
    unreachable   sum of squared residuals that no change of the unknowns can reduce
    """

    runs: tuple[CondensedRun, ...]
    rows: Array
    unreachable: float

    def merit(self, dz: Array | None = None) -> float:
        """Sum of squared residuals with the defects closed, after a step dz if one is given."""
        if dz is not None:
            residual = self.rows[:, -1] + self.rows[:, :-1] @ dz
            return float(residual @ residual) + self.unreachable
        starts = sum(float(run.top[:, -1] @ run.top[:, -1]) for run in self.runs)
        return float(self.rows[:, -1] @ self.rows[:, -1]) + self.unreachable + starts

    def step(self, z: Array, bounds: tuple[Array, Array], radius: float) -> Array:
        """Damped least squares within bounds, dz; `radius` is the change of z that is hardly damped."""
        damping = np.hstack([np.eye(len(z)) / radius, np.zeros((len(z), 1))])
        triangle = triangular(np.vstack([self.rows, damping]))
        low, high = np.minimum(bounds[0] - z, 0.0), np.maximum(bounds[1] - z, 0.0)
        dz: Array = lsq_linear(triangle[:, :-1], -triangle[:, -1], (low, high), method="bvls").x
        return dz


def linearise(old: Evaluation, new: Evaluation, priors: Priors, detached: bool) -> CondensedProblem:
    """Linearisation and weights of `old`, residuals and defects of `new`; without defects if `detached`."""
    runs, unreachable = [], 0.0
    for k, segments in enumerate(old.runs):
        pairs = list(zip(segments, new.runs[k], strict=True))
        projected = [s.projected(n) for s, n in pairs]
        squares = sum(float(np.sum((s.factor * n.residual) ** 2)) for s, n in pairs)
        unreachable += max(0.0, squares - sum(float(c @ c) for c in projected))
        linear = [s.linear for s in segments if s.linear is not None]
        prior, defects = priors.start_rows(k, new.iterate.starts[k][0]), new.defects[k]
        if detached:
            linear, defects = [s.detached() for s in linear], [0 * d for d in defects]
            prior[:, : len(prior)] *= _STIFF
        runs.append(condense(linear, defects, projected, prior))
    rows = np.vstack([*(run.bottom for run in runs), priors.parameter_rows(new.iterate.z)])
    return CondensedProblem(tuple(runs), rows, unreachable)


@dataclass(frozen=True)
class TrustRegion:
    """How far the linearisation is trusted: change of z, and fraction of a step."""

    radius: float = 1.0
    fraction: float = 1.0

    def reduced(self) -> TrustRegion:
        """After a step that was not accepted."""
        return TrustRegion(self.radius / 4, self.fraction / 2)

    def predicted(self, full: float) -> float:
        """Predicted decrease for the fraction, if the full step is predicted to bring `full`."""
        return full * self.fraction * (2 - self.fraction)

    def after(self, full: float, decrease: float) -> TrustRegion:
        """After a step that brought `decrease`, where the full step was predicted to bring `full`.

        Along the step the merit decreases by 2 full t - c t^2; `decrease` determines c, and c the best t.
        """
        curvature = (2 * full * self.fraction - decrease) / self.fraction**2
        best = full / curvature if curvature > 0 else 1.0
        good = decrease > _GOOD * self.predicted(full)
        radius = min(LARGEST_RADIUS, 3 * self.radius) if good else self.radius
        return TrustRegion(radius, float(np.clip(best, self.fraction / 2, min(1.0, 2 * self.fraction))))


def next_iterate(
    shooting: Shooting,
    current: Evaluation,
    linear: CondensedProblem,
    priors: Priors,
    scales: Scales,
    trust: TrustRegion,
) -> tuple[Evaluation | None, TrustRegion]:
    """The next iterate, None if no step reduces the merit, and the trust region from there on."""
    bounds, merit, iterate = shooting.problem.bounds(), linear.merit(), current.iterate
    while trust.radius > SMALLEST_RADIUS and trust.fraction > SMALLEST_FRACTION:
        dz = linear.step(iterate.z, bounds, trust.radius)
        full = max(merit - linear.merit(dz), 0.0)
        try:
            ds = [run.states(dz) for run in linear.runs]
            new = shooting.evaluate(shooting.stepped(iterate, dz, ds, trust.fraction), scales)
        except SimulationFailed:
            trust = trust.reduced()
            continue
        decrease = merit - linearise(current, new, priors, shooting.detached).merit()
        slack = 1e-9 * merit  # rounding and the solver's error
        if decrease > _ACCEPTED * trust.predicted(full) - slack:
            return new, trust.after(full, decrease + slack)
        trust = trust.reduced()
    return None, trust


@dataclass(frozen=True)
class Iteration:
    """One iteration.

    residual    root mean square of the residuals, 1 if the sensors explain them
    remaining   predicted change of all residuals by the best step, in standard deviations
    defect      largest continuity defect, in nominal values
    trust       trust region of the step
    """

    iteration: int
    residual: float
    remaining: float
    defect: float
    trust: TrustRegion
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Options:
    """Options of the search.

    tolerance     the search has converged if the best step changes all residuals together by less, in
                  standard deviations; no parameter then moves by more than this fraction of its own
    model_error   estimate an error of the model per output from the residuals; it is zero if the sensors
                  explain them
    correlated    weight correlated residuals by their correlation time, so that slow residuals do not
                  outweigh fast ones
    """

    iterations: int = 100
    tolerance: float = 0.1
    model_error: bool = True
    correlated: bool = True

    def scales(self, current: Evaluation, far: bool) -> Scales:
        """Scales of the residuals at an iterate, far from the optimum or near it."""
        return estimated_scales(current.residuals(), self.model_error or far, self.correlated and not far)


@dataclass(frozen=True)
class Solution:
    """The end of a search: the last iterate, its linearisation, the reason of the end."""

    evaluation: Evaluation
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
    previous: Solution | None = None,
) -> Solution:
    """Search from an iterate; `previous` is a search that led to it.

    After an interrupt, or if no step reduces the merit, the result is the best iterate so far.
    Far from the optimum, each output is weighted by its residuals, as if the model had an error of that size.
    No sensor then outweighs the others by its precision.
    """
    problem, far, trust = shooting.problem, True, TrustRegion()
    unweighted = shooting.evaluate(start, sensor_scales(len(problem.outputs)), False)
    scales = estimated_scales(unweighted.residuals(), True, False)
    current = shooting.evaluate(start, scales)
    linear = linearise(current, current, priors, shooting.detached)
    history = list(previous.history) if previous else []
    if previous and previous.reason == INTERRUPTED:
        return Solution(current, linear, scales, tuple(history), False, INTERRUPTED)
    reason = f"{options.iterations} iterations"
    try:
        for _ in range(options.iterations):
            best = linear.merit(linear.step(current.iterate.z, problem.bounds(), LARGEST_RADIUS))
            remaining = math.sqrt(max(0.0, linear.merit() - best))
            history.append(_iteration(len(history), current, remaining, trust))
            if progress:
                progress(history[-1])
            new_scales = options.scales(current, far)
            settled = new_scales.change(scales) < SETTLED
            continuous = current.largest_defect() < CLOSED
            converged = settled and not far and remaining < options.tolerance and continuous
            if remaining < DETACHED if shooting.detached else converged:
                reason = ""
                break
            if far and settled and remaining < 1:
                far = False
                new_scales = options.scales(current, far)
            new, trust = next_iterate(shooting, current, linear, priors, new_scales, trust)
            if new is None:
                reason = STUCK
                break
            current, scales = new, new_scales
            linear = linearise(current, current, priors, shooting.detached)
    except KeyboardInterrupt:
        reason = INTERRUPTED
    return Solution(current, linear, scales, tuple(history), not reason, reason or "converged")


def _iteration(number: int, current: Evaluation, remaining: float, trust: TrustRegion) -> Iteration:
    residual = np.concatenate(current.residuals())
    rms = float((residual @ residual / max(1, residual.size)) ** 0.5)
    parameters = current.problem.by_name(current.iterate.z)
    return Iteration(number, rms, remaining, current.largest_defect(), trust, parameters)
