"""Robust losses as weights: a residual beyond `tuning` pulls less than its square would.

Iteratively reweighted least squares; the residuals are in standard deviations. 95 % efficiency on normal
noise at 1.345 for Huber's loss [Holland and Welsch 1977], and nearly that for the smooth one.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Loss = Literal["linear", "huber", "soft_l1"]

TUNING = 1.345
_TO_SD = 1.4826  # standard deviation over median magnitude of a normal variable


def weights(residual: Array, tuning: Array, loss: Loss) -> Array:
    """Factors of residuals and their Jacobian: square roots of the weights, in (0, 1]."""
    if loss == "linear":
        return np.ones_like(residual)
    ratio = np.abs(residual) / tuning
    if loss == "huber":
        return 1 / np.sqrt(np.maximum(ratio, 1.0))
    return (1 + ratio**2) ** -0.25


def tuning(residual: Array) -> float:
    """Where outliers begin, for residuals of one output: never below that of noise as the sensor has it.

    Far from the optimum all residuals are large; they are not outliers then.
    """
    magnitude = float(np.median(np.abs(residual))) if residual.size else 0.0
    return TUNING * max(1.0, _TO_SD * magnitude)
