"""Parameters from the balance of momenta by weighted least squares; for one joint the paper's (13).

    e = phi * f - phi' * h        theta = theta_0 - A^-1 E'W e_0        A = E'W E        E = de/dtheta

with the terms and filters of `momentum_balance`; W: inverse mean squares of the joints' residuals. To first
order in noise n of the sensors

    d theta = - A^-1 E'W (de/dn) n                  its covariance: by the transposed filters
    mean    = - A^-1 mean(dE'W de + E'W d2e)        errors in variables; squares of the speeds' noise

The first part of the mean is what attenuates the paper's (13), for one joint - B var(x' noise)/mean(x'^2),
here with all terms of the equation that see the speed; the second is in the centrifugal terms. The residuals
give a covariance of their own (Newey and West 1987), whatever made them. Errors of the known parameters move
theta by its sensitivity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from statsmodels.stats.sandwich_covariance import S_hac_simple

from fmus.identification.procedures.momentum_balance import (
    JOINTS,
    PARAMETERS,
    MomentumEquation,
    SmoothedRecording,
    apply,
    equation,
    motion,
    transposed,
)
from fmus.parameters import Number
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]
SETTLED = 2  # rounds: weights by residuals hardly move theta
LACKS = 2.0  # standard deviation by residuals over that by noise, from which on noise does not explain them
SINGULAR = 1e12  # condition of the scaled normal equations from which on they are not solved
MOST = 3  # parameters named
LITTLE = 0.1  # of a standard deviation, and of a variance: what is smaller is not mentioned
EXACT = "manipulator.gravity"  # nobody doubts it


@dataclass(frozen=True)
class MomentumSolution:
    """theta by least squares.

    values       with the mean effect of the noise taken off, which is `mean_effect`
    noise        covariance by the noise of the sensors; zero if there is none to see
    residual     covariance by the residuals
    sensitivity  d theta / d parameter, (m, parameters), in the order of `PARAMETERS`
    equations    e and E at theta before the correction, one for each recording
    """

    theta: tuple[str, ...]
    values: Array
    mean_effect: Array
    noise: Array
    residual: Array
    sensitivity: Array
    weights: Array
    equations: tuple[MomentumEquation, ...]

    @property
    def lacks(self) -> bool:
        """Can the sensors' noise not explain the residuals? If no noise is known or seen, it cannot."""
        return bool(np.any(np.diag(self.residual) > LACKS**2 * np.diag(self.noise)))

    @property
    def sd(self) -> Array:
        """Standard deviations by the noise of the sensors; by the residuals if noise cannot explain them."""
        sd: Array = np.sqrt(np.diag(self.residual if self.lacks else self.noise))
        return sd


def solve(
    records: Sequence[SmoothedRecording], joints: Sequence[str], theta: tuple[str, ...], p: Array
) -> MomentumSolution:
    """Least squares over all records for parameters in which the equation of motion is linear."""
    rows, places = [JOINTS.index(j) for j in joints], [PARAMETERS.index(n) for n in theta]
    start = [equation(s, rows, theta, p) for s in records]
    weights = np.ones(1) if len(rows) == 1 else 1 / _mean_square(start)
    normal, step = normal_step(start, weights, theta)
    for _ in range(SETTLED if len(rows) > 1 else 0):
        weights = 1 / _mean_square([e.moved(step) for e in start])
        normal, step = normal_step(start, weights, theta)
    at = p.copy()
    at[places] += step
    equations = tuple(e.moved(step) for e in start)
    fit = WeightedBalance(theta, rows, weights, np.array(np.linalg.inv(normal), float), at)
    noise, sensitivity = fit.noise(records, equations)
    bias = fit.mean_effect(records, equations)
    return MomentumSolution(
        theta=theta,
        values=at[places] - bias,
        mean_effect=bias,
        noise=noise,
        residual=fit.residual_covariance(records, equations),
        sensitivity=sensitivity,
        weights=weights,
        equations=equations,
    )


