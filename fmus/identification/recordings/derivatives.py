"""Derivatives of sampled signals, and delays between signals.

Derivatives come from the filter of Savitzky and Golay, Analytical Chemistry 36 (1964). A polynomial is fitted
to the samples of a window by least squares; its value, slope and curvature in the middle are the filtered
signal and its derivatives. All signals of an equation have to pass the same filter. The filter adds no delay,
because its window is symmetric.

`delay` estimates the delay between two signals, `shift` removes it.
"""

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

MAX_ORDER = 2  # highest order of a derivative


class Derivatives(NamedTuple):
    """Filtered value and time derivatives, each of shape (n,), and their standard deviations.

    The standard deviations are those of white noise after the filter: gain * sensor.sd.
    """

    value: Array
    first: Array
    second: Array
    sd_value: float
    sd_first: float
    sd_second: float


@dataclass(frozen=True)
class SavitzkyGolay:
    """A Savitzky-Golay filter for a uniform clock.

    rate     samples per second [Hz]
    window   length of the window [s], rounded to an odd number of samples
    degree   degree of the polynomial
    """

    rate: float
    window: float
    degree: int = 3

    def __post_init__(self) -> None:
        if self.degree < MAX_ORDER or self.size <= self.degree:
            raise Problem(
                f"filter: window of {self.window:g} s at {self.rate:g} Hz is {self.size} samples;"
                f" expected {MAX_ORDER} <= degree < samples, got degree {self.degree}"
            )

    @property
    def size(self) -> int:
        """Number of samples in the window."""
        return 2 * round(self.window * self.rate / 2) + 1

    @cached_property
    def weights(self) -> Array:
        """Weights of the samples of the window, earliest first, shape (3, size): value, slope, curvature."""
        rows = [
            scipy.signal.savgol_coeffs(self.size, self.degree, order, 1 / self.rate, use="dot")
            for order in range(MAX_ORDER + 1)
        ]
        return np.array(rows)

    def apply(self, values: Array, order: int = 0) -> Array:
        """The filtered signal or its derivative; NaN if the window is incomplete or contains a gap."""
        result = np.full(len(values), np.nan)
        if len(values) >= self.size:
            half = self.size // 2
            result[half : len(values) - half] = np.correlate(values, self.weights[order], mode="valid")
        return result

    def gain(self, order: int = 0) -> float:
        """Standard deviation of white noise after the filter over that before it [1/s^order]."""
        return float(np.sqrt(self.covariance(order, order)))

    def covariance(self, first: int, second: int, lag: int = 0) -> float:
        """Covariance of derivatives of two orders of the same white noise of variance 1.

        lag   number of samples by which the derivative of order `second` is later
        """
        a, b = self.weights[first], self.weights[second]
        if abs(lag) >= self.size:
            return 0.0
        # sample j of the first window is sample j - lag of the second window
        return float(a[lag:] @ b[: self.size - lag] if lag >= 0 else a[:lag] @ b[-lag:])


def filter_for(recording: Recording, window: float, degree: int = 3) -> SavitzkyGolay:
    """The filter for the clock of a recording; the clock must be uniform."""
    return SavitzkyGolay(uniform_rate(recording), window, degree)


def derivatives(recording: Recording, name: str, window: float, degree: int = 3) -> Derivatives:
    """Filtered value, first and second derivative of a signal; `window` in s."""
    savitzky_golay = filter_for(recording, window, degree)
    value, first, second = (savitzky_golay.apply(recording[name], order) for order in range(MAX_ORDER + 1))
    sds = (recording.sensor(name).sd * savitzky_golay.gain(order) for order in range(MAX_ORDER + 1))
    return Derivatives(value, first, second, *sds)


Interpolation = Literal["cubic", "linear", "previous"]
MARGIN = 3  # samples next to a gap at which a spline is not used


@dataclass(frozen=True)
class Delay:
    """The delay of one signal behind another.

    seconds       the delay [s]
    sd            its standard deviation [s], if the residual is white
    correlation   correlation of the two signals without the delay
    """

    seconds: float
    sd: float
    correlation: float


