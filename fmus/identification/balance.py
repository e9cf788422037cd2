"""One balance for all procedures: d/dt h(z, theta) = f(z, theta), fitted with the noise of its signals.

The balance is multiplied by a bump phi of compact support and integrated by parts over windows, so that no
signal is differentiated (modulating functions, Shinbrot 1957):

    e = sum phi f dt - sum (-phi') h = 0        phi = (1 - s^2)^4, |s| < 1

A steady balance, f = 0, is one sample per steady stretch and phi = 1. z are signals of sensors, each through
a filter. With G = de/d(samples of a sensor), sd its noise and z_0 the zeros of the sensors,

    e(y) = G (noise + z_0)        S = cov(e) = sum over sensors of sd^2 G G'
    minimise  e' S^-1 e + sum 3 (z_0 / limit)^2        with de/dz_0 = G 1

The zeros are columns of the regression. A data sheet bounds them and tells no more, so that all zeros up to
its limit are equally likely: the standard deviation of their prior is limit / sqrt(3) (`limit_sd`). The delay
of a logger against the others is an unknown, too, with the column G y'.
e and its derivatives are taken at the estimated true signals y - z_0 - sd^2 G' S^-1 e, so noise in regressors
does not bias theta (H. I. Britt and R. H. Luecke, The estimation of parameters in nonlinear, implicit models,
Technometrics 15, 1973, 233-247). A window has far more samples than balances, so most of the noise stays in
them: the mean of e by its squares, such as a centrifugal torque at rest, is subtracted.

If residuals are k > 1 times the noise, only the share 1/k^2 of them is noise. The covariance then is the
larger one of k^2 times that by the noise and that by the residuals (Newey and West 1987), so that it covers
errors of the model.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import linalg, ndimage, optimize, sparse, stats
from scipy.linalg.lapack import dtbtrs
from scipy.signal import savgol_filter
from statsmodels.stats.sandwich_covariance import S_hac_simple

from orchestrator.base.errors import Problem
from orchestrator.base.text import first_names
from orchestrator.data.recording import Mask
from orchestrator.data.table import Array

Indices: TypeAlias = NDArray[np.int64]

UNLIKELY = 1e-3  # probability of chi-square below which a fit is a misfit
SIGNIFICANT = 3.7  # standard deviations above which a term is significant: 1 in 5000 by chance
DETERMINED = 0.25  # largest relative standard deviation of a parameter that the data determine
NEGLIGIBLE = 0.1  # effects below this fraction of a standard deviation are not mentioned
SINGULAR = 1e12  # largest condition number of scaled normal equations; beyond, rounding errors decide
HOP = 0.5  # distance of neighbouring windows over their half width; they overlap
ITERATIONS = 60  # at most
ALTERNATING = 10  # iterations from which on the signals move by half a step, because some alternate
CONVERGED = 1e-2  # standard deviations, of the last step
CORRELATION = 4  # lengths of a window over which residuals may be correlated
TINY = 1e-300  # variance of a column without effect
SLOPE = 9  # samples of the polynomials whose slopes are the effect of a delay
SMALLEST = 1e-6  # noise of a sensor over the largest of its samples, if it is described as perfect


@dataclass(frozen=True)
class Law:
    """A balance as a function of one sample.

    unknowns   names of theta
    rows       number of equations
    terms      (z, theta, known) -> (f, h), their derivatives by z, and by theta, column by column
    by_known   (z, theta, known) -> derivatives of (f, h) by `known`, column by column
    by_squares (z, theta, known, sd of z) -> mean of (f, h) at z + sd and z - sd less that at z, sum over z
    """

    unknowns: tuple[str, ...]
    rows: int
    terms: ca.Function
    by_known: ca.Function
    by_squares: ca.Function


def law(
    z: ca.SX, unknowns: Mapping[str, ca.SX], known: ca.SX, force: ca.SX, momentum: ca.SX | None = None
) -> Law:
    """The balance of f = `force` and h = `momentum`, without `momentum` a steady one."""
    both = ca.vertcat(force, ca.SX.zeros(force.shape[0]) if momentum is None else momentum)
    theta = ca.vertcat(*unknowns.values())
    derivatives = [ca.densify(ca.vec(ca.jacobian(both, x))) for x in (z, theta, known)]
    arguments, sd, slopes = [z, theta, known], ca.SX.sym("sd", z.shape[0]), ca.jacobian(both, z)
    by_squares = ca.SX(2 * force.shape[0], 1)
    for c in range(z.shape[0]):
        if ca.depends_on(slopes[:, c], z[c]):
            up, down = (ca.substitute(both, z[c], z[c] + sign * sd[c]) for sign in (1, -1))
            by_squares += (up + down) / 2 - both
    return Law(
        unknowns=tuple(unknowns),
        rows=force.shape[0],
        terms=ca.Function("terms", arguments, [ca.densify(both), *derivatives[:2]], {"cse": True}),
        by_known=ca.Function("by_known", arguments, derivatives[2:]),
        by_squares=ca.Function("by_squares", [*arguments, sd], [ca.densify(by_squares)], {"cse": True}),
    )


def modulating_function(half: int, rate: float) -> tuple[Array, Array]:
    """phi dt and -phi' dt at the 2 half - 1 samples within a window of `half` samples to each side.

    The integral of phi is 1, and the derivative is scaled so that its sum over a straight line is exact.
    """
    position = np.arange(1 - half, half)
    s = position / half
    bump, slope = (1 - s**2) ** 4, 8 * s * (1 - s**2) ** 3
    return bump / bump.sum(), slope * rate / (slope @ position)


@dataclass(frozen=True)
class Samples:
    """Signals of one recording in a law; k sensors with n samples, m windows of L filtered samples.

    names         name of each unknown of the law among those of all recordings
    sensors       names of the sensors
    raw, sd       samples without gaps, shape (k, n), and their noise, shape (k, n) or (k, 1)
    channels      sensor and filter of each entry of z; filters have one length, 1 without a filter
    known         constants of the law
    rate          sampling rate [Hz]
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
    rate: float
    bump: Array
    slope: Array
    starts: Indices

    @property
    def taps(self) -> int:
        """Number of samples in the filters."""
        return self.channels[0][1].size

    @property
    def steady(self) -> bool:
        """Whether each sample is a balance of its own."""
        return self.taps == self.bump.size == 1

    @property
    def centres(self) -> Indices:
        """Filtered sample at the centre of each window, shape (m,)."""
        return self.starts + self.bump.size // 2

    @property
    def times(self) -> Array:
        """Time of the centre of each window since the start [s], shape (m,)."""
        return np.asarray((self.centres + self.taps // 2) / self.rate)

    def filtered(self, raw: Array) -> Array:
        """z, shape (channels, n - taps + 1), of samples (k, n)."""
        if self.steady:
            return raw
        return np.array([np.correlate(raw[s], kernel, "valid") for s, kernel in self.channels])

    def integral(self, force: Array, momentum: Array) -> Array:
        """sum phi f - sum (-phi') h over each window, for terms (..., n) the shape is (..., m)."""
        if self.steady:
            return force[..., self.starts]
        size = self.bump.size
        f, h = (sliding_window_view(x, size, axis=-1)[..., self.starts, :] for x in (force, momentum))
        return np.asarray(f @ self.bump - h @ self.slope)


def hop(size: int) -> int:
    """Distance in samples of neighbouring windows of `size` samples."""
    return max(round(HOP * (size + 1) / 2), 1)


def window_starts(good: Mask, size: int) -> Indices:
    """First sample of each window of `size` good samples, on one grid for the recording."""
    if good.size < size:
        return np.zeros(0, dtype=int)
    whole: Mask = np.asarray(sliding_window_view(good, size).all(axis=1))
    return np.flatnonzero(whole & (np.arange(whole.size) % hop(size) == 0))


def samples_of(
    model: Law, sensors: Iterable[str], raw: Array, noise: Array, known: Sequence[float] = (0.0,)
) -> Samples:
    """`Samples` of some signals, each a balance of its own, such as the means over a steady stretch.

    For balances over windows of moving signals the caller replaces rate, bump, slope and starts.

    raw     shape (k, n)
    noise   standard deviations, shape (k, n) or (k,); a perfect sensor gets one above zero
    """
    largest = np.max(np.abs(raw), axis=1, keepdims=True)
    return Samples(
        law=model,
        names=model.unknowns,
        sensors=tuple(sensors),
        raw=raw,
        sd=np.maximum(noise.reshape(len(raw), -1), SMALLEST * np.where(largest > 0, largest, 1.0)),
        channels=[(k, np.ones(1)) for k in range(len(raw))],
        known=np.array(known),
        rate=1.0,
        bump=np.ones(1),
        slope=np.zeros(1),
        starts=np.arange(raw.shape[1]),
    )


@dataclass(frozen=True)
class Linear:
    """The balance of one recording at some signals and parameters.

    e          residual, shape (rows, m)
    by_theta   de/dtheta, shape (unknowns, rows, m)
    g          G = de/d(samples) of each sensor, shape (k, rows, m, L + taps - 1)
    under      the samples under each window, shape (m, L + taps - 1)
    """

    e: Array
    by_theta: Array
    g: Array
    under: Indices

    def times(self, samples: Array) -> Array:
        """G y for samples (k, n), in the order of `flat`."""
        return np.asarray(np.einsum("krml,kml->mr", self.g, samples[:, self.under])).ravel()

    def transposed(self, weights: Array, count: int) -> Array:
        """G' w of weights in the order of `flat`, shape (k, count)."""
        each = np.einsum("krml,mr->kml", self.g, weights.reshape(len(self.under), -1))
        return np.array([np.bincount(self.under.ravel(), x.ravel(), count) for x in each])

    def covariance(self, variance: Array) -> Array:
        """Lower bands of G diag(variance) G' for variances (k, n)."""
        (k, r, m, size), n = self.g.shape, variance.shape[1]
        if size == 1:  # windows have no sample in common: r rows of each window
            blocks = np.einsum("kaml,kbml,kml->mab", self.g, self.g, variance[:, self.under])
            bands = np.zeros((r, m * r))
            for first, second in zip(*np.triu_indices(r), strict=True):
                bands[second - first, first::r] = blocks[:, first, second]
            return bands
        columns = np.arange(k)[:, None] * n + self.under[:, None, None]
        indices, ends = np.broadcast_to(columns, (m, r, k, size)).ravel(), np.arange(m * r + 1) * k * size
        matrix = sparse.csr_array((self.g.transpose(2, 1, 0, 3).ravel(), indices, ends), (m * r, k * n))
        lower = sparse.tril(matrix * variance.ravel() @ matrix.T).todia()
        bands = np.zeros((1 - lower.offsets.min(), m * r))
        bands[-lower.offsets] = lower.data
        return bands


def evaluated(function: ca.Function, *arguments: Array) -> list[Array]:
    """The results (rows, n) of a function at samples (k, n) and constants (k,).

    They pass through buffers: CasADi's own matrices take most of the time of a fit.
    """
    n = max(x.shape[1] for x in arguments if x.ndim == 2)
    columns = [x.T if x.ndim == 2 else np.broadcast_to(x, (n, x.size)) for x in arguments]
    given = [np.ascontiguousarray(x, dtype=float).reshape(-1) for x in columns]
    results = [np.empty(n * function.size1_out(i)) for i in range(function.n_out())]
    buffer, run = _mapped(function, n).buffer()
    for i, x in enumerate(given):
        buffer.set_arg(i, x.data)  # type: ignore[call-arg]  # its stub is that of C++
    for i, y in enumerate(results):
        buffer.set_res(i, y.data)  # type: ignore[call-arg]
    run()
    return [np.ascontiguousarray(y.reshape(n, -1).T) for y in results]


@lru_cache(maxsize=64)
def _mapped(function: ca.Function, n: int) -> ca.Function:
    """The function at n samples, which takes as long to make as to evaluate."""
    return function.map(n)


def linearised(s: Samples, raw: Array, theta: Array) -> Linear:
    """The balance at samples (k, n) and parameters in the order of the law's unknowns."""
    z, r, size = s.filtered(raw), s.law.rows, s.bump.size
    both, by_z, by_theta = evaluated(s.law.terms, z, theta, s.known)
    by_z, by_theta = (x.reshape(-1, 2 * r, z.shape[1]) for x in (by_z, by_theta))
    g = np.zeros((len(s.sensors), r, s.starts.size, size + s.taps - 1))
    if s.steady:
        g[..., 0] = by_z[:, :r, s.starts]
    for (sensor, kernel), derivative in zip(s.channels, by_z, strict=True):
        if derivative.any() and not s.steady:
            by_force, by_momentum = sliding_window_view(derivative, size, axis=-1)[:, s.starts].reshape(
                2, r, s.starts.size, size
            )
            by_filtered = by_force * s.bump - by_momentum * s.slope
            g[sensor] += by_filtered @ linalg.convolution_matrix(kernel, size).T
    under = s.starts[:, None] + np.arange(size + s.taps - 1)
    return Linear(s.integral(both[:r], both[r:]), s.integral(by_theta[:, :r], by_theta[:, r:]), g, under)


def squares_of_noise(s: Samples, true: Array, theta: Array) -> Array:
    """Mean of e by the squares of the noise, shape (rows, m).

    A value and a slope of one sensor have no common noise: one filter is even, the other odd.
    """
    variance = np.broadcast_to(s.sd**2, true.shape)
    kernels = ((variance[sensor], kernel**2) for sensor, kernel in s.channels)
    sds = np.sqrt(variance if s.steady else [np.correlate(*both, "valid") for both in kernels])
    (mean,), r = evaluated(s.law.by_squares, s.filtered(true), theta, s.known, sds), s.law.rows
    return s.integral(mean[:r], mean[r:])


def flat(rows: Array) -> Array:
    """Terms (..., rows, m) of e in one order, shape (..., m rows): the rows of each window together."""
    return np.swapaxes(rows, -1, -2).reshape(*rows.shape[:-2], -1)


@dataclass(frozen=True)
class Whitened:
    """The balance of one recording, transformed to white noise of variance 1.

    linear    the balance at the estimated true signals, its `e` that of the measured signals
    factor    Cholesky factor of S = cov(e), in bands
    columns   de/d(unknowns of all recordings), -de/d(zeros), de/d(delays), shape (unknowns, N)
    e         residual, shape (N,)
    """

    linear: Linear
    factor: Array
    columns: Array
    e: Array

    def whiten(self, e: Array) -> Array:
        """Terms of e in the order of `flat`, shape (..., N)."""
        white: Array = dtbtrs(self.factor, e.reshape(-1, e.shape[-1]).T, uplo="L")[0]
        return white.T.reshape(e.shape)

    def most_probable(self, measured: Array, variance: Array) -> Array:
        """The true signals y - sd^2 G' S^-1 e, for samples y of this variance."""
        weighted = dtbtrs(self.factor, self.e[:, None], uplo="L", trans="T")[0][:, 0]
        return np.asarray(measured - variance * self.linear.transposed(weighted, measured.shape[1]))


def whitened(
    s: Samples, true: Array, measured: Array, x: Mapping[str, float], delays: Mapping[str, Collection[str]]
) -> Whitened:
    """The balance linearised at the signals `true` (k, n), and extended to the measured ones.

    x          all unknowns, then zeros by the names of their sensors, and delays
    measured   samples without these zeros and delays
    delays     name of a delay -> sensors that have it
    """
    theta = np.array([x[n] for n in s.names])
    linear = linearised(s, true, theta)
    e = flat(linear.e - squares_of_noise(s, true, theta)) + linear.times(measured - true)
    bands = linear.covariance(np.broadcast_to(s.sd**2, true.shape))
    bands[0] *= 1 + 1e-12  # rounding
    columns = dict(zip(s.names, linear.by_theta, strict=True))
    columns |= dict(zip(s.sensors, -linear.g.sum(axis=-1), strict=True))
    if delays:
        width = min(SLOPE, s.raw.shape[1] - 1 | 1)
        slopes = savgol_filter(measured, width, 3, deriv=1, delta=1 / s.rate, axis=1)
    for name, late in delays.items():
        by_delay = linear.times(np.isin(s.sensors, list(late))[:, None] * slopes)
        columns[name] = by_delay.reshape(-1, s.law.rows).T
    every = flat(np.array([columns.get(n, np.zeros_like(linear.e)) for n in x]))
    linear = replace(linear, e=e.reshape(-1, s.law.rows).T)
    raw = Whitened(linear, linalg.cholesky_banded(bands, lower=True), every, e)
    return replace(raw, columns=raw.whiten(every), e=raw.whiten(e))


@dataclass(frozen=True)
class Normal:
    """Normal equations of  minimise |e + dx' columns|^2 + prior' (x + dx)^2.

    columns   shape (c, N); a column of zeros has no effect
    prior     inverse variances, shape (c,)
    """

    columns: Array
    prior: Array

    @cached_property
    def scale(self) -> Array:
        """Norm of each column with its prior."""
        size = np.sqrt(np.sum(self.columns**2, axis=1) + self.prior)
        return np.where(size > 0, size, np.inf)

    @cached_property
    def scaled(self) -> Array:
        """The matrix of the equations, with a diagonal of ones."""
        of_length_one = self.columns / self.scale[:, None]
        return np.asarray(of_length_one @ of_length_one.T + np.diag(self.prior / self.scale**2))

    @cached_property
    def inverse(self) -> Array:
        """Covariance of x by noise of variance 1."""
        scaled = np.linalg.pinv(self.scaled, rcond=1 / SINGULAR, hermitian=True)
        return np.asarray(scaled / np.outer(self.scale, self.scale))

    def step(self, e: Array, x: Array | float = 0.0, bound: Array | float = math.inf) -> Array:
        """dx, with which |x + dx| is at most `bound`."""
        step: Array = -self.inverse @ (self.columns @ e + self.prior * x)
        if np.all(np.abs(x + step) <= bound):
            return step
        root = np.sqrt(self.prior)
        rows = np.concatenate([self.columns, np.diag(root)], axis=1).T / self.scale
        between = (-bound - x) * self.scale, (bound - x) * self.scale
        return np.asarray(optimize.lsq_linear(rows, -np.concatenate([e, root * x]), between).x / self.scale)

    def covariance(self, e: Array, samples: Sequence[Samples], k_square: float) -> Array:
        """k^2 times that by the noise, widened where residuals e are correlated over some windows."""
        middle = np.diag(self.prior)
        for s, scores in zip(samples, np.split(self.columns * e, _ends(samples), axis=1), strict=True):
            by_window = scores.reshape(len(scores), -1, s.law.rows).sum(axis=2).T
            lags = (
                round(CORRELATION * (s.bump.size + s.taps - 1) / hop(s.bump.size)) if s.bump.size > 1 else 2
            )
            middle = middle + S_hac_simple(by_window, nlags=min(lags, len(by_window) // 4))
        by_noise, by_residuals = k_square * self.inverse, self.inverse @ middle @ self.inverse
        variance = np.maximum(np.diag(by_noise), TINY)
        widening = np.sqrt(np.maximum(np.diag(by_residuals) / variance, 1.0))
        return np.asarray(by_noise * np.outer(widening, widening))


def _ends(samples: Sequence[Samples]) -> Indices:
    """Where e of all recordings is split into that of each."""
    return np.cumsum([s.starts.size * s.law.rows for s in samples])[:-1]


@dataclass(frozen=True)
class Regression:
    """Result of a fit.

    names, values, covariance   parameters in one order; the covariance is widened if there is a misfit
    chi_square, freedom         sum of squares of the whitened residuals, and its degrees of freedom
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
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

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

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

    def combination(self, weights: Mapping[str, float]) -> tuple[float, float]:
        """A weighted sum of parameters and its standard deviation."""
        w = np.array([weights.get(n, 0.0) for n in self.names])
        return float(w @ self.values), math.sqrt(max(float(w @ self.covariance @ w), 0.0))


@dataclass(frozen=True)
class Solution:
    """Fit of a law to recordings.

    every     the estimates, then the zeros of the sensors in `limits`
    limits    largest zero of each sensor by its data sheet
    names     all unknowns, also those that are not fitted and whose effect can be tested
    normal    the whitened columns of the estimates and the zeros, with their priors
    parts     the balance of each recording at the solution
    """

    every: Regression
    limits: Mapping[str, float]
    names: tuple[str, ...]
    normal: Normal
    samples: Sequence[Samples]
    parts: Sequence[Whitened]

    @cached_property
    def fit(self) -> Regression:
        """The estimates without the zeros."""
        own = slice(len(self.every.names) - len(self.limits))
        names, values, covariance = self.every.names[own], self.every.values[own], self.every.covariance
        return replace(self.every, names=names, values=values, covariance=covariance[own, own])

    @property
    def cost(self) -> float:
        """Chi-square with the zeros by their priors."""
        zeros = sum((self.every[n] / limit_sd(limit)) ** 2 for n, limit in self.limits.items())
        return self.fit.chi_square + zeros

    @cached_property
    def residual(self) -> Array:
        """Whitened residual of all recordings."""
        return np.concatenate([part.e for part in self.parts])

    def column(self, name: str) -> Array:
        """Whitened column of an unknown, fitted or tested."""
        return np.concatenate([part.columns[self.names.index(name)] for part in self.parts])

    def effects(self, columns: Array) -> tuple[Array, Array]:
        """Further unknowns with whitened columns de/dx (c, N), fitted together, and their covariance.

        The covariance is the larger one of those by the noise, by the scatter and by correlated residuals.
        """
        fitted = self.normal
        left = columns - columns @ fitted.columns.T @ fitted.inverse @ fitted.columns
        new = np.linalg.norm(left, axis=1) > 1e-9 * np.linalg.norm(columns, axis=1)
        further = Normal(np.where(new[:, None], left, 0.0), np.zeros(len(columns)))
        change = further.step(self.residual)
        rest = self.residual + change @ further.columns
        scatter = float(rest @ rest) / max(rest.size - len(self.normal.prior), 1)
        return change, further.covariance(rest, self.samples, max(1.0, scatter))

    def effect(self, column: Array, given: Sequence[Array] = ()) -> tuple[float, float]:
        """The effect of one further unknown and its standard deviation; that of `given` columns is free."""
        value, covariance = self.effects(np.array([column, *given]))
        return float(value[0]), math.sqrt(covariance[0, 0])

    def free(self, sensor: str, held: Collection[str] = ()) -> tuple[float, float]:
        """Change of a sensor's zero without its own prior, and its standard deviation.

        The others keep their priors; those of the sensors `held` keep their values.
        """
        names = [n for n in self.every.names if n not in held]
        kept, row = [self.every.names.index(n) for n in names], names.index(sensor)
        prior = np.where(np.arange(len(names)) == row, 0.0, self.normal.prior[kept])
        alone = Normal(self.normal.columns[kept], prior)
        if not np.any(alone.columns[row]):
            return 0.0, math.inf
        step = alone.step(self.residual, self.every.values[kept])
        left = self.residual + step @ alone.columns
        scatter = max(1.0, float(left @ left) / max(self.fit.freedom, 1))
        return float(step[row]), math.sqrt(alone.inverse[row, row] * scatter)

    def by_known(self) -> Array:
        """d estimate / d known constant, shape (estimates, constants); all recordings have the same."""
        estimates, influence = len(self.fit.names), -self.normal.inverse @ self.normal.columns
        theta = dict(zip(self.fit.names, self.fit.values, strict=True))
        total = np.zeros((estimates, self.samples[0].known.size))
        each = np.split(influence[:estimates], _ends(self.samples), axis=1)
        for s, part, own in zip(self.samples, self.parts, each, strict=True):
            at = np.array([theta.get(n, 0.0) for n in s.names])
            (terms,) = evaluated(s.law.by_known, s.filtered(s.raw), at, s.known)
            terms = terms.reshape(s.known.size, 2, s.law.rows, -1)
            total += own @ part.whiten(flat(s.integral(terms[:, 0], terms[:, 1]))).T
        return total


def solve(
    samples: Sequence[Samples],
    start: Mapping[str, float],
    label: str,
    limits: Mapping[str, float] | None = None,
    tested: Collection[str] = (),
    priors: Mapping[str, float] | None = None,
    delays: Mapping[str, Collection[str]] | None = None,
) -> Solution:
    """Fit of the laws of all recordings; Problem if it does not converge.

    start    initial value of each unknown
    limits   sensor -> largest error of its zero by its data sheet; a sensor without one has no zero
    tested   unknowns that keep their initial value
    priors   unknown -> standard deviation of its initial value, which is zero
    delays   unknown -> sensors that are late by it [s] against the others
    """
    limits, delays = {n: limit for n, limit in (limits or {}).items() if limit > 0}, delays or {}
    start = {**start, **dict.fromkeys(delays, 0.0)}
    fitted = tuple(n for n in start if n not in tested)
    free, x = (*fitted, *limits), {**start, **dict.fromkeys(limits, 0.0)}
    sds = {n: limit_sd(limit) for n, limit in limits.items()} | dict(priors or {})
    prior = np.array([sds.get(n, math.inf) ** -2.0 for n in free])
    bound = np.array([limits.get(n, math.inf) for n in free])
    moved = np.zeros(len(free))  # since the start
    measured = true = [s.raw for s in samples]
    for iteration in range(ITERATIONS):
        try:
            parts = [whitened(s, t, y, x, delays) for s, t, y in zip(samples, true, measured, strict=True)]
        except (ValueError, np.linalg.LinAlgError):  # terms that are not finite, or no noise at all
            break
        normal = Normal(np.concatenate([p.columns[[n in free for n in x]] for p in parts], axis=1), prior)
        e = np.concatenate([p.e for p in parts])
        if not (np.isfinite(normal.columns).all() and np.isfinite(e).all()):
            break
        if np.linalg.cond(normal.scaled) > SINGULAR:
            points = f"the {e.size} points"
            raise Problem(f"{label}: {points} cannot distinguish between {first_names(fitted)}")
        step = normal.step(e, moved, bound)
        moved += step
        e = e + step @ normal.columns
        x |= {n: x[n] + float(dx) for n, dx in zip(free, step, strict=True)}
        k_square = max(1.0, float(e @ e) / max(e.size - len(fitted), 1))
        parts = [replace(p, e=own) for p, own in zip(parts, np.split(e, _ends(samples)), strict=True)]
        if iteration > 1 and np.all(np.abs(step) < CONVERGED * np.sqrt(k_square * np.diag(normal.inverse))):
            values = np.array([x[n] for n in free])
            found = Regression(free, values, normal.inverse, float(e @ e), max(e.size - len(fitted), 0))
            if found.misfit:
                wider = normal.covariance(e, samples, max(1.0, found.times_noise**2))
                found = replace(found, covariance=wider)
            return Solution(found, limits, tuple(x), normal, samples, parts)
        measured = [_corrected(s, {n: x[n] for n in (*limits, *delays)}, delays) for s in samples]
        every = zip(samples, parts, measured, true, strict=True)
        share = 0.5 if iteration > ALTERNATING else 1.0
        true = [t + share * (p.most_probable(y, s.sd**2 / k_square) - t) for s, p, y, t in every]
    raise Problem(f"{label}: the fit of {first_names(fitted)} did not converge")


def _corrected(s: Samples, x: Mapping[str, float], delays: Mapping[str, Collection[str]]) -> Array:
    """The samples without zeros and delays x."""
    raw: Array = s.raw - np.array([[x.get(n, 0.0)] for n in s.sensors])
    for name, late in delays.items():
        for row in np.flatnonzero(np.isin(s.sensors, list(late)) & (x[name] != 0)):
            raw[row] = ndimage.shift(raw[row], -x[name] * s.rate, mode="nearest")
    return raw


def limit_sd(limit: float) -> float:
    """Standard deviation of a zero that is anywhere up to a limit: that of a uniform distribution."""
    return limit / math.sqrt(3)


def probability(value: float, sd: float, tolerance: float = 0.0, *, sides: int = 2) -> float:
    """Probability of a value this far or farther from zero, if the true one is at most `tolerance` from it.

    sides   1: only a positive value counts
    """
    if not (sd > 0 and math.isfinite(sd) and math.isfinite(value)):
        return 1.0
    size = abs(value) if sides == 2 else value
    return float(min(1.0, sides * stats.norm.sf((size - tolerance) / sd))) if size > tolerance else 1.0
