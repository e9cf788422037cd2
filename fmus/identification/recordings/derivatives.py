"""Derivatives of sampled signals by one filter for all: Savitzky and Golay, Analytical Chemistry 36 (1964).

A polynomial is fitted to the samples of a window by least squares; its value, slope and curvature in the
middle are the filtered signal and its derivatives. Filter all signals of an equation with the same object,
then both sides see the same filter. There is no delay: the window lies symmetrically about its sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.signal

from fmus.contract import ModelError
from fmus.identification.recordings.recording import Array, Recording
from fmus.identification.recordings.resampling import uniform_rate

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
            raise ModelError(
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
