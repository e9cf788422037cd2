"""Weak form of a linear equation with derivatives: regression without differentiating noise.

Every term of   y = sum_c theta_c x_c   is an integral over a window: of a signal times a bump phi, or, for
the derivative of a signal, times -phi' (modulating functions, Shinbrot 1957):

    int phi x dt        int phi dx/dt dt = -int phi' x dt        phi = (1 - s^2)^4, |s| < 1

The bump has three continuous derivatives, so sums over samples are as accurate as integrals. Changes that are
faster than the bump are filtered out. The residual e = y - X theta is linear in the noise of the sensors, so
its covariance follows from theta. It is banded, because neighbouring windows share samples:

    S(theta) = sum over sensors of sd^2 M(theta) M(theta)'        theta minimises e' S(theta)^-1 e

This is the maximum likelihood estimate of a structured errors-in-variables problem: unlike in least squares,
noise in the regressors does not bias theta towards zero. Reference: I. Markovsky and S. Van Huffel, Overview
of total least squares methods, Signal Processing 87 (2007), section 4.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from scipy import linalg, sparse

from orchestrator.data.table import Array

HOP = 0.5  # distance of neighbouring windows over their half width; they overlap
BANDS = 3  # number of following windows that share samples with a window


def modulating_function(half: int) -> tuple[Array, Array]:
    """phi and -d phi/d(sample) at the 2 half - 1 samples within a window of `half` samples to each side.

    The derivative is scaled so that its sum over a straight line is exact.
    """
    position = np.arange(1 - half, half)
    s = position / half
    bump, slope = (1 - s**2) ** 4, 8 * s * (1 - s**2) ** 3
    return bump, slope * bump.sum() / (slope @ position)


@dataclass(frozen=True)
class Windows:
    """Windows over the samples of a recording; rows are windows, columns are samples.

    bump, slope   phi dt and -phi' dt, sparse, shape (m, n)
    """

    bump: sparse.csr_array
    slope: sparse.csr_array


def windows(stretches: Sequence[slice], samples: int, step: float, half_width: float) -> Windows:
    """Windows within stretches of good samples.

    samples      number of samples in the recording
    step         sample time [s]
    half_width   half the length of a window [s]
    """
    half = max(round(half_width / step), 3)
    bump, slope = modulating_function(half)
    hop = max(round(HOP * half), 1)
    start = np.concatenate(
        [np.arange(p.start, p.stop - bump.size + 1, hop) for p in stretches] or [np.zeros(0, dtype=int)]
    )
    columns = (start[:, None] + np.arange(bump.size)).ravel()
    rows = np.repeat(np.arange(start.size), bump.size)

    def matrix(kernel: Array) -> sparse.csr_array:
        return sparse.csr_array((np.tile(kernel, start.size), (rows, columns)), (start.size, samples))

    return Windows(matrix(bump * step), matrix(slope))


@dataclass(frozen=True)
class FilteredEquation:
    """The filtered equation on one recording.

    y, regressors   integrals over the windows, shape (m,) each
    noise           for each sensor its standard deviation, and the matrices by which its noise enters each
                    regressor and y (as "y")
    factors         factor of each regressor from the parameters
    """

    windows: Windows
    y: Array
    regressors: Mapping[str, Array]
    noise: Sequence[tuple[float, Mapping[str, sparse.csr_array]]]
    factors: Callable[[Mapping[str, float]], Mapping[str, float]]

    @property
    def weight(self) -> Array:
        """Integral of each bump [s]; an integral over the window divided by it is a mean."""
        ones: Array = self.windows.bump.sum(axis=1)
        return ones

    def residual(self, theta: Mapping[str, float]) -> Array:
        """y - X theta, unweighted."""
        factor = self.factors(theta)
        e: Array = self.y - sum(factor[name] * regressor for name, regressor in self.regressors.items())
        return e

    @cached_property
    def _products(self) -> dict[tuple[str, str], Array]:
        """Lower bands of sd^2 (M_a M_b' + M_b M_a')/2, summed over the sensors, by pairs of regressors."""
        products: dict[tuple[str, str], Array] = {}
        for sd, matrices in self.noise:
            for (a, m_a), (b, m_b) in combinations_with_replacement(matrices.items(), 2):
                product = m_a @ m_b.T
                bands = (_lower(product) + _lower(product.T)) * (0.5 if a == b else 1.0) * sd**2
                products[a, b] = products.get((a, b), 0.0) + bands
        return products

    def whitened_residual(self, theta: Mapping[str, float]) -> Array:
        """The residual, transformed by the Cholesky factor of its covariance to white noise of variance 1."""
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
