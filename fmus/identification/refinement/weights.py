"""How much each residual counts: robust losses, the model's own error, correlated residuals, priors.

Residuals are in standard deviations of their sensors. A robust loss is a weight in iteratively reweighted
least squares: a residual beyond `tuning` pulls less than its square would. 95 % efficiency on normal noise at
1.345 for Huber's loss [Holland and Welsch 1977], and nearly that for the smooth one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fmus.identification.recordings.masks import autocorrelation_time
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.simulation import Simulator

Array = NDArray[np.float64]
Loss = Literal["linear", "huber", "soft_l1"]

TUNING = 1.345
_TO_SD = 1.4826  # standard deviation over median magnitude of a normal variable
_LONGEST = 0.05  # of the samples: a correlation time beyond that is a trend
AT_REST = 1e-3  # nominal values: what a state that stands still may deviate from zero
UNKNOWN = 1.0  # nominal values: a state that is measured, or that nobody knows


def loss_factors(residual: Array, tuning: Array, loss: Loss) -> Array:
    """Factors of residuals and their Jacobian: square roots of the weights, in (0, 1]."""
    if loss == "linear":
        return np.ones_like(residual)
    ratio = np.abs(residual) / tuning
    if loss == "huber":
        return 1 / np.sqrt(np.maximum(ratio, 1.0))
    return (1 + ratio**2) ** -0.25


@dataclass(frozen=True)
class Scales:
    """Per output.

    floor    standard deviation of the model's own error, in those of the sensor, 0 for none
    memory   correlation time of the residuals in samples: so many count as one
    tuning   where outliers begin, in standard deviations of sensor and model together
    """

    floor: Array
    memory: Array
    tuning: Array

    def factor(self, residual: Array, column: NDArray[np.int64], loss: Loss) -> Array:
        """What residuals and their Jacobian are multiplied by; `column` is the output of each."""
        shrunk = 1 / np.hypot(1.0, self.floor[column])
        robust = loss_factors(residual * shrunk, self.tuning[column], loss)
        return np.asarray(shrunk * robust / np.sqrt(self.memory[column]))

    def change(self, other: Scales) -> float:
        """Largest relative difference."""
        mine, others = (
            np.concatenate([np.hypot(1.0, s.floor), np.sqrt(s.memory), s.tuning]) for s in (self, other)
        )
        return float(np.max(np.abs(others / mine - 1)))


def sensor_scales(outputs: int) -> Scales:
    """A model without errors: only the noise of the sensors counts."""
    return Scales(np.zeros(outputs), np.ones(outputs), np.full(outputs, TUNING))


def estimated_scales(residuals: list[Array], model_error: bool, memory: bool) -> Scales:
    """The scales that the residuals of each output show, in the order of time.

    Outliers never begin below the noise of the sensor. Far from the optimum all residuals are large; they are
    not outliers then, so the median magnitude counts.
    """
    floor, tuning = np.zeros(len(residuals)), np.full(len(residuals), TUNING)
    for k, part in enumerate(residuals):
        if model_error and part.size:
            floor[k] = math.sqrt(max(0.0, float(np.mean(part**2)) - 1))
        if part.size:
            tuning[k] *= max(1.0, _TO_SD * float(np.median(np.abs(part))) / math.hypot(1, floor[k]))
    times = [correlation_time(part) if memory else 1.0 for part in residuals]
    return Scales(floor, np.array(times), tuning)


def correlation_time(residual: Array) -> float:
    """Samples over which a residual lasts, at least 1; at most a share of them, as more would be a trend."""
    n = len(residual)
    if n < 4 or not float(residual @ residual) > 0:
        return 1.0
    return min(max(1.0, autocorrelation_time(residual)), max(1.0, _LONGEST * n))


@dataclass(frozen=True)
class Priors:
    """Means and standard deviations known before the recordings, as rows of the least-squares problem.

    z, z_sd           of the parameters; infinite where nothing is known
    start, start_sd   per run, of the first state in nominal values
    """

    z: Array
    z_sd: Array
    start: tuple[Array, ...]
    start_sd: tuple[Array, ...]

    def start_rows(self, run: int, state: Array) -> Array:
        """Rows [start | parameters | residual] of one run."""
        weight = 1 / self.start_sd[run]
        residual = (state - self.start[run]) * weight
        return np.hstack([np.diag(weight), np.zeros((len(weight), len(self.z))), residual[:, None]])

    def parameter_rows(self, z: Array) -> Array:
        """Rows [parameters | residual]."""
        weight = 1 / self.z_sd
        known = weight > 0
        residual = np.where(known, (z - self.z) * weight, 0.0)
        return np.hstack([np.diag(weight), residual[:, None]])[known]


def priors(problem: EstimationProblem, simulator: Simulator, first_states: list[Array]) -> Priors:
    """Priors of a problem; `first_states` per run, in nominal values."""
    return Priors(
        z=problem.initial(),
        z_sd=np.array([f.z_sd for f in problem.free]),
        start=tuple(first_states),
        start_sd=tuple(
            np.array([AT_REST if name in run.rest else UNKNOWN for name in simulator.states])
            for run in problem.training
        ),
    )
