"""Regression on an equation with derivatives that differentiates no noise, with errors in all variables.

Every term of   y = sum_c theta_c x_c   is an integral over a window: of a signal times a bump phi, or, for
the derivative of a signal, times -phi' (modulating functions, Shinbrot 1957):

    int phi x dt        int phi dx/dt dt = -int phi' x dt        phi = (1 - s^2)^4, |s| < 1

The bump has three continuous derivatives, so sums over samples are as good as integrals, and what is faster
than the bump drops out. The residual e = y - X theta is linear in the noise of the sensors, so its covariance
follows from theta; neighbouring windows share samples, so it is banded:

    S(theta) = sum over sensors of sd^2 M(theta) M(theta)'        theta minimises e' S(theta)^-1 e

This is the maximum likelihood of a structured errors-in-variables problem: noise in the columns does not draw
theta to zero as it does in least squares. Reference: I. Markovsky and S. Van Huffel, Overview of total least
squares methods, Signal Processing 87 (2007), section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

Array = NDArray[np.float64]

HOP = 0.5  # of the half width: neighbours overlap, nothing between them is lost
BANDS = 3  # windows after one that share samples with it


def modulating_function(half: int) -> tuple[Array, Array]:
    """phi and -d phi/d(sample) at the 2 half - 1 samples within a window of `half` samples to each side.

    The slope is scaled to be exact for a straight line, also as a sum.
    """
    place = np.arange(1 - half, half)
    s = place / half
    bump, slope = (1 - s**2) ** 4, 8 * s * (1 - s**2) ** 3
    return bump, slope * bump.sum() / (slope @ place)


@dataclass(frozen=True)
class Windows:
    """Windows over the samples of a recording: rows are windows, columns samples.

    bump, slope   phi dt and -phi' dt, sparse, shape (m, n)
    """

    bump: sparse.csr_array
    slope: sparse.csr_array


def windows(parts: Sequence[slice], samples: int, step: float, half_width: float) -> Windows:
    """Windows that lie within the stretches `parts` of good samples, `step` [s] apart; half width [s]."""
    half = max(round(half_width / step), 3)
    bump, slope = modulating_function(half)
    hop = max(round(HOP * half), 1)
    start = np.concatenate(
        [np.arange(p.start, p.stop - bump.size + 1, hop) for p in parts] or [np.zeros(0, dtype=int)]
    )
    columns = (start[:, None] + np.arange(bump.size)).ravel()
    rows = np.repeat(np.arange(start.size), bump.size)

    def matrix(kernel: Array) -> sparse.csr_array:
        return sparse.csr_array((np.tile(kernel, start.size), (rows, columns)), (start.size, samples))

    return Windows(matrix(bump * step), matrix(slope))


@dataclass(frozen=True)
class FilteredEquation:
    """The filtered equation on one recording.

    y, columns   integrals over the windows, shape (m,) each
    noise        for each sensor: its standard deviation and how its noise enters the columns, and y as "y"
    factors      factor of each column from the parameters; by default the parameter of the same name
    """

    windows: Windows
    y: Array
    columns: Mapping[str, Array]
    noise: Sequence[tuple[float, Mapping[str, sparse.csr_array]]]
    factors: Callable[[Mapping[str, float]], Mapping[str, float]] = dict

    @property
    def weight(self) -> Array:
        """Integral of each bump [s]: integrals over it are means."""
        ones: Array = self.windows.bump.sum(axis=1)
        return ones

    def residual(self, theta: Mapping[str, float]) -> Array:
        """y - X theta, not weighted."""
        factor = self.factors(theta)
        left: Array = self.y - sum(factor[name] * column for name, column in self.columns.items())
        return left

    @cached_property
    def _products(self) -> dict[tuple[str, str], Array]:
        """Lower bands of sd^2 (M_a M_b' + M_b M_a')/2, summed over the sensors, for each pair of columns."""
        products: dict[tuple[str, str], Array] = {}
        for sd, maps in self.noise:
            for (a, of_a), (b, of_b) in combinations_with_replacement(maps.items(), 2):
                product = of_a @ of_b.T
                bands = (_lower(product) + _lower(product.T)) * (0.5 if a == b else 1.0) * sd**2
                products[a, b] = products.get((a, b), 0.0) + bands
        return products

    def weighted(self, theta: Mapping[str, float]) -> Array:
        """The residual without correlation and of unit variance."""
        factor = {name: -value for name, value in self.factors(theta).items()} | {"y": 1.0}
        covariance = np.zeros((BANDS + 1, self.y.size))  # lower bands
        for (a, b), bands in self._products.items():
            covariance += factor[a] * factor[b] * bands
        lower = linalg.cholesky_banded(covariance, lower=True)
        white: Array = linalg.solve_banded((BANDS, 0), lower, self.residual(theta))
        return white


def _lower(matrix: sparse.csr_array) -> Array:
    """The diagonal and the `BANDS` below it, as `scipy.linalg` stores them."""
    bands = np.zeros((BANDS + 1, matrix.shape[0]))
    for k in range(BANDS + 1):
        band = matrix.diagonal(-k)
        bands[k, : band.size] = band
    return bands
