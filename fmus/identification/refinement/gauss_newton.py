"""Gauss-Newton with bounds over all unknowns of multiple shooting, globalised by a trust region.

The merit of an iterate is the sum of squared residuals that remains once the linearisation has closed the
continuity defects between segments. Defects thus count by their effect on the residuals, and no penalty has
to be chosen. If the merit does not decrease as predicted, the step of the parameters is damped [Levenberg,
Marquardt] and a smaller fraction of it is taken. Damping, unlike shortening alone, slows down mainly the
parameters that the data hardly determine.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fmus.identification.refinement.compiled_model import SimulationFailed
from fmus.identification.refinement.shooting import Evaluation, Linearisation, Shooting, linearise
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

CONVERGED = "converged"
STUCK = "no step reduces the residuals"
INTERRUPTED = "interrupted"
TOLERANCE = 0.1  # standard deviations
ITERATIONS = 100
SMALLEST_RADIUS = 1e-5  # change of z; the search gives up if the linearisation does not hold even for that
SMALLEST_FRACTION = 1e-4  # fraction of a step; the search gives up below
LARGEST_RADIUS = 10.0  # change of z
_ACCEPTED = 0.01  # a step is accepted from this fraction of the predicted decrease on
_GOOD = 0.5  # the trust region grows from this fraction on
CLOSED = 1e-4  # nominal values; smaller continuity defects are negligible
DETACHED = 3.0  # standard deviations; tolerance of the search with detached segments
SETTLED = 0.05  # relative change of the scales that is negligible


@dataclass(frozen=True)
class Iteration:
    """One iteration.

    residual     root mean square of the residuals, 1 if the sensors explain them
    remaining    predicted change of all residuals by the best step, in standard deviations
    parameters   values by name
    """

    iteration: int
    residual: float
    remaining: float
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Minimum:
    """The end of a search: the last iterate with its linearisation, the reason of the end."""

    linear: Linearisation
    history: tuple[Iteration, ...]
    reason: str

    @property
    def converged(self) -> bool:
        """Has the search converged?"""
        return self.reason == CONVERGED

    @property
    def z(self) -> Array:
        """z of the parameters."""
        return self.linear.at.z


def minimise(
    shooting: Shooting,
    z: Array,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    progress: Callable[[Iteration], None] | None = None,
    previous: Minimum | None = None,
) -> Minimum:
    """Search from z, or from the end of the search `previous`, with measured initial states.

    After an interrupt, or if no step reduces the merit, the result is the best iterate so far.
    Far from the optimum, each output is weighted by its residuals without their correlation.

    Raises Problem if the start cannot be simulated.
    """
    problem, outputs = shooting.problem, len(shooting.problem.outputs)
    z = previous.z if previous else z
    try:
        start = shooting.evaluate(z, shooting.measured_starts(z))
    except SimulationFailed as failed:
        what = "cannot be simulated with the initial parameter values"
        raise Problem(f"{problem.sub.name}: {what}: {failed}") from None
    linear = linearise(shooting, start, start, start.scales(outputs, correlated=False))
    history, reason = list(previous.history) if previous else [], f"{iterations} iterations"
    if previous and previous.reason == INTERRUPTED:
        return Minimum(linear, tuple(history), INTERRUPTED)
    far, trust = True, (1.0, 1.0)
    try:
        for _ in range(iterations):
            current = linear.at
            best = linear.merit(linear.step(LARGEST_RADIUS, problem.bounds()))
            remaining = math.sqrt(max(0.0, linear.merit() - best))
            history.append(Iteration(len(history), current.rms, remaining, problem.by_name(current.z)))
            if progress:
                progress(history[-1])
            scales = current.scales(outputs, correlated=not far)
            settled = scales.change(linear.scales) < SETTLED
            converged = settled and not far and remaining < tolerance and current.continuous(CLOSED)
            if remaining < DETACHED if shooting.detached else converged:
                reason = CONVERGED
                break
            if far and settled and remaining < 1:
                far, scales = False, current.scales(outputs, correlated=True)
            new, trust = _next(shooting, linear, trust)
            if new is None:
                reason = STUCK
                break
            linear = linearise(shooting, new, new, scales)
    except KeyboardInterrupt:
        reason = INTERRUPTED
    return Minimum(linear, tuple(history), reason)


def _next(
    shooting: Shooting, linear: Linearisation, trust: tuple[float, float]
) -> tuple[Evaluation | None, tuple[float, float]]:
    """The next iterate, None if no step reduces the merit.

    trust   how far the linearisation is trusted: change of z, and fraction of a step; also the second result

    Along a step, of which the whole is predicted to decrease the merit by `full`, the merit decreases by
    2 full t - c t^2. The decrease at the fraction t that was taken determines c, and c the best t.
    """
    (radius, fraction), current, merit = trust, linear.at, linear.merit()
    slack = 1e-9 * merit  # rounding and the solver's error
    while radius > SMALLEST_RADIUS and fraction > SMALLEST_FRACTION:
        dz = linear.step(radius, shooting.problem.bounds())
        full = max(merit - linear.merit(dz), 0.0)
        predicted = full * fraction * (2 - fraction)
        z, runs = current.z + fraction * dz, zip(current.starts, linear.runs, strict=True)
        try:
            if shooting.detached:
                starts = shooting.measured_starts(z)
            else:
                starts = tuple(states + fraction * run.states(dz) for states, run in runs)
            new = shooting.evaluate(z, starts)
            decrease = merit - linearise(shooting, current, new, linear.scales).merit() + slack
        except SimulationFailed:
            decrease = -math.inf
        if decrease > _ACCEPTED * predicted:
            curvature = (2 * full * fraction - decrease) / fraction**2
            best = full / curvature if curvature > 0 else 1.0
            if decrease > _GOOD * predicted:
                radius = min(LARGEST_RADIUS, 3 * radius)
            return new, (radius, float(np.clip(best, fraction / 2, min(1.0, 2 * fraction))))
        radius, fraction = radius / 4, fraction / 2
    return None, (radius, fraction)
