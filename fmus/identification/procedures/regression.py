"""Regression with known errors: lmfit and statsmodels fit, this hands back estimates with 95 % intervals.

Residuals are divided by their standard deviations, so chi-square is the sum of their squares and the
covariance is (J'J)^-1, not scaled. Only if chi-square says that the model does not fit the data (probability
below `UNLIKELY`) the covariance is multiplied by chi-square per degree of freedom, and `misfit` tells so: the
interval then covers what the model cannot show as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import lmfit
import numpy as np
import statsmodels.api as sm
from numpy.typing import NDArray
from scipy import stats

from fmus.identification.known import Estimate
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]
Residual = Callable[[Mapping[str, float]], Array]

UNLIKELY = 1e-3  # a fit whose chi-square is less probable than this is called a misfit
SINGULAR = 1e8  # condition of scaled columns from which on rounding of the data decides
SURE = 3.7  # standard deviations from which on a term is said to be seen: 1 in 5000 by chance
WIDTH = float(stats.norm.ppf(0.975))  # half width of a 95 % interval in standard deviations


@dataclass(frozen=True)
class Guess:
    """Where the search for one parameter starts; `scale` is its magnitude, by default that of `value`."""

    value: float
    scale: float = 0.0
    low: float = -math.inf
    high: float = math.inf

    @property
    def unit(self) -> float:
        """What the search takes for 1."""
        return self.scale or abs(self.value) or 1.0


@dataclass(frozen=True)
class Regression:
    """Result of a fit.

    names, values, covariance   in the same order; the covariance is scaled if there is a misfit
    residual    each divided by its standard deviation
    chi_square, freedom         of these residuals
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    residual: Array
    chi_square: float
    freedom: int

    @property
    def probability(self) -> float:
        """Probability of a chi-square as large as this one if the model is right."""
        return float(stats.chi2.sf(self.chi_square, self.freedom))

    @property
    def misfit(self) -> bool:
        """True if noise alone cannot explain the residuals."""
        return self.probability < UNLIKELY

    @property
    def aic(self) -> float:
        """Akaike's criterion for residuals of known standard deviation: the lower, the better."""
        return self.chi_square + 2 * len(self.names)

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    def as_dict(self) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, map(float, self.values), strict=True))

    def seen(self, name: str) -> bool:
        """Is a parameter not zero by chance?"""
        return abs(self[name]) > SURE * self.sd(name)

    def sd(self, name: str) -> float:
        """Standard deviation of one parameter."""
        i = self.names.index(name)
        return math.sqrt(self.covariance[i, i])

    def estimate(self, name: str, unit: str, note: str, of: str = "", factor: float = 1.0) -> Estimate:
        """One parameter, times a factor known exactly, as an estimate called `name`."""
        parameter = of or name
        return symmetrical(name, factor * self[parameter], unit, abs(factor) * self.sd(parameter), note)

    def derived(
        self, name: str, unit: str, note: str, function: Callable[[Mapping[str, float]], float]
    ) -> Estimate:
        """A function of the parameters, its standard deviation by its gradient (central differences).

        A positive value gets the interval of its logarithm, which stays positive.
        """
        value, gradient = function(self.as_dict()), self._gradient(function)
        sd = math.sqrt(float(gradient @ self.covariance @ gradient))
        if value <= 0:
            return symmetrical(name, value, unit, sd, note)
        ratio = math.exp(WIDTH * sd / value)
        return Estimate(name, value, unit, sd, value / ratio, value * ratio, note)

    def _gradient(self, function: Callable[[Mapping[str, float]], float]) -> Array:
        at, steps = self.as_dict(), np.sqrt(np.diag(self.covariance)) / 10  # where the noise moves it
        both = [
            [function(at | {name: value + sign * h}) for sign in (1, -1)]
            for (name, value), h in zip(at.items(), steps, strict=True)
        ]
        rises = np.array([up - down for up, down in both])
        slopes: Array = np.divide(rises, 2 * steps, out=np.zeros_like(rises), where=steps > 0)
        return slopes


def symmetrical(name: str, value: float, unit: str, sd: float, note: str) -> Estimate:
    """An estimate with a normal distribution: 95 % within 1.96 sd."""
    return Estimate(name, value, unit, sd, value - WIDTH * sd, value + WIDTH * sd, note)


def fit(residual: Residual, start: Mapping[str, Guess], what: str) -> Regression:
    """Least squares of a residual, divided by its standard deviation, as a function of parameters by name.

    `what` names the fit in an error message.
    """
    units = {name: guess.unit for name, guess in start.items()}
    search = lmfit.Parameters()
    for name, guess in start.items():
        value, low, high = (x / units[name] for x in (guess.value, guess.low, guess.high))
        search.add(name, value=value, min=low, max=high)

    def scaled(parameters: lmfit.Parameters) -> Array:
        return residual({name: parameters[name].value * unit for name, unit in units.items()})

    found = lmfit.minimize(scaled, search, scale_covar=False, nan_policy="propagate")
    if not found.success or getattr(found, "covar", None) is None:
        raise Problem(f"{what}: the fit of {', '.join(start)} did not converge on {found.ndata} values")
    scale = np.array(list(units.values()))
    values = scale * [found.params[name].value for name in units]
    return _regression(tuple(units), values, found.covar * np.outer(scale, scale), found.residual)


def linear(y: Array, columns: Mapping[str, Array], sd: Array, what: str) -> Regression:
    """Weighted linear least squares of y = sum of parameter times column; `sd` is that of each y.

    `what` names the fit in an error message.
    """
    matrix = np.column_stack(list(columns.values()))
    scale = np.linalg.norm(matrix, axis=0)
    if not (scale > 0).all() or np.linalg.cond(matrix / scale) > SINGULAR:
        raise Problem(f"{what}: the {len(y)} points do not tell apart {', '.join(columns)}")
    found = sm.WLS(y, matrix / scale, weights=1 / sd**2).fit()
    covariance = found.normalized_cov_params / np.outer(scale, scale)
    return _regression(tuple(columns), found.params / scale, covariance, found.resid / sd)


def _regression(names: tuple[str, ...], values: Array, covariance: Array, residual: Array) -> Regression:
    freedom, chi_square = len(residual) - len(names), float(residual @ residual)
    plain = Regression(names, values, covariance, residual, chi_square, freedom)
    if not plain.misfit:
        return plain
    return Regression(names, values, covariance * chi_square / freedom, residual, chi_square, freedom)


def differ(values: Sequence[float], sds: Sequence[float]) -> float:
    """Probability that independent estimates of one quantity scatter as much as these (chi-square)."""
    v, w = np.array(values), 1 / np.array(sds) ** 2
    mean = np.sum(w * v) / np.sum(w)
    return float(stats.chi2.sf(np.sum(w * (v - mean) ** 2), len(v) - 1))


def misfit_remark(fit: Regression, what: str) -> tuple[str, ...]:
    """A sentence if the model cannot explain the data, else nothing."""
    if not fit.misfit:
        return ()
    ratio = math.sqrt(fit.chi_square / fit.freedom)
    return (
        f"{what} leaves residuals {ratio:.3g} times as large as the noise: the model lacks something. "
        "The intervals are widened by that factor.",
    )
