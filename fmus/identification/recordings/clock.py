"""Uniform clocks: resampling at the same rate, at a lower one for simulation, at any rate; derivatives.

A missing sample becomes a gap (NaN) of a new clock; it is not interpolated.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fmus.identification.recordings.masks import good, noise
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording, Sensor, true_intervals
from orchestrator.data.table import Array

UNIFORM = 0.05  # periods; largest deviation of a time stamp on a uniform clock; derivatives are sensitive
GAP = 1.5  # periods; in a longer interval a sample is missing
ROUNDING = 1e-6  # periods; rounding of time stamps
CUTOFF = 0.8  # -6 dB of the anti-aliasing filter, over half the new rate, where it has -34 dB
ORDER = 8  # order of the anti-aliasing filter
COUNTABLE = 0.22  # periods of white jitter; with more, single lost samples cannot be told from late ones
LONG = 4.0  # periods; white jitter of up to 0.4 periods makes no interval this long
LATE = 0.65  # periods, from which a stamp is that of the next sample; more than half, as few are lost
PHASE = 0.1  # share of a time stamp's deviation that moves the expected time of the next sample
SLOWER, FASTER = 1.25, 0.8  # of the usual period: how far a clock may drift
MAX_RATE = 500.0  # Hz; ten times the frequency of oil in the longest hose; more only costs simulation time


def period(time: Array) -> float:
    """Sampling period of a clock [s]: the median interval, which missing samples do not change."""
    return float(np.median(np.diff(time)))


def sample_steps(time: Array) -> NDArray[np.int64]:
    """Periods between successive samples of a clock with jitter, drift and lost samples, shape (n - 1,).

    1: the next sample, 2: one is lost, 0: two stamps of one sample. A phase-locked loop follows the clock
    [second order, critically damped]; rounded intervals would count each late stamp as a lost sample. If
    single lost samples cannot be counted, only long intervals have more than one period.
    """
    intervals = np.diff(time)
    usual = every = float(np.median(intervals[intervals < GAP * period(time)]))
    if noise(time) > COUNTABLE * usual:
        return np.where(intervals > LONG * usual, np.round(intervals / usual), 1).astype(np.int64)
    expected, steps = float(time[0]) + every, []
    for stamp in time[1:].tolist():
        off = (stamp - expected) / every
        lost = max(math.ceil(off - LATE), 0) - (off < -LATE)
        late = stamp - expected - lost * every
        every = min(max(every + PHASE**2 / 4 * late, FASTER * usual), SLOWER * usual)
        expected += (1 + lost) * every + PHASE * late
        steps.append(1 + lost)
    found = np.array(steps, dtype=np.int64)
    # a stamp that is far early or late
    pairs = np.flatnonzero((found[:-1] + found[1:] == 2) & (found[:-1] != 1))
    found[pairs] = found[pairs + 1] = 1
    return found


def clock_error(time: Array) -> Array:
    """Deviation of each time stamp from a uniform clock, in periods."""
    step = (time[-1] - time[0]) / (len(time) - 1)
    return np.asarray(np.abs(time - (time[0] + step * np.arange(len(time)))) / step)


def uniform_rate(recording: Recording) -> float:
    """Samples per second [Hz]; raises Problem if the clock is not uniform (see `resample`)."""
    time = recording.time
    if len(time) < 2:
        raise Problem(f"{recording.source}: expected two or more samples, got {len(time)}")
    error = clock_error(time)
    worst = int(np.argmax(error))
    if error[worst] > UNIFORM:
        raise Problem(
            f"{recording.source}: time {time[worst]:g} s is {100 * error[worst]:.0f} % of a period off"
            f" a uniform clock, expected at most {100 * UNIFORM:.0f} %: resample the recording first"
        )
    return float((len(time) - 1) / (time[-1] - time[0]))


def resample_uniformly(recording: Recording) -> Recording:
    """The recording on a uniform clock at the same rate; unchanged if its clock is uniform.

    Commands are interpolated linearly like all signals, as in a simulation. If they were held, half of them
    would be a period late.
    """
    time = recording.time
    if len(time) < 2 or np.max(clock_error(time)) <= UNIFORM:
        return recording
    return resample(recording, 1 / period(time))


def downsample(recording: Recording) -> Recording:
    """The recording at a rate of at most `MAX_RATE`; commands are held, other signals are filtered."""
    if len(recording.time) < 2 or period(recording.time) > 0.99 / MAX_RATE:
        return recording
    commands = [name for name in recording.signals if name.endswith("command")]
    return resample(recording, MAX_RATE, hold=commands)


def resample(recording: Recording, rate: float, hold: Collection[str] = ()) -> Recording:
    """The recording on a uniform clock of `rate` [Hz] that starts with its first sample.

    Signals are interpolated linearly. For a lower rate they pass a zero-phase filter first. Samples that are
    not good (clipped, in the dead zone) then become gaps, because the filter would hide them. The noise of
    the sensor is that after the filter.

    hold   signals that keep their value from sample to sample, such as commands; they are not filtered
    """
    time = recording.time
    if rate <= 0 or len(time) < 2:
        got = f"{rate:g} Hz and {len(time)} samples"
        raise Problem(f"{recording.source}: expected a rate above 0 and two or more samples, got {got}")
    old = 1 / period(time)
    duration = time[-1] - time[0]
    clock = time[0] + np.arange(1 + int(duration * rate * (1 + 1e-12) + 1e-9)) / rate
    lost = (sample_steps(time) > 1) & (np.diff(time) > GAP / old)
    down = rate < old * (1 - 1e-6)
    finer = np.linspace(time[0], time[-1], 1 + round(duration * old))
    signals, sensors = {}, dict(recording.sensors)
    for name, values in recording.signals.items():
        if not down or name in hold:
            signals[name] = _interpolated(clock, time, values, lost, name in hold)
            continue
        usable = np.where(good(recording, name), values, np.nan)
        filtered = _filtered(_interpolated(finer, time, usable, lost), rate / old)
        signals[name] = _interpolated(clock, finer, filtered, np.zeros(len(finer) - 1, dtype=bool))
        if name in sensors:
            sensors[name] = _filtered_sensor(sensors[name], rate / old)
    return replace(recording, time=clock, signals=signals, sensors=sensors)


def _interpolated(clock: Array, time: Array, values: Array, lost: Mask, hold: bool = False) -> Array:
    """A signal at other times, linear or held; NaN next to a gap and in an interval with lost samples."""
    rounding = ROUNDING * period(time)  # a new sample this close to an old one gets its value
    if hold:
        before = np.searchsorted(time, clock + rounding, side="right") - 1
        result = values[np.clip(before, 0, len(time) - 1)]
    else:
        result = np.interp(np.clip(clock, time[0], time[-1]), time, values)
    after = np.clip(np.searchsorted(time, clock), 1, len(time) - 1)
    inside = (clock > time[after - 1] + rounding) & (clock < time[after] - rounding)
    return np.where(inside & lost[after - 1], np.nan, result)


def _filter(ratio: float) -> Array:
    """Second-order sections of the anti-aliasing filter; `ratio` is new over old rate."""
    import scipy.signal

    return np.asarray(scipy.signal.butter(ORDER, CUTOFF * ratio, output="sos"))


def _filtered(values: Array, ratio: float) -> Array:
    """A signal filtered forwards and backwards by a Butterworth filter, in each interval without gaps."""
    import scipy.signal

    sections = _filter(ratio)
    result = np.full_like(values, np.nan)
    for part in true_intervals(np.isfinite(values)):
        # subtracting the line through both ends, which passes the filter unchanged, reduces ringing there
        line = np.linspace(values[part.start], values[part.stop - 1], part.stop - part.start)
        pad = min(int(10 / ratio), len(line) - 1)
        result[part] = line + scipy.signal.sosfiltfilt(sections, values[part] - line, padlen=pad)
    return result


def _filtered_sensor(sensor: Sensor, ratio: float) -> Sensor:
    """The sensor after the filter, which reduces white noise.

    The quantisation error is white only if noise of half a step or more moves the signal from step to step.
    Otherwise all samples that the filter averages may have the same error, and the resolution is kept.
    """
    import scipy.signal

    _, response = scipy.signal.sosfreqz(_filter(ratio), worN=4096)
    # forwards and backwards is |H|^2, so that the power is |H|^4
    gain = float(np.sqrt(np.mean(np.abs(response) ** 4)))
    if sensor.noise < sensor.resolution / 2:
        return replace(sensor, noise=sensor.noise * gain)
    return replace(sensor, noise=sensor.sd * gain, resolution=0.0)


@dataclass(frozen=True)
class SavitzkyGolay:
    """The filter of Savitzky and Golay, Analytical Chemistry 36 (1964), for a uniform clock.

    A polynomial is fitted to the samples of a window; its value, slope and curvature in the middle are the
    filtered signal and its derivatives, without delay. All signals of an equation have to pass one filter.

    rate     samples per second [Hz]
    window   length of the window [s], rounded to an odd number of samples
    degree   degree of the polynomial
    """

    rate: float
    window: float
    degree: int = 3

    def __post_init__(self) -> None:
        if self.size <= self.degree:
            raise Problem(
                f"filter: window of {self.window:g} s at {self.rate:g} Hz is {self.size} samples;"
                f" expected 2 <= degree < samples, got degree {self.degree}"
            )

    @property
    def size(self) -> int:
        """Number of samples in the window."""
        return 2 * round(self.window * self.rate / 2) + 1

    @cached_property
    def weights(self) -> Array:
        """Weights of the samples of the window, earliest first, shape (3, size): value, slope, curvature."""
        import scipy.signal

        step = 1 / self.rate
        return np.array(
            [scipy.signal.savgol_coeffs(self.size, self.degree, n, step, use="dot") for n in range(3)]
        )

    def apply(self, values: Array, order: int = 0) -> Array:
        """The filtered signal or its derivative; NaN if the window is incomplete or contains a gap."""
        if len(values) < self.size:
            return np.full(len(values), np.nan)
        inside = np.correlate(values, self.weights[order], mode="valid")
        return np.pad(inside, self.size // 2, constant_values=np.nan)

    def gain(self, order: int) -> float:
        """Standard deviation of white noise after the filter over that before it [1/s^order]."""
        return float(np.linalg.norm(self.weights[order]))


def filter_for(recording: Recording, window: float, degree: int = 3) -> SavitzkyGolay:
    """The filter for the clock of a recording, which must be uniform; of at least degree + 2 samples."""
    rate = uniform_rate(recording)
    return SavitzkyGolay(rate, max(window, (degree + 1.5) / rate), degree)
