"""How far one signal of a recording can be trusted.

How far a recording can be trusted: `examine` finds what is wrong, `remarks` says it, `table` shows it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fmus.identification.recordings import clock
from fmus.identification.recordings.clock import Clock, beyond
from fmus.identification.recordings.masks import (
    clipped,
    dead,
    frozen,
    noise,
    noise_in_motion,
    overstated,
    step,
)
from orchestrator.base.units import display
from orchestrator.data.recording import Mask, Recording, Sensor, stretches
from orchestrator.data.table import Array

LOUD = 2.0  # times what is told, from which noise is more than told
COARSE, FINE = 1.5, 0.67  # of the told step
COUNTS = 1e-4  # of the range: finer steps, such as the digits of a file, need not be told


@dataclass(frozen=True)
class Fault:
    """Samples that something is wrong with.

    share     of all samples
    first     when it starts first [s]
    longest   longest stretch [s]
    """

    samples: int
    share: float
    parts: int
    first: float
    longest: float

    def __bool__(self) -> bool:
        return self.samples > 0


@dataclass(frozen=True)
class SignalQuality:
    """One signal; numbers in SI.

    step, noise   estimated from the data; step 0: none to be seen
    moving        noise where the signal is not held; overstated: much more is told
    sensor        what is told
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
            zone = shown(self.sensor.dead_zone, self.unit)
            yield f"{self.name}: {_words(self.dead)} in the sensor's dead zone of {zone}, not used."

    def faults(self) -> Iterator[str]:
        """The first of them: a dead zone is no fault."""
        if self.gaps:
            yield f"{self.name}: {_words(self.gaps)} without a sample."
        if self.clipped:
            yield (
                f"{self.name}: {_words(self.clipped)} clipped, at an end of the sensor's range or held at the"
                f" signal's own extreme."
            )
        if self.stuck:
            yield (
                f"{self.name}: {_words(self.stuck)} stuck at one value, which its noise would not"
                " allow, not used."
            )
        usual = beyond(max(abs(self.lowest), abs(self.highest)), self.unit)
        if usual:
            low, high = (shown(value, self.unit) for value in usual)
            wanted = f"{low} to {high}" if usual[0] else f"up to {high}"
            lowest, highest = (shown(value, self.unit) for value in (self.lowest, self.highest))
            yield (
                f"{self.name}: from {lowest} to {highest}, expected a largest magnitude of {wanted}:"
                " is its unit right?"
            )
        yield from self._instrument()

    def _instrument(self) -> Iterator[str]:
        told, found = self.sensor, shown(self.noise, self.unit)
        # a slow signal rounded to steps looks like noise of up to half a step
        usual = float(np.hypot(told.noise, told.resolution / 2))
        if usual > 0 and self.noise > LOUD * usual:
            yield f"{self.name}: noise of {found}, told {shown(told.noise, self.unit)}."
        if self.overstated:
            seen = shown(self.moving, self.unit)
            yield (
                f"{self.name}: noise told {shown(told.noise, self.unit)}, much larger than what is seen,"
                f" {seen}: the signal counts for too little."
            )
        step, wanted = shown(self.step, self.unit), shown(told.resolution, self.unit)
        if told.resolution > 0 and self.step > COARSE * told.resolution:
            yield f"{self.name}: steps of {step}, coarser than the resolution told, {wanted}."
        elif told.resolution > 0 and 0 < self.step < FINE * told.resolution:
            yield f"{self.name}: steps of {step}, finer than the resolution told, {wanted}."
        elif told.resolution == 0 and self.noise > 0 and self.step > COUNTS * (self.highest - self.lowest):
            yield f"{self.name}: steps of {step} without a resolution told."


def signal_quality(recording: Recording, name: str) -> SignalQuality:
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
        lowest=float(there.min()) if len(there) else float("nan"),
        highest=float(there.max()) if len(there) else float("nan"),
    )


def _fault(bad: Mask, time: Array) -> Fault:
    parts = stretches(bad)
    # a stretch of one sample lasts until the next one
    ends = np.append(time, 2 * time[-1] - time[-2])
    longest = max((float(ends[part.stop] - time[part.start]) for part in parts), default=0.0)
    first = float(time[parts[0].start]) if parts else float("nan")
    return Fault(int(bad.sum()), float(bad.mean()), len(parts), first, longest)


def _words(fault: Fault) -> str:
    share = f"{100 * fault.share:.2g} %" if fault.share < 0.995 else "all"
    parts = f"in {fault.parts} parts, " if fault.parts > 1 else ""
    count = "1 sample" if fault.samples == 1 else f"{fault.samples} samples"
    return f"{count} ({share}; {parts}first at {fault.first:.6g} s, longest {fault.longest:.3g} s)"


def shown(value: float, unit: str) -> str:
    """A number in the unit a reader expects."""
    text, factor = display(unit) or (unit, 1.0)
    shown = f"{factor * value:.0f}" if 1e3 <= abs(factor * value) < 1e6 else f"{factor * value:.3g}"
    return shown + ("" if text == "1" else f" {text}")


@dataclass(frozen=True)
class Quality:
    """A recording's clock and signals."""

    source: str
    clock: Clock
    signals: tuple[SignalQuality, ...]

    def remarks(self) -> list[str]:
        """Whole sentences, one for each thing that is not as it should be; none for a clean recording."""
        found = [*self.clock.remarks(), *(text for signal in self.signals for text in signal.remarks())]
        still = [f"{s.name} ({shown(s.lowest, s.unit)})" for s in self.signals if s.still]
        return [*found, f"One value throughout: {', '.join(still)}."] if still else found

    def table(self) -> str:
        """One line for each signal: shares of samples, steps and noise as seen (and as told)."""
        head = ("signal", "gaps", "clipped", "stuck", "dead zone", "step (told)", "noise (told)")
        rows = [head, *(_row(signal) for signal in self.signals)]
        widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
        lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
        clock = f"{self.clock.rate:.6g} Hz, jitter {1e3 * self.clock.jitter:.2g} ms"
        return "\n".join([f"{self.source}: {clock}", *lines])


def examine(recording: Recording) -> Quality:
    """What can be told of a recording's quality from its data and what its meta file says."""
    signals = tuple(signal_quality(recording, name) for name in recording.signals)
    return Quality(recording.source.name, clock.examine(recording), signals)


def _row(signal: SignalQuality) -> tuple[str, ...]:
    faults = (signal.gaps, signal.clipped, signal.stuck, signal.dead)
    shares = (f"{100 * fault.share:.2g} %" if fault else "-" for fault in faults)
    told = (signal.sensor.resolution, signal.sensor.noise)
    pairs = zip((signal.step, signal.noise), told, strict=True)
    seen = (f"{shown(v, signal.unit)} ({shown(t, signal.unit) if t else '-'})" for v, t in pairs)
    return (signal.name, *shares, *seen)
