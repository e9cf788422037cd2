"""Sizes that quantities of a machine usually have: what is far off may be in another unit than told."""

from __future__ import annotations

import math
from collections.abc import Mapping

# SI unit -> what the largest magnitude in a recording lies between
USUAL: Mapping[str, tuple[float, float]] = {
    "Pa": (1e4, 1e8),  # a tenth of a bar; what a hose bursts at
    "m3/s": (0.0, 0.05),  # 3000 L/min; a leakage may be as small as it likes
    "V": (0.1, 100.0),
    "rad": (0.0, 4 * math.pi),  # two turns of the column; what was read as rad may be degrees
    "rad/s": (0.0, 20.0),
}
RATES = (10.0, 1e5)  # Hz: of a logger that follows a valve


def beyond(largest: float, unit: str) -> tuple[float, float] | None:
    """What is usual, if the largest magnitude of a signal is not; a signal that is zero tells nothing."""
    low, high = USUAL.get(unit, (0.0, math.inf))
    return (low, high) if largest > 0 and not low <= largest <= high else None
