"""How much each output counts, as its residuals show: the model's own error, memory, where outliers begin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from fmus.identification.refinement import loss as losses
from fmus.identification.refinement.loss import Loss

Array = NDArray[np.float64]

_LONGEST = 0.05  # of the samples: memory beyond that is a trend


@dataclass(frozen=True)
class Scales:
    """Per output.

    floor    standard deviation of the model's own error, in those of the sensor, 0 for none
    memory   over how many samples a residual lasts: so many count as one
    tuning   where outliers begin, in standard deviations of sensor and model together
    """

    floor: Array
    memory: Array
    tuning: Array

    @classmethod
    def sensors(cls, outputs: int) -> Scales:
        """A model without errors."""
        return cls(np.zeros(outputs), np.ones(outputs), np.full(outputs, losses.TUNING))

    def factor(self, residual: Array, column: NDArray[np.int64], loss: Loss) -> Array:
        """What residuals and their Jacobian are multiplied with; `column` is the output of each."""
        shrunk = 1 / np.hypot(1.0, self.floor[column])
        weight = losses.weights(residual * shrunk, self.tuning[column], loss)
        return np.asarray(shrunk * weight / np.sqrt(self.memory[column]))

    def change(self, other: Scales) -> float:
        """Largest relative difference."""
        mine, others = (
            np.concatenate([np.hypot(1.0, s.floor), np.sqrt(s.memory), s.tuning]) for s in (self, other)
        )
        return float(np.max(np.abs(others / mine - 1)))


def seen(residuals: list[Array], model_error: bool, memory: bool) -> Scales:
    """The scales that the residuals of each output show, in the order of time."""
    floor = np.zeros(len(residuals))
    if model_error:
        power = np.array([np.mean(part**2) if part.size else 0.0 for part in residuals])
        floor = np.sqrt(np.maximum(0.0, power - 1))
    tuning = [losses.tuning(part / math.hypot(1, f)) for part, f in zip(residuals, floor, strict=True)]
    lasting = [correlation_time(part) if memory else 1.0 for part in residuals]
    return Scales(floor, np.array(lasting), np.array(tuning))


def correlation_time(residual: Array) -> float:
    """Samples over which a residual lasts: 1 + 2 sum of its autocorrelation, at least 1.

    Summed over pairs of lags as long as a pair is positive [Geyer 1992, section 3.3]; at most a share of
    the samples, because a longer memory cannot be seen in them.
    """
    n = len(residual)
    power = float(residual @ residual)
    if n < 4 or not power > 0:
        return 1.0
    own = correlate(residual, residual, method="fft")[n - 1 :] / power
    pairs = own[: 2 * (n // 2)].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    lasting = 2 * float(pairs[: ends[0] if len(ends) else None].sum()) - 1
    return min(max(1.0, lasting), max(1.0, _LONGEST * n))
