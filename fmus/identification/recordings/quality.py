"""Quality of a recording: `examine` checks its clock and its signals against their description.

`Quality.remarks` reports faults in sentences, `Quality.table` lists all signals. Faulty samples come from
`masks`. A magnitude that no machine reaches indicates a wrong unit.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from fmus.identification.recordings.clock import GAP, UNIFORM, period
from fmus.identification.recordings.masks import (
    MAX_CHANCE,
    at_ends,
    clipped,
    dead,
    equal_by_chance,
    noise,
    noise_in_motion,
    overstated,
    step,
    step_and_noise,
    stuck_samples,
)
from orchestrator.base.text import TextTable, display_unit
from orchestrator.data.recording import Mask, Recording, Sensor, true_intervals
from orchestrator.data.table import Array

AT_ZERO = 6.0  # standard deviations, which noise exceeds once in 5e8 samples
# SI unit -> plausible range of the largest magnitude in a recording
PLAUSIBLE: Mapping[str, tuple[float, float]] = {
    "Pa": (1e4, 1e8),  # a tenth of a bar; burst pressure of a hose
    "m3/s": (0.0, 0.05),  # 3000 L/min; a leakage has no lower limit
    "V": (0.1, 100.0),
    "rad": (0.0, 4 * math.pi),  # two turns of the column; larger values may be degrees read as rad
    "rad/s": (0.0, 20.0),
}
PLAUSIBLE_RATES = (10.0, 1e5)  # Hz, of a logger that records the motion of a valve
LOUD = 2.0  # a remark from this ratio of noise to stated noise on
COARSE, FINE = 1.5, 0.67  # a remark outside these ratios of step to stated resolution
FINEST_STATED = 1e-4  # fraction of a signal's range; finer steps, such as digits of a file, need no statement
CLOSE = 0.5  # periods; time stamps closer than this belong to one sample that was written twice
SIGNIFICANT = 5  # standard deviations; a larger count or drift is not due to chance
RARE = 0.05  # rows that are equal by chance with a larger probability are not judged
NEIGHBOURS = 8  # samples on each side that determine the slope of a signal
BOW = 0.25  # periods; a remark if the drift moves time stamps farther than this off a uniform clock


@dataclass(frozen=True)
class ClockQuality:
    """Time stamps and repeated rows.

    rate       samples per second, missing samples included [Hz]
    jitter     standard deviation of a time stamp from a clock with constant drift [s]
    drift      relative change of the interval from start to end
    bow        largest deviation from a uniform clock by the drift [s], 0 if it is not significant
    missing    number of missing samples in intervals that are too long
    longest    longest interval [s], at `longest_at` [s]
    close      number of time stamps that follow too closely
    repeated   number of rows that repeat the row before in spite of noise; the first is at `repeated_at` [s]
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
        """A sentence for each fault of the clock."""
        interval = 1 / self.rate
        low, high = PLAUSIBLE_RATES
        if not low <= self.rate <= high:
            expected = f"expected {low:g} Hz to {high:g} Hz: is the unit of time right?"
            yield f"The clock: {self.rate:.3g} Hz, {expected}"
        if self.missing:
            yield (
                f"The clock: {self.missing} samples are missing; the longest interval is"
                f" {1e3 * self.longest:.4g} ms at {self.longest_at:.6g} s,"
                f" the usual one {1e3 * interval:.4g} ms."
            )
        if self.close:
            yield f"The clock: {self.close} time stamps are less than half a period after the one before."
        if self.jitter > UNIFORM * interval:
            percent = 100 * self.jitter / interval
            yield f"The clock: jitter of {1e3 * self.jitter:.3g} ms, {percent:.0f} % of a period."
        if self.bow > BOW * interval:
            yield (
                f"The clock: the interval changes by {100 * self.drift:.2g} % from start to end,"
                f" which is {1e3 * self.bow:.3g} ms off a uniform clock."
            )
        if self.repeated:
            yield f"The clock: {self.repeated} rows repeat the row before, first at {self.repeated_at:.6g} s."


def clock_quality(recording: Recording) -> ClockQuality:
    """The quality of a clock; jitter and drift need ten samples."""
    time = recording.time
    interval, intervals = period(time), np.diff(time)
    steps = np.maximum(np.round(intervals / interval), 1)
    jitter, drift, bow = _drift(time, steps) if len(time) >= 10 else (0.0, 0.0, 0.0)
    repetitions = repeated(recording)
    longest = int(np.argmax(intervals))
    return ClockQuality(
        rate=float(np.sum(steps) / (time[-1] - time[0])),
        jitter=jitter,
        drift=drift,
        bow=bow,
        missing=int(np.sum(steps[intervals > GAP * interval] - 1)),
        longest=float(intervals[longest]),
        longest_at=float(time[longest]),
        close=int(np.sum(intervals < CLOSE * interval)),
        repeated=int(np.sum(repetitions)),
        repeated_at=float(time[np.argmax(repetitions)]) if repetitions.any() else math.nan,
    )


