"""All segments of all runs at one point: what each contributes, and the gaps between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.condense import Local
from fmus.identification.refinement.problem import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Point:
    """Unknowns: z of the parameters, and per run the start states (segments, nx) in nominal values."""

    z: Array
    starts: tuple[Array, ...]


@dataclass(frozen=True)
class Segment:
    """What one segment contributes.

    residual   in standard deviations of the sensor, shape (m,)
    column     output of each, shape (m,)
    factor     for the model's own error and of the robust loss, shape (m,)
    end        end state in nominal values
    local      the linearisation; none if it was not asked for
    """

    residual: Array
    column: NDArray[np.int64]
    factor: Array
    end: Array
    local: Local | None

    def projected(self, other: Segment) -> Array:
        """Q' r of this segment's linearisation, with the residuals of `other`."""
        assert self.local is not None
        return self.local.factors.project(self.factor * other.residual)


@dataclass(frozen=True)
class Evaluated:
    """The segments of each run at a point."""

    problem: Problem
    point: Point
    runs: tuple[tuple[Segment, ...], ...]

    @property
    def defects(self) -> list[list[Array]]:
        """Gaps: end of each segment minus start of the next, in nominal values."""
        return [
            [piece.end - start for piece, start in zip(pieces[:-1], starts[1:], strict=True)]
            for pieces, starts in zip(self.runs, self.point.starts, strict=True)
        ]

    def gap(self) -> float:
        """Largest of them."""
        return max((float(np.abs(d).max(initial=0.0)) for run in self.defects for d in run), default=0.0)

    def residuals(self) -> list[Array]:
        """The residuals of each output in standard deviations of the sensor, in the order of time."""
        segments = [s for run in self.runs for s in run]
        outputs = range(len(self.problem.outputs))
        return [np.concatenate([s.residual[s.column == k] for s in segments]) for k in outputs]
