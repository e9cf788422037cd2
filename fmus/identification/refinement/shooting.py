"""All segments of all runs at one point: residuals, their Jacobian, gaps in the trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.condense import Local
from fmus.identification.refinement.factor import factors
from fmus.identification.refinement.guess import first_states
from fmus.identification.refinement.loss import Loss
from fmus.identification.refinement.parallel import parallel
from fmus.identification.refinement.problem import Problem
from fmus.identification.refinement.scales import Scales
from fmus.identification.refinement.segments import Evaluated, Point, Segment
from fmus.identification.refinement.simulator import Simulator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shooting:
    """How a problem is cut into segments and evaluated.

    inputs   per run, shape (n, nu)
    edges    per run the indices of the samples at which segments begin, and the last one
    loose    segments start from what is measured and need not meet: prediction over their length
    """

    problem: Problem
    simulator: Simulator
    inputs: tuple[Array, ...]
    edges: tuple[tuple[int, ...], ...]
    threads: int
    loss: Loss
    loose: bool = False

    def guessed(self, z: Array) -> Point:
        """A point with start states from the measurements, the others by simulation."""
        p = self.problem.values_of(z)

        def states(k: int) -> Array:
            run = self.problem.training[k]
            return (
                first_states(run, self.simulator, p, self.inputs[k], self.edges[k]) / self.simulator.nominal
            )

        return Point(z, tuple(parallel(states, range(len(self.edges)), self.threads)))

    def moved(self, point: Point, dz: Array, changes: Sequence[Sequence[Array]], length: float) -> Point:
        """The point a fraction `length` of a step away."""
        if self.loose:
            return self.guessed(point.z + length * dz)
        starts = [
            s + length * np.array(ds).reshape(s.shape) for s, ds in zip(point.starts, changes, strict=True)
        ]
        return Point(point.z + length * dz, tuple(starts))

    def evaluate(self, point: Point, scales: Scales, sensitivities: bool = True) -> Evaluated:
        """Integrate all segments; raises what the simulator raises."""
        p, slopes = self.problem.values_of(point.z), self.problem.slopes(point.z)

        def job(place: tuple[int, int]) -> Segment:
            run, i = place
            return self._segment(run, i, point.starts[run][i], p, slopes, scales, sensitivities)

        places = [(k, i) for k, cuts in enumerate(self.edges) for i in range(len(cuts) - 1)]
        found = iter(parallel(job, places, self.threads))
        return Evaluated(
            self.problem, point, tuple(tuple(next(found) for _ in cuts[1:]) for cuts in self.edges)
        )

    def _segment(
        self, run: int, i: int, start: Array, p: Array, slopes: Array, scales: Scales, sensitivities: bool
    ) -> Segment:
        record, cuts = self.problem.training[run], self.edges[run]
        first, last = cuts[i], cuts[i + 1]
        nominal = self.simulator.nominal
        time, inputs = record.time[first : last + 1], self.inputs[run][first : last + 1]
        piece = self.simulator.segment(start * nominal, p, time, inputs, sensitivities)
        own = last - first + (i == len(cuts) - 2)  # a sample on an edge counts once
        weight = record.weight[first : first + own]
        use = weight > 0
        w, column = weight[use], np.nonzero(use)[1]
        residual = (piece.y[:own][use] - record.measured[first : first + own][use]) * w
        factor = scales.factor(residual, column, self.loss)
        local = None
        if sensitivities:
            rows = np.hstack([piece.y_x[:own][use] * nominal, piece.y_p[:own][use] * slopes])
            found = factors(rows * (w * factor)[:, None])
            local = Local(
                found, piece.x_x * nominal / nominal[:, None], piece.x_p * slopes / nominal[:, None]
            )
        return Segment(residual, column, factor, piece.x / nominal, local)


def cut(time: Array, seconds: float) -> tuple[int, ...]:
    """Indices that cut `time` into about equal segments of about `seconds`."""
    count = max(1, round((time[-1] - time[0]) / seconds))
    inner = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[1:-1])
    return tuple(int(i) for i in np.unique([0, *inner, len(time) - 1]))