def _drift(time: Array, steps: Array) -> tuple[float, float, float]:
    """Jitter, drift and bow from the fit of time = a + b k + c k^2 over the index k of each sample."""
    k = np.concatenate(([0.0], np.cumsum(steps)))
    x = 2 * k / k[-1] - 1  # from -1 to 1, so that the terms are nearly orthogonal
    terms = np.stack([np.ones_like(x), x, x**2], axis=1)
    fit, *_ = np.linalg.lstsq(terms, time - time[0], rcond=None)
    residual = time - time[0] - terms @ fit
    jitter = float(np.sqrt(np.sum(residual**2) / (len(time) - 3)))
    error = jitter * math.sqrt(np.linalg.inv(terms.T @ terms)[2, 2])
    bow = abs(float(fit[2])) / 2
    return jitter, float(4 * fit[2] / fit[1]), bow if abs(fit[2]) > SIGNIFICANT * error else 0.0


def repeated(recording: Recording) -> Mask:
    """Rows equal to the row before in all signals, if there are more of them than chance explains.

    The probability comes from the signals with noise, outside the ends of their ranges and their dead zones.
    """
    equal = np.ones(len(recording.time), dtype=bool)
    equal[0] = False
    chance = np.ones(len(recording.time))
    for name, values in recording.signals.items():
        equal[1:] &= (np.diff(values) == 0) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
        chance *= _chance(values, recording.sensor(name))
    equal &= chance < RARE
    expected = float(np.sum(chance[chance < RARE]))
    significant = np.sum(equal) > expected + SIGNIFICANT * math.sqrt(expected) + 0.5
    return equal if significant else np.zeros_like(equal)


def _chance(values: Array, sensor: Sensor) -> Array:
    """Probability that a sample equals the one before; 1 if it cannot be estimated.

    Two samples with noise sd whose true values differ by d are equal with P exp(-d^2 / (4 sd^2)).
    """
    result = np.ones(len(values))
    at_rest = equal_by_chance(values, sensor)
    if at_rest > MAX_CHANCE:
        return result
    _, sd = step_and_noise(values, sensor)
    change = np.zeros(len(values))
    span = 2 * NEIGHBOURS + 1
    if len(values) > span:
        late, early = values[span:], values[:-span]
        change[NEIGHBOURS + 1 : -NEIGHBOURS] = np.nan_to_num((late - early) / span)
    judged = np.isfinite(values) & ~at_ends(values, sensor) & (np.abs(values) > sensor.dead_zone)
    result[judged] = (at_rest * np.exp(-((change / sd) ** 2) / 4))[judged]
    return result


@dataclass(frozen=True)
class FaultySamples:
    """Samples of a signal with one kind of fault.

    fraction   fraction of all samples
    parts      number of intervals
    first      start of the first interval [s]
    longest    longest interval [s]
    """

    samples: int
    fraction: float
    parts: int
    first: float
    longest: float

    def __bool__(self) -> bool:
        return self.samples > 0

    def __str__(self) -> str:
        fraction = f"{100 * self.fraction:.2g} %" if self.fraction < 0.995 else "all"
        parts = f"in {self.parts} parts, " if self.parts > 1 else ""
        count = "1 sample" if self.samples == 1 else f"{self.samples} samples"
        return f"{count} ({fraction}; {parts}first at {self.first:.6g} s, longest {self.longest:.3g} s)"


def _faulty(mask: Mask, time: Array) -> FaultySamples:
    parts = true_intervals(mask)
    # an interval of one sample lasts until the next sample
    ends = np.append(time, 2 * time[-1] - time[-2])
    longest = max((float(ends[part.stop] - time[part.start]) for part in parts), default=0.0)
    first = float(time[parts[0].start]) if parts else math.nan
    return FaultySamples(int(mask.sum()), float(mask.mean()), len(parts), first, longest)


