"""Commands over time: levels that are held, straight lines between them, all corners on the 200 Hz grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fmus.scenarios import RATE

Array = NDArray[np.float64]


def levels(values: Sequence[float], hold: float, ramp: float, rest: float = 1.0) -> tuple[Array, Array]:
    """Time and values, shape (n,): the first level for `rest` [s], then each next one for `hold` [s].

    The `ramp` [s] towards a level is the beginning of its hold.
    """
    starts = rest + hold * np.arange(len(values) - 1)
    corners = np.concatenate([[0.0], np.column_stack([starts, starts + ramp]).ravel(), [starts[-1] + hold]])
    held = np.repeat(np.asarray(values, dtype=float), 2)
    time = np.arange(round(corners[-1] * RATE) + 1) / RATE
    return time, np.interp(time, corners, held)


def up_and_down(steps: Sequence[float]) -> list[float]:
    """Zero, the steps upwards, and down again to zero."""
    up = [0.0, *steps]
    return up + up[-2::-1]
