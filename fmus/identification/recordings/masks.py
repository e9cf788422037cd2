"""Which samples can be used: not those that are missing, clipped, stuck or in the sensor's dead zone.

Noise and quantisation step are estimated from the signal alone. Two samples in a row of a noisy signal are
equal by chance with the probability

    P = step / (2 sqrt(pi) sd)

step: resolution of the converter; sd: noise; for sd above the step. A run of equal values that chance does
not explain is a fault: clipped if it is at the signal's own extreme, stuck elsewhere. A signal that has no
noise to be seen (a command, an encoder) may stand still, so it is not judged.

`steady` finds where a command stands still; `averages` are means of the good samples there.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate

from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording, Sensor
from orchestrator.data.table import Array

ORDER = 6  # of the difference: passes white noise, and 1e-3 of an oscillation at a twentieth of the rate
MAD = 0.6744897501960817  # median of |x| over the sd of a normal x
LEVELS = 8  # fewer different values are no converter's steps
MOVES = 0.02  # share of samples that differ from the one before, below which steps are those of a command


def noise(values: Array, sensor: Sensor | None = None) -> float:
    """Standard deviation of the white noise of one sample; NaN if there are too few samples.

    The median of the sixth difference: it does not see a smooth signal, nor what less than half of the
    recording does. Samples in the dead zone are left out.
    """
    found = _spread(values, sensor, ORDER, moving=False)
    if math.isnan(found):
        return found
    # below this it is rounding of the numbers, not noise
    floor = 1e-12 * float(np.nanmax(np.abs(values)))
    return found if found > floor else 0.0


def noise_in_motion(values: Array, sensor: Sensor | None = None, order: int = ORDER) -> float:
    """The noise where a signal is not held: a stuck stretch, however long, or an encoder at rest has none.

    NaN if there are too few such samples.
    """
    return _spread(values, sensor, order, moving=True)


def _spread(values: Array, sensor: Sensor | None, order: int, moving: bool) -> float:
    """Noise from the median of a difference, outside the dead zone; NaN from too few samples.

    moving   without samples whose difference is zero
    """
    outside = values if sensor is None else np.where(in_dead_zone(values, sensor), np.nan, values)
    difference = np.abs(np.diff(outside, order))
    difference = difference[np.isfinite(difference) & ((difference > 0) | (not moving))]
    if len(difference) < 4 * order:
        return math.nan
    return float(np.median(difference)) / (MAD * math.sqrt(math.comb(2 * order, order)))


def in_dead_zone(values: Array, sensor: Sensor) -> Mask:
    """Where a signal is in its sensor's dead zone, if it has one: a meter may well stand still there."""
    result: Mask = (np.abs(values) <= sensor.dead_zone) & (sensor.dead_zone > 0)
    return result


def step(values: Array) -> float:
    """Quantisation step of a signal, 0 if its values are not multiples of one.

    The smallest gap between two values is the first guess; it is made exact by a line through all values
    over their number of steps.
    """
    kept = values[np.isfinite(values)]
    levels = np.unique(kept)
    if len(levels) < LEVELS or np.mean(np.diff(kept) != 0) < MOVES:
        return 0.0
    span = levels[-1] - levels[0]
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * span]  # closer: the same level, rounded twice
    if len(gaps) < LEVELS - 1:
        return 0.0
    first = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    number = np.concatenate(([0.0], np.cumsum(np.round(gaps / first))))
    place = np.concatenate(([0.0], np.cumsum(gaps)))
    line = np.polyfit(number, place, 1)
    residual = place - np.polyval(line, number)
    # values that are no multiples of anything leave 1 / sqrt(12) = 0.29 of a step
    return float(line[0]) if float(np.sqrt(np.mean(residual**2))) < 0.15 * line[0] else 0.0


CHANCE = 1e-3  # of a false alarm in one recording
LEAST = 1e-3  # least probability of two equal samples, for what a logger does that we do not know
TOO_LARGE = 3.0  # times the noise seen, from which the stated noise is not believed
WHITE = 0.7  # of the fourth difference's noise: what the sixth one has left of it
NOISY = 0.5  # P above which equal samples tell nothing; a slow encoder looks like 0.6


