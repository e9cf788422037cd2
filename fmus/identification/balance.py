"""One balance for all procedures: d/dt h(z, theta) = f(z, theta), fitted with the noise of its signals.

The balance is multiplied by a bump phi of compact support and integrated by parts over windows, so that no
signal is differentiated (modulating functions, Shinbrot 1957):

    e = sum phi f dt - sum (-phi') h = 0        phi = (1 - s^2)^4, |s| < 1

A steady balance, f = 0, is one sample per steady stretch and phi = 1. z are signals of sensors, each through
a filter. With G = de/d(samples of a sensor), sd its noise and z_0 the zeros of the sensors,

    e(y) = G (noise + z_0)        S = cov(e) = sum over sensors of sd^2 G G'
    minimise  e' S^-1 e + sum (2 z_0 / limit)^2        with de/dz_0 = G 1

The zeros are columns of the regression; the limit of a data sheet is two standard deviations of their prior.
e and its derivatives are taken at the estimated true signals y - z_0 - sd^2 G' S^-1 e, so noise in regressors
does not bias theta, and squares of the noise hardly do (H. I. Britt and R. H. Luecke, The estimation of
parameters in nonlinear, implicit models, Technometrics 15, 1973, 233-247). If residuals are k > 1 times the
noise, only the share 1/k^2 of them is noise. The covariance then is the larger one of k^2 times that by the
noise and that by the residuals (Newey and West 1987), so that it covers errors of the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import linalg, optimize, stats
from scipy.signal import savgol_filter
from statsmodels.stats.sandwich_covariance import S_hac_simple

from fmus.identification.estimate import Estimate
from fmus.identification.finding import Finding
from fmus.identification.procedure_result import BAR, LITRES_PER_MINUTE
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask
from orchestrator.data.table import Array

Indices: TypeAlias = NDArray[np.int64]

UNLIKELY = 1e-3  # probability of chi-square below which a fit is a misfit
SINGULAR = 1e8  # largest condition number of the scaled regressors; beyond, rounding errors decide
SIGNIFICANT = 3.7  # standard deviations above which a term is significant: 1 in 5000 by chance
DETERMINED = 0.25  # largest relative standard deviation of a parameter that the data determine
NEGLIGIBLE = 0.1  # effects below this fraction of a standard deviation are not mentioned
HOP = 0.5  # distance of neighbouring windows over their half width; they overlap
ITERATIONS = 60  # at most
CONVERGED = 1e-2  # standard deviations, of the last step
CORRELATION = 4  # lengths of a window over which residuals may be correlated
NOISE_KNOWN = 2.0  # factor to which the noise of a sensor is known
LAGS, CORRELATED = 5, 0.2  # windows, and correlation of whitened residuals that is no contradiction
UNTOLD = 5.0  # limits of a zero above which its standard deviation allows no test
SHIFT = 0.5  # sample times by which two sensors may be apart
SMALLEST = 1e-6  # noise of a sensor over the largest of its samples, if it is described as perfect


@dataclass(frozen=True)
class Law:
    """A balance as a function of one sample.

    unknowns   names of theta
    rows       number of equations
    terms      (z, theta, known) -> (f, h), their derivatives by z, and by theta, column by column
    used       whether a row depends on each entry of z
    by_known   (z, theta, known) -> nonzero derivatives of (f, h) by `known`, and their places
    places     row and column of each of these
    """

    unknowns: tuple[str, ...]
    rows: int
    terms: ca.Function
    used: tuple[bool, ...]
    by_known: ca.Function
    places: tuple[tuple[int, int], ...]


def law(
    z: ca.SX, unknowns: Mapping[str, ca.SX], known: ca.SX, force: ca.SX, momentum: ca.SX | None = None
) -> Law:
    """The balance of f = `force` and h = `momentum`, without `momentum` a steady one."""
    both = ca.vertcat(force, ca.SX.zeros(force.shape[0]) if momentum is None else momentum)
    theta = ca.vertcat(*unknowns.values())
    by_z, by_known = ca.jacobian(both, z), ca.jacobian(both, known)
    outputs = [both, ca.vec(by_z), ca.vec(ca.jacobian(both, theta))]
    columns = set(by_z.sparsity().get_col())
    arguments = [z, theta, known]
    return Law(
        unknowns=tuple(unknowns),
        rows=force.shape[0],
        terms=ca.Function("terms", arguments, [ca.densify(x) for x in outputs]),
        used=tuple(k in columns for k in range(z.shape[0])),
        by_known=ca.Function("by_known", arguments, [by_known.nz[:]]),
        places=tuple(zip(by_known.sparsity().row(), by_known.sparsity().get_col(), strict=True)),
    )


def modulating_function(half: int) -> tuple[Array, Array]:
    """phi and -d phi/d(sample) at the 2 half - 1 samples within a window of `half` samples to each side.

    The derivative is scaled so that its sum over a straight line is exact.
    """
    position = np.arange(1 - half, half)
    s = position / half
    bump, slope = (1 - s**2) ** 4, 8 * s * (1 - s**2) ** 3
    return bump, slope * bump.sum() / (slope @ position)


@dataclass(frozen=True)
class Samples:
    """Signals of one recording in a law; k sensors with n samples, m windows of L filtered samples.

    names         name of each unknown of the law among those of all recordings
    sensors       names of the sensors
    raw, sd       samples without gaps, shape (k, n), and their noise, shape (k, n) or (k, 1)
    channels      sensor and filter of each entry of z; filters have one length, 1 without a filter
    known         constants of the law
    bump, slope   phi dt and -phi' dt, shape (L,)
    starts        first filtered sample of each window, shape (m,)
    """

    law: Law
    names: tuple[str, ...]
    sensors: tuple[str, ...]
    raw: Array
    sd: Array
    channels: Sequence[tuple[int, Array]]
    known: Array
    bump: Array
    slope: Array
    starts: Indices

    @property
    def taps(self) -> int:
        """Number of samples in the filters."""
        return self.channels[0][1].size

    @property
    def centres(self) -> Indices:
        """Filtered sample at the centre of each window, shape (m,)."""
        return self.starts + self.bump.size // 2

    @property
    def weight(self) -> float:
        """Integral of the bump [s]; e divided by it is a mean."""
        return float(self.bump.sum())

    def filtered(self, raw: Array) -> Array:
        """z, shape (channels, n - taps + 1), of samples (k, n)."""
        return np.array([np.correlate(raw[s], kernel, "valid") for s, kernel in self.channels])

    def integral(self, force: Array, momentum: Array | None = None) -> Array:
        """sum phi f - sum (-phi') h over each window, for terms (..., n) the shape is (..., m)."""
        size = self.bump.size
        by_force: Array = sliding_window_view(force, size, axis=-1)[..., self.starts, :] @ self.bump
        if momentum is None:
            return by_force
        return by_force - sliding_window_view(momentum, size, axis=-1)[..., self.starts, :] @ self.slope

    def windows(self, values: Array) -> Array:
        """Raw samples (..., n) under each window with its filter, shape (..., m, L + taps - 1)."""
        return sliding_window_view(values, self.bump.size + self.taps - 1, axis=-1)[..., self.starts, :]


def window_starts(good: Mask, half: int) -> Indices:
    """First sample of each window of 2 half - 1 good samples, on one grid for the recording."""
    size, hop = 2 * half - 1, max(round(HOP * half), 1)
    if good.size < size:
        return np.zeros(0, dtype=int)
    whole: Mask = np.asarray(sliding_window_view(good, size).all(axis=1))
    return np.flatnonzero(whole & (np.arange(whole.size) % hop == 0))


def steady(
    model: Law, sensors: Sequence[str], means: Array, errors: Array, known: Sequence[float] = (0.0,)
) -> Samples:
    """Means of sensors over n steady stretches, shape (k, n), with their standard errors, as `Samples`."""
    smallest = SMALLEST * np.maximum(np.max(np.abs(means), axis=1, keepdims=True), 1e-30)
    channels = [(k, np.ones(1)) for k in range(len(sensors))]
    one, starts = np.ones(1), np.arange(means.shape[1])
    sd = np.maximum(errors, smallest)
    return Samples(
        model, model.unknowns, tuple(sensors), means, sd, channels, np.array(known), one, 0 * one, starts
    )


@dataclass(frozen=True)
class Linear:
    """The balance of one recording at some signals and parameters.

    e          residual, shape (rows, m)
    by_theta   de/dtheta, shape (unknowns, rows, m)
    g          de/d(samples) of each sensor, shape (k, rows, m, L + taps - 1)
    """

    e: Array
    by_theta: Array
    g: Array


def linearised(s: Samples, raw: Array, theta: Array) -> Linear:
    """The balance at samples (k, n) and parameters in the order of the law's unknowns."""
    z, r = s.filtered(raw), s.law.rows
    both, by_z, by_theta = (x.full() for x in s.law.terms(z, theta, s.known))
    n, size = z.shape[1], s.bump.size
    by_z, by_theta = (x.reshape(-1, 2 * r, n) for x in (by_z, by_theta))
    g = np.zeros((len(s.sensors), r, s.starts.size, size + s.taps - 1))
    for (sensor, kernel), derivative, used in zip(s.channels, by_z, s.law.used, strict=True):
        if used:
            force, momentum = (
                sliding_window_view(x, size, axis=-1)[:, s.starts] for x in (derivative[:r], derivative[r:])
            )
            rows = force * s.bump - momentum * s.slope
            shift = np.zeros(size)
            shift[0] = kernel[0]
            last = np.concatenate([kernel, np.zeros(size - 1)])
            g[sensor] += rows @ linalg.toeplitz(shift, last) if s.taps > 1 else rows * kernel
    return Linear(s.integral(both[:r], both[r:]), s.integral(by_theta[:, :r], by_theta[:, r:]), g)


def covariance_bands(s: Samples, g: Array) -> Array:
    """Lower bands of S = sum of sd^2 G G', windows in order and the rows of each window together."""
    _, r, m, size = g.shape
    scaled = (g * s.windows(np.broadcast_to(s.sd, s.raw.shape))[:, None]).transpose(2, 1, 0, 3)
    lags = 1
    while lags < m and np.any(s.starts[lags:] - s.starts[:-lags] < size):
        lags += 1
    bands = np.zeros((lags * r, r * m))
    for lag in range(lags):
        distance = s.starts[lag:] - s.starts[: m - lag]
        blocks = np.zeros((m - lag, r, r))  # later row, earlier row
        for d in np.unique(distance[distance < size]):
            at = np.flatnonzero(distance == d)
            later, earlier = (
                x.reshape(at.size, r, -1) for x in (scaled[at + lag, ..., : size - d], scaled[at, ..., d:])
            )
            blocks[at] = later @ earlier.transpose(0, 2, 1)
        for a in range(r):
            for b in range(r):
                if lag * r + b - a >= 0:
                    bands[lag * r + b - a, a : r * (m - lag) : r] = blocks[:, b, a]
    bands[0] *= 1 + 1e-12  # rounding
    return bands


@dataclass(frozen=True)
class Whitened:
    """The balance of one recording, transformed to white noise of variance 1.

    factor    Cholesky factor of S in bands
    linear    the balance at the estimated true signals, its `e` that of the measured signals
    columns   de/d(unknowns of all recordings), then -de/d(zeros), shape (unknowns + zeros, rows m)
    e         residual, shape (rows m,)
    """

    factor: Array
    linear: Linear
    columns: Array
    e: Array

    def whiten(self, rows: Array) -> Array:
        """Terms (..., rows, m) of e, shape (..., rows m)."""
        return _solved(self.factor, rows)


def _solved(factor: Array, rows: Array) -> Array:
    flat = np.swapaxes(rows, -1, -2).reshape(*rows.shape[:-2], -1)
    white: Array = linalg.solve_banded((factor.shape[0] - 1, 0), factor, flat.reshape(-1, flat.shape[-1]).T)
    return white.T.reshape(flat.shape)


@dataclass(frozen=True)
class Regression:
    """Result of a fit.

    names, values, covariance   parameters in one order; the covariance is widened if there is a misfit
    residual                    residuals, each divided by its standard deviation
    chi_square, freedom         sum of their squares, and its degrees of freedom
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    residual: Array
    chi_square: float
    freedom: int

    @property
    def misfit(self) -> bool:
        """Whether chi-square is too large to be explained by measurement noise."""
        return float(stats.chi2.sf(self.chi_square, self.freedom)) < UNLIKELY

    @property
    def times_noise(self) -> float:
        """Root mean square of the residuals in standard deviations: 1 if noise explains them."""
        return math.sqrt(self.chi_square / self.freedom) if self.freedom > 0 else 0.0

    @property
    def aic(self) -> float:
        """Akaike's information criterion for residuals of known standard deviation; lower is better."""
        return self.chi_square + 2 * len(self.names)

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    def as_dict(self) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, map(float, self.values), strict=True))

    def significant(self, name: str) -> bool:
        """Whether a parameter differs from zero by more than chance."""
        return abs(self[name]) > SIGNIFICANT * self.sd(name)

    def determined(self, name: str) -> bool:
        """Whether the data determine a positive parameter: its relative standard deviation is small."""
        return self.sd(name) <= DETERMINED * self[name]

    def sd(self, name: str) -> float:
        """Standard deviation of one parameter."""
        i = self.names.index(name)
        return math.sqrt(self.covariance[i, i])

    def estimate(self, name: str, unit: str, note: str, parameter: str = "", factor: float = 1.0) -> Estimate:
        """The estimate `name`: the fitted parameter (by default of that name) times an exact factor."""
        parameter = parameter or name
        return Estimate.normal(name, factor * self[parameter], unit, abs(factor) * self.sd(parameter), note)

    def derived(
        self, name: str, unit: str, note: str, function: Callable[[Mapping[str, float]], float]
    ) -> Estimate:
        """A function of the parameters, with its standard deviation by linear error propagation.

        The gradient is formed by central differences over the range of the noise. The interval of a positive
        value is that of its logarithm, so that it stays positive.
        """
        values, steps = self.as_dict(), np.sqrt(np.diag(self.covariance)) / 10
        differences = np.array(
            [
                function(values | {n: x + h}) - function(values | {n: x - h})
                for (n, x), h in zip(values.items(), steps, strict=True)
            ]
        )
        gradient = np.divide(differences, 2 * steps, out=np.zeros_like(differences), where=steps > 0)
        sd = math.sqrt(float(gradient @ self.covariance @ gradient))
        return Estimate.normal(name, function(values), unit, sd, note, log=True)


