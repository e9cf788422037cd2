"""The paper's way to describe C_R(V): a polynomial by plain least squares, for comparison."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import statsmodels.api as sm
from numpy.polynomial import Polynomial as Power
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Polynomial:
    """A polynomial in V, scaled to the range of its points."""

    power: Power

    @property
    def degree(self) -> int:
        """Its degree."""
        return int(self.power.degree())

    def __call__(self, x: Array) -> Array:
        y: Array = self.power(x)
        return y

    def wrong(self, x: Array) -> Mask:
        """Where it cannot be a resistance over the command: negative, or rising."""
        mask: Mask = (self(x) < 0) | (self.power.deriv()(x) > 0)
        return mask


def polynomial(x: Array, y: Array, highest: int = 8) -> Polynomial:
    """Plain least squares; the degree, up to `highest`, has the lowest AIC (residuals of unknown size)."""
    domain = (float(x.min()), float(x.max()))
    scaled = (2 * x - sum(domain)) / (domain[1] - domain[0])
    top = min(highest, np.unique(x).size - 2)
    fits = [sm.OLS(y, np.vander(scaled, n + 1, increasing=True)).fit() for n in range(1, max(top, 1) + 1)]
    best = min(fits, key=lambda fit: fit.aic)
    return Polynomial(Power(best.params, domain=domain, window=(-1.0, 1.0)))
