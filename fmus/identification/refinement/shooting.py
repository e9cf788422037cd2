"""QR factors of a tall matrix, in small blocks.

Small blocks stay in one thread of the linear algebra library; segments have threads of their own already,
and the two would wait for each other.

From linearised segments to a small least-squares problem, and back.

Each segment i of a run, with start state s_i and parameters z, is linearised to

    residuals    r_i + J_i (ds_i, dz)          QR: only R_i (ds_i, dz) + Q_i' r_i matters
    continuity   d_i + X_i ds_i + P_i dz - ds_(i+1) = 0

The recursion writes every ds_i as a function of (ds_0, dz) [condensing: Bock and Plitt 1984]; a second QR per
run eliminates ds_0. What is left has as many rows and columns as there are parameters.
States are counted in their nominal values throughout.

All segments of all runs at one point: what each contributes, and the gaps between them.

All segments of all runs at one point: residuals, their Jacobian, gaps in the trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.data import first_states
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.simulation import Simulator, parallel
from fmus.identification.refinement.weights import Loss, Scales

Array = NDArray[np.float64]

_TIMES = 3  # rows of a block over columns: each level of the tree has a third of the rows of that before


@dataclass(frozen=True)
class Factors:
    """Q as a tree of block factors, each of shape (blocks, rows, k), and R, shape (k, columns)."""

    levels: tuple[Array, ...]
    r: Array

    def project(self, vector: Array) -> Array:
        """Q' v, shape (k,)."""
        for q in self.levels:
            padded = np.zeros(q.shape[0] * q.shape[1])
            padded[: len(vector)] = vector
            vector = np.matmul(padded.reshape(q.shape[0], 1, q.shape[1]), q).ravel()
        return vector


def factors(rows: Array) -> Factors:
    """QR factors of `rows`, shape (m, columns)."""
    columns = rows.shape[1]
    height = max(1, _TIMES * columns)
    levels: list[Array] = []
    while True:
        blocks = max(1, -(-len(rows) // height))
        tall = len(rows) if blocks == 1 else height
        padded = np.zeros((blocks * tall, columns))
        padded[: len(rows)] = rows
        q, r = np.linalg.qr(padded.reshape(blocks, tall, columns))
        levels.append(q)
        rows = r.reshape(-1, columns)
        if blocks == 1:
            return Factors(tuple(levels), rows)


def triangular(rows: Array) -> Array:
    """R alone: the same least-squares problem in as few rows as possible."""
    columns = rows.shape[1]
    height = max(1, _TIMES * columns)
    while len(rows) > height:
        blocks = -(-len(rows) // height)
        padded = np.zeros((blocks * height, columns))
        padded[: len(rows)] = rows
        rows = np.asarray(np.linalg.qr(padded.reshape(blocks, height, columns), mode="r"))
        rows = rows.reshape(-1, columns)
    return np.asarray(np.linalg.qr(rows, mode="r"))


@dataclass(frozen=True)
class Local:
    """One linearised segment.

    factors    of the weighted Jacobian, shape (m, nx + np)
    x_x, x_p   end state with respect to start state and parameters
    """

    factors: Factors
    x_x: Array
    x_p: Array

    def loose(self) -> Local:
        """The same segment, after which the next one starts from somewhere else."""
        return Local(self.factors, 0 * self.x_x, 0 * self.x_p)


@dataclass(frozen=True)
class Condensed:
    """One run condensed: rows [start | parameters | residual] in upper triangular form.

    recursion   per segment, shape (nx, nx + np + 1): ds_i = recursion (ds_0, dz, 1)
    """

    top: Array
    bottom: Array
    recursion: tuple[Array, ...]

    def start(self, dz: Array) -> Array:
        """ds_0 of a step in the parameters."""
        nx = len(self.top)
        rest = self.top[:, nx:-1] @ dz + self.top[:, -1]
        return np.asarray(-np.linalg.solve(self.top[:, :nx], rest)) if nx else rest

    def states(self, dz: Array) -> list[Array]:
        """All ds_i of a step in the parameters."""
        full = np.concatenate([self.start(dz), dz, [1.0]])
        return [rows @ full for rows in self.recursion]


def recursion(locals_: Sequence[Local], defects: Sequence[Array], free: int) -> tuple[Array, ...]:
    """ds_i as a function of (ds_0, dz, 1), per segment."""
    nx = locals_[0].x_x.shape[0]
    rows: Array = np.hstack([np.eye(nx), np.zeros((nx, free + 1))])
    found: list[Array] = [rows]
    for local, defect in zip(locals_[:-1], defects, strict=True):
        rows = local.x_x @ rows
        rows[:, nx:-1] += local.x_p
        rows[:, -1] += defect
        found.append(rows)
    return tuple(found)


def spread(local: Local, rows: Array, projected: Array) -> Array:
    """A segment's rows [start | parameters | residual] of the condensed problem."""
    nx = rows.shape[0]
    full: Array = local.factors.r[:, :nx] @ rows
    full[:, nx:-1] += local.factors.r[:, nx:]
    full[:, -1] += projected
    return full


def condense(
    locals_: Sequence[Local], defects: Sequence[Array], projected: Sequence[Array], prior: Array
) -> Condensed:
    """Condense one run.

    defects     d_i, one fewer than segments
    projected   Q_i' r_i
    prior       rows [start | parameters | residual] of what is known about the start state
    """
    free = prior.shape[1] - 1 - locals_[0].x_x.shape[0]
    nx = prior.shape[1] - 1 - free
    chain = recursion(locals_, defects, free)
    blocks = [spread(a, rows, c) for a, rows, c in zip(locals_, chain, projected, strict=True)]
    triangle = triangular(np.vstack([prior, *blocks]))
    return Condensed(triangle[:nx], triangle[nx:, nx:], chain)


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

    problem: EstimationProblem
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


@dataclass(frozen=True)
class Shooting:
    """How a problem is cut into segments and evaluated.

    inputs   per run, shape (n, nu)
    edges    per run the indices of the samples at which segments begin, and the last one
    loose    segments start from what is measured and need not meet: prediction over their length
    """

    problem: EstimationProblem
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
