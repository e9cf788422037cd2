"""Masks of usable samples: not missing, not clipped, not stuck, and outside the sensor's dead zone.

Noise and quantisation step are estimated from the signal alone. Two successive samples of a noisy signal are
equal by chance with the probability

    P = step / (2 sqrt(pi) sd)

with the resolution `step` of the converter and the standard deviation `sd` of the noise, for sd > step. A run
of equal values that chance does not explain is a fault: clipped at the signal's own extreme, stuck elsewhere.
A signal without visible noise (a command, an encoder at rest) may be constant and is not judged.

`steady` returns the intervals in which a command is constant, `averages` the means of good samples there.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate

from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording, Sensor
from orchestrator.data.table import Array

ORDER = 6  # order of the difference, which passes white noise, and 1e-3 of an oscillation at rate/20
MEDIAN_TO_SD = 0.6744897501960817  # median of |x| over the standard deviation of a normal x
MIN_LEVELS = 8  # with fewer different values no quantisation step is estimated
MIN_CHANGES = 0.02  # fraction of samples that differ from the one before; below it the steps are of a command
FALSE_ALARM = 1e-3  # probability of a false alarm in one recording
MIN_CHANCE = 1e-3  # least probability of two equal samples, an allowance for unknown effects of a logger
MAX_CHANCE = 0.5  # largest probability of equal samples that can be judged; a slow encoder has about 0.6
OVERSTATED = 3.0  # stated noise over estimated noise, from which the stated noise is not used
WHITE = 0.7  # least ratio of the noise estimates by the sixth and the fourth difference if the noise is white
MIN_GOOD = 0.5  # least fraction of good samples for an average
ROUNDING = 1e-9  # s, of time stamps, in a settling time


def noise(values: Array, sensor: Sensor | None = None) -> float:
    """Standard deviation of the white noise of one sample; NaN if there are too few samples.

    The estimate is the median of the sixth difference. It is insensitive to a smooth signal, and to any
    disturbance of less than half of the recording. Samples in the dead zone are left out.
    """
    sd = _noise_by_difference(values, sensor, ORDER, moving=False)
    if math.isnan(sd):
        return sd
    rounding = 1e-12 * float(np.nanmax(np.abs(values)))
    return sd if sd > rounding else 0.0


def noise_in_motion(values: Array, sensor: Sensor | None = None, order: int = ORDER) -> float:
    """The noise of samples that differ from their neighbours; NaN if there are too few of them.

    It leaves out intervals without noise, in which a signal is stuck or an encoder at rest.
    """
    return _noise_by_difference(values, sensor, order, moving=True)


def _noise_by_difference(values: Array, sensor: Sensor | None, order: int, moving: bool) -> float:
    """Noise from the median of a difference, outside the dead zone; NaN if there are too few samples.

    moving   leave out samples whose difference is zero
    """
    outside = values if sensor is None else np.where(in_dead_zone(values, sensor), np.nan, values)
    difference = np.abs(np.diff(outside, order))
    difference = difference[np.isfinite(difference) & ((difference > 0) | (not moving))]
    if len(difference) < 4 * order:
        return math.nan
    return float(np.median(difference)) / (MEDIAN_TO_SD * math.sqrt(math.comb(2 * order, order)))


def in_dead_zone(values: Array, sensor: Sensor) -> Mask:
    """Mask of the samples in the sensor's dead zone, where a meter may be constant."""
    result: Mask = (np.abs(values) <= sensor.dead_zone) & (sensor.dead_zone > 0)
    return result


def step(values: Array) -> float:
    """Quantisation step of a signal, 0 if its values are not multiples of a step.

    The smallest difference between two values is a first estimate; the fit of a line to all values over their
    number of steps refines it.
    """
    finite = values[np.isfinite(values)]
    levels = np.unique(finite)
    if len(levels) < MIN_LEVELS or np.mean(np.diff(finite) != 0) < MIN_CHANGES:
        return 0.0
    span = levels[-1] - levels[0]
    differences = np.diff(levels)
    differences = differences[differences > 1e-9 * span]  # smaller ones are rounding of one level
    if len(differences) < MIN_LEVELS - 1:
        return 0.0
    estimate = float(np.median(differences[differences < 1.5 * differences.min()]))
    steps = np.concatenate(([0.0], np.cumsum(np.round(differences / estimate))))
    height = np.concatenate(([0.0], np.cumsum(differences)))
    line = np.polyfit(steps, height, 1)
    residual = height - np.polyval(line, steps)
    # the residual of arbitrary values is 1 / sqrt(12) = 0.29 of a step
    return float(line[0]) if float(np.sqrt(np.mean(residual**2))) < 0.15 * line[0] else 0.0


