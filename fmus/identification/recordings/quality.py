"""Quality of a recording: `examine` checks its clock and its signals against their description.

`Quality.remarks` reports faults in sentences. Faulty samples come from `masks`. A magnitude that no machine
reaches indicates a wrong unit. `prepared` gives the samples that an identification uses.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.recordings import clock, masks
from fmus.identification.recordings.clock import GAP, MAX_RATE, UNIFORM, period, sample_steps
from fmus.identification.recordings.reading import MACHINE, TABLES
from orchestrator.base.text import display_unit
from orchestrator.data.recording import Mask, Recording, true_intervals
from orchestrator.data.table import Array

PLAUSIBLE_RATES = (10.0, 1e5)  # Hz, of a logger that records the motion of a valve
COARSE, FINE = 1.5, 0.67  # a remark outside these ratios of step to stated resolution
FINEST_STATED = 1e-4  # fraction of a signal's range; finer steps, such as digits of a file, need no statement
LOOSE = 0.1  # periods of white jitter, from which a lost sample may not be seen, which moves all later ones
UNSEEN = 1.2  # times that jitter: deviations that show such samples
CLOSE = 0.5  # periods; time stamps closer than this belong to one sample that was written twice
SIGNIFICANT = 5  # standard deviations; a larger count or drift is not due to chance
RARE = 0.05  # rows that are equal by chance with a larger probability are not judged
HALF_ZERO = 60  # successive zeros, which noise that is mostly negative or rounds to 0 has: 0.7^60 = 5e-10
HUM_FROM, HUM_PARTS = 20.0, 8  # Hz, above the motion of a machine; parts of a recording that a hum is in
AROUND = 12  # frequencies on each side with which that of a hum is compared
HUM_SIZE = 0.5  # rms over noise, from which on a hum changes an interval by a tenth: sqrt(1 + 0.5^2) = 1.12
BOW = 0.25  # periods; a remark if the drift moves time stamps farther than this off a uniform clock


@dataclass(frozen=True)
class SignalQuality:
    """Faults of one signal, and its samples in SI units.

    low, high   extremes of the samples, NaN if there are none
    noise       noise estimated from the samples
    sensor      the instrument in words
    remarks     a sentence for each fault; samples in the dead zone are not a fault
    dead        fraction of the samples in the dead zone of the sensor, which are not used
    """

    signal: str
    unit: str
    low: float
    high: float
    noise: float
    sensor: str
    remarks: list[str]
    dead: float


@dataclass(frozen=True)
class Quality:
    """Quality of a recording's clock and signals.

    duration   from the first to the last sample [s]
    rate       samples per second, missing samples included [Hz]
    clock      a sentence for each fault of the clock
    notes      sentences on what is no fault: samples in dead zones, and constant signals
    """

    name: str
    title: str
    procedure: str
    use: str
    kind: str
    duration: float
    rate: float
    clock: list[str]
    channels: list[SignalQuality]
    notes: list[str]

    def faults(self) -> list[str]:
        """One sentence for each fault; none for a clean recording."""
        return [*self.clock, *(f"{c.signal}: {fault}" for c in self.channels for fault in c.remarks)]

    def remarks(self) -> list[str]:
        """The faults, then the notes."""
        return [*self.faults(), *self.notes]


def examine(recording: Recording) -> Quality:
    """The quality of a recording, from its samples and its description."""
    notes, constant = list[str](), list[str]()
    channels = [_signal(recording, name, notes, constant) for name in recording.signals]
    if constant:
        notes.append(f"One value throughout: {', '.join(constant)}.")
    about = recording.source.name, recording.title, recording.procedure, recording.use, recording.kind
    duration = float(recording.time[-1] - recording.time[0])
    return Quality(*about, duration, *_clock(recording), channels, notes)


def prepared(recording: Recording) -> tuple[Recording, Quality]:
    """A recording on a uniform clock, of the machine one of at most `MAX_RATE`; its quality before."""
    found, uniform = examine(recording), clock.resample_uniformly(recording)
    if uniform is not recording:
        found.clock.append(f"The clock: all signals are interpolated at {found.rate:.6g} Hz; gaps stay gaps.")
    if recording.procedure != MACHINE:
        return uniform, found
    if found.rate > 1.01 * MAX_RATE:
        found.clock.append(
            f"The clock: {found.rate:.6g} Hz, filtered to {MAX_RATE:g} Hz to be fitted together."
        )
    return clock.downsample(uniform), found


def _signal(recording: Recording, name: str, notes: list[str], constant: list[str]) -> SignalQuality:
    """The quality of a signal; adds to the notes, and to the signals with one value."""
    values, sensor, unit = recording[name], recording.sensor(name), recording.units[name]
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (math.nan, math.nan)
    seen, step = masks.noise(values, sensor), masks.step(values)
    moving = masks.noise(values, sensor, moving=True)
    zone, unused = masks.zeros_of_dead_zone(values, sensor), masks.faults(recording, name)
    dead = unused.pop("dead zone")
    zeros = max((run.stop - run.start for run in true_intervals(finite == 0)), default=0)
    # a sensor from 0 on reads zero where noise around it is negative
    rest = (values == 0) & (zone > 0 or (sensor.low == 0 and zeros < HALF_ZERO))
    gaps, clipped, stuck = (_unused(mask & ~rest, recording.time) for mask in unused.values())

    def show(value: float) -> str:
        shown = display_unit(unit)
        return shown.plain(value) if unit == "1" else shown.ascii(value)

    least, most = TABLES["quantities"].get(unit, {}).get("plausible", (0.0, math.inf))
    largest = max(abs(low), abs(high))
    # what is zero up to the noise of its sensor tells nothing about its unit
    implausible = largest > masks.AT_ZERO * sensor.sd and not least <= largest <= most
    limits = f"{show(least)} to {show(most)}" if least else f"up to {show(most)}"
    extremes = f"from {show(low)} to {show(high)}"
    (louder, quieter), known = masks.misstated(sensor, seen, moving), sensor.resolution
    weight = f"{show(moving)}: the weight of the signal is too small"
    visible = seen > 0 and step > FINEST_STATED * (high - low)
    steps, resolution = f"steps of {show(step)}", f"the stated resolution, {show(known)}"
    ends = "at an end of the sensor's range or held at the signal's own extreme"
    noise = show(sensor.noise)
    tests = {
        f"{gaps} without a sample.": gaps,
        f"{clipped} clipped, {ends}.": clipped,
        f"reads 0 or at least {show(zone)}: a meter's dead zone? dead_zone states it.": zone,
        f"{stuck} stuck at one value, without the noise of the sensor; not used.": stuck,
        f"{extremes}, expected a largest magnitude of {limits}: is its unit right?": implausible,
        f"noise of {show(seen)}, stated {noise}.": louder > 1,
        f"stated noise of {noise}, much larger than that of the samples, {weight}.": quieter > 1,
        f"{steps}, coarser than {resolution}.": step > COARSE * known > 0,
        f"{steps}, finer than {resolution}.": 0 < step < FINE * known,
        f"{steps} without a stated resolution.": known == 0 and visible,
    }
    if low == high:
        constant.append(f"{name} ({show(low)})")
    elif text := _unused(dead, recording.time):
        notes.append(f"{name}: {text} in the sensor's dead zone of {show(sensor.dead_zone)}, not used.")
    remarks = [sentence for sentence, true in tests.items() if true]
    return SignalQuality(name, unit, low, high, seen, sensor.text, remarks, float(dead.mean()))


def _unused(mask: Mask, time: Array) -> str:
    """A text of the samples that are not used for one cause; empty if there are none."""
    count, parts, fraction = int(mask.sum()), true_intervals(mask), float(mask.mean())
    if not parts:
        return ""
    ends = np.append(time, 2 * time[-1] - time[-2])  # an interval of one sample lasts until the next sample
    longest = max(float(ends[part.stop] - time[part.start]) for part in parts)
    share = f"{100 * fraction:.2g} %" if fraction < 0.995 else "all"
    several = f"in {len(parts)} parts, " if len(parts) > 1 else ""
    first = f"first at {time[parts[0].start]:.6g} s"
    samples = f"{count} sample{'s' * (count > 1)}"
    return f"{samples} ({share}; {several}{first}, longest {longest:.3g} s)"


def _clock(recording: Recording) -> tuple[float, list[str]]:
    """Rate and faults of a clock."""
    time = recording.time
    usual, intervals, steps = period(time), np.diff(time), sample_steps(time)
    rate = float(np.sum(steps) / (time[-1] - time[0]))
    jitter, drift, bow = _drift(time, steps) if len(time) >= 10 else (0.0, 0.0, 0.0)
    if LOOSE * usual < (white := masks.noise(time)) < jitter / UNSEEN:
        jitter, bow = white, 0.0
    missing, longest = int(np.sum(steps[intervals > GAP * usual] - 1)), int(np.argmax(intervals))
    gap = f"the longest interval is {1e3 * intervals[longest]:.4g} ms at {time[longest]:.6g} s"
    close, repeated = int(np.sum(intervals < CLOSE * usual)), time[_repeated(recording)]
    # by chance, if successive time stamps have independent normal jitter
    chance = math.erfc((1 - CLOSE) * usual / (2 * jitter)) / 2 if jitter else 0.0
    expected = chance * len(intervals)
    twice = close > expected + SIGNIFICANT * math.sqrt(expected)
    low, high = PLAUSIBLE_RATES
    rows, off = f"{repeated.size} rows repeat the row before", f"{1e3 * bow:.3g} ms off a uniform clock"
    tests = {
        f"{rate:.3g} Hz, expected {low:g} Hz to {high:g} Hz: is the unit of time right?": not (
            low <= rate <= high
        ),
        f"{missing} samples are missing; {gap}, the usual one {1e3 / rate:.4g} ms.": missing,
        f"{close} time stamps are less than half a period after the one before.": twice,
        f"jitter of {1e3 * jitter:.3g} ms, {100 * jitter * rate:.0f} % of a period.": jitter * rate > UNIFORM,
        f"the interval changes by {100 * drift:.2g} % from start to end, which is {off}.": bow * rate > BOW,
        f"{rows}, first at {repeated[:1].sum():.6g} s.": repeated.size,
    }
    return rate, [f"The clock: {sentence}" for sentence, true in tests.items() if true]


def _drift(time: Array, steps: NDArray[np.int64]) -> tuple[float, float, float]:
    """Jitter [s], relative change of the interval from start to end, and its bow off a uniform clock [s].

    They come from the fit of a parabola over the index of each sample; the bow is 0 if it is not significant.
    """
    k = np.concatenate(([0.0], np.cumsum(steps)))
    x = 2 * k / k[-1] - 1  # from -1 to 1, so that the terms are nearly orthogonal
    fit, covariance = np.polyfit(x, time - time[0], 2, cov=True)
    residual = time - time[0] - np.polyval(fit, x)
    jitter = math.sqrt(float(residual @ residual) / (len(time) - 3))
    significant = abs(fit[0]) > SIGNIFICANT * math.sqrt(covariance[0, 0])
    return jitter, float(4 * fit[0] / fit[1]), abs(float(fit[0])) / 2 if significant else 0.0


def _repeated(recording: Recording) -> Mask:
    """Rows equal to the row before in all signals, if there are more of them than chance explains.

    The probability is that of signals at rest, outside the ends of their ranges and their dead zones.
    """
    equal, chance = np.append(False, np.ones(len(recording.time) - 1, bool)), np.ones(len(recording.time))
    for name, values in recording.signals.items():
        sensor, at_rest = recording.sensor(name), masks.equal_by_chance(values, recording.sensor(name))
        equal[1:] &= (np.diff(values) == 0) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
        if at_rest <= masks.MAX_CHANCE:
            judged = (
                np.isfinite(values) & ~masks.at_ends(values, sensor) & ~masks.in_dead_zone(values, sensor)
            )
            chance[judged] *= at_rest
    equal &= chance < RARE
    expected = float(np.sum(chance[chance < RARE]))
    significant = np.sum(equal) > expected + SIGNIFICANT * math.sqrt(expected) + 0.5
    return equal if significant else np.zeros_like(equal)


def hum(recording: Recording, name: str) -> tuple[float, float, float]:
    """A periodic disturbance, such as the hum of the mains: its p-value, frequency [Hz] and rms.

    It is in all parts of a recording, in contrast to what motion excites. The power of white noise at a
    frequency is exponential, so the least of n parts exceeds n times less than the mean with exp(-n ratio).
    The mean is that of the frequencies around. 1 without one, also if it is small for the sensor's noise.
    """
    values, rate = recording.interpolated(name), 1 / period(recording.time)
    size, sd = len(values) // HUM_PARTS, recording.sensor(name).sd or masks.noise(values)
    frequency = np.fft.rfftfreq(size, 1 / rate) if size else np.zeros(0)
    seen = (frequency > HUM_FROM) & (frequency < 0.98 * rate / 2)
    if seen.sum() < 2 * AROUND or not sd > 0:
        return 1.0, 0.0, 0.0
    parts = np.diff(values)[: HUM_PARTS * size - 1]  # without the trend
    parts = np.resize(parts, (HUM_PARTS, size)) * np.hanning(size)
    power = np.abs(np.fft.rfft(parts)[:, seen]) ** 2
    mean, near = power.mean(axis=0), np.ones(2 * AROUND + 1)
    near[AROUND - 3 : AROUND + 4] = 0.0  # the line itself, as wide as the window makes it
    floor = np.convolve(mean, near, "same") / np.convolve(np.ones_like(mean), near, "same")
    ratio = power.min(axis=0) / np.maximum(floor, np.finfo(float).tiny)
    k = int(np.argmax(ratio))
    at = float(frequency[seen][k])
    line = power.mean(axis=0)[max(k - 2, 0) : k + 3].sum() - 5 * floor[k]
    # a sine of rms r has the power r^2 size sum(window^2) / 2 in its line; of differences 2 sin(pi f / rate)
    rms = math.sqrt(max(line, 0.0) * 2 / (size * 0.375 * size)) / (2 * math.sin(math.pi * at / rate))
    p = min(1.0, len(ratio) * math.exp(-HUM_PARTS * float(ratio[k])))
    return (p, at, rms) if rms > HUM_SIZE * sd else (1.0, at, rms)