@dataclass(frozen=True)
class Solution:
    """Fit of a law to recordings.

    fit        the estimates; their covariance is widened if there is a misfit
    zeros      sensor -> estimated zero and its standard deviation
    covariance   of the estimates and the zeros
    by_noise   standard deviations of the estimates by the noise of the sensors alone
    parts      the balance of each recording at the solution
    prior      inverse variances of the unknowns and zeros by the data sheets
    names      all unknowns, also those that are not fitted and whose effect can be tested
    limits     largest zero of each sensor by its data sheet
    """

    fit: Regression
    zeros: Mapping[str, tuple[float, float]]
    covariance: Array
    by_noise: Array
    samples: tuple[Samples, ...]
    parts: tuple[Whitened, ...]
    prior: Array
    names: tuple[str, ...]
    limits: Mapping[str, float]

    def difference_of_zeros(self, first: str, second: str) -> tuple[float, float]:
        """Zero of one sensor less that of another, and its standard deviation."""
        contrast = np.zeros(len(self.covariance))
        for sensor, sign in ((first, 1.0), (second, -1.0)):
            contrast[len(self.fit.names) + list(self.limits).index(sensor)] = sign
        value = self.zeros[first][0] - self.zeros[second][0]
        return value, math.sqrt(contrast @ self.covariance @ contrast)

    @cached_property
    def residual(self) -> Array:
        """Whitened residual of all recordings."""
        return np.concatenate([part.e for part in self.parts])

    @cached_property
    def _free(self) -> list[int]:
        """Indices of fitted unknowns and zeros among the columns."""
        fitted = [self.names.index(n) for n in self.fit.names]
        return [*fitted, *range(len(self.names), len(self.prior))]

    @cached_property
    def columns(self) -> Array:
        """Whitened columns of the fitted unknowns and zeros, shape (unknowns + zeros, N)."""
        return np.concatenate([part.columns[self._free] for part in self.parts], axis=1)

    def column(self, name: str) -> Array:
        """Whitened column of an unknown, fitted or tested."""
        return np.concatenate([part.columns[self.names.index(name)] for part in self.parts])

    def whitened(self, rows: Sequence[Array]) -> Array:
        """Terms of e for each recording, (rows, m), as one whitened column."""
        return np.concatenate([p.whiten(r) for p, r in zip(self.parts, rows, strict=True)])

    def without(self, columns: Array) -> Array:
        """What is left of whitened columns (c, N) after the fit of the unknowns and zeros."""
        x, prior = self.columns, self.prior[self._free]
        scale = np.sqrt(np.sum(x**2, axis=1) + prior)
        normal = x @ x.T / np.outer(scale, scale) + np.diag(prior / scale**2)
        left: Array = columns - ((columns @ x.T / scale) @ np.linalg.pinv(normal, hermitian=True)) @ (
            x / scale[:, None]
        )
        return left

    def effects(self, columns: Array) -> tuple[Array, Array]:
        """Further unknowns with whitened columns de/dx (c, N), fitted together, and their covariance.

        The covariance is the larger one of those by the noise, by the scatter and by correlated residuals.
        """
        left = self.without(columns)
        scale = np.linalg.norm(left, axis=1)
        scale = np.where(scale > 1e-9 * np.linalg.norm(columns, axis=1), scale, np.inf)
        unit = left / scale[:, None]
        inverse = np.linalg.pinv(unit @ unit.T, rcond=1e-6, hermitian=True)
        change = -inverse @ unit @ self.residual
        rest = self.residual + change @ unit
        meat = np.array(sum(self._by_part(scores_covariance, unit, rest)))
        scatter = max(1.0, float(rest @ rest) / max(rest.size - len(self._free), 1))
        plain, hac = np.diag(inverse) * scatter, np.diag(inverse @ meat @ inverse)
        widening = np.sqrt(np.maximum(np.divide(hac, plain, out=np.ones_like(hac), where=plain > 0), 1.0))
        covariance = inverse * scatter * np.outer(widening, widening)
        return change / scale, covariance / np.outer(scale, scale)

    def _by_part(
        self, function: Callable[[Array, Array, Samples], Array], columns: Array, e: Array
    ) -> list[Array]:
        """A function of columns (c, N), of e (N,), and of the samples of each recording."""
        ends = np.cumsum([part.e.size for part in self.parts])[:-1]
        split = zip(np.split(columns, ends, axis=1), np.split(e, ends), self.samples, strict=True)
        return [function(*own) for own in split]

    def by_known(self) -> Array:
        """d estimate / d known constant, shape (estimates, constants); all recordings have the same."""
        x = self.columns
        scale = np.sqrt(np.sum(x**2, axis=1) + self.prior[self._free])
        normal = x @ x.T / np.outer(scale, scale) + np.diag(self.prior[self._free] / scale**2)
        influence = -np.linalg.solve(normal, x / scale[:, None]) / scale[:, None]
        total = np.zeros((len(self._free), self.samples[0].known.size))
        theta = dict(zip(self.fit.names, self.fit.values, strict=True))
        ends = np.cumsum([part.e.size for part in self.parts])[:-1]
        for s, part, own in zip(self.samples, self.parts, np.split(influence, ends, axis=1), strict=True):
            at = np.array([theta.get(n, 0.0) for n in s.names])
            entries = s.law.by_known(s.filtered(s.raw), at, s.known).full()
            for (row, column), entry in zip(s.law.places, entries, strict=True):
                r = row % s.law.rows
                e = np.zeros((s.law.rows, s.starts.size))
                zero = np.zeros_like(entry)
                e[r] = s.integral(entry) if row < s.law.rows else s.integral(zero, entry)
                total[:, column] += own @ part.whiten(e)
        return total[: len(self.fit.names)]


