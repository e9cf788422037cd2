"""Least squares on the momentum balance, with covariance, bias, and sensitivity to known parameters.

    e = phi * f - phi' * h        theta = theta_0 - A^-1 E'W e_0        A = E'W E        E = de/dtheta

Terms and filters are those of `momentum_balance`. The weights W are inverse mean squares of the joints'
residuals. For one joint and one parameter this is the paper's (13). To first order in the noise n of the
sensors

    d theta = - A^-1 E'W (de/dn) n                  its covariance follows by the transposed filters
    bias    = - A^-1 mean(dE'W de + E'W d2e)        errors in variables; squares of the noise of the speeds

The first part of the bias is the attenuation of the paper's (13), for one joint - B var(x' noise)/mean(x'^2),
here with all terms of the equation that contain the speed. The second part is due to the centrifugal terms.
The residuals give another covariance, whatever their cause (Newey and West 1987). Errors of the known
parameters shift theta by its sensitivity.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from statsmodels.stats.sandwich_covariance import S_hac_simple

from fmus.identification.procedures.momentum_balance import (
    JOINTS,
    PARAMETERS,
    MomentumEquation,
    SmoothedRecording,
    convolve,
    equation_of_motion,
    momentum_equation,
    transposed_convolve,
)
from fmus.identification.procedures.regression import NEGLIGIBLE
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

WEIGHT_ITERATIONS = 2  # updates of the weights; further ones change theta only slightly
MISFIT = 2.0  # standard deviation by residuals over that by noise above which noise does not explain them
SINGULAR = 1e12  # largest condition number of the scaled normal equations
MAX_NAMES = 3  # parameters named in a remark
EXACT = "manipulator.gravity"  # has no error


@dataclass(frozen=True)
class MomentumSolution:
    """Least-squares estimate of theta.

    values                estimates, with the bias subtracted
    bias                  mean effect of the noise on the estimates
    noise_covariance      by the noise of the sensors; zero if no noise is described or visible
    residual_covariance   by the residuals
    sensitivity           d theta / d parameter, (m, parameters), in the order of `PARAMETERS`
    equations             e and E at theta before the bias is subtracted, one for each recording
    """

    theta: tuple[str, ...]
    values: Array
    bias: Array
    noise_covariance: Array
    residual_covariance: Array
    sensitivity: Array
    weights: Array
    equations: tuple[MomentumEquation, ...]

    @property
    def misfit(self) -> bool:
        """Whether the noise of the sensors cannot explain the residuals, as is the case without noise."""
        return bool(np.any(np.diag(self.residual_covariance) > MISFIT**2 * np.diag(self.noise_covariance)))

    @property
    def times_noise(self) -> float:
        """Largest ratio of the standard deviation by the residuals to that by the noise; 0 without noise."""
        by_residuals, by_noise = (np.diag(c) for c in (self.residual_covariance, self.noise_covariance))
        ratio = np.divide(by_residuals, by_noise, out=np.zeros_like(by_residuals), where=by_noise > 0)
        return math.sqrt(float(ratio.max()))

    @property
    def sd(self) -> Array:
        """Standard deviations by the noise of the sensors, or by the residuals if there is a misfit."""
        sd: Array = np.sqrt(np.diag(self.residual_covariance if self.misfit else self.noise_covariance))
        return sd


def solve(
    records: Sequence[SmoothedRecording], joints: Sequence[str], theta: tuple[str, ...], p: Array
) -> MomentumSolution:
    """Least squares over all records for parameters in which the equation of motion is linear."""
    rows, indices = [JOINTS.index(j) for j in joints], [PARAMETERS.index(n) for n in theta]
    start = [momentum_equation(s, rows, theta, p) for s in records]
    weights = np.ones(1) if len(rows) == 1 else 1 / _mean_square(start)
    normal, step = normal_step(start, weights, theta)
    for _ in range(WEIGHT_ITERATIONS if len(rows) > 1 else 0):
        weights = 1 / _mean_square([e.shifted(step) for e in start])
        normal, step = normal_step(start, weights, theta)
    estimated = p.copy()
    estimated[indices] += step
    equations = tuple(e.shifted(step) for e in start)
    fit = WeightedBalance(theta, rows, weights, np.array(np.linalg.inv(normal), float), estimated)
    noise_covariance, sensitivity = fit.noise(records, equations)
    bias = fit.bias(records, equations)
    return MomentumSolution(
        theta=theta,
        values=estimated[indices] - bias,
        bias=bias,
        noise_covariance=noise_covariance,
        residual_covariance=fit.residual_covariance(records, equations),
        sensitivity=sensitivity,
        weights=weights,
        equations=equations,
    )


def normal_step(
    equations: Sequence[MomentumEquation], weights: Array, theta: tuple[str, ...]
) -> tuple[Array, Array]:
    """Matrix of the normal equations and their solution, the step of theta."""
    normal = np.array(sum(np.einsum("mrt,r,krt->mk", e.jacobian, weights, e.jacobian) for e in equations))
    right = np.array(sum(np.einsum("mrt,r,rt->m", e.jacobian, weights, e.residual) for e in equations))
    scale = np.sqrt(np.diag(normal))
    if not (scale > 0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > SINGULAR:
        raise Problem("the recorded motion cannot distinguish between " + ", ".join(theta))
    return normal, -np.linalg.solve(normal, right)


def _mean_square(equations: Sequence[MomentumEquation]) -> Array:
    """Mean square of each joint's residual over the valid samples."""
    total = np.array(sum(np.sum(e.residual**2, axis=1) for e in equations))
    count = sum(np.count_nonzero(e.residual[0]) for e in equations)
    return total / max(count, 1)


