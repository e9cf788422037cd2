"""Measures of the samples of one signal: whether it moves, its range, its root mean square."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CONSTANT = 1e-9  # range over magnitude of a constant signal: rounding of the digits in a CSV file
CONSTANT_OF_NOMINAL = 1e-6  # the same over a nominal value
TINY = 1e-150  # magnitudes whose squares leave the range of a float count as zero


def moves(signal: Array, recording: Array | None = None) -> bool:
    """Whether a signal, possibly a part of a recording, varies beyond the rounding of a text file."""
    magnitude = float(np.max(np.abs(signal if recording is None else recording)))
    return not np.ptp(signal) <= max(TINY, CONSTANT * magnitude)


def span(signal: Array) -> float:
    """The range of a signal; 0 if it does not move."""
    return float(np.ptp(signal)) if moves(signal) else 0.0


def rms(values: Array) -> float:
    """Root mean square; 0 without values."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0
