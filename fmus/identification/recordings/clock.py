"""Sizes that quantities of a machine usually have: what is far off may be in another unit than told.

A uniform clock: its rate, whether a recording has one, resampling to one. Gaps stay gaps.

The clock of a recording: rate, jitter, drift, missing and repeated samples.

A recording on a uniform clock: at its own rate, or at one that a simulation can follow.

Signals that a simulation needs at every sample, such as commands: short gaps are bridged.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.signal

from fmus.identification.recordings.masks import NOISY, at_ends, equal_by_chance, good, step_and_noise
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording, Sensor, stretches
from orchestrator.data.table import Array

# SI unit -> what the largest magnitude in a recording lies between
USUAL: Mapping[str, tuple[float, float]] = {
    "Pa": (1e4, 1e8),  # a tenth of a bar; what a hose bursts at
    "m3/s": (0.0, 0.05),  # 3000 L/min; a leakage may be as small as it likes
    "V": (0.1, 100.0),
    "rad": (0.0, 4 * math.pi),  # two turns of the column; what was read as rad may be degrees
    "rad/s": (0.0, 20.0),
}
RATES = (10.0, 1e5)  # Hz: of a logger that follows a valve


def beyond(largest: float, unit: str) -> tuple[float, float] | None:
    """What is usual, if the largest magnitude of a signal is not; a signal that is zero tells nothing."""
    low, high = USUAL.get(unit, (0.0, math.inf))
    return (low, high) if largest > 0 and not low <= largest <= high else None


UNEVEN = 0.05  # of a period: how far a stamp may be off a uniform clock; more is jitter that derivatives see
MISSED = 1.5  # periods from one sample to the next, from which on one is missing
CUTOFF = 0.8  # of half the new rate: -6 dB of the filter before going down; -34 dB at half the new rate
ORDER = 8


def period(time: Array) -> float:
    """The usual interval of a clock [s], whatever is missing."""
    return float(np.median(np.diff(time)))


def uniform_rate(recording: Recording) -> float:
    """Samples per second [Hz]; refuses a clock that is not uniform, which `resample` makes uniform."""
    time = recording.time
    if len(time) < 2:
        raise Problem(f"{recording.source}: expected two or more samples, found {len(time)}")
    off = periods_off(time)
    worst = int(np.argmax(off))
    if off[worst] > UNEVEN:
        raise Problem(
            f"{recording.source}: time {time[worst]:g} s is {100 * off[worst]:.0f} % of a period off"
            f" a uniform clock, expected at most {100 * UNEVEN:.0f} %: resample the recording first"
        )
    return float((len(time) - 1) / (time[-1] - time[0]))


def periods_off(time: Array) -> Array:
    """How far each stamp is off a uniform clock, in periods."""
    step = (time[-1] - time[0]) / (len(time) - 1)
    return np.asarray(np.abs(time - (time[0] + step * np.arange(len(time)))) / step)


def resample(
    recording: Recording, rate: float, hold: Collection[str] = (), bridge: float | None = None
) -> Recording:
    """The recording on a uniform clock of `rate` [Hz] that starts with its first sample.

    Signals are interpolated linearly. When the rate goes down, they pass a zero-phase filter first, and what
    is not good (clipped, in the dead zone) becomes a gap, which a filtered sample would hide. The standard
    deviation of the sensor is that of what the filter leaves.

    hold     signals that keep their value from sample to sample, such as commands: not filtered
    bridge   longest interval to interpolate over [s]; None: a missing sample is a gap
    """
    time = recording.time
    if rate <= 0 or len(time) < 2:
        found = f"{rate:g} Hz and {len(time)} samples"
        raise Problem(f"{recording.source}: expected a rate above 0 and two or more samples, found {found}")
    old = 1 / period(time)
    clock = time[0] + np.arange(1 + int((time[-1] - time[0]) * rate * (1 + 1e-12) + 1e-9)) / rate
    longest = MISSED / old if bridge is None else bridge
    down = rate < old * (1 - 1e-6)
    signals, sensors = {}, dict(recording.sensors)
    for name, values in recording.signals.items():
        if name in hold:
            signals[name] = _held(clock, time, values, longest)
        elif down:
            finer = np.linspace(time[0], time[-1], 1 + round((time[-1] - time[0]) * old))
            kept = np.where(good(recording, name), values, np.nan)
            filtered = _filtered(_linear(finer, time, kept, longest), rate / old)
            signals[name] = _linear(clock, finer, filtered, longest)
            if name in sensors:
                sensors[name] = _quieter(sensors[name], rate / old)
        else:
            signals[name] = _linear(clock, time, values, longest)
    return replace(recording, time=clock, signals=signals, sensors=sensors)


def _linear(clock: Array, time: Array, values: Array, longest: float) -> Array:
    """Linear interpolation; NaN next to a gap and within an interval longer than `longest`."""
    # the last new sample may be late by rounding
    result = np.interp(np.clip(clock, time[0], time[-1]), time, values)
    return np.where(_missing(clock, time, longest), np.nan, result)


def _held(clock: Array, time: Array, values: Array, longest: float) -> Array:
    """The value of the sample before."""
    # a stamp that is late by rounding still counts as this sample's
    before = np.clip(np.searchsorted(time, clock + 1e-6 * period(time), side="right") - 1, 0, len(time) - 1)
    return np.where(_missing(clock, time, longest), np.nan, values[before])


def _missing(clock: Array, time: Array, longest: float) -> Mask:
    """Where a new sample lies inside an interval longer than `longest` [s]."""
    after = np.clip(np.searchsorted(time, clock), 1, len(time) - 1)
    rounding = 1e-6 * period(time)  # of stamps: a new sample that close to an old one has its value
    inside = (clock > time[after - 1] + rounding) & (clock < time[after] - rounding)
    return inside & (time[after] - time[after - 1] > longest)


def _filtered(values: Array, ratio: float) -> Array:
    """Each stretch without a gap through a Butterworth filter, forwards and back."""
    sections = scipy.signal.butter(ORDER, CUTOFF * ratio, output="sos")
    result = np.full_like(values, np.nan)
    for part in stretches(np.isfinite(values)):
        # a line passes the filter as it is; without the one through the ends these are zero and ring little
        line = np.linspace(values[part.start], values[part.stop - 1], part.stop - part.start)
        pad = min(int(10 / ratio), len(line) - 1)
        result[part] = line + scipy.signal.sosfiltfilt(sections, values[part] - line, padlen=pad)
    return result


def _quieter(sensor: Sensor, ratio: float) -> Sensor:
    """The sensor behind the filter: white noise keeps the share that passes.

    A converter's error is white only where noise of half a step moves the signal from step to step. An
    encoder that hardly moves has the same error in all samples that the filter averages, and keeps it.
    """
    sections = scipy.signal.butter(ORDER, CUTOFF * ratio, output="sos")
    _, response = scipy.signal.sosfreqz(sections, worN=4096)
    # forwards and back is |H|^2, so the power is |H|^4
    passed = float(np.sqrt(np.mean(np.abs(response) ** 4)))
    if sensor.noise < sensor.resolution / 2:
        return replace(sensor, noise=sensor.noise * passed)
    return replace(sensor, noise=sensor.sd * passed, resolution=0.0)


CLOSE = 0.5  # of a period: two stamps closer than this are one sample written twice
SURE = 5  # standard deviations from which a count or a drift is no chance
RARE = 0.05  # chance of an equal row above which it tells nothing
AROUND = 8  # samples on each side that tell how fast a signal moves
BOW = 0.25  # of a period off a uniform clock, from which a drift is told


@dataclass(frozen=True)
class Clock:
    """What the time stamps and repeated rows tell.

    rate       samples per second, of what is there [Hz]
    jitter     standard deviation of a stamp about a clock of steady drift [s]
    drift      change of the interval from start to end over the interval
    bow        what the drift puts the stamps off a uniform clock [s], 0 if it is not significant
    missing    samples that should lie in intervals that are too long
    longest    longest interval [s], at `longest_at` [s]
    close      stamps that follow too soon on another
    repeated   rows equal to the row before, which noise would not allow; the first is at `repeated_at` [s]
    """

    rate: float
    jitter: float
    drift: float
    bow: float
    missing: int
    longest: float
    longest_at: float
    close: int
    repeated: int
    repeated_at: float

    def remarks(self) -> Iterator[str]:
        """Whole sentences on what is not as it should be."""
        step = 1 / self.rate
        low, high = RATES
        if not low <= self.rate <= high:
            yield (
                f"The clock: {self.rate:.3g} Hz, expected {low:g} Hz to {high:g} Hz:"
                " is the unit of time right?"
            )
        if self.missing:
            yield (
                f"The clock: {self.missing} samples are missing; the longest interval is"
                f" {1e3 * self.longest:.4g} ms at {self.longest_at:.6g} s, the usual one {1e3 * step:.4g} ms."
            )
        if self.close:
            yield f"The clock: {self.close} stamps follow within half a period on the one before."
        if self.jitter > UNEVEN * step:
            share = 100 * self.jitter / step
            yield f"The clock: jitter of {1e3 * self.jitter:.3g} ms, {share:.0f} % of a period."
        if self.bow > BOW * step:
            yield (
                f"The clock: the interval changes by {100 * self.drift:.2g} % from start to end,"
                f" which is {1e3 * self.bow:.3g} ms off a uniform clock."
            )
        if self.repeated:
            yield f"The clock: {self.repeated} rows repeat the row before, first at {self.repeated_at:.6g} s."


def examine(recording: Recording) -> Clock:
    """The clock of a recording of ten samples or more; of fewer only the rate."""
    time = recording.time
    usual = period(time)
    intervals = np.diff(time)
    steps = np.maximum(np.round(intervals / usual), 1)
    jitter, drift, bow = _drift(time, steps)
    again = repeated(recording)
    longest = int(np.argmax(intervals))
    return Clock(
        rate=float(np.sum(steps) / (time[-1] - time[0])),
        jitter=jitter,
        drift=drift,
        bow=bow,
        missing=int(np.sum(steps[intervals > MISSED * usual] - 1)),
        longest=float(intervals[longest]),
        longest_at=float(time[longest]),
        close=int(np.sum(intervals < CLOSE * usual)),
        repeated=int(np.sum(again)),
        repeated_at=float(time[np.argmax(again)]) if again.any() else math.nan,
    )


def _drift(time: Array, steps: Array) -> tuple[float, float, float]:
    """Jitter, drift and bow from time = a + b k + c k^2 over the number k of each sample."""
    if len(time) < 10:
        return 0.0, 0.0, 0.0
    number = np.concatenate(([0.0], np.cumsum(steps)))
    # from -1 to 1, so that the terms are nearly orthogonal
    x = 2 * number / number[-1] - 1
    terms = np.stack([np.ones_like(x), x, x**2], axis=1)
    found, *_ = np.linalg.lstsq(terms, time - time[0], rcond=None)
    residual = time - time[0] - terms @ found
    jitter = float(np.sqrt(np.sum(residual**2) / (len(time) - 3)))
    error = jitter * math.sqrt(np.linalg.inv(terms.T @ terms)[2, 2])
    drift = float(4 * found[2] / found[1])
    bow = abs(float(found[2])) / 2
    return jitter, drift, bow if abs(found[2]) > SURE * error else 0.0


def repeated(recording: Recording) -> Mask:
    """Rows equal to the row before in all signals, if noise and motion make that too rare to be chance.

    Chance is told by the signals with noise, where they are away from their ends and dead zones.
    """
    again = np.ones(len(recording.time), dtype=bool)
    again[0] = False
    chance = np.ones(len(recording.time))
    for name, values in recording.signals.items():
        again[1:] &= (np.diff(values) == 0) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
        chance *= _chance(values, recording.sensor(name))
    again &= chance < RARE
    expected = float(np.sum(chance[chance < RARE]))
    certain = np.sum(again) > expected + SURE * math.sqrt(expected) + 0.5
    return again if certain else np.zeros_like(again)


def _chance(values: Array, sensor: Sensor) -> Array:
    """Probability that a sample equals the one before; 1 where nothing can be told.

    Two samples of noise sd about values that differ by d are equal with P exp(-d^2 / (4 sd^2)).
    """
    result = np.ones(len(values))
    equal = equal_by_chance(values, sensor)
    if equal > NOISY:
        return result
    _, sd = step_and_noise(values, sensor)
    move = np.zeros(len(values))
    if len(values) > 2 * AROUND + 1:
        late, early = values[2 * AROUND + 1 :], values[: -2 * AROUND - 1]
        move[AROUND + 1 : -AROUND] = np.nan_to_num((late - early) / (2 * AROUND + 1))
    live = np.isfinite(values) & ~at_ends(values, sensor) & (np.abs(values) > sensor.dead_zone)
    result[live] = (equal * np.exp(-((move / sd) ** 2) / 4))[live]
    return result


FASTEST = 500.0  # Hz: ten times what oil does in the longest hose; more only takes time to simulate


def evenly(recording: Recording) -> Recording:
    """The recording on a uniform clock at its own rate, itself if it has one; what is missing becomes a gap.

    Commands are interpolated as all else is: a simulation draws straight lines between its samples, and
    holding the sample before would make half of them a period late.
    """
    time = recording.time
    if len(time) < 2 or np.max(periods_off(time)) <= UNEVEN:
        return recording
    return resample(recording, 1 / period(time))


def thinned(recording: Recording, fastest: float = FASTEST) -> Recording:
    """The recording at a rate of at most `fastest` [Hz]; commands are held, all else is filtered before."""
    if len(recording.time) < 2 or period(recording.time) > 0.99 / fastest:
        return recording
    held = [name for name in recording.signals if name.endswith("command")]
    return resample(recording, fastest, hold=held)
