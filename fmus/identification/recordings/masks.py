"""Masks of usable samples: not missing, not clipped, not stuck, and outside the sensor's dead zone.

Noise and quantisation step are estimated from the signal alone. Two successive samples of a noisy signal are
equal by chance with the probability

    P = step / (2 sqrt(pi) sd)

with the resolution `step` of the converter and the standard deviation `sd` of the noise, for sd > step. A run
of equal values that chance does not explain is a fault: clipped at the signal's own extreme, stuck elsewhere.
A missing sample, as between those of a slower group of the logger, does not end a run.
A signal without visible noise (a command, an encoder at rest) may be constant and is not judged.

`steady` returns the intervals in which a command is constant, `averages` the means of good samples there.
"""

import math
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from orchestrator.data.recording import Mask, Recording, Sensor
from orchestrator.data.table import Array

ORDER = 6  # order of the difference, which passes white noise, and 1e-3 of an oscillation at rate/20
MEDIAN_TO_SD = 0.6744897501960817  # median of |x| over the standard deviation of a normal x
MIN_LEVELS = 8  # with fewer different values no quantisation step is estimated
MIN_CHANGES = 0.02  # fraction of samples that differ from the one before; below it the steps are of a command
FALSE_ALARM = 1e-3  # probability of a false alarm in one recording
MIN_CHANCE = 1e-3  # least probability of two equal samples, an allowance for unknown effects of a logger
MAX_CHANCE = 0.5  # largest probability of equal samples that can be judged; a slow encoder has about 0.6
KNOWN = 2.0  # factor to which a description knows the noise of a sensor: noise of the samples over it
OVERSTATED = 3.0  # stated noise over that of the samples, from which the stated noise is not used
WHITE = 0.7  # least ratio of the noise estimates by the sixth and the fourth difference if the noise is white
MIN_GOOD = 0.5  # least fraction of good samples for an average
VISIBLE = 1e-6  # of the largest magnitude; finer noise and steps are of a computation, whose zeros are exact
AT_ZERO = 6.0  # standard deviations, which noise exceeds once in 5e8 samples
ROUNDING = 1e-9  # s, of time stamps, in a settling time
EXACT = Sensor()  # without noise, steps, ends and dead zone


def noise(values: Array, sensor: Sensor = EXACT, order: int = ORDER, moving: bool = False) -> float:
    """Standard deviation of the white noise of one sample; NaN if there are too few samples.

    The estimate is the median of the sixth difference. It is insensitive to a smooth signal, and to any
    disturbance of less than half of the recording. Samples in the dead zone are left out. Without enough
    neighbours, in a slower group of the logger, successive samples count as neighbours.

    moving   leave out samples whose difference is zero: a signal is stuck there, or an encoder at rest
    """
    judged = np.where(in_dead_zone(values, sensor), np.nan, values)
    for part in (judged, judged[np.isfinite(values)]):
        difference = np.abs(np.diff(part, order))
        difference = difference[np.isfinite(difference) & ((difference > 0) | (not moving))]
        if len(difference) >= 4 * order:
            break
    else:
        return math.nan
    sd = float(np.median(difference)) / (MEDIAN_TO_SD * math.sqrt(math.comb(2 * order, order)))
    rounding = 1e-12 * float(np.nanmax(np.abs(values)))
    return sd if sd > rounding else 0.0


def in_dead_zone(values: Array, sensor: Sensor) -> Mask:
    """Mask of the samples in the sensor's dead zone, where a meter may be constant."""
    return np.asarray((np.abs(values) <= sensor.dead_zone) & (sensor.dead_zone > 0))


def zeros_of_dead_zone(values: Array, sensor: Sensor) -> float:
    """The least magnitude beyond the exact zeros of a meter, if noise does not bridge it; else 0."""
    if sensor.dead_zone or not (values == 0).any():
        return 0.0
    others = values[np.isfinite(values) & (values != 0)]
    if not others.size or equal_by_chance(others, sensor) > MAX_CHANCE:  # a signal without noise may be zero
        return 0.0
    sizes, error = np.abs(others), max(step_and_noise(others, sensor))
    least = float(sizes.min())
    return least if VISIBLE * sizes.max() < error < least / AT_ZERO else 0.0


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


def at_ends(values: Array, sensor: Sensor) -> Mask:
    """Mask of the samples within half a step of an end of the sensor's range."""
    width = sensor.high - sensor.low
    margin = max(sensor.resolution / 2, 1e-9 * width) if math.isfinite(width) else sensor.resolution / 2
    return np.asarray((values >= sensor.high - margin) | (values <= sensor.low + margin))


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
    if misstated(sensor, total, noise(values, sensor, moving=True))[1] > 1:
        return width, estimate
    if not sensor.noise > 0:
        # a smooth signal, such as a command, is not white: each higher difference of it is smaller
        high, low = (noise(values, sensor, order, moving=True) for order in (ORDER, ORDER - 2))
        estimate = estimate if high > WHITE * low else 0.0
    return width, max(sensor.noise, estimate)