def delay(recording: Recording, first: str, second: str, longest: float) -> Delay:
    """The delay of `second` behind `first`, between -longest and longest [s].

    The delay in whole samples comes from the cross-correlation. Least squares refine it: second(t) =
    gain first(t - delay) + offset, with a spline through `first`. Of signals with opposite sign, negate one.
    """
    rate = uniform_rate(recording)
    x, y = recording[first], recording[second]
    most = min(int(np.ceil(longest * rate)), len(x) // 2)
    if most < 1 or not (np.nanstd(x) > 0 and np.nanstd(y) > 0):
        raise Problem(
            f"{recording.source}: delay of {second} behind {first}: expected signals that vary"
            f" and a longest delay of one sample or more, got {longest:g} s"
        )
    lag = _lag(x, y, most)
    spline, usable = _spline(x)

    def cost(samples: float) -> float:
        return _residual(spline, usable, y, samples)[0]

    optimum = scipy.optimize.minimize_scalar(
        cost, bounds=(lag - 1, lag + 1), method="bounded", options={"xatol": 1e-6}
    )
    variance, information, correlation = _residual(spline, usable, y, float(optimum.x))
    sd = float(np.sqrt(variance / information)) if information > 0 else float("inf")
    return Delay(float(optimum.x) / rate, sd / rate, correlation)


def _lag(x: Array, y: Array, most: int) -> int:
    """Number of samples by which y is later: the lag with the largest correlation coefficient."""
    x_finite, y_finite = np.isfinite(x), np.isfinite(y)
    a, b = np.where(x_finite, x - np.nanmean(x), 0.0), np.where(y_finite, y - np.nanmean(y), 0.0)

    def sums(p: Array, q: Array) -> Array:
        products: Array = scipy.signal.correlate(q, p, method="fft")
        return products

    # the energy of each signal at the samples that the other one has, too
    energy = sums(a**2, y_finite.astype(float)) * sums(x_finite.astype(float), b**2)
    floor = 1e-9 * float(np.sum(a**2) * np.sum(b**2))
    coefficient = sums(a, b) / np.sqrt(np.maximum(energy, floor))
    lags = scipy.signal.correlation_lags(len(y), len(x))
    near = np.abs(lags) <= most
    return int(lags[near][np.argmax(coefficient[near])])


def _spline(values: Array) -> tuple[scipy.interpolate.CubicSpline, Mask]:
    """A spline through the finite samples, and the mask of the samples at which it is valid."""
    finite = np.isfinite(values)
    index = np.arange(len(values))
    usable = np.zeros(len(values), dtype=bool)
    for part in true_intervals(finite):
        low = part.start + (MARGIN if part.start > 0 else 0)
        high = part.stop - (MARGIN if part.stop < len(values) else 0)
        usable[low : max(low, high)] = True  # an interval may be shorter than its margins
    return scipy.interpolate.CubicSpline(index[finite], values[finite]), usable


def _residual(
    spline: scipy.interpolate.CubicSpline, usable: Mask, y: Array, samples: float
) -> tuple[float, float, float]:
    """For a delay in samples: variance of the residual, sum of squared derivatives, correlation."""
    at = np.arange(len(y)) - samples
    low, high = np.floor(at).astype(int), np.ceil(at).astype(int)
    valid = np.isfinite(y) & (low >= 0) & (high < len(usable))
    valid[valid] = usable[low[valid]] & usable[high[valid]]
    delayed = spline(at[valid])
    gain, offset = np.polyfit(delayed, y[valid], 1)
    variance = float(np.mean((y[valid] - gain * delayed - offset) ** 2))
    information = float(np.sum((gain * spline(at[valid], 1)) ** 2))
    return variance, information, float(np.corrcoef(delayed, y[valid])[0, 1])


def shift(
    recording: Recording, name: str, seconds: float, interpolation: Interpolation = "cubic"
) -> Recording:
    """The recording with one signal moved earlier by `seconds`, which removes its delay.

    interpolation   between samples: "cubic", "linear", or "previous" for a command that is held

    Samples from outside the recording or next to a gap become gaps.
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
        result[inside] = _interpolated(
            time[part], values[part], np.clip(at[inside], first, last), interpolation
        )
    return replace(recording, signals={**recording.signals, name: result})


def _interpolated(time: Array, values: Array, at: Array, interpolation: Interpolation) -> Array:
    """The signal at the times `at`."""
    if interpolation == "previous":
        # a time that is early by rounding still belongs to the sample
        previous = np.searchsorted(time, at + ROUNDING * period(time), side="right") - 1
        return np.asarray(values[previous])
    if interpolation == "linear" or len(time) < 4:
        return np.interp(at, time, values)
    return np.asarray(scipy.interpolate.CubicSpline(time, values)(at))
