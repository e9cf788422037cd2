"""How far noise moves parameters that a weighted balance of momenta gave.

theta = theta_0 - A^-1 E'W e with A = E'W E, so that to first order in noise n of the sensors

    d theta = - A^-1 E'W (de/dn) n                  its covariance: by the transposed filters
    mean    = - A^-1 mean(dE'W de + E'W d2e)        errors in variables; squares of the speeds' noise

The first part of the mean is what attenuates the paper's (13), for one joint - B var(x' noise)/mean(x'^2),
here with all terms of the equation that see the speed; the second is in the centrifugal terms. The residuals
give a covariance of their own (Newey and West 1987), whatever made them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from statsmodels.stats.sandwich_covariance import S_hac_simple

from fmus.identification.procedures.balance import modulation
from fmus.identification.procedures.balance.equation import Equation
from fmus.identification.procedures.balance.motion import motion
from fmus.identification.procedures.balance.samples import Samples

Array = NDArray[np.float64]


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
        pull[row] = modulation.transposed(s.filters.bump, one)
        pull[3 + row] = -modulation.transposed(s.filters.slope, one)
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
    return modulation.apply(s.filters.bump, force) * s.good
