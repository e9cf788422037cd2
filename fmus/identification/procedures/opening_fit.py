"""Opening curve of one or several equal edges: data from steps, 95 % band, table for the machine.

The curves that the data allow come from `opening_posterior`, or from the covariance of a straight line
(`valve_law`). The band is simultaneous: 95 of 100 such curves lie in it over their whole length [Besag et
al., Statistical Science 10 (1995) 3, section 6.3]. The table has up to ten points, the first of which is the
start of the opening, and is evaluated as the machine does: a monotone cubic with the slope zero at its start.

Validity: as in `opening_posterior`. Effective areas contain C_d and the density: A = K / (C_d sqrt(2/rho)).
"""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from fmus.identification.estimate import CONFIDENCE, Estimate
from fmus.identification.procedures.experiment_data import select
from fmus.identification.procedures.opening_posterior import (
    OpeningData,
    OpeningDraws,
    OpeningPosterior,
    explore,
    unexplained,
)
from fmus.identification.procedures.regression import NEGLIGIBLE, UNLIKELY, Regression
from fmus.identification.procedures.valve_law import ValveConstants, ValveFit, ValveSteps
from orchestrator.data.table import Array

POINTS = 10  # of a table
GRID = 96  # commands at which curves are drawn, besides the measured ones
SAME = 1e-6  # V, difference of two commands that are one
PARAMETERS = 5  # of a curve beyond noise: area, start, exponent, size and length of the deviation
LINE = 2  # of a line: area, start
READING = 2.0  # areas over that of the meter's dead zone from which on it must read a flow, also with ripple
ZEROS = 21  # zeros with which a falling opening is tested
REPEATED = 0.5  # degrees of freedom from steps with nearly one command below which they are not repeated


@dataclass(frozen=True)
class OpeningCurve:
    """A fitted opening curve with its band.

    draws          curves that the data allow
    area           effective area [m2] at `draws.command`: the curve through the points of the table
    low, high      ends of the simultaneous 95 % band
    commands, areas   points of the table [V], [m2]; the first one is the start of the opening, with area 0
    first_measured    lowest command [V] with a measured flow; below it the curve is extrapolated
    """

    draws: OpeningDraws
    area: Array
    low: Array
    high: Array
    commands: Array
    areas: Array
    first_measured: float

    @property
    def command(self) -> Array:
        """Commands of `area`, `low` and `high` [V]."""
        return self.draws.command

    def band_at(self, command: Array) -> tuple[Array, Array]:
        """Ends of the band at commands [V]."""
        low, high = (np.interp(command, self.command, end) for end in (self.low, self.high))
        return np.asarray(low), np.asarray(high)

    def draws_at(self, command: float) -> Array:
        """Effective area [m2] of each curve at the nearest command [V] of the grid."""
        return np.asarray(self.draws.area[:, np.argmin(np.abs(self.command - command))])

    def at(self, command: Array) -> Array:
        """Effective area [m2] at commands [V], as the machine evaluates the table."""
        return tabulated(self.commands, self.areas, command)

    def estimate(self, name: str, unit: str, note: str, draws: Array, value: float | None = None) -> Estimate:
        """An estimate from its value in each curve: median, standard deviation, 95 % interval."""
        tail = (1 - CONFIDENCE) / 2
        low, middle, high = (float(x) for x in np.quantile(draws, [tail, 0.5, 1 - tail]))
        value = middle if value is None else value
        return Estimate(name, value, unit, float(draws.std()), min(low, value), max(high, value), note)


def tabulated(commands: Array, areas: Array, command: Array) -> Array:
    """Monotone cubic through the points of a table, 0 up to the first and constant after the last point.

    The slope at the first point is zero, as in the machine: here by a further point before it.
    """
    before = commands[0] - (commands[1] - commands[0])
    cubic = PchipInterpolator([before, *commands], [0.0, *areas])
    return np.asarray(np.where(command <= commands[0], 0.0, cubic(np.clip(command, before, commands[-1]))))


