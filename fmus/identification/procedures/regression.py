"""Result of a weighted least squares fit with known measurement errors, and a nonlinear fit.

Each residual is divided by its standard deviation, so chi-square is the sum of squared residuals, and the
covariance of the estimates is (J'J)^-1 without scaling. Goodness of fit: if chi-square is less probable than
`UNLIKELY`, `misfit` is true, and the covariance is multiplied by chi-square per degree of freedom. The
intervals then also cover the model error.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, stats

from fmus.identification.estimate import Estimate
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

Residual = Callable[[Mapping[str, float]], Array]

UNLIKELY = 1e-3  # probability of chi-square below which a fit is a misfit
SINGULAR = 1e8  # largest condition number of the scaled regressors; beyond, rounding errors decide
SIGNIFICANT = 3.7  # standard deviations above which a term is significant: 1 in 5000 by chance
DETERMINED = 0.25  # largest relative standard deviation of a parameter that the data determine
FAR = 3.0  # residuals over noise from which on eight ninths of chi-square are errors of the model
NEGLIGIBLE = 0.1  # effects below this fraction of a standard deviation are not mentioned


@dataclass(frozen=True)
class Guess:
    """Initial value of a parameter, its nominal magnitude (by default that of the value) and its bounds."""

    value: float
    magnitude: float = 0.0
    low: float = -math.inf
    high: float = math.inf

    @property
    def nominal(self) -> float:
        """The value that is scaled to 1 during the search."""
        return self.magnitude or abs(self.value) or 1.0


@dataclass(frozen=True)
class Regression:
    """Result of a fit.

    names, values, covariance   parameters in one order; the covariance is scaled if there is a misfit
    residual                    residuals, each divided by its standard deviation
    chi_square, freedom         sum of their squares, and its degrees of freedom
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    residual: Array
    chi_square: float
    freedom: int

    @property
    def misfit(self) -> bool:
        """Whether chi-square is too large to be explained by measurement noise."""
        return float(stats.chi2.sf(self.chi_square, self.freedom)) < UNLIKELY

    @property
    def times_noise(self) -> float:
        """Root mean square of the residuals in standard deviations: 1 if noise explains them."""
        return math.sqrt(self.chi_square / self.freedom) if self.freedom > 0 else 0.0

    @property
    def aic(self) -> float:
        """Akaike's information criterion for residuals of known standard deviation; lower is better."""
        return self.chi_square + 2 * len(self.names)

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    def as_dict(self) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, map(float, self.values), strict=True))

    def significant(self, name: str) -> bool:
        """Whether a parameter differs from zero by more than chance."""
        return abs(self[name]) > SIGNIFICANT * self.sd(name)

    def determined(self, name: str) -> bool:
        """Whether the data determine a positive parameter: its relative standard deviation is small."""
        return self.sd(name) <= DETERMINED * self[name]

    def sd(self, name: str) -> float:
        """Standard deviation of one parameter."""
        i = self.names.index(name)
        return math.sqrt(self.covariance[i, i])

    def estimate(self, name: str, unit: str, note: str, parameter: str = "", factor: float = 1.0) -> Estimate:
        """The estimate `name`: the fitted parameter (by default of that name) times an exact factor."""
        parameter = parameter or name
        return Estimate.normal(name, factor * self[parameter], unit, abs(factor) * self.sd(parameter), note)

    def derived(
        self, name: str, unit: str, note: str, function: Callable[[Mapping[str, float]], float]
    ) -> Estimate:
        """A function of the parameters, with its standard deviation by linear error propagation.

        The gradient is formed by central differences over the range of the noise. The interval of a positive
        value is that of its logarithm, so that it stays positive.
        """
        values, steps = self.as_dict(), np.sqrt(np.diag(self.covariance)) / 10
        differences = np.array(
            [
                function(values | {n: x + h}) - function(values | {n: x - h})
                for (n, x), h in zip(values.items(), steps, strict=True)
            ]
        )
        gradient = np.divide(differences, 2 * steps, out=np.zeros_like(differences), where=steps > 0)
        sd = math.sqrt(float(gradient @ self.covariance @ gradient))
        return Estimate.normal(name, function(values), unit, sd, note, log=True)


def fit(residual: Residual, start: Mapping[str, Guess], label: str) -> Regression:
    """Nonlinear least squares of residuals over their standard deviations, a function of the parameters.

    start   initial value of each parameter
    label   name of the fit in error messages
    """
    names, nominal = tuple(start), np.array([guess.nominal for guess in start.values()])
    first, low, high = np.array([(g.value, g.low, g.high) for g in start.values()]).T / nominal

    def scaled(x: Array) -> Array:
        return residual(dict(zip(names, x * nominal, strict=True)))

    problem = Problem(
        f"{label}: the fit of {', '.join(names)} to {scaled(first).size} values did not converge"
    )
    try:
        found = optimize.least_squares(scaled, first, bounds=(low, high))
        covariance = np.linalg.inv(found.jac.T @ found.jac) * np.outer(nominal, nominal)
    except (ValueError, np.linalg.LinAlgError):  # not finite, singular
        raise problem from None
    if not found.success or not (np.diag(covariance) > 0).all():
        raise problem
    return _regression(names, nominal * found.x, covariance, found.fun)


def _regression(names: tuple[str, ...], values: Array, covariance: Array, residual: Array) -> Regression:
    freedom, chi_square = len(residual) - len(names), float(residual @ residual)
    unscaled = Regression(names, values, covariance, residual, chi_square, freedom)
    if not unscaled.misfit:
        return unscaled
    return replace(unscaled, covariance=covariance * chi_square / freedom)


def misfit_remark(fit: Regression, equation: str) -> tuple[str, ...]:
    """A sentence if the equation cannot explain the data, else nothing."""
    if not fit.misfit:
        return ()
    return (
        f"{equation} leaves residuals {fit.times_noise:.3g} times as large as the noise: the model is "
        "incomplete. The intervals are widened by that factor.",
    )


def misfit_warning(times_noise: float, equation: str) -> tuple[str, ...]:
    """A sentence for the terminal if residuals are far above the noise, else nothing."""
    if not times_noise > FAR:
        return ()
    return (
        f"{equation} leaves residuals {times_noise:.3g} times as large as the noise of the sensors: "
        "the data contain an effect that the model lacks, and the estimates compensate for this effect.",
    )