def clipped(values: Array, sensor: Sensor) -> Mask:
    """Mask of the samples at an end of the sensor's range, or held at an extreme of the signal."""
    return at_ends(values, sensor) | (
        _long_runs(values, sensor, at_extreme=True) & ~in_dead_zone(values, sensor)
    )


def at_ends(values: Array, sensor: Sensor) -> Mask:
    """Mask of the samples within half a step of an end of the sensor's range."""
    width = sensor.high - sensor.low
    margin = max(sensor.resolution / 2, 1e-9 * width) if math.isfinite(width) else sensor.resolution / 2
    result: Mask = (values >= sensor.high - margin) | (values <= sensor.low + margin)
    return result


def stuck(values: Array, sensor: Sensor) -> Mask:
    """Mask of runs of equal values that noise does not explain, except at the ends and in the dead zone."""
    runs = _long_runs(values, sensor, at_extreme=False)
    return runs & ~clipped(values, sensor) & ~in_dead_zone(values, sensor)


def equal_by_chance(values: Array, sensor: Sensor) -> float:
    """P of the module's docstring; 1 if it cannot be estimated."""
    width, sd = step_and_noise(values, sensor)
    if not sd > 0:
        return 1.0
    return min(width / (2 * math.sqrt(math.pi) * sd), 1.0)


def step_and_noise(values: Array, sensor: Sensor) -> tuple[float, float]:
    """Step of the converter and noise before it, as stated or else estimated; 0 if unknown."""
    width = sensor.resolution or step(values)
    total = noise(values, sensor)
    estimate = math.sqrt(max(total**2 - width**2 / 12, 0.0)) if total > 0 else 0.0
    if overstated(values, sensor):
        return width, estimate
    if not sensor.noise > 0:
        # a smooth signal, such as a command, is not white: each higher difference of it is smaller
        high, low = (noise_in_motion(values, sensor, order) for order in (ORDER, ORDER - 2))
        estimate = estimate if high > WHITE * low else 0.0
    return width, max(sensor.noise, estimate)


def overstated(values: Array, sensor: Sensor) -> bool:
    """Is the stated noise much larger than the noise of the samples that differ from their neighbours?

    A step of the converter hides noise of up to half a step.
    """
    moving = noise_in_motion(values, sensor)
    if math.isnan(moving):
        return False
    return sensor.noise > OVERSTATED * math.hypot(moving, sensor.resolution / 2)


def _long_runs(values: Array, sensor: Sensor, at_extreme: bool) -> Mask:
    """Mask of runs of equal values that are too long for chance, at the signal's extremes or anywhere."""
    result = np.zeros(len(values), dtype=bool)
    chance = max(equal_by_chance(values, sensor), MIN_CHANCE)
    if chance > MAX_CHANCE or not np.isfinite(values).any():
        return result
    longest = 1 + math.ceil(math.log(FALSE_ALARM / len(values)) / math.log(chance))
    extremes = (np.nanmin(values), np.nanmax(values))
    edges = np.flatnonzero(~(np.diff(values) == 0)) + 1  # each gap is a run of its own
    starts, stops = np.concatenate(([0], edges)), np.concatenate((edges, [len(values)]))
    for start, stop in zip(starts[stops - starts > longest], stops[stops - starts > longest], strict=True):
        if not at_extreme or values[start] in extremes:
            result[start:stop] = True
    return result


def good(recording: Recording, name: str) -> Mask:
    """Mask of the usable samples, (n,): not missing, clipped, stuck or in the dead zone."""
    values, sensor = recording[name], recording.sensor(name)
    unclipped: Mask = np.isfinite(values) & ~clipped(values, sensor)
    return unclipped & ~stuck_samples(recording, name) & ~dead(recording, name)


def stuck_samples(recording: Recording, name: str) -> Mask:
    """Mask of the samples at which a signal is stuck; a command may be constant."""
    if name.endswith("command"):
        return np.zeros(len(recording.time), dtype=bool)
    return stuck(recording[name], recording.sensor(name))


def dead(recording: Recording, name: str) -> Mask:
    """Mask of the samples in the dead zone of the signal's sensor."""
    return in_dead_zone(recording[name], recording.sensor(name))


def good_all(recording: Recording, names: Collection[str]) -> Mask:
    """Mask of the samples at which all these signals are good."""
    result: Mask = np.logical_and.reduce([good(recording, name) for name in names])
    return result


