"""How far a recording can be trusted: `examine` finds what is wrong with its clock and signals.

`Quality.remarks` says it in sentences, `Quality.table` shows it. What is wrong with a signal is found by
`masks`; what is far off the sizes that quantities of a machine have may be in another unit than stated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fmus.identification.recordings.clock import MISSED, UNEVEN, period
from fmus.identification.recordings.masks import (
    NOISY,
    at_ends,
    clipped,
    dead,
    equal_by_chance,
    frozen,
    noise,
    noise_in_motion,
    overstated,
    step,
    step_and_noise,
)
from orchestrator.base.text import TextTable
from orchestrator.base.units import display_conversion
from orchestrator.data.recording import Mask, Recording, Sensor, true_intervals
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
LOUD = 2.0  # times the stated noise, from which noise is more than stated
COARSE, FINE = 1.5, 0.67  # of the stated step
COUNTS = 1e-4  # of the range: finer steps, such as the digits of a file, need not be stated
CLOSE = 0.5  # of a period: two stamps closer than this are one sample written twice
SURE = 5  # standard deviations from which a count or a drift is no chance
RARE = 0.05  # chance of an equal row above which it tells nothing
AROUND = 8  # samples on each side that tell how fast a signal moves
BOW = 0.25  # of a period off a uniform clock, from which a drift is a remark


@dataclass(frozen=True)
class ClockQuality:
    """Time stamps and repeated rows.

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
        usual = 1 / self.rate
        low, high = RATES
        if not low <= self.rate <= high:
            expected = f"expected {low:g} Hz to {high:g} Hz: is the unit of time right?"
            yield f"The clock: {self.rate:.3g} Hz, {expected}"
        if self.missing:
            yield (
                f"The clock: {self.missing} samples are missing; the longest interval is"
                f" {1e3 * self.longest:.4g} ms at {self.longest_at:.6g} s,"
                f" the usual one {1e3 * usual:.4g} ms."
            )
        if self.close:
            yield f"The clock: {self.close} stamps follow within half a period on the one before."
        if self.jitter > UNEVEN * usual:
            share = 100 * self.jitter / usual
            yield f"The clock: jitter of {1e3 * self.jitter:.3g} ms, {share:.0f} % of a period."
        if self.bow > BOW * usual:
            yield (
                f"The clock: the interval changes by {100 * self.drift:.2g} % from start to end,"
                f" which is {1e3 * self.bow:.3g} ms off a uniform clock."
            )
        if self.repeated:
            yield f"The clock: {self.repeated} rows repeat the row before, first at {self.repeated_at:.6g} s."


