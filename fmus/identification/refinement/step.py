"""One Gauss-Newton step over all unknowns, and how much of it to go.

The step solves the linearised problem under the parameters' bounds. Its length follows the natural level
test: with the Jacobian J of the old point, the simplified step J^+ F(new point) has to be shorter than the
step J^+ F(old point). It does not depend on how residuals and gaps are weighted against each other
[Deuflhard, Newton Methods for Nonlinear Problems, 2011, chapter 3; Bock 1987].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fmus.identification.refinement.condense import Condensed, condense, triangular
from fmus.identification.refinement.model import Failed
from fmus.identification.refinement.priors import PROXIMAL, Priors
from fmus.identification.refinement.shooting import Evaluated, Scales, Shooting

Array = NDArray[np.float64]

LONGEST = 0.7  # of z in one step: a factor of two
SHORTEST = 1 / 256  # fraction of a step at which the search gives up


@dataclass(frozen=True)
class Step:
    """Changes of the parameters and, per run and segment, of the start states.

    predicted   by how much the residuals change, in standard deviations
    """

    dz: Array
    states: tuple[list[Array], ...]
    predicted: float

    def norm(self, other: Step | None = None, factor: float = 0.0) -> float:
        """Length of this step minus `factor` times another one."""
        dz = self.dz - (factor * other.dz if other else 0.0)
        squares = float(dz @ dz)
        for k, run in enumerate(self.states):
            changes = np.array(run) - (factor * np.array(other.states[k]) if other else 0.0)
            squares += float(np.sum(changes**2)) / (len(run) * len(self.states))
        return math.sqrt(squares)


def condensed(old: Evaluated, new: Evaluated, priors: Priors) -> tuple[Condensed, ...]:
    """The runs condensed: linearisation of `old`, residuals and gaps of `new`."""
    return tuple(
        condense(
            [s.local for s in segments if s.local is not None],
            new.defects[k],
            [s.projected(n) for s, n in zip(segments, new.runs[k], strict=True)],
            priors.start_rows(k, new.point.starts[k][0]),
        )
        for k, segments in enumerate(old.runs)
    )


def solve(runs: tuple[Condensed, ...], z: Array, priors: Priors, bounds: tuple[Array, Array]) -> Step:
    """The step at z: least squares under bounds, held back where the data say nothing."""
    rows = np.vstack([*(run.bottom for run in runs), priors.parameter_rows(z)])
    back = np.hstack([np.eye(len(z)) / PROXIMAL, np.zeros((len(z), 1))])
    triangle = triangular(np.vstack([rows, back]))
    low, high = (np.minimum(bounds[0] - z, 0.0), np.maximum(bounds[1] - z, 0.0))
    dz = lsq_linear(triangle[:, :-1], -triangle[:, -1], (low, high), method="bvls").x
    before, after = rows[:, -1], rows[:, :-1] @ dz + rows[:, -1]
    gain = before @ before - after @ after + sum(float(run.top[:, -1] @ run.top[:, -1]) for run in runs)
    return Step(dz, tuple(run.states(dz) for run in runs), math.sqrt(max(0.0, float(gain))))


@dataclass(frozen=True)
class Search:
    """Where a step led, and which fraction of it was gone; nowhere if `evaluated` is None."""

    evaluated: Evaluated | None
    length: float


def search(
    shooting: Shooting, old: Evaluated, step: Step, priors: Priors, scales: Scales, first: float
) -> Search:
    """Go as much of the step as the natural level test allows, at first a fraction `first`."""
    bounds = shooting.problem.bounds()
    size = step.norm()
    length = min(first, LONGEST / max(LONGEST, float(np.max(np.abs(step.dz), initial=0.0))))
    while length >= SHORTEST:
        try:
            new = shooting.evaluate(old.point.moved(step.dz, step.states, length), scales)
        except Failed:
            length /= 4
            continue
        simplified = solve(condensed(old, new, priors), new.point.z, priors, bounds)
        if simplified.norm() <= (1 - length / 4) * size:
            return Search(new, length)
        bend = simplified.norm(step, 1 - length)
        length = min(length / 2, size * length**2 / (2 * bend)) if bend > 0 else length / 2
    return Search(None, 0.0)
