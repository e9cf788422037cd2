"""Measured inputs without their noise, and slopes: local parabolas [Savitzky and Golay 1964].

Noise of an input shakes the model, and what that does to the outputs looks like dynamics. So an input is
smoothed over as long a window as its sensor allows: what is taken off has to be no more than its noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

Array = NDArray[np.float64]

_FEWEST = 5  # samples of a window
_CHUNK = 1.0  # s over which what is taken off is compared with the noise
_DOUBT = 3.0  # standard deviations of a mean square that are still called chance


def smoothed(time: Array, signal: Array, longest: float, noise: float) -> tuple[Array, int]:
    """A signal without its noise, and the samples of the window it took, 1 if none would do.

    longest   window to try first [s], then half of it, and so on
    noise     standard deviation of a sample; if it is zero nothing is taken off
    """
    count = samples(time, longest)
    while count >= _FEWEST:
        smooth = parabolas(signal, count)
        if _noise_only(time, signal - smooth, noise):
            return smooth, count
        count = count // 2 - 1 + (count // 2) % 2
    return signal, 1


def parabolas(signal: Array, count: int) -> Array:
    """Local parabolas over so many samples."""
    return np.asarray(savgol_filter(signal, count, 2)) if count >= _FEWEST else signal


def _noise_only(time: Array, taken: Array, noise: float) -> bool:
    """Is what was taken off no larger than noise, on the whole and in each second?"""
    size = max(1, samples(time, _CHUNK))
    parts = max(1, len(taken) // size)
    squares = np.resize(taken, (parts, min(size, len(taken)))) ** 2
    # a mean of n squares of normal numbers has the relative standard deviation sqrt(2 / n)
    whole = noise**2 * (1 + _DOUBT * np.sqrt(2 / squares.size))
    part = noise**2 * (1 + (_DOUBT + 1) * np.sqrt(2 / squares.shape[1]))
    return bool(squares.mean() <= whole and squares.mean(axis=1).max() <= part)


def derivative(time: Array, signal: Array, window: float) -> Array:
    """Slope of local parabolas over `window` [s]."""
    step = float(np.median(np.diff(time)))
    return np.asarray(savgol_filter(signal, max(3, samples(time, window)), 2, deriv=1, delta=step))


def samples(time: Array, window: float) -> int:
    """Odd number of samples in a window, no more than there are."""
    count = min(round(window / float(np.median(np.diff(time)))), len(time) - 1)
    return count - 1 + count % 2