@dataclass(frozen=True)
class WeightedBalance:
    """A weighted balance at its solution, and the effect of noise on the solution.

    rows, weights   indices of the joints and their weights
    inverse         A^-1
    p               all parameters of the machine, with the estimated theta
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
        covariance, sensitivity = np.zeros((m, m)), np.zeros((m, self.p.size))
        for s, e in zip(records, equations, strict=True):
            influence = -np.einsum("mk,krt,r->mrt", self.inverse, e.jacobian, self.weights)
            by_signal, by_parameter = self._backward(s, influence)
            sensitivity += by_parameter
            # an angle acts by its value and by its rate, the speed
            by_sample = [s.filters.transposed(by_signal[k], by_signal[k + 3]) for k in range(3)]
            by_sample += [s.filters.transposed(by_pressure) for by_pressure in by_signal[6:]]
            for sd, gradient in zip((*s.angle_noise, *s.pressure_noise), by_sample, strict=True):
                covariance += sd**2 * gradient @ gradient.T
        return covariance, sensitivity

    def _backward(self, s: SmoothedRecording, influence: Array) -> tuple[Array, Array]:
        """d theta / d smoothed angle, speed, pressure (12, m, n); d theta / d parameter (m, parameters)."""
        m, n = len(influence), s.q.shape[1]
        by_term = np.zeros((6, m, n))  # d theta / d f, then d theta / d h
        for row, by_residual in zip(self.rows, np.swapaxes(influence, 0, 1), strict=True):
            by_term[row] = transposed_convolve(s.filters.bump, by_residual)
            by_term[3 + row] = -transposed_convolve(s.filters.slope, by_residual)
        signals = 6 + s.pressures.shape[0]
        by_signal, by_parameter = np.zeros((signals, m, n)), np.zeros((m, self.p.size))
        f = equation_of_motion(())
        for (row, column), entry in zip(f.entries, f.gradients(*s.arguments, self.p).full(), strict=True):
            if column < signals:
                by_signal[column] += by_term[row] * entry
            else:
                by_parameter[:, column - signals] += by_term[row] @ entry
        return by_signal, by_parameter

    def residual_covariance(
        self, records: Sequence[SmoothedRecording], equations: Sequence[MomentumEquation]
    ) -> Array:
        """Covariance of theta by the residuals, which are correlated."""
        m = len(self.inverse)
        total = np.zeros((m, m))
        for s, e in zip(records, equations, strict=True):
            scores = np.einsum("mrt,r,rt->tm", e.jacobian, self.weights, e.residual)
            total += S_hac_simple(scores, nlags=min(s.filters.correlation_lags, scores.shape[0] - 1))
        return self.inverse @ total @ self.inverse

    def bias(self, records: Sequence[SmoothedRecording], equations: Sequence[MomentumEquation]) -> Array:
        """Mean effect of the noise of the speeds on theta."""
        total = np.zeros(len(self.theta))
        for s, e in zip(records, equations, strict=True):
            # mean(d2e), (rows, t): effect of squares of the noise of the speeds in the centrifugal terms
            hessian = equation_of_motion(()).speed_hessian(*s.arguments, self.p).full()
            hessian = hessian.reshape(3, 3, s.q.shape[1])[:, self.rows]
            variance = (s.angle_noise * s.filters.gain(np.ones(1))) ** 2
            squares = convolve(s.filters.bump, np.einsum("k,krn->rn", variance, hessian) / 2) * s.good
            total += self._products(s) + np.einsum("mrt,r,rt->m", e.jacobian, self.weights, squares)
        return -self.inverse @ total

    def _products(self, s: SmoothedRecording) -> Array:
        """Sum of mean(dE'W de); the same noise is uncorrelated after phi * and after phi' *."""
        m = len(self.theta)
        stacked = equation_of_motion(self.theta).speed_jacobian(*s.arguments, self.p).full()
        by_speed = stacked.reshape(3, 2 * (m + 1), 3, s.q.shape[1])[:, :, self.rows]
        by_speed = by_speed[..., s.centres] * s.good
        gains = s.filters.gain(s.filters.bump), s.filters.gain(s.filters.slope)
        total = np.zeros(m)
        for sd, of_joint in zip(s.angle_noise, by_speed, strict=True):
            for gain, terms in zip(gains, (of_joint[: m + 1], of_joint[m + 1 :]), strict=True):
                total += (sd * gain) ** 2 * np.einsum("mrt,r,rt->m", terms[1:], self.weights, terms[0])
        return total


@dataclass(frozen=True)
class KnownParameterEffect:
    """Effect of errors of the known parameters on an estimated parameter.

    recording_sd   standard deviation by the recordings
    by_sd          change by one standard deviation of each known parameter that has one
    by_percent     change by 1 % of each known parameter without a standard deviation
    """

    recording_sd: float
    by_sd: Mapping[str, float]
    by_percent: Mapping[str, float]

    @property
    def sd(self) -> float:
        """Standard deviation by those of the known parameters, which are assumed independent."""
        return math.sqrt(sum(x**2 for x in self.by_sd.values()))

    @property
    def total(self) -> float:
        """Standard deviation by the recordings and by the known parameters."""
        return math.hypot(self.recording_sd, self.sd)

    @property
    def significant(self) -> bool:
        """Whether the known parameters widen the interval noticeably."""
        return self.sd > NEGLIGIBLE * self.recording_sd

    def remarks(self, value: float, unit: str) -> list[str]:
        """Sentences that follow the parameter's name and a colon."""
        sentences = []
        if self.significant:
            names = _largest({n: x for n, x in self.by_sd.items() if x**2 > NEGLIGIBLE * self.sd**2})
            sentences.append(
                f"the uncertainty of the known parameters adds a standard deviation of {self.sd:.2g} "
                f"{unit} to the {self.recording_sd:.2g} {unit} from the recordings; most of it comes "
                f"from {', '.join(names)}."
            )
        large = {n: x for n, x in self.by_percent.items() if abs(x) > self.total}
        if large:
            changes = ", ".join(f"{n} {100 * large[n] / value:+.2g} %" for n in _largest(large))
            sentences.append(
                "the interval assumes exact geometry and masses. An error of 1 % would change the "
                f"value: {changes}."
            )
        return sentences

    def note(self) -> str:
        """Addition to the note in parameters.toml; empty unless the effect is significant."""
        if not self.significant:
            return ""
        return f"; sd {self.recording_sd:.2g} by the recordings, {self.sd:.2g} by the known parameters"


def known_parameter_effect(
    solution: MomentumSolution, index: int, parameters: Mapping[str, Number]
) -> KnownParameterEffect:
    """Effect of the known parameters on the estimated parameter with this index in theta."""
    sensitivity = dict(zip(PARAMETERS, map(float, solution.sensitivity[index]), strict=True))
    known = {n: parameters[n] for n in PARAMETERS if n not in solution.theta and n != EXACT}
    return KnownParameterEffect(
        float(solution.sd[index]),
        {n: sensitivity[n] * x.sd for n, x in known.items() if x.sd is not None},
        {n: sensitivity[n] * abs(x.value) / 100 for n, x in known.items() if x.sd is None},
    )


def _largest(changes: Mapping[str, float]) -> list[str]:
    return sorted(changes, key=lambda n: -abs(changes[n]))[:MAX_NAMES]
