"""Derivatives of sampled signals, and delays between them.

Derivatives come from one filter for all signals: Savitzky and Golay, Analytical Chemistry 36 (1964). A
polynomial is fitted to the samples of a window by least squares; its value, slope and curvature in the
middle are the filtered signal and its derivatives. Filter all signals of an equation with the same object,
then both sides see the same filter. It adds no delay: the window lies symmetrically about its sample.

`delay` measures how much later one signal is than another, `shift` moves a signal in time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import scipy.interpolate
import scipy.optimize
import scipy.signal

from fmus.identification.recordings.clock import ROUNDING, period, uniform_rate
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording, true_intervals
from orchestrator.data.table import Array

HIGHEST = 2  # order of derivative


class Derivatives(NamedTuple):
    """Filtered value and derivatives by time, each of shape (n,), and their standard deviations.

    The standard deviations are those that white noise of the sensor leaves: gain of the filter * sensor.sd.
    """

    value: Array
    first: Array
    second: Array
    sd_value: float
    sd_first: float
    sd_second: float


@dataclass(frozen=True)
class SavitzkyGolay:
    """A filter for one clock.

    rate     samples per second [Hz]
    window   length [s]; it becomes an odd number of samples
    degree   of the polynomial
    """

    rate: float
    window: float
    degree: int = 3

    def __post_init__(self) -> None:
        if self.degree < HIGHEST or self.size <= self.degree:
            raise Problem(
                f"filter: window of {self.window:g} s at {self.rate:g} Hz is {self.size} samples,"
                f" expected more than the degree {self.degree}, and a degree of {HIGHEST} or more"
            )

    @property
    def size(self) -> int:
        """Samples of the window."""
        return 2 * round(self.window * self.rate / 2) + 1

    @cached_property
    def weights(self) -> Array:
        """Weights of the samples of the window, earliest first, shape (3, size): value, slope, curvature."""
        rows = [
            scipy.signal.savgol_coeffs(self.size, self.degree, order, 1 / self.rate, use="dot")
            for order in range(HIGHEST + 1)
        ]
        return np.array(rows)

    def apply(self, values: Array, order: int = 0) -> Array:
        """The filtered signal or its derivative; NaN where the window is not full or has a gap."""
        result = np.full(len(values), np.nan)
        if len(values) >= self.size:
            half = self.size // 2
            result[half : len(values) - half] = np.correlate(values, self.weights[order], mode="valid")
        return result

    def gain(self, order: int = 0) -> float:
        """Standard deviation after the filter over that of white noise before it [1/s^order]."""
        return float(np.sqrt(self.covariance(order, order)))

    def covariance(self, one: int, other: int, lag: int = 0) -> float:
        """Covariance of two orders of the same filtered white noise of variance 1.

        lag   samples by which `other` is taken later
        """
        a, b = self.weights[one], self.weights[other]
        if abs(lag) >= self.size:
            return 0.0
        # sample j of the window of one is sample j - lag of the window of the other
        return float(a[lag:] @ b[: self.size - lag] if lag >= 0 else a[:lag] @ b[-lag:])


def filter_for(recording: Recording, window: float, degree: int = 3) -> SavitzkyGolay:
    """The filter for the clock of a recording, which must be uniform."""
    return SavitzkyGolay(uniform_rate(recording), window, degree)


def derivatives(recording: Recording, name: str, window: float, degree: int = 3) -> Derivatives:
    """Filtered value, first and second derivative of a signal; `window` [s], the same for all signals."""
    used = filter_for(recording, window, degree)
    value, first, second = (used.apply(recording[name], order) for order in range(HIGHEST + 1))
    sd = recording.sensor(name).sd
    return Derivatives(value, first, second, sd * used.gain(0), sd * used.gain(1), sd * used.gain(2))


Kind = Literal["cubic", "linear", "previous"]
NEAR = 3  # samples next to a gap where a spline through it is not used


@dataclass(frozen=True)
class Delay:
    """How much later one signal is than another.

    seconds       the delay
    sd            its standard deviation, if what remains is white
    correlation   of the two signals with the delay taken out
    """

    seconds: float
    sd: float
    correlation: float


def delay(recording: Recording, first: str, second: str, longest: float) -> Delay:
    """How much later `second` is than `first`, between -longest and longest [s].

    The whole samples come from the cross-correlation, the rest from least squares: second(t) =
    gain first(t - delay) + offset, with a spline through `first`. Signals of opposite sign: negate one.
    """
    rate = uniform_rate(recording)
    x, y = recording[first], recording[second]
    most = min(int(np.ceil(longest * rate)), len(x) // 2)
    if most < 1 or not (np.nanstd(x) > 0 and np.nanstd(y) > 0):
        raise Problem(
            f"{recording.source}: no delay of {second} behind {first}: expected signals that move"
            f" and a longest delay of one sample or more, found {longest:g} s"
        )
    whole = _whole(x, y, most)
    spline, usable = _spline(x)

    def cost(samples: float) -> float:
        return _residual(spline, usable, y, samples)[0]

    found = scipy.optimize.minimize_scalar(
        cost, bounds=(whole - 1, whole + 1), method="bounded", options={"xatol": 1e-6}
    )
    variance, slopes, correlation = _residual(spline, usable, y, float(found.x))
    sd = float(np.sqrt(variance / slopes)) if slopes > 0 else float("inf")
    return Delay(float(found.x) / rate, sd / rate, correlation)


def _whole(x: Array, y: Array, most: int) -> int:
    """Samples by which y is later, at the peak of the correlation coefficient of what is there of both."""
    here, there = np.isfinite(x), np.isfinite(y)
    a, b = np.where(here, x - np.nanmean(x), 0.0), np.where(there, y - np.nanmean(y), 0.0)

    def sums(p: Array, q: Array) -> Array:
        products: Array = scipy.signal.correlate(q, p, method="fft")
        return products

    # the energy of each signal where the other one is there, too
    energy = sums(a**2, there.astype(float)) * sums(here.astype(float), b**2)
    floor = 1e-9 * float(np.sum(a**2) * np.sum(b**2))
    coefficient = sums(a, b) / np.sqrt(np.maximum(energy, floor))
    lags = scipy.signal.correlation_lags(len(y), len(x))
    near = np.abs(lags) <= most
    return int(lags[near][np.argmax(coefficient[near])])


def _spline(values: Array) -> tuple[scipy.interpolate.CubicSpline, Mask]:
    """A spline through the samples that are there, and where it can be used: away from gaps."""
    there = np.isfinite(values)
    number = np.arange(len(values))
    usable = np.zeros(len(values), dtype=bool)
    for part in true_intervals(there):
        low = part.start + (NEAR if part.start > 0 else 0)
        high = part.stop - (NEAR if part.stop < len(values) else 0)
        usable[low : max(low, high)] = True  # a short stretch at the beginning has none
    return scipy.interpolate.CubicSpline(number[there], values[there]), usable


def _residual(
    spline: scipy.interpolate.CubicSpline, usable: Mask, y: Array, samples: float
) -> tuple[float, float, float]:
    """Variance of what the moved first signal leaves, sum of its squared slopes, correlation."""
    at = np.arange(len(y)) - samples
    low, high = np.floor(at).astype(int), np.ceil(at).astype(int)
    kept = np.isfinite(y) & (low >= 0) & (high < len(usable))
    kept[kept] = usable[low[kept]] & usable[high[kept]]
    moved = spline(at[kept])
    gain, offset = np.polyfit(moved, y[kept], 1)
    variance = float(np.mean((y[kept] - gain * moved - offset) ** 2))
    slopes = float(np.sum((gain * spline(at[kept], 1)) ** 2))
    return variance, slopes, float(np.corrcoef(moved, y[kept])[0, 1])


def shift(recording: Recording, name: str, seconds: float, kind: Kind = "cubic") -> Recording:
    """The recording with one signal earlier by `seconds`, so that its delay is gone.

    kind   how it is read between samples: "cubic", "linear", or "previous" for a command that is held.
           Samples that come from outside the recording or next to a gap are gaps.
    """
    time, values = recording.time, recording[name]
    at = time + seconds
    result = np.full_like(values, np.nan)
    slack = 1e-9 * period(time)
    for part in true_intervals(np.isfinite(values)):
        if part.stop - part.start < 2:
            continue
        first, last = time[part.start], time[part.stop - 1]
        inside = (at >= first - slack) & (at <= last + slack)
        result[inside] = _between(time[part], values[part], np.clip(at[inside], first, last), kind)
    return replace(recording, signals={**recording.signals, name: result})


def _between(time: Array, values: Array, at: Array, kind: Kind) -> Array:
    """The values between samples."""
    if kind == "previous":
        # a stamp that is early by rounding still counts as the sample's own
        previous = np.searchsorted(time, at + ROUNDING * period(time), side="right") - 1
        return np.asarray(values[previous])
    if kind == "linear" or len(time) < 4:
        return np.interp(at, time, values)
    return np.asarray(scipy.interpolate.CubicSpline(time, values)(at))