def clipped(values: Array, sensor: Sensor) -> Mask:
    """Where a signal is at an end of its sensor's range, or stays at an extreme of its own."""
    return at_ends(values, sensor) | (
        _long_runs(values, sensor, at_extreme=True) & ~in_dead_zone(values, sensor)
    )


def at_ends(values: Array, sensor: Sensor) -> Mask:
    """Where a signal is within half a step of an end of its sensor's range."""
    width = sensor.high - sensor.low
    margin = max(sensor.resolution / 2, 1e-9 * width) if math.isfinite(width) else sensor.resolution / 2
    result: Mask = (values >= sensor.high - margin) | (values <= sensor.low + margin)
    return result


def stuck(values: Array, sensor: Sensor) -> Mask:
    """Where a signal keeps a value longer than its noise lets it, apart from its ends and its dead zone."""
    flat = _long_runs(values, sensor, at_extreme=False)
    return flat & ~clipped(values, sensor) & ~in_dead_zone(values, sensor)


def equal_by_chance(values: Array, sensor: Sensor) -> float:
    """P of the module's docstring; 1 where it cannot be told."""
    width, sd = step_and_noise(values, sensor)
    if not sd > 0:
        return 1.0
    return min(width / (2 * math.sqrt(math.pi) * sd), 1.0)


def step_and_noise(values: Array, sensor: Sensor) -> tuple[float, float]:
    """Step of the converter and noise before it, stated or else seen in the data; 0 if neither."""
    width = sensor.resolution or step(values)
    seen = noise(values, sensor)
    own = math.sqrt(max(seen**2 - width**2 / 12, 0.0)) if seen > 0 else 0.0
    if overstated(values, sensor):
        return width, own
    if not sensor.noise > 0:
        # is it white? a smooth signal, such as a command, leaves less to each difference
        high, low = (noise_in_motion(values, sensor, order) for order in (ORDER, ORDER - 2))
        own = own if high > WHITE * low else 0.0
    return width, max(sensor.noise, own)


def overstated(values: Array, sensor: Sensor) -> bool:
    """Is the stated noise much larger than any that the signal shows where it is not held?

    A step of the converter hides noise of up to half of it.
    """
    moving = noise_in_motion(values, sensor)
    if math.isnan(moving):
        return False
    return sensor.noise > TOO_LARGE * math.hypot(moving, sensor.resolution / 2)


def _long_runs(values: Array, sensor: Sensor, at_extreme: bool) -> Mask:
    """Samples of runs of equal values that are too long for chance, at the extremes or anywhere."""
    result = np.zeros(len(values), dtype=bool)
    chance = max(equal_by_chance(values, sensor), LEAST)
    if chance > NOISY or not np.isfinite(values).any():
        return result
    longest = 1 + math.ceil(math.log(CHANCE / len(values)) / math.log(chance))
    extremes = (np.nanmin(values), np.nanmax(values))
    edges = np.flatnonzero(~(np.diff(values) == 0)) + 1  # each gap is a run of its own
    starts, stops = np.concatenate(([0], edges)), np.concatenate((edges, [len(values)]))
    for start, stop in zip(starts[stops - starts > longest], stops[stops - starts > longest], strict=True):
        if not at_extreme or values[start] in extremes:
            result[start:stop] = True
    return result


ENOUGH = 0.5  # share of a stretch that has to be good for an average
EARLY = 1e-9  # s: what rounding of stamps may add to a settling time


def good(recording: Recording, name: str) -> Mask:
    """Where a signal is there, not clipped, not stuck and out of its sensor's dead zone, shape (n,)."""
    values, sensor = recording[name], recording.sensor(name)
    there: Mask = np.isfinite(values) & ~clipped(values, sensor)
    return there & ~frozen(recording, name) & ~dead(recording, name)


def frozen(recording: Recording, name: str) -> Mask:
    """Where a signal is stuck; a command may stand still."""
    if name.endswith("command"):
        return np.zeros(len(recording.time), dtype=bool)
    return stuck(recording[name], recording.sensor(name))


def dead(recording: Recording, name: str) -> Mask:
    """Where a signal is in its sensor's dead zone; nowhere if it has none."""
    return in_dead_zone(recording[name], recording.sensor(name))


def good_all(recording: Recording, names: Collection[str]) -> Mask:
    """Where all these signals are good."""
    result: Mask = np.logical_and.reduce([good(recording, name) for name in names])
    return result


