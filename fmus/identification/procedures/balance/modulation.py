"""An equation dh/dt = f between measured signals, filtered so that nothing has to be differentiated twice.

Multiply by a smooth bump phi of compact support and integrate by parts (Shinbrot 1957, modulating functions):

    int phi'(t - s) h(s) ds = int phi(t - s) f(s) ds        at every t

the same filter on both sides, and the acceleration is never formed. h and f are functions of angles, speeds
and pressures that one and the same Savitzky-Golay filter has smoothed before, the speeds being its
derivative. All of it is linear in the sensors' noise, so a noise of the equation goes back to a noise of each
sample by the transposed filters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.recordings.derivatives import SavitzkyGolay

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMOOTHING = 0.06  # s, length of the polynomials: flat up to 15 Hz, far above the modes of the arm
ORDER = 4
WINDOW = 0.3  # s, length of the bump


@dataclass(frozen=True)
class Filters:
    """Kernels, each of odd length, in the order of convolution.

    step           between two smoothed samples [s]: of those of the clock, each `every`-th is kept
    smooth, rate   Savitzky-Golay value and derivative, over the clock
    bump, slope    phi dt, of sum one, and phi' dt, of first moment one, over the smoothed samples
    """

    step: float
    every: int
    smooth: Array
    rate: Array
    bump: Array
    slope: Array

    @property
    def loss(self) -> int:
        """Samples of the clock without a result at each end."""
        return self.smooth.size // 2 + self.bump.size // 2 * self.every

    def gain(self, outer: Array) -> float:
        """Standard deviation of a speed, filtered by `outer`, over that of one sample of the angle [1/s]."""
        return float(np.linalg.norm(np.convolve(self.rate, stuffed(outer, self.every))))

    def smoothed(self, rows: Array) -> Array:
        """Values of signals (k, n), where the kernel lies within them."""
        return apply(self.smooth, rows)[:, :: self.every]

    def slopes(self, rows: Array) -> Array:
        """Their derivatives."""
        return apply(self.rate, rows)[:, :: self.every]

    def unsmoothed(self, values: Array, slopes: Array | None = None) -> Array:
        """The transpose of both together: gradients by smoothed values to gradients by samples."""
        back = transposed(self.smooth, stuffed(values, self.every))
        return back if slopes is None else back + transposed(self.rate, stuffed(slopes, self.every))


def filters(rate: float, smoothing: float = SMOOTHING, window: float = WINDOW, every: int = 1) -> Filters:
    """The kernels for `rate` samples per second; lengths [s], or what a slow clock allows."""
    inner = SavitzkyGolay(rate, max(smoothing, (ORDER + 2) / rate), ORDER)
    step, half = every / rate, max(round(window * rate / every / 2), 2)
    s = np.arange(-half, half + 1) / (half + 1)
    bump = (1 - s**2) ** 4  # three continuous derivatives: its sums are as good as integrals
    slope = -8 * s * (1 - s**2) ** 3
    moment = float(np.sum(slope * -np.arange(-half, half + 1))) * step
    smooth, slopes = (inner.weights[order][::-1] for order in (0, 1))
    return Filters(step, every, smooth, slopes, bump / bump.sum(), slope / moment)


def apply(kernel: Array, rows: Array) -> Array:
    """Each row (k, n) through a filter, only where the kernel lies within it."""
    return np.array([np.convolve(row, kernel, "valid") for row in rows])


def transposed(kernel: Array, rows: Array) -> Array:
    """The transpose of `apply`."""
    return np.array([np.convolve(row, kernel[::-1], "full") for row in rows])


def stuffed(rows: Array, every: int) -> Array:
    """With zeros between the samples, the transpose of keeping each `every`-th of (n - 1) every + 1."""
    found = np.zeros((*rows.shape[:-1], (rows.shape[-1] - 1) * every + 1))
    found[..., ::every] = rows
    return found


def spread(bad: Mask, width: int) -> Mask:
    """True where a kernel of `width` samples has only good samples, shape (n - width + 1,)."""
    return np.convolve(bad, np.ones(width), "valid") < 0.5
