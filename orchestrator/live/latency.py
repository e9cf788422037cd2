"""Latencies in bins, so that a session of any length takes the same memory."""

from __future__ import annotations

from math import log

import numpy as np
from numpy.typing import NDArray

LEAST, MOST, RATIO = 1e-6, 100.0, 1.02  # [s], [s], from bin to bin
BINS = int(log(MOST / LEAST) / log(RATIO)) + 2


def bin_of(latency: float) -> int:
    """The bin of a latency [s]."""
    return min(max(int(log(max(latency, LEAST) / LEAST) / log(RATIO)), 0), BINS - 1)


def quantile(bins: NDArray[np.int64], share: float) -> float:
    """The latency [s] that a share of them does not exceed, to 1 %; 0 without any."""
    total = np.cumsum(bins)
    if total[-1] == 0:
        return 0.0
    found = int(np.searchsorted(total, share * total[-1]))
    return float(LEAST * RATIO ** (found + 0.5))