def steady(
    recording: Recording,
    command: str,
    settle: float = 0.0,
    shortest: float = 0.0,
) -> list[slice]:
    """Intervals in which a signal is constant, without the first `settle` seconds of each.

    shortest   least length of the rest of an interval [s]

    A sample may deviate from the mean of the interval before it by four standard deviations of the sensor and
    one step, thus not at all if it is a command that is known exactly.
    """
    values, time, sensor = recording[command], recording.time, recording.sensor(command)
    width = 4 * sensor.sd + sensor.resolution
    # the mean of equal values differs from them by rounding
    width += 1e-9 * float(np.nanmax(np.abs(values), initial=0.0))
    result, start = [], 0
    while start < len(values):
        stop = start + _steady_size(values[start:], width)
        first = max(int(np.searchsorted(time, time[start] + settle - ROUNDING)), start)
        long_enough = first < stop and time[stop - 1] - time[first] >= shortest - ROUNDING
        if long_enough and np.isfinite(values[start]):
            result.append(slice(first, stop))
        start = stop
    return result


def _steady_size(values: Array, width: float) -> int:
    """Number of samples from the first on that are within `width` of the mean before them, at least one."""
    size = 64
    while True:
        part = values[:size]
        mean = np.cumsum(part[:-1]) / np.arange(1, len(part))
        # a comparison with a gap is False: a gap ends an interval, and is an interval of one sample by itself
        outside = np.flatnonzero(~(np.abs(part[1:] - mean) <= width))
        if len(outside):
            return int(outside[0]) + 1
        if size >= len(values):
            return len(values)
        size *= 2


@dataclass(frozen=True)
class Averages:
    """Means of signals over k intervals, each array of shape (k,).

    time          middle of each interval [s]
    mean, error   by signal: mean and its standard error, NaN if too few samples are good
    fraction      by signal: fraction of good samples
    """

    time: Array
    mean: Mapping[str, Array]
    error: Mapping[str, Array]
    fraction: Mapping[str, Array]


def averages(recording: Recording, names: Sequence[str], intervals: Sequence[slice]) -> Averages:
    """Means of the good samples over intervals, such as those of `steady`."""
    if not intervals:
        raise Problem(f"{recording.source}: expected intervals to average over, got none")
    mean, error, fraction = dict[str, Array](), dict[str, Array](), dict[str, Array]()
    for name in names:
        values, usable, sensor = recording[name], good(recording, name), recording.sensor(name)
        rows = [_average(values[part], usable[part], sensor.resolution) for part in intervals]
        mean[name], error[name], fraction[name] = (np.array(column) for column in zip(*rows, strict=True))
    middle = np.array([recording.time[part].mean() for part in intervals])
    return Averages(middle, mean, error, fraction)


def _average(values: Array, usable: Mask, resolution: float) -> tuple[float, float, float]:
    """Mean, standard error and fraction of the usable samples."""
    fraction = float(usable.mean())
    if fraction < MIN_GOOD:
        return math.nan, math.nan, fraction
    used = values[usable]
    return float(used.mean()), standard_error(used, resolution), fraction


def standard_error(values: Array, resolution: float = 0.0) -> float:
    """Standard error of a mean of samples that may be correlated.

    var(mean) = s^2 / n (1 + 2 sum_k rho_k). If a signal stays within one step of its converter, averaging
    does not reduce the quantisation error, and the standard error is at least step / sqrt(12).
    """
    n = len(values)
    spread = float(values.std(ddof=1)) if n > 1 else math.nan
    if not spread > 0:
        return resolution / math.sqrt(12) if spread == 0 else math.nan
    centred = values - values.mean()
    error = spread * math.sqrt(max(autocorrelation_time(centred), 1 / n) / n)
    return max(error, resolution / math.sqrt(12)) if spread < resolution / 2 else error


def autocorrelation_time(deviations: Array) -> float:
    """Autocorrelation time of deviations from a mean [samples], not all zero: 1 + 2 sum_k rho_k.

    The sum is taken while rho_(2m) + rho_(2m+1) > 0: Geyer, Practical Markov chain Monte Carlo, Statistical
    Science 7 (1992), section 3.3.
    """
    n = len(deviations)
    rho = correlate(deviations, deviations, method="fft")[n - 1 :] / float(deviations @ deviations)
    pairs = rho[: 2 * (n // 2)].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    return 2 * float(pairs[: ends[0] if len(ends) else None].sum()) - 1
