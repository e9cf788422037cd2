"""Regression with known errors: lmfit and statsmodels fit, this returns estimates with 95 % intervals.

Residuals are divided by their standard deviations, so chi-square is the sum of their squares and the
covariance is (J'J)^-1, not scaled. Only if chi-square says that the model does not fit the data (probability
below `UNLIKELY`) the covariance is multiplied by chi-square per degree of freedom, and `misfit` is true: the
interval then covers what the model cannot show as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import lmfit
import numpy as np
import statsmodels.api as sm
from numpy.typing import NDArray
from scipy import stats

from fmus.identification.estimate import Estimate
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]
Residual = Callable[[Mapping[str, float]], Array]

UNLIKELY = 1e-3  # a fit whose chi-square is less probable than this is called a misfit
SINGULAR = 1e8  # condition of scaled columns from which on rounding of the data decides
SIGNIFICANT = 3.7  # standard deviations from which on a term is significant: 1 in 5000 by chance


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
    def misfit(self) -> bool:
        """True if noise alone cannot explain the residuals: so large a chi-square is improbable."""
        return float(stats.chi2.sf(self.chi_square, self.freedom)) < UNLIKELY

    @property
    def aic(self) -> float:
        """Akaike's criterion for residuals of known standard deviation: the lower, the better."""
        return self.chi_square + 2 * len(self.names)

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    def as_dict(self) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, map(float, self.values), strict=True))

    def significant(self, name: str) -> bool:
        """Is a parameter not zero by chance?"""
        return abs(self[name]) > SIGNIFICANT * self.sd(name)

    def sd(self, name: str) -> float:
        """Standard deviation of one parameter."""
        i = self.names.index(name)
        return math.sqrt(self.covariance[i, i])

    def estimate(self, name: str, unit: str, note: str, of: str = "", factor: float = 1.0) -> Estimate:
        """One parameter, times a factor known exactly, as an estimate called `name`."""
        parameter = of or name
        return Estimate.normal(name, factor * self[parameter], unit, abs(factor) * self.sd(parameter), note)

    def derived(
        self, name: str, unit: str, note: str, function: Callable[[Mapping[str, float]], float]
    ) -> Estimate:
        """A function of the parameters, its standard deviation by its gradient (central differences).

        A positive value gets the interval of its logarithm, which stays positive.
        """
        at, steps = self.as_dict(), np.sqrt(np.diag(self.covariance)) / 10  # where the noise moves it
        rises = np.array(
            [
                function(at | {n: x + h}) - function(at | {n: x - h})
                for (n, x), h in zip(at.items(), steps, strict=True)
            ]
        )
        gradient = np.divide(rises, 2 * steps, out=np.zeros_like(rises), where=steps > 0)
        sd = math.sqrt(float(gradient @ self.covariance @ gradient))
        return Estimate.normal(name, function(at), unit, sd, note, log=True)


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

    result = lmfit.minimize(scaled, search, scale_covar=False, nan_policy="propagate")
    if not result.success or getattr(result, "covar", None) is None:
        raise Problem(f"{what}: the fit of {', '.join(start)} did not converge on {result.ndata} values")
    scale = np.array(list(units.values()))
    values = scale * [result.params[name].value for name in units]
    return _regression(tuple(units), values, result.covar * np.outer(scale, scale), result.residual)


def linear(y: Array, columns: Mapping[str, Array], sd: Array, what: str) -> Regression:
    """Weighted linear least squares of y = sum of parameter times column; `sd` is that of each y.

    `what` names the fit in an error message.
    """
    matrix = np.column_stack(list(columns.values()))
    scale = np.linalg.norm(matrix, axis=0)
    if not (scale > 0).all() or np.linalg.cond(matrix / scale) > SINGULAR:
        raise Problem(f"{what}: the {len(y)} points do not tell apart {', '.join(columns)}")
    result = sm.WLS(y, matrix / scale, weights=1 / sd**2).fit()
    covariance = result.normalized_cov_params / np.outer(scale, scale)
    return _regression(tuple(columns), result.params / scale, covariance, result.resid / sd)


def _regression(names: tuple[str, ...], values: Array, covariance: Array, residual: Array) -> Regression:
    freedom, chi_square = len(residual) - len(names), float(residual @ residual)
    plain = Regression(names, values, covariance, residual, chi_square, freedom)
    return replace(plain, covariance=covariance * chi_square / freedom) if plain.misfit else plain


def homogeneity(values: Sequence[float], sds: Sequence[float]) -> float:
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