def steady(
    recording: Recording,
    command: str,
    settle: float = 0.0,
    shortest: float = 0.0,
    tolerance: float | None = None,
) -> list[slice]:
    """Stretches in which a signal stands still, without the first `settle` seconds of each.

    shortest    what must be left of a stretch [s]
    tolerance   how far a sample may be from the mean of its stretch so far; None: four standard deviations
                of the sensor and one step, so 0 for a command that is known exactly
    """
    values, time, sensor = recording[command], recording.time, recording.sensor(command)
    width = 4 * sensor.sd + sensor.resolution if tolerance is None else tolerance
    # the mean of equal numbers is that number but for rounding
    width += 1e-9 * float(np.nanmax(np.abs(values), initial=0.0))
    result, start = [], 0
    while start < len(values):
        stop = start + _steady_size(values[start:], width)
        first = max(int(np.searchsorted(time, time[start] + settle - EARLY)), start)
        if first < stop and time[stop - 1] - time[first] >= shortest - EARLY and np.isfinite(values[start]):
            result.append(slice(first, stop))
        start = stop
    return result


def _steady_size(values: Array, width: float) -> int:
    """Samples from the first on that are within `width` of the mean of those before them, at least one."""
    size = 64
    while True:
        part = values[:size]
        mean = np.cumsum(part[:-1]) / np.arange(1, len(part))
        # a gap compares as False, so it ends a stretch, and a stretch that starts with one is one sample long
        away = np.flatnonzero(~(np.abs(part[1:] - mean) <= width))
        if len(away):
            return int(away[0]) + 1
        if size >= len(values):
            return len(values)
        size *= 2


@dataclass(frozen=True)
class Averages:
    """Means of signals over k stretches, each array of shape (k,).

    mean, error   by signal; standard error of the mean, NaN where too little of a stretch is good
    share         by signal: share of good samples
    time          middle of each stretch [s]
    """

    time: Array
    mean: Mapping[str, Array]
    error: Mapping[str, Array]
    share: Mapping[str, Array]


def averages(recording: Recording, names: Sequence[str], parts: Sequence[slice]) -> Averages:
    """Means over stretches, such as those of `steady`, of the good samples only."""
    if not parts:
        raise Problem(f"{recording.source}: expected stretches to average over, found none")
    mean, error, share = dict[str, Array](), dict[str, Array](), dict[str, Array]()
    for name in names:
        values, usable, sensor = recording[name], good(recording, name), recording.sensor(name)
        rows = [_average(values[part], usable[part], sensor.resolution) for part in parts]
        mean[name], error[name], share[name] = (np.array(column) for column in zip(*rows, strict=True))
    middle = np.array([recording.time[part].mean() for part in parts])
    return Averages(middle, mean, error, share)


def _average(values: Array, usable: Mask, resolution: float) -> tuple[float, float, float]:
    share = float(usable.mean())
    if share < ENOUGH:
        return math.nan, math.nan, share
    kept = values[usable]
    return float(kept.mean()), standard_error(kept, resolution), share


def standard_error(values: Array, resolution: float = 0.0) -> float:
    """Standard error of a mean of samples that may be correlated.

    var(mean) = s^2 / n (1 + 2 sum_k rho_k). A signal that stays within one step of its converter is not
    averaged by its own noise: the error is then at least that of the step, step / sqrt(12).
    """
    n = len(values)
    spread = float(values.std(ddof=1)) if n > 1 else math.nan
    if not spread > 0:
        return resolution / math.sqrt(12) if spread == 0 else math.nan
    centred = values - values.mean()
    error = spread * math.sqrt(max(autocorrelation_time(centred), 1 / n) / n)
    return max(error, resolution / math.sqrt(12)) if spread < resolution / 2 else error


def autocorrelation_time(deviations: Array) -> float:
    """Samples over which deviations from a mean, not all zero, last: 1 + 2 sum_k rho_k.

    Summed while rho_(2m) + rho_(2m+1) > 0: Geyer, Practical Markov chain Monte Carlo, Statistical Science 7
    (1992), section 3.3.
    """
    n = len(deviations)
    rho = correlate(deviations, deviations, method="fft")[n - 1 :] / float(deviations @ deviations)
    pairs = rho[: 2 * (n // 2)].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    return 2 * float(pairs[: ends[0] if len(ends) else None].sum()) - 1