def opening_data(
    steps: ValveSteps, constants: ValveConstants, zero_limit: float, dead_zone: float
) -> OpeningData:
    """Effective areas from the steps of one edge, or of several that are equal; one for each command.

    dead_zone   flow [m3/s] up to which the meter reads nothing, with its noise
    """
    good = steps.measured()
    area_gain = constants.discharge_coefficient * math.sqrt(2 / constants.density)

    def log_area(flow: Array, s: ValveSteps) -> Array:
        leak = constants.leakage * (2 * s.drop - s.supply_drop)
        turbulent = np.maximum(flow - leak, 1e-3 * flow) * np.hypot(flow, constants.transition_flow)
        return np.asarray(np.log(turbulent / s.drop) / 2 - math.log(area_gain))

    sd = np.hypot(good.flow_error / good.flow, good.drop_error / (2 * good.drop))
    command, y, error, by_zero, pure = _by_command(good.command, log_area(good.flow, good), sd, good.drop)
    dead = steps.dead & (steps.drop > 0) & (dead_zone > 0)
    idle = select(steps, dead)
    bound = log_area(np.full(idle.drop.size, dead_zone), idle)
    return OpeningData(
        command=command,
        log_area=y,
        sd=error,
        by_zero=by_zero,
        bounds=np.column_stack([idle.command, bound]),
        zero_limit=zero_limit,
        full_command=constants.full_command,
        pure_error=pure,
    )


def _by_command(
    command: Array, y: Array, sd: Array, drop: Array
) -> tuple[Array, Array, Array, Array, tuple[float, int]]:
    """Weighted means of steps with one command, d y/d z, and chi-square of their scatter with its freedom."""
    order = np.argsort(command)
    groups = np.split(order, np.flatnonzero(np.diff(command[order]) > SAME) + 1)
    rows, chi_square = [], 0.0
    for rows_of in groups:
        weight = sd[rows_of] ** -2.0
        total = weight.sum()
        mean = float(weight @ y[rows_of] / total)
        chi_square += float(weight @ (y[rows_of] - mean) ** 2)
        by_zero = float(weight @ (-0.5 / drop[rows_of]) / total)
        rows.append((command[rows_of].mean(), mean, total**-0.5, by_zero))
    means = [np.array(column) for column in zip(*rows, strict=True)]
    return means[0], means[1], means[2], means[3], (chi_square, command.size - len(groups))


def scatter(data: OpeningData) -> float:
    """Scatter of steps with one command, or nearly one, over their noise: 1 unless significantly larger.

    A recorded command has noise, so that repeated steps do not have exactly one; no smooth curve goes
    through them if the valve has hysteresis. Their chi-square is approximated by its mean and variance
    [Satterthwaite, Biometrics Bulletin 2 (1946) 6].
    """
    chi_square, freedom = data.pure_error
    left, weights = unexplained(data)
    if weights.sum() < REPEATED:
        left, weights = 0.0, np.zeros(1)
    mean, variance = freedom + float(weights.sum()), freedom + float(np.sum(weights**2))
    total = chi_square + left
    if not mean or float(stats.chi2.sf(total * mean / variance, mean**2 / variance)) >= UNLIKELY:
        return 1.0
    return math.sqrt(total / mean)


def posterior(data: OpeningData, factor: float | None = None, label: str = "valve") -> OpeningPosterior:
    """What the data say of the opening.

    factor   errors of the steps over their noise; by default by their scatter, if noise does not explain it
    label    of error messages
    """
    factor = scatter(data) if factor is None else factor
    return explore(replace(data, sd=factor * data.sd, scatter=factor), label)


def curve(found: OpeningPosterior) -> OpeningCurve:
    """The opening curve with its band."""
    return curve_of(found.draws(_grid(found.data)), float(found.data.command.min()))


