"""Does a signal move, and how much; how far is it from another one. NRMSE is `rms` of errors over `span`."""

import numpy as np

from orchestrator.data.table import Array

CONSTANT = 1e-9  # range over magnitude of a constant signal: rounding of the digits in a CSV file
TINY = 1e-150  # magnitudes whose squares leave the range of a float count as zero


def moves(signal: Array, recording: Array | None = None) -> bool:
    """Whether a signal, possibly a part of a recording, varies beyond the rounding of a text file."""
    magnitude = float(np.max(np.abs(signal if recording is None else recording)))
    return not np.ptp(signal) <= max(TINY, CONSTANT * magnitude)


def span(signal: Array) -> float:
    """The range of a signal; 0 if it does not move."""
    return float(np.ptp(signal)) if moves(signal) else 0.0


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
