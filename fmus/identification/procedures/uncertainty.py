"""How far noise moves parameters that a weighted balance of momenta gave.

theta = theta_0 - A^-1 E'W e with A = E'W E, so that to first order in noise n of the sensors

    d theta = - A^-1 E'W (de/dn) n                  its covariance: by the transposed filters
    mean    = - A^-1 mean(dE'W de)                  errors in variables: the noise of E and of e is the same

The second is what the paper's (13) attenuates B by, for one joint - B var(x' noise)/mean(x'^2), here with all
terms of the equation that see the speed. The residuals give a covariance of their own (Newey and West 1987),
whatever made them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from statsmodels.stats.sandwich_covariance import S_hac_simple

from fmus.identification.procedures import modulation
from fmus.identification.procedures.equation import Equation
from fmus.identification.procedures.motion import motion
from fmus.identification.procedures.samples import Samples

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
    m = len(fit.theta)
    variance, slopes = np.zeros((m, m)), np.zeros((m, fit.p.size))
    for s, e in zip(records, equations, strict=True):
        influence = -np.einsum("mk,krt,r->mrt", fit.inverse, e.slope, fit.weights)
        moved, by_parameter = zip(*(_backward(fit, s, one) for one in influence), strict=True)
        noises = (*s.angle_noise, *s.pressure_noise)
        for sd, by_sample in zip(noises, np.swapaxes(np.array(moved), 0, 1), strict=True):
            variance += sd**2 * by_sample @ by_sample.T
        slopes += np.array(by_parameter)
    return variance, slopes


def _backward(fit: Fit, s: Samples, influence: Array) -> tuple[Array, Array]:
    """From d theta / d e to d theta / d sample (sensors, n) and d theta / d parameter."""
    by_force, by_momentum = np.zeros((2, *s.q.shape))
    by_force[fit.rows] = modulation.transposed(s.filters.bump, influence)
    by_momentum[fit.rows] = -modulation.transposed(s.filters.slope, influence)
    gradients = motion(fit.theta).pull(*s.known, fit.p, by_force, by_momentum)
    q, w, pressures, parameters = (np.array(g.full()) for g in gradients)
    by_sample = np.vstack([s.filters.unsmoothed(q, w), s.filters.unsmoothed(pressures)])
    return by_sample, parameters.sum(axis=1)


def by_residuals(fit: Fit, records: Sequence[Samples], equations: Sequence[Equation]) -> Array:
    """Covariance of theta by the residuals, correlated up to four times the filters' length."""
    m = len(fit.theta)
    total = np.zeros((m, m))
    for s, e in zip(records, equations, strict=True):
        scores = np.einsum("mrt,r,rt->tm", e.slope, fit.weights, e.error)
        lags = 8 * s.filters.loss // s.filters.every
        total += S_hac_simple(scores, nlags=min(lags, scores.shape[0] - 1))
    return fit.inverse @ total @ fit.inverse


def attenuation(fit: Fit, records: Sequence[Samples]) -> Array:
    """What the noise of the speeds adds to theta in the mean; phi * and phi' * of it are not correlated."""
    m = len(fit.theta)
    total = np.zeros(m)
    for s in records:
        stacked = np.array(motion(fit.theta).sway(*s.known, fit.p).full())
        by_speed = stacked.reshape(3, 2 * (m + 1), 3, s.q.shape[1])[:, :, fit.rows]
        by_speed = by_speed[..., s.middle] * s.good
        gains = s.filters.gain(s.filters.bump), s.filters.gain(s.filters.slope)
        for sd, one in zip(s.angle_noise, by_speed, strict=True):
            for gain, part in zip(gains, (one[: m + 1], one[m + 1 :]), strict=True):
                total += (sd * gain) ** 2 * np.einsum("mrt,r,rt->m", part[1:], fit.weights, part[0])
    return -fit.inverse @ total