def falling(data: OpeningData) -> tuple[float, float]:
    """Probability that areas of a rising opening fall as much, and the largest fall [1].

    Chi-square of the areas against the closest ones that rise (isotonic regression), by the number of areas
    that it joins [Robertson, Wright and Dykstra, Order Restricted Statistical Inference (1988), section 2.3];
    with the zero of the pressures for which it is least.
    """
    best = (math.inf, 1, 0.0)
    for zero in np.linspace(-data.zero_limit, data.zero_limit, ZEROS):
        areas = data.log_area - data.by_zero * zero
        rising = isotonic_regression(areas, weights=data.sd**-2.0).x
        joined = data.sd.size - np.unique(rising).size
        chi_square = float(np.sum(((areas - rising) / data.sd) ** 2))
        fall = float(np.max(np.maximum.accumulate(areas) - areas))
        best = min(best, (chi_square, max(joined, 1), fall))
    return float(stats.chi2.sf(best[0], best[1])), 1 - math.exp(-best[2])


def idle_command(curve: OpeningCurve, data: OpeningData) -> float | None:
    """Highest command [V] of a step without a reading, though all of the band says that there is one."""
    low = curve.band_at(data.bounds[:, 0])[0]
    wrong = data.bounds[low > READING * np.exp(data.bounds[:, 1]), 0]
    return float(wrong.max()) if wrong.size else None


def _grid(data: OpeningData) -> Array:
    """Commands at which curves are drawn: equidistant ones, the measured ones, those of the dead zone."""
    inside = data.command[data.command < data.full_command - SAME]
    return np.unique(np.round([*np.linspace(0.0, data.full_command, GRID), *inside, *data.bounds[:, 0]], 6))


def line_curve(fitted: ValveFit, random: np.random.Generator, draws: int = 2000) -> OpeningCurve:
    """A straight line with its band, from the covariance of its fit.

    If no flow was measured on the rounded foot, the foot may be as long as the data allow.
    """
    regression, constants = fitted.regression, fitted.constants
    values = _normal_draws(regression, random, draws)
    rounding = values.get("rounding", np.full(draws, fitted.rounding))
    zero_of_line = values["dead_band"] + rounding / 2
    first = float(fitted.steps.command.min())
    if not fitted.rounding_estimated:
        longest = 2 * np.maximum(np.minimum(first - zero_of_line, zero_of_line), 0.0)
        rounding = np.clip(random.uniform(-1.0, 2.0, draws), 0.0, 1.0) * longest  # its ends are held, too
    rounding = np.maximum(rounding, 1e-3)
    start = np.maximum(zero_of_line - rounding / 2, 0.0)
    grid = np.unique(
        np.round([*np.linspace(0.0, constants.full_command, GRID), *np.unique(fitted.steps.command)], 6)
    )
    columns = (values["area"][:, None], start[:, None], rounding[:, None])
    area = line_area(*columns, constants, grid[None, :])
    zero = values.get("zero", np.zeros(draws))
    return curve_of(OpeningDraws(grid, area, start, np.ones(draws), zero), first)


def _normal_draws(regression: Regression, random: np.random.Generator, draws: int) -> dict[str, Array]:
    """Parameter -> its values in draws of the estimates' normal distribution."""
    sd = np.sqrt(np.diag(regression.covariance))
    scale = np.where(sd > 0, sd, 1.0)  # a zero at its limit has none
    correlation = regression.covariance / np.outer(scale, scale)
    normal = random.multivariate_normal(np.zeros(sd.size), correlation, draws, check_valid="ignore")
    return dict(zip(regression.names, (regression.values + scale * normal).T, strict=True))


def line_area(
    area: Array | float,
    start: Array | float,
    rounding: Array | float,
    constants: ValveConstants,
    command: Array,
) -> Array:
    """Effective area [m2] of a straight opening with a rounded foot, as `fmus.components.spool_valve`."""
    full = _rounded(np.asarray(constants.full_command - start), rounding)
    return np.asarray(area * _rounded(np.minimum(command, constants.full_command) - start, rounding) / full)


