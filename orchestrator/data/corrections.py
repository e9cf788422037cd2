"""Corrects what loggers do to samples: other clocks, held samples, delays, wraps of angles, error codes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DENSE = 1.5  # periods of a clock; samples that are closer have no gap in between
ROUNDING = 1e-6  # of times, in periods


def at_times(clock: Array, time: Array, values: Array) -> Array:
    """A signal that was sampled at its own times, on another clock; linear between two samples.

    Where its samples are farther apart than those of the clock, each is at the nearest time, and gaps follow.
    """
    if np.array_equal(clock, time):
        return values
    used = np.isfinite(values) & (np.diff(np.maximum.accumulate(time), prepend=-np.inf) > 0)
    time, values = time[used], values[used]
    if not time.size:
        return np.full(len(clock), np.nan)
    last = len(time) - 1
    next_one = np.clip(np.searchsorted(time, clock), min(1, last), last)
    before, after = time[np.maximum(next_one - 1, 0)], time[next_one]
    period = float(np.median(np.diff(clock)))
    inside = (clock >= time[0] - ROUNDING * period) & (clock <= time[-1] + ROUNDING * period)
    near = inside & (np.minimum(np.abs(clock - before), np.abs(clock - after)) <= period / 2 * (1 + ROUNDING))
    dense = inside & (after - before <= DENSE * period)
    return np.where(near | dense, np.interp(clock, time, values), np.nan)
