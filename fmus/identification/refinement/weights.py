"""Weights of residuals, in standard deviations of their sensors: model error, correlation; priors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.recordings.masks import autocorrelation_time
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.simulation import Simulator
from orchestrator.data.table import Array

_LONGEST = 0.05  # largest correlation time, as a fraction of the samples; beyond that a residual is a trend
SD_AT_REST = 1e-3  # prior standard deviation of an initial state that is at rest, in nominal values
SD_UNKNOWN = 1.0  # the same for any other initial state


@dataclass(frozen=True)
class Scales:
    """Scales of the residuals, per output.

    model_error        standard deviation of the model's own error in those of the sensor, 0 for none
    correlation_time   of the residuals [samples]: so many samples count as one
    """

    model_error: Array
    correlation_time: Array

    def factor(self, column: NDArray[np.int64]) -> Array:
        """The factor of each residual and its row of the Jacobian; `column` is the index of its output."""
        return np.asarray((1 / np.hypot(1.0, self.model_error) / np.sqrt(self.correlation_time))[column])

    def change(self, other: Scales) -> float:
        """Largest relative difference."""
        old, new = (
            np.concatenate([np.hypot(1.0, s.model_error), np.sqrt(s.correlation_time)]) for s in (self, other)
        )
        return float(np.max(np.abs(new / old - 1)))


def sensor_scales(outputs: int) -> Scales:
    """A model without errors: only the noise of the sensors counts."""
    return Scales(np.zeros(outputs), np.ones(outputs))


def estimated_scales(residuals: list[Array], model_error: bool, correlated: bool) -> Scales:
    """Scales estimated from the residuals of each output, in the order of time."""
    error = np.zeros(len(residuals))
    for k, residual in enumerate(residuals):
        if model_error and residual.size:
            error[k] = math.sqrt(max(0.0, float(np.mean(residual**2)) - 1))
    times = [correlation_time(residual) if correlated else 1.0 for residual in residuals]
    return Scales(error, np.array(times))


def correlation_time(residual: Array) -> float:
    """Correlation time of a residual [samples], at least 1 and at most a fraction of all samples."""
    n = len(residual)
    if n < 4 or not float(residual @ residual) > 0:
        return 1.0
    return min(max(1.0, autocorrelation_time(residual)), max(1.0, _LONGEST * n))


@dataclass(frozen=True)
class Priors:
    """Means and standard deviations of the priors, as rows of the least-squares problem.

    z, z_sd           of the parameters; the standard deviation is infinite without a prior
    start, start_sd   per run, of its initial state in nominal values
    """

    z: Array
    z_sd: Array
    start: tuple[Array, ...]
    start_sd: tuple[Array, ...]

    def start_rows(self, run: int, state: Array) -> Array:
        """Rows [initial state | parameters | residual] of one run."""
        weight = 1 / self.start_sd[run]
        residual = (state - self.start[run]) * weight
        return np.hstack([np.diag(weight), np.zeros((len(weight), len(self.z))), residual[:, None]])

    def parameter_rows(self, z: Array) -> Array:
        """Rows [parameters | residual] of the parameters with a prior."""
        weight = 1 / self.z_sd
        informative = weight > 0
        residual = np.where(informative, (z - self.z) * weight, 0.0)
        return np.hstack([np.diag(weight), residual[:, None]])[informative]


def priors(problem: EstimationProblem, simulator: Simulator, initial_states: list[Array]) -> Priors:
    """Priors of a problem; `initial_states` per run, in nominal values."""
    return Priors(
        z=problem.initial(),
        z_sd=np.array([f.z_sd for f in problem.free]),
        start=tuple(initial_states),
        start_sd=tuple(
            np.array([SD_AT_REST if name in run.at_rest else SD_UNKNOWN for name in simulator.states])
            for run in problem.training
        ),
    )
