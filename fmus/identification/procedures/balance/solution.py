"""Parameters from the balance of momenta by weighted least squares; for one joint the paper's (13).

    e = phi * f - phi' * h        theta = theta_0 - (E'W E)^-1 E'W e_0        E = de/dtheta

with the filters of `modulation` and the terms of `motion`; W: inverse mean squares of the joints' residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.procedures.balance import uncertainty
from fmus.identification.procedures.balance.equation import Equation, equation
from fmus.identification.procedures.balance.motion import JOINTS, PARAMETERS
from fmus.identification.procedures.balance.samples import Samples
from fmus.identification.procedures.balance.uncertainty import Fit

Array = NDArray[np.float64]
SETTLED = 2  # rounds: weights by residuals hardly move theta
LACKS = 2.0  # standard deviation by residuals over that by noise, from which on noise does not explain them
SINGULAR = 1e12  # condition of the scaled normal equations from which on they are not solved


@dataclass(frozen=True)
class Solution:
    """theta by least squares.

    values       with the mean effect of the noise taken off, which is `mean_effect`
    noise        covariance by the noise of the sensors; zero if there is none to see
    residual     covariance by the residuals
    sensitivity  d theta / d parameter, (m, parameters), in the order of `motion.PARAMETERS`
    equations    e and E at theta before the correction, one for each recording
    """

    theta: tuple[str, ...]
    values: Array
    mean_effect: Array
    noise: Array
    residual: Array
    sensitivity: Array
    weights: Array
    equations: tuple[Equation, ...]

    @property
    def lacks(self) -> bool:
        """Can the sensors' noise not explain the residuals? If no noise is told or seen, it cannot."""
        return bool(np.any(np.diag(self.residual) > LACKS**2 * np.diag(self.noise)))

    @property
    def covariance(self) -> Array:
        """By the noise of the sensors; by the residuals if noise cannot explain them."""
        return self.residual if self.lacks else self.noise

    @property
    def sd(self) -> Array:
        """Standard deviations."""
        sd: Array = np.sqrt(np.diag(self.covariance))
        return sd


def solve(records: Sequence[Samples], joints: Sequence[str], theta: tuple[str, ...], p: Array) -> Solution:
    """Least squares over all records for parameters in which the equation of motion is linear."""
    rows = [JOINTS.index(j) for j in joints]
    start = [equation(s, rows, theta, p) for s in records]
    weights = np.ones(1) if len(rows) == 1 else 1 / _mean_square(start)
    normal, step = normal_step(start, weights, theta)
    for _ in range(SETTLED if len(rows) > 1 else 0):
        weights = 1 / _mean_square([e.moved(step) for e in start])
        normal, step = normal_step(start, weights, theta)
    at = p.copy()
    at[[PARAMETERS.index(n) for n in theta]] += step
    equations = tuple(e.moved(step) for e in start)
    fit = Fit(theta, rows, weights, np.array(np.linalg.inv(normal), float), at)
    noise, sensitivity = uncertainty.by_noise(fit, records, equations)
    mean_effect = uncertainty.mean_effect(fit, records, equations)
    return Solution(
        theta=theta,
        values=at[[PARAMETERS.index(n) for n in theta]] - mean_effect,
        mean_effect=mean_effect,
        noise=noise,
        residual=uncertainty.by_residuals(fit, records, equations),
        sensitivity=sensitivity,
        weights=weights,
        equations=equations,
    )


def normal_step(equations: Sequence[Equation], weights: Array, theta: tuple[str, ...]) -> tuple[Array, Array]:
    """The normal equations' matrix and the step that they ask for."""
    normal = np.array(sum(np.einsum("mrt,r,krt->mk", e.slope, weights, e.slope) for e in equations))
    right = np.array(sum(np.einsum("mrt,r,rt->m", e.slope, weights, e.error) for e in equations))
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > SINGULAR:
        raise ModelError("the motion recorded does not tell apart " + ", ".join(theta))
    return normal, -np.linalg.solve(normal, right)


def _mean_square(equations: Sequence[Equation]) -> Array:
    """Mean square of each joint's error where the equation holds."""
    total = np.array(sum(np.sum(e.error**2, axis=1) for e in equations))
    count = sum(np.count_nonzero(e.error[0]) for e in equations)
    return total / max(count, 1)