def normal_step(
    equations: Sequence[MomentumEquation], weights: Array, theta: tuple[str, ...]
) -> tuple[Array, Array]:
    """The normal equations' matrix and the step that they ask for."""
    normal = np.array(sum(np.einsum("mrt,r,krt->mk", e.slope, weights, e.slope) for e in equations))
    right = np.array(sum(np.einsum("mrt,r,rt->m", e.slope, weights, e.error) for e in equations))
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > SINGULAR:
        raise Problem("the motion recorded does not tell apart " + ", ".join(theta))
    return normal, -np.linalg.solve(normal, right)


def _mean_square(equations: Sequence[MomentumEquation]) -> Array:
    """Mean square of each joint's error where the equation holds."""
    total = np.array(sum(np.sum(e.error**2, axis=1) for e in equations))
    count = sum(np.count_nonzero(e.error[0]) for e in equations)
    return total / max(count, 1)


@dataclass(frozen=True)
class WeightedBalance:
    """A weighted balance at its solution, and how far noise moves it.

    rows     joints, by number; `weights` of them
    inverse  A^-1
    p        all parameters of the machine, theta among them as estimated
    """

    theta: tuple[str, ...]
    rows: list[int]
    weights: Array
    inverse: Array
    p: Array

    def noise(
        self, records: Sequence[SmoothedRecording], equations: Sequence[MomentumEquation]
    ) -> tuple[Array, Array]:
        """Covariance of theta by the noise of the sensors, and d theta / d parameter (m, parameters)."""
        m = len(self.inverse)
        variance, slopes = np.zeros((m, m)), np.zeros((m, self.p.size))
        for s, e in zip(records, equations, strict=True):
            influence = -np.einsum("mk,krt,r->mrt", self.inverse, e.slope, self.weights)
            by_value, by_parameter = self._backward(s, influence)
            slopes += by_parameter
            for k, sd in enumerate((*s.angle_noise, *s.pressure_noise)):
                speeds = by_value[k + 3] if k < 3 else None  # of an angle also the slope counts
                moved = s.filters.unsmoothed(by_value[k if k < 3 else k + 3], speeds)
                variance += sd**2 * moved @ moved.T
        return variance, slopes

    def _backward(self, s: SmoothedRecording, influence: Array) -> tuple[Array, Array]:
        """d theta / d smoothed angle, speed, pressure (12, m, n); d theta / d parameter (m, parameters)."""
        m, n = len(influence), s.q.shape[1]
        pull = np.zeros((6, m, n))  # by f, then by h
        for row, one in zip(self.rows, np.swapaxes(influence, 0, 1), strict=True):
            pull[row] = transposed(s.filters.bump, one)
            pull[3 + row] = -transposed(s.filters.slope, one)
        signals = 6 + s.pressures.shape[0]
        by_value, by_parameter = np.zeros((signals, m, n)), np.zeros((m, self.p.size))
        f = motion(())
        for (row, column), entry in zip(f.entries, f.gradients(*s.known, self.p).full(), strict=True):
            if column < signals:
                by_value[column] += pull[row] * entry
            else:
                by_parameter[:, column - signals] += pull[row] @ entry
        return by_value, by_parameter

    def residual_covariance(
        self, records: Sequence[SmoothedRecording], equations: Sequence[MomentumEquation]
    ) -> Array:
        """Covariance of theta by the residuals, correlated up to four times the filters' length."""
        m = len(self.inverse)
        total = np.zeros((m, m))
        for s, e in zip(records, equations, strict=True):
            scores = np.einsum("mrt,r,rt->tm", e.slope, self.weights, e.error)
            lags = 8 * s.filters.loss // s.filters.every
            total += S_hac_simple(scores, nlags=min(lags, scores.shape[0] - 1))
        return self.inverse @ total @ self.inverse

    def mean_effect(
        self, records: Sequence[SmoothedRecording], equations: Sequence[MomentumEquation]
    ) -> Array:
        """What the noise of the speeds adds to theta in the mean."""
        total = np.zeros(len(self.theta))
        for s, e in zip(records, equations, strict=True):
            # mean(d2e), (rows, t): what the squares of the speeds' noise are in the centrifugal terms
            bend = motion(()).bend(*s.known, self.p).full().reshape(3, 3, s.q.shape[1])[:, self.rows]
            variance = (s.angle_noise * s.filters.gain(np.ones(1))) ** 2
            squares = apply(s.filters.bump, np.einsum("k,krn->rn", variance, bend) / 2) * s.good
            total += self._products(s) + np.einsum("mrt,r,rt->m", e.slope, self.weights, squares)
        return -self.inverse @ total

    def _products(self, s: SmoothedRecording) -> Array:
        """Sum of mean(dE'W de); phi * and phi' * of one noise are not correlated."""
        m = len(self.theta)
        stacked = motion(self.theta).sway(*s.known, self.p).full()
        by_speed = stacked.reshape(3, 2 * (m + 1), 3, s.q.shape[1])[:, :, self.rows]
        by_speed = by_speed[..., s.middle] * s.good
        gains = s.filters.gain(s.filters.bump), s.filters.gain(s.filters.slope)
        total = np.zeros(m)
        for sd, one in zip(s.angle_noise, by_speed, strict=True):
            for gain, part in zip(gains, (one[: m + 1], one[m + 1 :]), strict=True):
                total += (sd * gain) ** 2 * np.einsum("mrt,r,rt->m", part[1:], self.weights, part[0])
        return total


