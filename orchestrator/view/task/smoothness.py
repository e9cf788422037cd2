"""Smoothness of a movement: the arc length of the spectrum of its speed, negative.

    S = - int_0^w sqrt((1 / w)^2 + (dV / dw)^2) dw,   V(f) = |FFT v(f)| / |FFT v(0)|

up to w: at most 10 Hz, and where V stays below 0.05. One bell-shaped movement has about -1.4 to -1.6; each
further start and stop makes it more negative. It depends neither on the size of the movement nor, closely, on
its duration. Balasubramanian, Melendez-Calderon, Roby-Brami, Burdet, J. NeuroEng. Rehabil. 12:112, 2015.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HIGHEST = 10.0  # Hz
SMALLEST = 0.05  # of the spectrum at zero frequency
RATE = 50.0  # Hz, of the samples that the spectrum is taken from
PADDING = 4  # powers of two beyond the length, so that the arc has no corners


def spectral_arc_length(time: NDArray[np.float64], speed: NDArray[np.float64]) -> float | None:
    """Spectral arc length [1] of a speed over time; None where nothing moves or there is too little."""
    if len(time) < 2 or time[-1] - time[0] < 5 / RATE:
        return None
    even = np.interp(np.arange(time[0], time[-1], 1 / RATE), time, speed)
    size = 2 ** (int(np.ceil(np.log2(len(even)))) + PADDING)
    spectrum = np.abs(np.fft.rfft(even, size))
    if not spectrum[0] > 0:
        return None
    heights = (spectrum / spectrum[0])[np.fft.rfftfreq(size, 1 / RATE) <= HIGHEST]
    last = int(np.flatnonzero(heights >= SMALLEST)[-1])
    if last == 0:
        return None
    return float(-np.sum(np.hypot(1 / last, np.diff(heights[: last + 1]))))
