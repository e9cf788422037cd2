"""Derivatives of sampled signals.

They come from the filter of Savitzky and Golay, Analytical Chemistry 36 (1964). A polynomial is fitted
to the samples of a window by least squares; its value, slope and curvature in the middle are the filtered
signal and its derivatives. All signals of an equation have to pass the same filter. The filter adds no delay,
because its window is symmetric.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.signal

from fmus.identification.recordings.clock import uniform_rate
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

MAX_ORDER = 2  # highest order of a derivative


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