@dataclass(frozen=True)
class SignalQuality:
    """Faults and noise of one signal, in SI units.

    step              quantisation step estimated from the samples, 0 if there is none
    noise             noise estimated from the samples
    noise_in_motion   noise of the samples that differ from their neighbours
    overstated        whether the stated noise is much larger
    sensor            the instrument as described
    lowest, highest   extremes of the samples
    """

    name: str
    unit: str
    gaps: FaultySamples
    clipped: FaultySamples
    stuck: FaultySamples
    dead: FaultySamples
    step: float
    noise: float
    noise_in_motion: float
    overstated: bool
    sensor: Sensor
    lowest: float
    highest: float

    @property
    def constant(self) -> bool:
        """Whether the signal has one value throughout."""
        return self.lowest == self.highest

    def remarks(self) -> Iterator[str]:
        """A sentence for each fault, and one on unused samples in the dead zone."""
        yield from self.faults()
        if self.dead and not self.constant:
            zone = self._display(self.sensor.dead_zone)
            yield f"{self.name}: {self.dead} in the sensor's dead zone of {zone}, not used."

    def faults(self) -> Iterator[str]:
        """A sentence for each fault; samples in the dead zone are not a fault."""
        if self.gaps:
            yield f"{self.name}: {self.gaps} without a sample."
        if self.clipped:
            position = "at an end of the sensor's range or held at the signal's own extreme"
            yield f"{self.name}: {self.clipped} clipped, {position}."
        if self.stuck:
            yield f"{self.name}: {self.stuck} stuck at one value, without the noise of the sensor; not used."
        largest = max(abs(self.lowest), abs(self.highest))
        low, high = PLAUSIBLE.get(self.unit, (0.0, math.inf))
        # what is zero up to the noise of its sensor tells nothing about its unit
        if largest > AT_ZERO * self.sensor.sd and not low <= largest <= high:
            limits = f"{self._display(low)} to" if low else "up to"
            yield (
                f"{self.name}: from {self._display(self.lowest)} to {self._display(self.highest)},"
                f" expected a largest magnitude of {limits} {self._display(high)}: is its unit right?"
            )
        yield from self._differences()

    def _differences(self) -> Iterator[str]:
        """A sentence for each difference between the samples and the described instrument."""
        sensor = self.sensor
        # a slow signal rounded to steps looks like noise of up to half a step
        stated = float(np.hypot(sensor.noise, sensor.resolution / 2))
        if stated > 0 and self.noise > LOUD * stated:
            yield f"{self.name}: noise of {self._display(self.noise)}, stated {self._display(sensor.noise)}."
        if self.overstated:
            yield (
                f"{self.name}: stated noise of {self._display(sensor.noise)}, much larger than that of the"
                f" samples, {self._display(self.noise_in_motion)}: the weight of the signal is too small."
            )
        step, resolution = self._display(self.step), self._display(sensor.resolution)
        if sensor.resolution > 0 and self.step > COARSE * sensor.resolution:
            yield f"{self.name}: steps of {step}, coarser than the stated resolution, {resolution}."
        elif sensor.resolution > 0 and 0 < self.step < FINE * sensor.resolution:
            yield f"{self.name}: steps of {step}, finer than the stated resolution, {resolution}."
        elif (
            sensor.resolution == 0
            and self.noise > 0
            and self.step > FINEST_STATED * (self.highest - self.lowest)
        ):
            yield f"{self.name}: steps of {step} without a stated resolution."

    def row(self) -> tuple[str, ...]:
        """The signal's row of the table."""
        faults = (self.gaps, self.clipped, self.stuck, self.dead)
        fractions = (f"{100 * fault.fraction:.2g} %" if fault else "-" for fault in faults)
        pairs = ((self.step, self.sensor.resolution), (self.noise, self.sensor.noise))
        cells = (f"{self._display(v)} ({self._display(stated) if stated else '-'})" for v, stated in pairs)
        return (self.name, *fractions, *cells)

    def _display(self, value: float) -> str:
        """A value in its display unit."""
        unit = display_unit(self.unit)
        return unit.plain(value) if self.unit == "1" else unit.ascii(value)


def signal_quality(recording: Recording, name: str) -> SignalQuality:
    """The quality of one signal."""
    values, sensor, time = recording[name], recording.sensor(name), recording.time
    finite = values[np.isfinite(values)]
    return SignalQuality(
        name=name,
        unit=recording.units[name],
        gaps=_faulty(~np.isfinite(values), time),
        clipped=_faulty(clipped(values, sensor), time),
        stuck=_faulty(stuck_samples(recording, name), time),
        dead=_faulty(dead(recording, name), time),
        step=step(values),
        noise=noise(values, sensor),
        noise_in_motion=noise_in_motion(values, sensor),
        overstated=overstated(values, sensor),
        sensor=sensor,
        lowest=float(finite.min()) if len(finite) else math.nan,
        highest=float(finite.max()) if len(finite) else math.nan,
    )


@dataclass(frozen=True)
class Quality:
    """Quality of a recording's clock and signals."""

    source: str
    clock: ClockQuality
    signals: tuple[SignalQuality, ...]

    def remarks(self) -> list[str]:
        """One sentence for each remark; none for a clean recording."""
        remarks = [*self.clock.remarks(), *(text for signal in self.signals for text in signal.remarks())]
        constant = [f"{s.name} ({s._display(s.lowest)})" for s in self.signals if s.constant]
        return [*remarks, f"One value throughout: {', '.join(constant)}."] if constant else remarks

    def table(self) -> str:
        """One line for each signal: fractions of faulty samples, estimated (and stated) step and noise."""
        head = ("signal", "gaps", "clipped", "stuck", "dead zone", "step (stated)", "noise (stated)")
        lines = TextTable(head, [signal.row() for signal in self.signals], left=range(len(head))).lines()
        clock = f"{self.clock.rate:.6g} Hz, jitter {1e3 * self.clock.jitter:.2g} ms"
        return "\n".join([f"{self.source}: {clock}", *lines])


def examine(recording: Recording) -> Quality:
    """The quality of a recording, from its samples and its description."""
    signals = tuple(signal_quality(recording, name) for name in recording.signals)
    return Quality(recording.source.name, clock_quality(recording), signals)
