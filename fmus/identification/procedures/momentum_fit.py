"""Parameters from the balance of momenta by weighted least squares; for one joint the paper's (13).

    e = phi * f - phi' * h        theta = theta_0 - (E'W E)^-1 E'W e_0        E = de/dtheta

with the filters of `modulation` and the terms of `motion`; W: inverse mean squares of the joints' residuals.

How far noise moves parameters that a weighted balance of momenta gave.

theta = theta_0 - A^-1 E'W e with A = E'W E, so that to first order in noise n of the sensors

    d theta = - A^-1 E'W (de/dn) n                  its covariance: by the transposed filters
    mean    = - A^-1 mean(dE'W de + E'W d2e)        errors in variables; squares of the speeds' noise

The first part of the mean is what attenuates the paper's (13), for one joint - B var(x' noise)/mean(x'^2),
here with all terms of the equation that see the speed; the second is in the centrifugal terms. The residuals
give a covariance of their own (Newey and West 1987), whatever made them.

What errors of the known parameters do to those that are found with them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from statsmodels.stats.sandwich_covariance import S_hac_simple

from fmus.identification.procedures import momentum_balance
from fmus.identification.procedures.momentum_balance import (
    JOINTS,
    PARAMETERS,
    Equation,
    Samples,
    equation,
    motion,
)
from fmus.parameters import Number
from orchestrator.base.errors import Problem

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
    noise, sensitivity = by_noise(fit, records, equations)
    bias = mean_effect(fit, records, equations)
    return Solution(
        theta=theta,
        values=at[[PARAMETERS.index(n) for n in theta]] - bias,
        mean_effect=bias,
        noise=noise,
        residual=by_residuals(fit, records, equations),
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
        raise Problem("the motion recorded does not tell apart " + ", ".join(theta))
    return normal, -np.linalg.solve(normal, right)


def _mean_square(equations: Sequence[Equation]) -> Array:
    """Mean square of each joint's error where the equation holds."""
    total = np.array(sum(np.sum(e.error**2, axis=1) for e in equations))
    count = sum(np.count_nonzero(e.error[0]) for e in equations)
    return total / max(count, 1)


@dataclass(frozen=True)
class Fit:
    """A weighted balance at its solution.

    rows     joints, by number; `weights` of them
    inverse  A^-1
    p        all parameters of the machine, theta among them as found
    """

    theta: tuple[str, ...]
    rows: list[int]
    weights: Array
    inverse: Array
    p: Array


def by_noise(fit: Fit, records: Sequence[Samples], equations: Sequence[Equation]) -> tuple[Array, Array]:
    """Covariance of theta by the noise of the sensors, and d theta / d parameter (m, parameters)."""
    m = len(fit.inverse)
    variance, slopes = np.zeros((m, m)), np.zeros((m, fit.p.size))
    for s, e in zip(records, equations, strict=True):
        influence = -np.einsum("mk,krt,r->mrt", fit.inverse, e.slope, fit.weights)
        by_value, by_parameter = _backward(fit, s, influence)
        slopes += by_parameter
        for k, sd in enumerate((*s.angle_noise, *s.pressure_noise)):
            speeds = by_value[k + 3] if k < 3 else None  # of an angle also the slope counts
            moved = s.filters.unsmoothed(by_value[k if k < 3 else k + 3], speeds)
            variance += sd**2 * moved @ moved.T
    return variance, slopes


def _backward(fit: Fit, s: Samples, influence: Array) -> tuple[Array, Array]:
    """d theta / d smoothed angle, speed, pressure (12, m, n) and d theta / d parameter (m, parameters)."""
    m, n = len(influence), s.q.shape[1]
    pull = np.zeros((6, m, n))  # by f, then by h
    for row, one in zip(fit.rows, np.swapaxes(influence, 0, 1), strict=True):
        pull[row] = momentum_balance.transposed(s.filters.bump, one)
        pull[3 + row] = -momentum_balance.transposed(s.filters.slope, one)
    signals = 6 + s.pressures.shape[0]
    by_value, by_parameter = np.zeros((signals, m, n)), np.zeros((m, fit.p.size))
    f = motion(())
    for (row, column), entry in zip(f.entries, np.array(f.gradients(*s.known, fit.p).full()), strict=True):
        if column < signals:
            by_value[column] += pull[row] * entry
        else:
            by_parameter[:, column - signals] += pull[row] @ entry
    return by_value, by_parameter


def by_residuals(fit: Fit, records: Sequence[Samples], equations: Sequence[Equation]) -> Array:
    """Covariance of theta by the residuals, correlated up to four times the filters' length."""
    m = len(fit.inverse)
    total = np.zeros((m, m))
    for s, e in zip(records, equations, strict=True):
        scores = np.einsum("mrt,r,rt->tm", e.slope, fit.weights, e.error)
        lags = 8 * s.filters.loss // s.filters.every
        total += S_hac_simple(scores, nlags=min(lags, scores.shape[0] - 1))
    return fit.inverse @ total @ fit.inverse


