"""Opening of a metering edge over the command as a curve with its 95 % band, and its table.

The areas at the nodes of `valve_fit` are those of noise and zeros. Between nodes a curve lies between their
chord and the straight continuations of its neighbours, where a kink would be, or the monotone cubic. Where no
flow was measured the opening is bounded by what any valve does. Below the lowest node it is a power
a_1 ((V - V_0) / (V_1 - V_0))^n with the slope of the opening there and an unknown exponent, not above what
a meter without reading allows. Above the highest node its slope is between zero and twice the last one.
The band is simultaneous: 95 of 100 curves that the data allow lie in it over their whole length [Besag et
al., Statistical Science 10 (1995) 3, section 6.3].
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from fmus.identification.procedures.valve_fit import DRAWS, SAME, Known, Lines, Nodes, ValveSteps, straight
from fmus.identification.results import CONFIDENCE, Estimate
from orchestrator.data.recording import Mask
from orchestrator.data.table import Array

POINTS, GRID = 10, 96  # of a table; commands at which curves are drawn, besides the measured ones
FOOT = (0.8, 3.5)  # exponents of a curve below its lowest node: a notch begins with 1 to 2, a rounding with 3
CURVED = 1.3  # times the change of slope to the lowest node by which a parabola through three is bent
UNDERLAP = 1.2  # largest exponent of an edge that is open at zero command
CLOSE = 0.1  # half bands: errors of a table below it do not count


@dataclass(frozen=True)
class OpeningCurve:
    """An opening with its band.

    command           grid [V] from zero to full command, shape (k,)
    draws             curves that the data allow [m2], shape (DRAWS, k)
    area, low, high   the opening through the points of the table, and the ends of the 95 % band [m2]
    commands, areas   points of the table [V], [m2]; the first one is the start of the opening, with area 0
    start             start of the opening [V] in each curve; negative: the edge is open at zero command
    first_measured    lowest command [V] with a measured flow; below it the curve is extrapolated
    last_measured     highest one, as well
    """

    command: Array
    draws: Array
    area: Array
    low: Array
    high: Array
    commands: Array
    areas: Array
    start: Array
    first_measured: float
    last_measured: float

    def band_at(self, command: Array) -> tuple[Array, Array]:
        """Ends of the band at commands [V]."""
        low, high = (np.interp(command, self.command, end) for end in (self.low, self.high))
        return np.asarray(low), np.asarray(high)

    def openings(self, largest: float, note: str) -> Iterator[Estimate]:
        """Points of the table behind the start, relative to an area [m2]; each has its command as name."""
        for command, area in zip(self.commands[1:], self.areas[1:], strict=True):
            numbers = np.array([area, self.draws_at(command).std(), *self.band_at(command)]) / largest
            value, sd, low, high = map(float, numbers)
            yield Estimate(f"{command:.3g}", value, "1", sd, low, high, note)

    def draws_at(self, command: float) -> Array:
        """Effective area [m2] of each curve at a command [V], linear between those of the grid."""
        k = int(np.clip(np.searchsorted(self.command, command), 1, self.command.size - 1))
        share = (command - self.command[k - 1]) / (self.command[k] - self.command[k - 1])
        return np.asarray((1 - share) * self.draws[:, k - 1] + share * self.draws[:, k])

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


def of_line(lines: Lines, label: str, steps: ValveSteps, c: Known, drift: float) -> OpeningCurve:
    """A straight opening with its band; steps: those of its edges."""
    commands = steps.command[steps.good]
    first, last = float(commands.min()), float(min(commands.max(), c.full_command))
    grid = _grid(np.unique(commands), steps, c)
    random, draws = np.random.default_rng(0), lines.areas(label, grid)
    above = grid > last + SAME * c.full_command
    if above.any():
        slope, at_last = lines.draws[f"slope{label}"], lines.areas(label, np.array([last]))
        draws[:, above] = at_last + random.uniform(0.0, 2.0, (DRAWS, 1)) * slope[:, None] * (
            grid[above] - last
        )
    best, start, width = lines.line(label)
    middle = best * straight(grid - start + width / 2, width)
    starts = lines.draws[f"start{label}"] - lines.draws["rounding"] / 2
    return _banded(grid, draws, middle, start - width / 2, starts, (first, last), drift, monotone=True)


def of_nodes(nodes: Nodes, steps: ValveSteps, c: Known, drift: float, *, monotone: bool) -> OpeningCurve:
    """The curve through the nodes with its band.

    steps      of the edges of this opening, also those without a flow
    monotone   whether the band is that of an opening that rises
    """
    random = np.random.default_rng(0)
    v = nodes.command[nodes.command < c.full_command * (1 + SAME)]
    grid, bounds = _grid(v, steps, c), np.column_stack(steps.idle(c))
    between = (grid >= v[0] - 1e-6) & (grid <= v[-1] + 1e-6)
    below, above = grid < v[0] - 1e-6, grid > v[-1] + 1e-6
    values = nodes.draws(random)[:, : v.size]
    mean = isotonic_regression(nodes.area[: v.size], weights=nodes.sd[: v.size] ** -2.0).x
    draws = np.empty((DRAWS, grid.size))
    draws[:, between] = _kinked(v, values, grid[between], random)
    middle = PchipInterpolator(v, mean)(np.clip(grid, v[0], v[-1]))
    first, second = (np.diff(values[:, :3], axis=1) / np.diff(v[:3])).T
    # between the slope of the first chord and that of a parabola, and beyond
    bend = random.uniform(0.0, CURVED, DRAWS) * (second - first) * (v[1] - v[0]) / (v[2] - v[0])
    area = np.maximum(values[:, 0], 1e-6 * nodes.area.max())  # noise may leave none
    slope = np.maximum(np.maximum(first - bend, 0.3 * first), 1e-3 * area / v[0])
    starts = _starts(v[0], area, slope, bounds[bounds[:, 0] < v[0]], random)
    largest = [np.min(bounds[bounds[:, 0] >= x, 1], initial=np.inf) for x in grid[below]]
    draws[:, below] = np.minimum(_powers(v[0], area, slope, starts, grid[below]), largest)
    start = float(np.median(starts))
    one = np.maximum(middle[between][:1], area.min()), np.median(slope, keepdims=True), np.array([start])
    middle[below] = np.minimum(_powers(v[0], *one, grid[below])[0], largest)
    last = np.diff(values[:, -2:], axis=1) / (v[-1] - v[-2])
    way = grid[above] - v[-1]
    draws[:, above] = values[:, -1:] + random.uniform(0.0, 2.0, (DRAWS, 1)) * last * way
    middle[above] = np.interp(v[-1], grid, middle) + max(float(np.median(last)), 0.0) * way
    return _banded(grid, draws, middle, start, starts, (float(v[0]), float(v[-1])), drift, monotone=monotone)


def _grid(v: Array, steps: ValveSteps, c: Known) -> Array:
    """Commands at which curves are drawn."""
    idle = steps.idle(c)[0]
    inside = [*v[v < c.full_command], *idle[idle < c.full_command], 0.02]
    return np.unique(np.round([*np.linspace(0.0, c.full_command, GRID), *inside], 6))


def _banded(
    grid: Array,
    draws: Array,
    middle: Array,
    start: float,
    starts: Array,
    measured: tuple[float, float],
    drift: float,
    *,
    monotone: bool,
) -> OpeningCurve:
    """The curve through the points of its table, with the band of the draws."""
    random = np.random.default_rng(1)
    draws = np.maximum(draws, 0.0) * (1 + drift * random.uniform(-1.0, 1.0, (DRAWS, 1)))
    low, high = simultaneous_band(draws)
    if monotone:  # a rising curve that is in the band is in this one, too
        low, high = np.maximum.accumulate(low), np.minimum.accumulate(high[::-1])[::-1]
    points = table(grid, np.maximum.accumulate(middle), (high - low) / 2, max(start, 0.0))
    area = tabulated(*points, grid)
    ends = np.minimum(low, area), np.maximum(high, area)
    return OpeningCurve(grid, draws, area, *ends, *points, starts, *measured)


def _kinked(v: Array, values: Array, grid: Array, random: np.random.Generator) -> Array:
    """Curves through values at nodes v: in each interval anywhere that a cubic, a chord or a kink may be."""
    j = np.clip(np.searchsorted(v, grid, "right") - 1, 0, v.size - 2)
    secant = np.diff(values, axis=1) / np.diff(v)
    cubic = PchipInterpolator(v, values, axis=1)(grid)
    chord = values[:, j] + secant[:, j] * (grid - v[j])
    before = values[:, j] + secant[:, np.maximum(j - 1, 0)] * (grid - v[j])
    after = values[:, j + 1] - secant[:, np.minimum(j + 1, v.size - 2)] * (v[j + 1] - grid)
    low = np.minimum(np.minimum(chord, cubic), np.maximum(before, after))
    high = np.maximum(np.maximum(chord, cubic), np.minimum(before, after))
    return np.asarray(low + random.uniform(size=(len(values), v.size - 1))[:, j] * (high - low))


def _powers(first: float, area: Array, slope: Array, start: Array, grid: Array) -> Array:
    """Openings (n, k) that begin at `start` and have area and slope, (n,) each, at the lowest node."""
    length = first - start[:, None]
    exponent = length * (slope / area)[:, None]
    share = np.clip((grid - start[:, None]) / length, 0.0, None)
    return np.asarray(area[:, None] * np.where(share > 0, share**exponent, 0.0))


def _starts(
    first: float,
    area: Array,
    slope: Array,
    bounds: Array,
    random: np.random.Generator,
) -> Array:
    """Starts of `_powers` that the bounds below the lowest node allow; without any the latest.

    bounds   commands and largest areas of steps without a flow, shape (m, 2)
    """
    tangent, (low, high) = area / slope, FOOT
    longest = first / tangent  # the exponent that begins at zero command
    high_of = np.where(longest < UNDERLAP, UNDERLAP, np.minimum(high, longest))
    latest = start = first - low * tangent
    free: Mask = np.ones(start.size, dtype=bool)
    for _ in range(8):
        exponent = low + (high_of - low) * random.uniform(size=start.size)
        start = np.where(free, first - exponent * tangent, start)
        free = np.asarray((_powers(first, area, slope, start, bounds[:, 0]) > bounds[:, 1]).any(axis=1))
    return np.where(free, latest, start)


def simultaneous_band(draws: Array) -> tuple[Array, Array]:
    """Ends of a band that holds 95 % of the curves over their whole length, shape (k,) each.

    A curve is as extreme as its most extreme point; the band leaves out the most extreme 5 % of the curves.
    """
    count, ordered = draws.shape[0], np.sort(draws, axis=0)
    below = stats.rankdata(draws, "max", axis=0)  # curves at or below this one, itself included
    above = count + 1 - stats.rankdata(draws, "min", axis=0)
    rank = np.minimum(below, above).min(axis=1)
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
    while len(chosen) < min(POINTS - 1, len(inner)) and (off := error(chosen)).max() > CLOSE:
        chosen.add(max((k for k in inner if k not in chosen), key=lambda k: float(off[inner.index(k)])))
    best, improved = float(error(chosen).max()), True
    while improved and best > CLOSE:
        improved = False
        for k in sorted(chosen - {inner[-1]}):
            at = inner.index(k)
            near = (at + step for step in (-1, 1, -2, 2, -4, 4))
            for other in [inner[i] for i in near if 0 <= i < len(inner) - 1]:
                moved = chosen - {k} | {other}
                if len(moved) == len(chosen) and (worst := float(error(moved).max())) < best:
                    chosen, best, improved, k = moved, worst, True, other
    return points(chosen)
