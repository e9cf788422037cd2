"""What is known before the recordings speak: rows of the least-squares problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.problem import Problem, Run
from fmus.identification.refinement.simulator import Simulator

Array = NDArray[np.float64]

AT_REST = 1e-3  # nominal values: what a state that stands still may deviate from zero
UNKNOWN = 1.0  # nominal values: a state that is measured, or that nobody knows


@dataclass(frozen=True)
class Priors:
    """Means and standard deviations.

    z, z_sd        of the parameters; infinite where nothing is known
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


def priors(problem: Problem, simulator: Simulator, firsts: list[Array]) -> Priors:
    """Priors of a problem; `firsts` are the first states per run, in nominal values."""

    def spread(run: Run) -> Array:
        return np.array([AT_REST if name in run.rest else UNKNOWN for name in simulator.states])

    return Priors(
        z=problem.search(),
        z_sd=np.array([f.z_sd for f in problem.free]),
        start=tuple(firsts),
        start_sd=tuple(spread(run) for run in problem.training),
    )