def clock_quality(recording: Recording) -> ClockQuality:
    """The clock of a recording of ten samples or more; of fewer only the rate."""
    time = recording.time
    usual, intervals = period(time), np.diff(time)
    steps = np.maximum(np.round(intervals / usual), 1)
    jitter, drift, bow = _drift(time, steps) if len(time) >= 10 else (0.0, 0.0, 0.0)
    again = repeated(recording)
    longest = int(np.argmax(intervals))
    return ClockQuality(
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
    number = np.concatenate(([0.0], np.cumsum(steps)))
    # from -1 to 1, so that the terms are nearly orthogonal
    x = 2 * number / number[-1] - 1
    terms = np.stack([np.ones_like(x), x, x**2], axis=1)
    fit, *_ = np.linalg.lstsq(terms, time - time[0], rcond=None)
    residual = time - time[0] - terms @ fit
    jitter = float(np.sqrt(np.sum(residual**2) / (len(time) - 3)))
    error = jitter * math.sqrt(np.linalg.inv(terms.T @ terms)[2, 2])
    bow = abs(float(fit[2])) / 2
    return jitter, float(4 * fit[2] / fit[1]), bow if abs(fit[2]) > SURE * error else 0.0


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


@dataclass(frozen=True)
class Fault:
    """Samples that something is wrong with.

    share     of all samples
    parts     stretches
    first     when the first one starts [s]
    longest   longest stretch [s]
    """

    samples: int
    share: float
    parts: int
    first: float
    longest: float

    def __bool__(self) -> bool:
        return self.samples > 0

    def __str__(self) -> str:
        share = f"{100 * self.share:.2g} %" if self.share < 0.995 else "all"
        parts = f"in {self.parts} parts, " if self.parts > 1 else ""
        count = "1 sample" if self.samples == 1 else f"{self.samples} samples"
        return f"{count} ({share}; {parts}first at {self.first:.6g} s, longest {self.longest:.3g} s)"


def _fault(bad: Mask, time: Array) -> Fault:
    parts = true_intervals(bad)
    # a stretch of one sample lasts until the next one
    ends = np.append(time, 2 * time[-1] - time[-2])
    longest = max((float(ends[part.stop] - time[part.start]) for part in parts), default=0.0)
    first = float(time[parts[0].start]) if parts else math.nan
    return Fault(int(bad.sum()), float(bad.mean()), len(parts), first, longest)


@dataclass(frozen=True)
class SignalQuality:
    """One signal; numbers in SI.

    step, noise   estimated from the data; step 0: none to be seen
    moving        noise where the signal is not held; overstated: much more is stated
    sensor        what the description states
    lowest, highest   of the samples
    """

    name: str
    unit: str
    gaps: Fault
    clipped: Fault
    stuck: Fault
    dead: Fault
    step: float
    noise: float
    moving: float
    overstated: bool
    sensor: Sensor
    lowest: float
    highest: float

    @property
    def still(self) -> bool:
        """Whether it has one value throughout."""
        return self.lowest == self.highest

    def remarks(self) -> Iterator[str]:
        """Whole sentences on what is not as it should be, and on what is not used."""
        yield from self.faults()
        if self.dead and not self.still:
            zone = self._shown(self.sensor.dead_zone)
            yield f"{self.name}: {self.dead} in the sensor's dead zone of {zone}, not used."

    def faults(self) -> Iterator[str]:
        """The first of them: a dead zone is no fault."""
        if self.gaps:
            yield f"{self.name}: {self.gaps} without a sample."
        if self.clipped:
            where = "at an end of the sensor's range or held at the signal's own extreme"
            yield f"{self.name}: {self.clipped} clipped, {where}."
        if self.stuck:
            why = "which its noise would not allow"
            yield f"{self.name}: {self.stuck} stuck at one value, {why}, not used."
        largest = max(abs(self.lowest), abs(self.highest))
        low, high = USUAL.get(self.unit, (0.0, math.inf))
        if largest > 0 and not low <= largest <= high:  # a signal that is zero tells nothing
            wanted = f"{self._shown(low)} to {self._shown(high)}" if low else f"up to {self._shown(high)}"
            yield (
                f"{self.name}: from {self._shown(self.lowest)} to {self._shown(self.highest)},"
                f" expected a largest magnitude of {wanted}: is its unit right?"
            )
        yield from self._instrument()

    def _instrument(self) -> Iterator[str]:
        """What differs from the instrument that the description states."""
        sensor, found = self.sensor, self._shown(self.noise)
        # a slow signal rounded to steps looks like noise of up to half a step
        usual = float(np.hypot(sensor.noise, sensor.resolution / 2))
        if usual > 0 and self.noise > LOUD * usual:
            yield f"{self.name}: noise of {found}, stated {self._shown(sensor.noise)}."
        if self.overstated:
            yield (
                f"{self.name}: stated noise of {self._shown(sensor.noise)}, much larger than what is seen,"
                f" {self._shown(self.moving)}: the signal counts for too little."
            )
        step, wanted = self._shown(self.step), self._shown(sensor.resolution)
        if sensor.resolution > 0 and self.step > COARSE * sensor.resolution:
            yield f"{self.name}: steps of {step}, coarser than the stated resolution, {wanted}."
        elif sensor.resolution > 0 and 0 < self.step < FINE * sensor.resolution:
            yield f"{self.name}: steps of {step}, finer than the stated resolution, {wanted}."
        elif sensor.resolution == 0 and self.noise > 0 and self.step > COUNTS * (self.highest - self.lowest):
            yield f"{self.name}: steps of {step} without a stated resolution."

    def row(self) -> tuple[str, ...]:
        """Its row of the table."""
        faults = (self.gaps, self.clipped, self.stuck, self.dead)
        shares = (f"{100 * fault.share:.2g} %" if fault else "-" for fault in faults)
        pairs = ((self.step, self.sensor.resolution), (self.noise, self.sensor.noise))
        seen = (f"{self._shown(v)} ({self._shown(stated) if stated else '-'})" for v, stated in pairs)
        return (self.name, *shares, *seen)

    def _shown(self, value: float) -> str:
        """A number in the unit a reader expects."""
        text, factor = display_conversion(self.unit) or (self.unit, 1.0)
        number = factor * value
        digits = f"{number:.0f}" if 1e3 <= abs(number) < 1e6 else f"{number:.3g}"
        return digits + ("" if text == "1" else f" {text}")


def signal_quality(recording: Recording, name: str) -> SignalQuality:
    """What can be told of one signal."""
    values, sensor, time = recording[name], recording.sensor(name), recording.time
    there = values[np.isfinite(values)]
    return SignalQuality(
        name=name,
        unit=recording.units[name],
        gaps=_fault(~np.isfinite(values), time),
        clipped=_fault(clipped(values, sensor), time),
        stuck=_fault(frozen(recording, name), time),
        dead=_fault(dead(recording, name), time),
        step=step(values),
        noise=noise(values, sensor),
        moving=noise_in_motion(values, sensor),
        overstated=overstated(values, sensor),
        sensor=sensor,
        lowest=float(there.min()) if len(there) else math.nan,
        highest=float(there.max()) if len(there) else math.nan,
    )


@dataclass(frozen=True)
class Quality:
    """A recording's clock and signals."""

    source: str
    clock: ClockQuality
    signals: tuple[SignalQuality, ...]

    def remarks(self) -> list[str]:
        """Whole sentences, one for each thing that is not as it should be; none for a clean recording."""
        found = [*self.clock.remarks(), *(text for signal in self.signals for text in signal.remarks())]
        still = [f"{s.name} ({s._shown(s.lowest)})" for s in self.signals if s.still]
        return [*found, f"One value throughout: {', '.join(still)}."] if still else found

    def table(self) -> str:
        """One line for each signal: shares of samples, steps and noise as seen (and as stated)."""
        head = ("signal", "gaps", "clipped", "stuck", "dead zone", "step (stated)", "noise (stated)")
        lines = TextTable(head, [signal.row() for signal in self.signals], left=range(len(head))).lines()
        clock = f"{self.clock.rate:.6g} Hz, jitter {1e3 * self.clock.jitter:.2g} ms"
        return "\n".join([f"{self.source}: {clock}", *lines])


def examine(recording: Recording) -> Quality:
    """What can be told of a recording's quality from its samples and its description."""
    signals = tuple(signal_quality(recording, name) for name in recording.signals)
    return Quality(recording.source.name, clock_quality(recording), signals)
