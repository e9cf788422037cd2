"""Opening of a metering edge over the command, with its uncertainty, from steady steps of the command.

Each step gives the effective area of the edge from its flow and pressure drop (`valve_law`), so

    ln a_i = ln A + n ln l(V_i) + g(V_i) - z / (2 dp_i) + e_i        l = (V - V_0) / (V_full - V_0)

A     area at full command [m2]
V_0   start of the opening [V]: between 0 and the lowest command with a measured flow, all equally probable
n     exponent; 1 for a straight line
g     a smooth relative deviation from the power law: a Gaussian process with the Matern 3/2 covariance
      s^2 (1 + r) exp(-r), r = sqrt(3) |V - V'| / c, whose size s and length c are chosen by the data
z     difference of the two pressures without flow [Pa], within the limits of their data sheets
e     noise of the means

Given V_0, s and c the model is linear, and its posterior is normal. These three are integrated over a grid,
where s = 0, no deviation, has half of the prior. The result is a sample of curves. Between the measured
commands they differ as far as a curve that is as smooth as the measured points may differ there; below the
lowest measured command as far as start and exponent are undetermined. Curves that contradict a meter in its
dead zone, or have impossible zeros of the pressures, are left out, and each curve is made monotone.

Validity: the opening rises with the command; it has no step between two measured commands. References:
Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections 2.7 and 4.2; monotone
rearrangement keeps bands valid: Chernozhukov, Fernandez-Val and Galichon, Biometrika 96 (2009) 559.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.special import logsumexp

from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

DRAWS = 3000  # curves: the 2.5 % quantile of one has an error of a tenth of a standard deviation
SIZES = (0.0, *np.geomspace(1e-4, 1.0, 13))  # s: deviation from the power law, relative
LENGTHS = (1.5, 4.0, 10.0)  # c [V]: from the distance of two steps of the command to the whole range
COARSE, FINE = 40, 41  # start points V_0, over the whole range and around the best one
WIDE = 3.0  # sd of ln A: no information
EXPONENT = (1.0, 0.7)  # mean and sd of n: spools with notches have 1 to 2
CLOSEST = 1e-3  # V between start and first measured command
FEWEST = 200  # curves that must agree with the meter's dead zone for this to be used


@dataclass(frozen=True)
class OpeningData:
    """Effective areas of an edge, one row per command, shape (n,).

    command, log_area, sd   [V], ln of [m2], and its standard error
    by_zero                 d ln a / d z [1/Pa]
    bounds                  (command, ln of the largest area) of steps with a meter in its dead zone, (m, 2)
    zero_limit              largest |z| [Pa], two standard deviations of its prior
    full_command            V_full
    pure_error              chi-square and degrees of freedom of repeated steps with one command
    scatter                 `sd` over the noise of the steps
    """

    command: Array
    log_area: Array
    sd: Array
    by_zero: Array
    bounds: Array
    zero_limit: float
    full_command: float
    pure_error: tuple[float, int]
    scatter: float = 1.0


@dataclass(frozen=True)
class OpeningDraws:
    """Curves that the data allow, each with the same probability.

    command         shape (k,) [V], from 0 to full command
    area            shape (draws, k) [m2]
    start           shape (draws,) [V]: V_0
    exponent, zero  shape (draws,): n, and z [Pa]
    """

    command: Array
    area: Array
    start: Array
    exponent: Array
    zero: Array


@dataclass(frozen=True)
class _Model:
    """The normal model with one size and length of g: whitening of the data and of their regressors."""

    data: OpeningData
    size: float
    length: float

    @property
    def factor(self) -> Array:
        """Lower Cholesky factor of the covariance of g + e."""
        v = self.data.command
        return np.asarray(np.linalg.cholesky(self.covariance(v, v) + np.diag(self.data.sd**2)))

    def covariance(self, a: Array, b: Array) -> Array:
        """Covariance of g at two sets of commands."""
        r = math.sqrt(3.0) * np.abs(a[:, None] - b[None, :]) / self.length
        return self.size**2 * (1 + r) * np.exp(-r)

    def fits(self, starts: Array) -> tuple[Array, Array, Array]:
        """Per start V_0: -2 ln of the likelihood and of the volume, mean and covariance of ln A, n, z.

        Shapes (starts, 2), (starts, 3), (starts, 3, 3). The sum of the first two is -2 ln of the likelihood
        that is integrated over ln A, n and z.
        """
        lower, d = self.factor, self.data
        shape = np.log((d.command[:, None] - starts) / (d.full_command - starts))  # (n, starts)
        columns = np.column_stack([np.ones_like(d.command), d.by_zero, d.log_area, shape])
        one, zero, y, *shapes = solve_triangular(lower, columns, lower=True).T
        mean, sd = self.prior()
        by_exponent = np.array(shapes)
        h = np.stack(
            [np.broadcast_to(one, by_exponent.shape), by_exponent, np.broadcast_to(zero, by_exponent.shape)],
            -1,
        )
        precision = np.einsum("sni,snj->sij", h, h) + np.diag(sd**-2)
        covariances = np.linalg.inv(precision)
        bests = np.einsum("sij,sj->si", covariances, h.transpose(0, 2, 1) @ y + mean / sd**2)
        residual = y - np.einsum("sni,si->sn", h, bests)
        chi_square = np.sum(residual**2, axis=1) + np.sum(((bests - mean) / sd) ** 2, axis=1)
        volume = np.linalg.slogdet(precision)[1] + 2 * np.sum(np.log(sd))
        determinant = 2 * float(np.sum(np.log(np.diag(lower)) - np.log(d.sd)))
        return np.column_stack([chi_square + determinant, volume]), bests, covariances

    def prior(self) -> tuple[Array, Array]:
        """Mean and standard deviation of ln A, n and z before the data."""
        middle = float(self.data.log_area.max())
        return (
            np.array([middle, EXPONENT[0], 0.0]),
            np.array([WIDE, EXPONENT[1], max(self.data.zero_limit / 2, 1e-9)]),
        )


def unexplained(data: OpeningData) -> tuple[float, Array]:
    """Chi-square of the noise that the most flexible curve leaves, and its weights.

    With noise alone it is a sum of squared standard normal numbers with these weights: about 0 for a step
    that is alone, which such a curve follows, and about 1 in all for two steps with nearly one command.
    """
    model = _Model(data, SIZES[-1], LENGTHS[0])
    starts = np.linspace(0.0, float(data.command.min()) - CLOSEST, COARSE)
    criteria, means, _ = model.fits(starts)
    best = int(np.argmin(criteria[:, 0]))
    shape = np.log((data.command - starts[best]) / (data.full_command - starts[best]))
    columns = np.column_stack([np.ones_like(shape), shape, data.by_zero])
    residual = (data.log_area - columns @ means[best]) / data.sd
    kept = data.sd[:, None] * cho_solve((model.factor, True), np.diag(data.sd))
    return float(np.sum((kept @ residual) ** 2)), np.maximum(np.linalg.eigvalsh(kept), 0.0) ** 2


@dataclass(frozen=True)
class _Cell:
    """A part of the grid: one size and length of g, and all starts with their weights."""

    model: _Model
    starts: Array
    log_weight: Array
    likelihood: float
    means: Array
    covariances: Array


@dataclass(frozen=True)
class OpeningPosterior:
    """What the data say of an opening, on the grid over start, size and length."""

    data: OpeningData
    cells: tuple[_Cell, ...]

    @property
    def likelihood(self) -> float:
        """-2 ln of the likelihood of the best curve, without constants: for noise alone chi-square."""
        return min(cell.likelihood for cell in self.cells)

    def draws(self, grid: Array, seed: int = 0, count: int = DRAWS) -> OpeningDraws:
        """Curves at the commands of `grid` [V], which ascend to full command."""
        weights = np.concatenate([cell.log_weight for cell in self.cells])
        probability = np.exp(weights - logsumexp(weights))
        random = np.random.default_rng(seed)
        counts = np.split(
            random.multinomial(count, probability / probability.sum()),
            np.cumsum([cell.starts.size for cell in self.cells])[:-1],
        )
        parts = [
            _draws_of(cell, n, grid, random) for cell, n in zip(self.cells, counts, strict=True) if n.sum()
        ]
        area, start, exponent, zero = (np.concatenate(column) for column in zip(*parts, strict=True))
        allowed = _allowed(self.data, grid, area, zero)
        return OpeningDraws(grid, _monotone(area[allowed]), start[allowed], exponent[allowed], zero[allowed])


def explore(data: OpeningData, label: str = "valve") -> OpeningPosterior:
    """The posterior of an edge, or of several equal ones; its label is for error messages."""
    if data.command.min() < 2 * CLOSEST:
        raise Problem(f"{label}: expected a closed edge at 0 V, got a flow at {data.command.min():g} V")
    return OpeningPosterior(data, tuple(_cells(data)))


def _cells(data: OpeningData) -> Iterator[_Cell]:
    """The grid over size and length of g, with the starts of each."""
    first = float(data.command.min())
    whole = np.linspace(0.0, first - CLOSEST, COARSE)
    for size in SIZES:
        lengths = LENGTHS if size else LENGTHS[:1]
        for length in lengths:
            model = _Model(data, size, length)
            prior = math.log(0.5 if not size else 0.5 / (len(LENGTHS) * (len(SIZES) - 1)))
            starts = _refined(model, whole, first - CLOSEST)
            criteria, means, covariances = model.fits(starts)
            width = np.gradient(starts)
            log_weight = prior - criteria.sum(axis=1) / 2 + np.log(width)
            yield _Cell(model, starts, log_weight, float(criteria[:, 0].min()), means, covariances)


def _refined(model: _Model, whole: Array, highest: float) -> Array:
    """Starts over the whole range, and dense ones where they are probable."""
    starts, reach = whole, float(whole[1] - whole[0])
    for _ in range(4):
        total = model.fits(starts)[0].sum(axis=1)
        best = float(starts[np.argmin(total)])
        dense = np.linspace(max(best - reach, 0.0), min(best + reach, highest), FINE)
        starts = np.unique(np.concatenate([whole, dense]))
        spread = dense[(t := model.fits(dense)[0].sum(axis=1)) < t.min() + 12.0]
        narrower = max(float(np.ptp(spread)), 2 * float(dense[1] - dense[0]))
        if narrower > 0.5 * reach:
            break
        reach = narrower
    return starts


def _draws_of(
    cell: _Cell, counts: NDArray[np.int64], grid: Array, random: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """Area at the grid, start, exponent and zero of curves, so many for each start of the cell."""
    model, data = cell.model, cell.model.data
    start = np.repeat(cell.starts, counts)
    beta = np.concatenate(
        [
            random.multivariate_normal(mean, covariance, n, method="cholesky")
            for mean, covariance, n in zip(cell.means, cell.covariances, counts, strict=True)
            if n
        ]
    )
    full = data.full_command - start
    share = (grid[None, :] - start[:, None]) / full[:, None]
    opened = share > 0
    log_area = beta[:, :1] + beta[:, 1:2] * np.log(np.where(opened, share, 1.0))
    if model.size:
        shape = np.log((data.command[None, :] - start[:, None]) / full[:, None])
        regression = beta[:, :1] + beta[:, 1:2] * shape + beta[:, 2:] * data.by_zero
        log_area += _deviations(model, data.log_area - regression, grid, random)
    return np.where(opened, np.exp(log_area), 0.0), start, beta[:, 1], beta[:, 2]


def _deviations(model: _Model, residual: Array, grid: Array, random: np.random.Generator) -> Array:
    """g at the grid, given residuals of the regression, shape (draws, n)."""
    lower, data = model.factor, model.data
    across = solve_triangular(lower, model.covariance(data.command, grid), lower=True)
    mean = solve_triangular(lower, residual.T, lower=True).T @ across
    values, vectors = np.linalg.eigh(model.covariance(grid, grid) - across.T @ across)
    scatter = random.standard_normal((residual.shape[0], grid.size)) * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(mean + scatter @ vectors.T)


def _allowed(data: OpeningData, grid: Array, area: Array, zero: Array) -> Array:
    """Mask of the curves with a possible zero that leave a meter in its dead zone there.

    The commands of the dead zone are in the grid.
    """
    mask = np.abs(zero) <= data.zero_limit if data.zero_limit > 0 else np.ones(zero.size, dtype=bool)
    if not mask.any():  # the data want a zero that is impossible; a warning says so
        mask = np.ones(zero.size, dtype=bool)
    below = mask.copy()
    for command, bound in data.bounds:
        below &= area[:, np.argmin(np.abs(grid - command))] <= math.exp(bound)
    return np.asarray(below if np.count_nonzero(below) >= FEWEST else mask)


def _monotone(area: Array) -> Array:
    """Curves that rise with the command: the mean of the running maximum and the reverse running minimum."""
    upper = np.maximum.accumulate(area, axis=1)
    lower = np.minimum.accumulate(area[:, ::-1], axis=1)[:, ::-1]
    return np.asarray((upper + lower) / 2)