@dataclass(frozen=True)
class KnownParameterEffect:
    """What errors of the known parameters do to one that is estimated with them.

    own     standard deviation by the recordings
    by_sd   what one standard deviation of each known parameter moves it by, where it has one
    by_1    what 1 % of each known parameter without a standard deviation moves it by
    """

    own: float
    by_sd: Mapping[str, float]
    by_1: Mapping[str, float]

    @property
    def sd(self) -> float:
        """By the standard deviations of the known parameters, taken as independent."""
        return math.sqrt(sum(x**2 for x in self.by_sd.values()))

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
        sentences = []
        if self.matters:
            names = _largest({n: x for n, x in self.by_sd.items() if x**2 > LITTLE * self.sd**2})
            sentences.append(
                f"the standard deviations of the known parameters add {self.sd:.2g} {unit} to its own "
                f"{self.own:.2g}, most of it by {', '.join(names)}."
            )
        moving = {n: x for n, x in self.by_1.items() if abs(x) > self.total}
        if moving:
            parts = ", ".join(f"{n} {100 * moving[n] / value:+.2g} %" for n in _largest(moving))
            sentences.append(
                "the interval takes geometry and masses as exact. An error of 1 % would change the value: "
                f"{parts}."
            )
        return sentences

    def note(self) -> str:
        """For parameters.toml, where it matters."""
        parts = f"; sd {self.own:.2g} by the recordings, {self.sd:.2g} by the known parameters"
        return parts if self.matters else ""


def known_parameter_effect(
    solution: MomentumSolution, number: int, known: Mapping[str, Number]
) -> KnownParameterEffect:
    """On the parameter with this number among those estimated."""
    slopes = dict(zip(PARAMETERS, map(float, solution.sensitivity[number]), strict=True))
    others = {n: known[n] for n in PARAMETERS if n not in solution.theta and n != EXACT}
    return KnownParameterEffect(
        float(solution.sd[number]),
        {n: slopes[n] * x.sd for n, x in others.items() if x.sd is not None},
        {n: slopes[n] * abs(x.value) / 100 for n, x in others.items() if x.sd is None},
    )


def _largest(moved: Mapping[str, float]) -> list[str]:
    return sorted(moved, key=lambda n: -abs(moved[n]))[:MOST]
