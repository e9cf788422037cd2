"""The clock of a recording: rate, jitter, drift, missing and repeated samples."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fmus.identification.recordings.flat import NOISY, at_ends, equal_by_chance, step_and_noise
from fmus.identification.recordings.plausible import RATES
from fmus.identification.recordings.recording import Array, Mask, Recording, Sensor
from fmus.identification.recordings.resampling import MISSED, UNEVEN, period

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