def misstated(sensor: Sensor, seen: float, most: float) -> tuple[float, float]:
    """Noise of the samples over `KNOWN` times the stated noise, and stated noise over `OVERSTATED` times it.

    The stated noise is wrong if one of them is above 1. A step of the converter hides noise of up to half a
    step, and a slow signal that is rounded to steps looks like noise of up to half a step.

    seen, most   noise of all samples, and the most that they may have, such as those that are not at rest
    """
    stated, most = (math.hypot(sd, sensor.resolution / 2) for sd in (sensor.noise, most))
    louder = seen / (KNOWN * stated) if stated else 0.0
    return louder, sensor.noise / (OVERSTATED * most) if most else math.inf if sensor.noise else 0.0


def _long_runs(values: Array, sensor: Sensor) -> Mask:
    """Mask of runs of equal values that are too long for chance."""
    known = np.isfinite(values)
    held: Mask = (values == 0) & (zeros_of_dead_zone(values, sensor) > 0)
    chance = max(equal_by_chance(values, sensor), MIN_CHANCE)
    if chance > MAX_CHANCE or not known.any():
        return held
    longest = 1 + math.ceil(math.log(FALSE_ALARM / known.sum()) / math.log(chance))
    edges = np.flatnonzero(np.diff(values[known])) + 1
    lengths = np.diff(edges, prepend=0, append=known.sum())
    held[known] |= np.repeat(lengths > longest, lengths)
    return held


def faults(recording: Recording, name: str) -> dict[str, Mask]:
    """Masks (n,) of the samples that are not used, by cause; a command may be constant and is never stuck."""
    values, sensor = recording[name], recording.sensor(name)
    dead, held = in_dead_zone(values, sensor), _long_runs(values, sensor)
    ends = np.nanmin(values, initial=math.inf), np.nanmax(values, initial=-math.inf)
    clipped = at_ends(values, sensor) | (held & np.isin(values, ends) & ~dead)
    stuck = held & ~clipped & ~dead & (not name.endswith("command"))
    return {"gaps": ~np.isfinite(values), "clipped": clipped, "stuck": stuck, "dead zone": dead}


def good(recording: Recording, name: str) -> Mask:
    """Mask of the usable samples, (n,): not missing, clipped, stuck or in the dead zone."""
    return np.asarray(~np.logical_or.reduce(list(faults(recording, name).values())))


def good_all(recording: Recording, names: Collection[str]) -> Mask:
    """Mask of the samples at which all these signals are good."""
    return np.asarray(np.logical_and.reduce([good(recording, name) for name in names]))


def steady(recording: Recording, command: str, settle: float = 0.0, shortest: float = 0.0) -> list[slice]:
    """Intervals in which a signal is constant, without the first `settle` seconds of each.

    shortest   least length of the rest of an interval [s]

    A sample may deviate from the mean of the interval before it by four standard deviations of the sensor and
    one step, thus not at all if it is a command that is known exactly.
    """
    values, time, sensor = recording[command], recording.time, recording.sensor(command)
    width = 4 * sensor.sd + sensor.resolution
    # the mean of equal values differs from them by rounding
    width += 1e-9 * float(np.nanmax(np.abs(values), initial=0.0))
    starts = _starts(values, width)
    stops = np.append(starts[1:], len(values))
    firsts = np.maximum(np.searchsorted(time, time[starts] + settle - ROUNDING), starts)
    lengths = time[stops - 1] - time[np.minimum(firsts, len(time) - 1)]
    kept = (firsts < stops) & (lengths >= shortest - ROUNDING) & np.isfinite(values[starts])
    return [slice(int(first), int(stop)) for first, stop in zip(firsts[kept], stops[kept], strict=True)]


def _starts(values: Array, width: float) -> NDArray[np.intp]:
    """Where a signal leaves the mean of the samples since the last such place by more than `width`."""
    first, *others = values.tolist()
    starts, total = [0], first
    for k, value in enumerate(others, 1):
        if abs(value - total / (k - starts[-1])) <= width:  # false at a gap and after it
            total += value
        else:
            starts.append(k)
            total = value
    return np.array(starts)


def averages(recording: Recording, names: Sequence[str], intervals: Sequence[slice]) -> tuple[Array, Array]:
    """Means of the good samples of signals over intervals such as those of `steady`, and standard errors.

    Both have a row for each signal; NaN if less than half of the samples are good.
    """
    found = np.full((2, len(names), len(intervals)), math.nan)
    for i, name in enumerate(names):
        values, usable, resolution = recording[name], good(recording, name), recording.sensor(name).resolution
        for k, part in enumerate(intervals):
            if usable[part].mean() >= MIN_GOOD:
                used = values[part][usable[part]]
                found[:, i, k] = used.mean(), standard_error(used, resolution)
    return found[0], found[1]


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
    from scipy.signal import correlate  # here, because `harvester describe` needs no SciPy

    n = len(deviations)
    rho = correlate(deviations, deviations, method="fft")[n - 1 :] / float(deviations @ deviations)
    pairs = rho[: 2 * (n // 2)].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    return 2 * float(pairs[: ends[0] if len(ends) else None].sum()) - 1
