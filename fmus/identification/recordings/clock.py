"""A recording on a uniform clock: at its own rate, at one that a simulation can follow, at any other.

A missing sample stays missing: it is a gap (NaN) of the new clock, never closed by interpolation.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
import scipy.signal

from fmus.identification.recordings.masks import good
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, Sensor, true_intervals
from orchestrator.data.table import Array

UNEVEN = 0.05  # of a period: how far a stamp may be off a uniform clock; more is jitter that derivatives see
MISSED = 1.5  # periods from one sample to the next, from which on one is missing
ROUNDING = 1e-6  # of a period: of time stamps
CUTOFF = 0.8  # of half the new rate: -6 dB of the filter before going down; -34 dB at half the new rate
ORDER = 8
FASTEST = 500.0  # Hz: ten times what oil does in the longest hose; more only takes time to simulate


def period(time: Array) -> float:
    """The usual interval of a clock [s], whatever is missing."""
    return float(np.median(np.diff(time)))


def periods_off(time: Array) -> Array:
    """How far each stamp is off a uniform clock, in periods."""
    step = (time[-1] - time[0]) / (len(time) - 1)
    return np.asarray(np.abs(time - (time[0] + step * np.arange(len(time)))) / step)


def uniform_rate(recording: Recording) -> float:
    """Samples per second [Hz]; refuses a clock that is not uniform, which `resample` makes uniform."""
    time = recording.time
    if len(time) < 2:
        raise Problem(f"{recording.source}: expected two or more samples, got {len(time)}")
    off = periods_off(time)
    worst = int(np.argmax(off))
    if off[worst] > UNEVEN:
        raise Problem(
            f"{recording.source}: time {time[worst]:g} s is {100 * off[worst]:.0f} % of a period off"
            f" a uniform clock, expected at most {100 * UNEVEN:.0f} %: resample the recording first"
        )
    return float((len(time) - 1) / (time[-1] - time[0]))


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
        raise Problem(f"{recording.source}: expected a rate above 0 and two or more samples, got {found}")
    old = 1 / period(time)
    duration = time[-1] - time[0]
    clock = time[0] + np.arange(1 + int(duration * rate * (1 + 1e-12) + 1e-9)) / rate
    longest = MISSED / old if bridge is None else bridge
    down = rate < old * (1 - 1e-6)
    signals, sensors = {}, dict(recording.sensors)
    for name, values in recording.signals.items():
        if down and name not in hold:
            finer = np.linspace(time[0], time[-1], 1 + round(duration * old))
            usable = np.where(good(recording, name), values, np.nan)
            filtered = _filtered(_interpolated(finer, time, usable, longest), rate / old)
            signals[name] = _interpolated(clock, finer, filtered, longest)
            if name in sensors:
                sensors[name] = _quieter(sensors[name], rate / old)
        else:
            signals[name] = _interpolated(clock, time, values, longest, name in hold)
    return replace(recording, time=clock, signals=signals, sensors=sensors)


def _interpolated(clock: Array, time: Array, values: Array, longest: float, hold: bool = False) -> Array:
    """A signal at other times, linear or the sample before; NaN next to a gap and in too long an interval."""
    rounding = ROUNDING * period(time)  # a new sample that close to an old one has its value
    if hold:
        before = np.searchsorted(time, clock + rounding, side="right") - 1
        result = values[np.clip(before, 0, len(time) - 1)]
    else:
        result = np.interp(np.clip(clock, time[0], time[-1]), time, values)
    after = np.clip(np.searchsorted(time, clock), 1, len(time) - 1)
    inside = (clock > time[after - 1] + rounding) & (clock < time[after] - rounding)
    return np.where(inside & (time[after] - time[after - 1] > longest), np.nan, result)


def _filtered(values: Array, ratio: float) -> Array:
    """Each stretch without a gap through a Butterworth filter, forwards and back."""
    sections = scipy.signal.butter(ORDER, CUTOFF * ratio, output="sos")
    result = np.full_like(values, np.nan)
    for part in true_intervals(np.isfinite(values)):
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