def mean_effect(fit: Fit, records: Sequence[Samples], equations: Sequence[Equation]) -> Array:
    """What the noise of the speeds adds to theta in the mean."""
    total = np.zeros(len(fit.theta))
    for s, e in zip(records, equations, strict=True):
        total += _products(fit, s) + np.einsum("mrt,r,rt->m", e.slope, fit.weights, _squares(fit, s))
    return -fit.inverse @ total


def _products(fit: Fit, s: Samples) -> Array:
    """Sum of mean(dE'W de); phi * and phi' * of one noise are not correlated."""
    m = len(fit.theta)
    stacked = np.array(motion(fit.theta).sway(*s.known, fit.p).full())
    by_speed = stacked.reshape(3, 2 * (m + 1), 3, s.q.shape[1])[:, :, fit.rows]
    by_speed = by_speed[..., s.middle] * s.good
    gains = s.filters.gain(s.filters.bump), s.filters.gain(s.filters.slope)
    total = np.zeros(m)
    for sd, one in zip(s.angle_noise, by_speed, strict=True):
        for gain, part in zip(gains, (one[: m + 1], one[m + 1 :]), strict=True):
            total += (sd * gain) ** 2 * np.einsum("mrt,r,rt->m", part[1:], fit.weights, part[0])
    return total


def _squares(fit: Fit, s: Samples) -> Array:
    """mean(d2e): what the squares of the speeds' noise are in the centrifugal terms, (rows, t)."""
    bend = np.array(motion(()).bend(*s.known, fit.p).full()).reshape(3, 3, s.q.shape[1])[:, fit.rows]
    variance = (s.angle_noise * s.filters.gain(np.ones(1))) ** 2
    force = np.einsum("k,krn->rn", variance, bend) / 2
    return momentum_balance.apply(s.filters.bump, force) * s.good


MOST = 3  # parameters named
LITTLE = 0.1  # of a standard deviation, and of a variance: what is smaller is not told
EXACT = "manipulator.gravity"  # nobody doubts it


@dataclass(frozen=True)
class Doubt:
    """Of one parameter.

    own      standard deviation by the recordings
    told     what one standard deviation of each known parameter moves it by, where one is told
    untold   what 1 % of each known parameter without a standard deviation moves it by
    """

    own: float
    told: Mapping[str, float]
    untold: Mapping[str, float]

    @property
    def sd(self) -> float:
        """By the standard deviations of the known parameters, taken as independent."""
        return math.sqrt(sum(x**2 for x in self.told.values()))

    @property
    def total(self) -> float:
        """Standard deviation by the recordings and by the known parameters."""
        return math.hypot(self.own, self.sd)

    @property
    def matters(self) -> bool:
        """Do the known parameters widen the interval?"""
        return self.sd > LITTLE * self.own

    def remarks(self, value: float, unit: str) -> list[str]:
        """Sentences without their subject's name; none if nothing matters."""
        found = []
        if self.matters:
            names = _largest({n: x for n, x in self.told.items() if x**2 > LITTLE * self.sd**2})
            found.append(
                f"the standard deviations of the known parameters add {self.sd:.2g} {unit} to its own "
                f"{self.own:.2g}, most of it by {', '.join(names)}."
            )
        moving = {n: x for n, x in self.untold.items() if abs(x) > self.total}
        if moving:
            parts = ", ".join(f"{n} {100 * moving[n] / value:+.2g} %" for n in _largest(moving))
            found.append(
                "the interval takes geometry and masses as exact. An error of 1 % would change the value: "
                f"{parts}."
            )
        return found

    def note(self) -> str:
        """For parameters.toml, where it matters."""
        parts = f"; sd {self.own:.2g} by the recordings, {self.sd:.2g} by the known parameters"
        return parts if self.matters else ""


def doubt(solution: Solution, number: int, known: Mapping[str, Number]) -> Doubt:
    """About the parameter with this number among those found."""
    slopes = dict(zip(PARAMETERS, map(float, solution.sensitivity[number]), strict=True))
    others = {n: known[n] for n in PARAMETERS if n not in solution.theta and n != EXACT}
    return Doubt(
        float(solution.sd[number]),
        {n: slopes[n] * x.sd for n, x in others.items() if x.sd is not None},
        {n: slopes[n] * abs(x.value) / 100 for n, x in others.items() if x.sd is None},
    )


def _largest(moved: Mapping[str, float]) -> list[str]:
    return sorted(moved, key=lambda n: -abs(moved[n]))[:MOST]