def scores_covariance(columns: Array, e: Array, s: Samples) -> Array:
    """Covariance of columns e, (c, N) and (N,), of residuals that are correlated over some windows."""
    scores = (columns * e).reshape(len(columns), -1, s.law.rows).sum(axis=2).T
    hop = max(round(HOP * (s.bump.size + 1) / 2), 1)
    lags = round(CORRELATION * (s.bump.size + s.taps - 1) / hop) if s.bump.size > 1 else 2
    return np.array(S_hac_simple(scores, nlags=min(lags, max(len(scores) // 4, 0))))


def solve(
    samples: Sequence[Samples],
    start: Mapping[str, float],
    label: str,
    limits: Mapping[str, float] | None = None,
    tested: Collection[str] = (),
    priors: Mapping[str, float] | None = None,
) -> Solution:
    """Fit of the laws of all recordings; Problem if it does not converge.

    start    initial value of each unknown
    limits   sensor -> largest error of its zero by its data sheet; a sensor without one has no zero
    tested   unknowns that keep their initial value
    priors   unknown -> standard deviation of its initial value, which is zero
    """
    limits = {n: x for n, x in (limits or {}).items() if x > 0}
    names, fitted = tuple(start), [k for k, n in enumerate(start) if n not in tested]
    weights = [1 / priors[n] ** 2 if priors and n in priors else 0.0 for n in names]
    prior = np.array([*weights, *(4 / limit**2 for limit in limits.values())])
    columns = [*fitted, *range(len(names), len(prior))]
    x, k_square = np.array([*start.values(), *(0.0 for _ in limits)], dtype=float), 1.0
    first, bound = x.copy(), np.array([*(np.inf for _ in fitted), *limits.values()])
    true = [s.raw for s in samples]
    problem = Problem(f"{label}: the fit of {', '.join(names[k] for k in fitted)} did not converge")
    for iteration in range(ITERATIONS):
        parts = [_whitened(s, y, x, names, limits) for s, y in zip(samples, true, strict=True)]
        matrix, e = (
            np.concatenate([p.columns for p in parts], axis=1)[columns],
            np.concatenate([p.e for p in parts]),
        )
        weight = prior[columns]
        scale = np.sqrt(np.sum(matrix**2, axis=1) + weight)
        if not np.isfinite(scale).all():
            raise problem
        normal = matrix @ matrix.T + np.diag(weight)
        if not (scale > 0).all() or np.linalg.cond(normal / np.outer(scale, scale)) > SINGULAR**2:
            unknown = ", ".join(names[k] for k in fitted)
            raise Problem(f"{label}: the {e.size} points cannot distinguish between {unknown}")
        inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
        step = -inverse @ (matrix @ e + weight * (x - first)[columns])
        if np.any(np.abs(x[columns] + step) > bound):  # a zero ends at its limit and keeps its interval
            step = _bounded(matrix, e, weight, (x - first)[columns], scale, bound)
        x[columns] += step
        e = e + step @ matrix
        freedom = max(e.size - len(fitted), 1)
        k_square = max(1.0, float(e @ e) / freedom)
        if iteration > 1 and np.max(np.abs(step) / np.sqrt(k_square * np.diag(inverse))) < CONVERGED:
            break
        ends = np.cumsum([p.e.size for p in parts])[:-1]
        zeros, half = (
            x[len(names) :],
            iteration > ITERATIONS // 6,
        )  # a smaller step where two signals alternate
        new = [
            _denoised(*own, zeros, limits, k_square)
            for own in zip(samples, parts, np.split(e, ends), strict=True)
        ]
        true = [(y + old) / 2 if half else y for y, old in zip(new, true, strict=True)]
    else:
        raise problem
    ends = np.cumsum([p.e.size for p in parts])[:-1]
    parts = [replace(p, e=own) for p, own in zip(parts, np.split(e, ends), strict=True)]
    fit = Regression(
        tuple(names[k] for k in fitted), x[fitted], inverse, e, float(e @ e), max(e.size - len(fitted), 0)
    )
    noise = np.sqrt(np.diag(inverse))
    covariance = inverse * (k_square if fit.misfit else 1.0)
    if fit.misfit:
        meat = sum(
            scores_covariance(p.columns[columns], p.e, s) for s, p in zip(samples, parts, strict=True)
        ) + np.diag(weight)
        by_residuals = np.sqrt(np.diag(inverse @ meat @ inverse) / np.diag(covariance))
        widening = np.maximum(by_residuals, 1.0)
        covariance = covariance * np.outer(widening, widening)
    sds, values = np.sqrt(np.diag(covariance)), x[len(names) :]
    return Solution(
        fit=replace(fit, covariance=covariance[: len(fitted), : len(fitted)]),
        zeros={n: (float(v), float(sd)) for n, v, sd in zip(limits, values, sds[len(fitted) :], strict=True)},
        covariance=covariance,
        by_noise=noise[: len(fitted)],
        samples=tuple(samples),
        parts=tuple(parts),
        prior=prior,
        names=names,
        limits=limits,
    )


def _bounded(matrix: Array, e: Array, weight: Array, x: Array, scale: Array, bound: Array) -> Array:
    """The step for which no |x + step| exceeds its bound."""
    rows = np.concatenate([matrix.T / scale, np.diag(np.sqrt(weight) / scale)])
    right = -np.concatenate([e, np.sqrt(weight) * x])
    margin = 1e-9 * np.where(np.isfinite(bound), bound, 0.0)
    found = optimize.lsq_linear(rows, right, ((-bound - x - margin) * scale, (bound - x + margin) * scale))
    return np.asarray(found.x / scale)


def _whitened(
    s: Samples, true: Array, x: Array, names: Sequence[str], limits: Mapping[str, float]
) -> Whitened:
    """The balance linearised at the signals `true`, and extended to the measured ones."""
    linear = linearised(s, true, x[[names.index(n) for n in s.names]])
    zeros = dict(zip(limits, x[len(names) :], strict=True))
    offset = np.array([zeros.get(n, 0.0) for n in s.sensors])[:, None]
    e = linear.e + np.einsum("krml,kml->rm", linear.g, s.windows(s.raw - offset - true))
    factor = linalg.cholesky_banded(covariance_bands(s, linear.g), lower=True)
    columns = np.zeros((x.size, *e.shape))
    for name, column in zip(s.names, linear.by_theta, strict=True):
        columns[names.index(name)] += column
    for k, sensor in enumerate(limits, len(names)):
        if sensor in s.sensors:
            columns[k] = -linear.g[s.sensors.index(sensor)].sum(axis=-1)
    return Whitened(factor, replace(linear, e=e), _solved(factor, columns), _solved(factor, e))


def _denoised(
    s: Samples, part: Whitened, e: Array, zeros: Array, limits: Mapping[str, float], k_square: float
) -> Array:
    """The most probable true signals: y - z_0 - sd^2 G' S^-1 e / k^2."""
    bands = part.factor
    upper = np.zeros_like(bands)  # the transpose of the Cholesky factor
    for d in range(bands.shape[0]):
        upper[bands.shape[0] - 1 - d, d:] = bands[d, : bands.shape[1] - d]
    weighted = linalg.solve_banded((0, bands.shape[0] - 1), upper, e)
    by_row = weighted.reshape(-1, s.law.rows).T / k_square
    samples = np.einsum("krml,rm->kml", part.linear.g, by_row)
    size = samples.shape[-1]
    index = (s.starts[:, None] + np.arange(size)).ravel()
    noise = np.array([np.bincount(index, own.ravel(), s.raw.shape[1]) for own in samples])
    found = dict(zip(limits, zeros, strict=True))
    offset = np.array([found.get(n, 0.0) for n in s.sensors])[:, None]
    return np.asarray(s.raw - offset - s.sd**2 * noise)


def noise_of(raw: Array, sd: Array) -> Array:
    """Standard deviations (k, 1) of the samples (k, n), above zero also for a perfect sensor."""
    largest = np.max(np.abs(raw), axis=1, keepdims=True)
    largest = np.where(largest > 0, largest, 1.0)
    return np.maximum(np.reshape(sd, (-1, 1)), SMALLEST * largest)


def homogeneity(values: Sequence[float], sds: Sequence[float]) -> float:
    """Probability (chi-square) that independent estimates of one quantity scatter as much as these."""
    v, w = np.array(values), 1 / np.array(sds) ** 2
    mean = np.sum(w * v) / np.sum(w)
    return float(stats.chi2.sf(np.sum(w * (v - mean) ** 2), len(v) - 1))


def probability(value: float, sd: float, tolerance: float = 0.0, *, sides: int = 2) -> float:
    """Probability of a value this far or farther from zero, if the true one is at most `tolerance` from it.

    sides   1: only a positive value counts
    """
    if not (sd > 0 and math.isfinite(sd) and math.isfinite(value)):
        return 1.0
    size = abs(value) if sides == 2 else value
    return float(min(1.0, sides * stats.norm.sf((size - tolerance) / sd))) if size > tolerance else 1.0


def misfit_remark(fit: Regression, equation: str) -> tuple[str, ...]:
    """A sentence if the equation cannot explain the data, else nothing."""
    if not fit.misfit:
        return ()
    return (
        f"{equation} leaves residuals {fit.times_noise:.3g} times as large as the noise: the model is "
        "incomplete. The intervals are widened by that factor.",
    )


def zero_findings(solution: Solution, label: str) -> Iterator[Finding]:
    """For each sensor: whether the data want its zero outside its declaration.

    The zero is estimated without its own prior; the zeros of the other sensors keep theirs.
    """
    columns, prior, e = solution.columns, solution.prior[solution._free], solution.residual
    x = np.array([*solution.fit.values, *(value for value, _ in solution.zeros.values())])
    for k, (sensor, limit) in enumerate(solution.limits.items(), len(solution.fit.names)):
        if not ("pressure" in sensor or "flow" in sensor) or not np.any(columns[k]):
            continue
        others = np.where(np.arange(x.size) == k, 0.0, prior)
        scale = np.sqrt(np.sum(columns**2, axis=1) + others)
        normal = (columns @ columns.T + np.diag(others)) / np.outer(scale, scale)
        inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True) / np.outer(scale, scale)
        step = -inverse @ (columns @ e + others * x)
        left = e + step @ columns
        zero, scatter = x[k] + step[k], float(left @ left) / max(solution.fit.freedom, 1)
        sd = math.sqrt(inverse[k, k] * max(1.0, scatter))
        pressure = "pressure" in sensor
        name, (unit, one) = ("pressure sensor", BAR) if pressure else ("flow meter", LITRES_PER_MINUTE)
        if sd > UNTOLD * limit:
            continue  # the data tell nothing about this zero
        pressure = "pressure" in sensor
        name, (unit, one) = ("pressure sensor", BAR) if pressure else ("flow meter", LITRES_PER_MINUTE)
        if not (pressure or "flow" in sensor):
            continue
        yield Finding(
            f"zero of a {name}",
            probability(zero, sd, limit),
            f"{label}: the data fit best with a zero of {sensor} of {zero / one:.3g} +- {sd / one:.2g} "
            f"{unit}; the declared limit is {limit / one:.3g} {unit}",
        )


def model_finding(solution: Solution, label: str) -> Finding:
    """Whether the residual is an effect that the law lacks: too large, or correlated beyond noise.

    A noise that is known to a factor of two (`NOISE_KNOWN`) and neighbours with a correlation of
    `CORRELATED` are no contradiction; the interval covers them. Without noise nothing is tested.
    """
    e, n = solution.residual, solution.fit.freedom
    sentence = f"{label}: the residuals are {solution.fit.times_noise:.3g} times the noise of the sensors"
    exact = any(
        np.any(s.sd[:, :1] <= SMALLEST * np.max(np.abs(s.raw), axis=1, keepdims=True))
        for s in solution.samples
    )
    if n < 1 or exact:
        return Finding("model", 1.0, sentence)
    excess = (NOISE_KNOWN**2 - 1) * n
    if n < 1000:
        too_large = float(stats.ncx2.sf(float(e @ e), n, excess))
    else:
        too_large = float(stats.norm.sf((float(e @ e) - n - excess) / math.sqrt(2 * (n + 2 * excess))))
    correlated, largest = 1.0, 0.0
    if n >= LAGS * 10 and solution.samples[0].bump.size > 1:
        rows = [p.e.reshape(-1, s.law.rows).T for s, p in zip(solution.samples, solution.parts, strict=True)]
        for lag in range(1, LAGS + 1):
            products = np.concatenate([(r[:, lag:] * r[:, :-lag]).ravel() for r in rows])
            rho = float(products.sum() / max(e @ e, n))
            largest = max(largest, abs(rho))
            correlated = min(correlated, probability(rho, 1 / math.sqrt(products.size), CORRELATED))
    if LAGS * correlated < too_large:
        sentence += f", and neighbours in time have a correlation of {largest:.2g}"
    return Finding("model", min(1.0, 2 * too_large, 2 * LAGS * correlated), sentence)


def shift_finding(
    solution: Solution, sensors: Collection[str], step: float, label: str, given: Sequence[str] = ()
) -> Finding:
    """Whether some sensors are late against the others, by more than `SHIFT` sample times `step` [s].

    given   tested unknowns that are estimated together with the delay
    """
    rows = []
    for s, part in zip(solution.samples, solution.parts, strict=True):
        smooth = savgol_filter(s.raw, min(9, s.raw.shape[1] - 1 | 1), 3, deriv=1, axis=1)
        late = [k for k, name in enumerate(s.sensors) if name in sensors]
        rows.append(np.einsum("krml,kml->rm", part.linear.g[late], s.windows(smooth[late])))
    columns = solution.whitened(rows)[None]
    if not np.any(solution.without(columns)):
        return Finding("time shift", 1.0, label)
    value, covariance = solution.effects(np.array([*columns, *(solution.column(n) for n in given)]))
    late_by, sd = float(value[0]) * step, math.sqrt(covariance[0, 0]) * step
    return Finding(
        "time shift",
        probability(late_by, sd, SHIFT * step),
        f"{label}: {', '.join(sensors)} would have to be {1e3 * late_by:.3g} +- {1e3 * sd:.2g} ms late",
    )


def drift_finding(
    solution: Solution,
    name: str,
    courses: Sequence[tuple[Array, str]],
    label: str,
    given: Array | None = None,
) -> Finding:
    """Whether an unknown changes in time or with the temperature of the oil.

    A change of less than the standard deviation of the unknown is no contradiction.

    courses   time or temperature of each window of each recording, and the word for it
    given     whitened columns that are estimated together, (c, N)
    """
    along, word = np.concatenate([values for values, _ in courses]), courses[0][1]
    span = float(np.ptp(along))
    along = np.repeat((along - along.mean()) / (span or 1.0), solution.samples[0].law.rows)
    own = (solution.column(name) * along)[None]
    value, covariance = solution.effects(own if given is None else np.concatenate([own, given]))
    change, sd = float(value[0]), math.sqrt(covariance[0, 0])
    percent = 100 / abs(solution.fit[name])
    return Finding(
        "oil temperature",
        probability(change, sd, solution.fit.sd(name)),
        f"{label} changes with the {word} by {percent * change:+.3g} +- {percent * sd:.2g} % over all of it",
    )