def _rounded(z: Array, width: Array | float) -> Array:
    """`fmus.components.smooth.ramp` of arrays."""
    s = np.clip(z / width, 0.0, 1.0)
    return np.asarray(width * (s**3 - s**4 / 2) + np.maximum(z - width, 0.0))


def curve_of(draws: OpeningDraws, first_measured: float) -> OpeningCurve:
    """Median, table and band of curves."""
    low, high = simultaneous_band(draws.area)
    middle, start = np.median(draws.area, axis=0), float(np.median(draws.start))
    commands, areas = table(draws.command, middle, (high - low) / 2, start)
    area = tabulated(commands, areas, draws.command)
    return OpeningCurve(
        draws, area, np.minimum(low, area), np.maximum(high, area), commands, areas, first_measured
    )


def simultaneous_band(draws: Array) -> tuple[Array, Array]:
    """Ends of a band that holds 95 % of the curves over their whole length, shape (k,) each.

    A curve is as extreme as its most extreme point; the band leaves out the most extreme 5 % of the curves.
    """
    count, ordered = draws.shape[0], np.sort(draws, axis=0)
    rank = np.full(count, count)
    for column, values in zip(draws.T, ordered.T, strict=True):
        below = np.searchsorted(values, column, side="right")  # curves at or below this one, itself included
        above = count - np.searchsorted(values, column, side="left")
        rank = np.minimum(rank, np.minimum(below, above))
    k = max(int(np.quantile(rank, 1 - CONFIDENCE)), 1)
    return ordered[k - 1], ordered[count - k]


def table(command: Array, area: Array, half_band: Array, start: float) -> tuple[Array, Array]:
    """Up to ten points of a curve, between which its largest error in half bands is as small as possible.

    Each further point is where the table is farthest off; then points move as long as this is better.
    """
    tolerance = np.maximum(half_band, 1e-4 * area.max())
    inner = [int(k) for k in np.flatnonzero(command > start + 0.01) if area[k] > 0]

    def points(chosen: Collection[int]) -> tuple[Array, Array]:
        order = sorted(chosen)
        return np.array([start, *command[order]]), np.array([0.0, *area[order]])

    def error(chosen: Collection[int]) -> Array:
        return np.asarray(np.abs(tabulated(*points(chosen), command) - area)[inner] / tolerance[inner])

    chosen = {inner[-1]}
    while len(chosen) < min(POINTS - 1, len(inner)) and (off := error(chosen)).max() > NEGLIGIBLE:
        chosen.add(max((k for k in inner if k not in chosen), key=lambda k: float(off[inner.index(k)])))
    best, improved = float(error(chosen).max()), True
    while improved and best > NEGLIGIBLE:
        improved = False
        for k in sorted(chosen - {inner[-1]}):
            for other in (inner[i] for i in _neighbours(inner.index(k), len(inner))):
                moved = chosen - {k} | {other}
                if len(moved) == len(chosen) and (worst := float(error(moved).max())) < best:
                    chosen, best, improved, k = moved, worst, True, other
    return points(chosen)


def _neighbours(index: int, count: int) -> Iterator[int]:
    """Indices up to four before and after one, without the last."""
    return (i for d in (1, 2, 4) for i in (index - d, index + d) if 0 <= i < count - 1)


def excess(found: OpeningPosterior, factor: float) -> float:
    """-2 ln of the likelihood of the best curve and of the scatter of steps with one command."""
    return found.likelihood + found.data.pure_error[0] / factor**2


def line_probability(line: ValveFit, found: OpeningPosterior) -> float:
    """Probability that data of a straight line prefer the curve as much (likelihood ratio)."""
    factor = found.data.scatter
    ratio = line.regression.chi_square / factor**2 - excess(found, factor)
    return float(stats.chi2.sf(ratio, PARAMETERS - LINE))
