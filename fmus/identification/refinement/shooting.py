"""Multiple shooting: segments of all runs at one iterate, and the small least-squares problem in them.

Each segment i of a run, with start state s_i and parameters z, is linearised to

    residuals    r_i + J_i (ds_i, dz)          QR: only R_i (ds_i, dz) + Q_i' r_i matters
    continuity   d_i + X_i ds_i + P_i dz - ds_(i+1) = 0

The recursion writes every ds_i as a function of (ds_0, dz) [condensing: Bock and Plitt 1984]; a second QR per
run eliminates ds_0. What is left has as many rows and columns as there are parameters.
States are counted in their nominal values throughout.

QR is done in small blocks, which stay in one thread of the linear algebra library: segments have threads of
their own already, and the two would wait for each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.data import first_states
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.simulation import Simulator
from fmus.identification.refinement.weights import Loss, Scales

Array = NDArray[np.float64]
Job = TypeVar("Job")
Result = TypeVar("Result")

_TIMES = 3  # rows of a block over columns: each level of the tree has a third of the rows of that before


def parallel(job: Callable[[Job], Result], places: Sequence[Job], threads: int) -> list[Result]:
    """Results in the order of the places; an interrupt does not wait for what has not begun."""
    if threads == 1 or len(places) == 1:
        return [job(place) for place in places]
    pool = ThreadPoolExecutor(threads)
    try:
        return list(pool.map(job, places))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _blocks(rows: Array) -> Array:
    """The rows in blocks of equal height, padded with zeros, shape (blocks, height, columns)."""
    columns = rows.shape[1]
    height = max(1, _TIMES * columns)
    blocks = max(1, -(-len(rows) // height))
    padded = np.zeros((blocks * (len(rows) if blocks == 1 else height), columns))
    padded[: len(rows)] = rows
    return padded.reshape(blocks, -1, columns) if padded.size else padded[None]


def triangular(rows: Array) -> Array:
    """R alone: the same least-squares problem in as few rows as possible."""
    while True:
        blocks = _blocks(rows)
        rows = np.asarray(np.linalg.qr(blocks, mode="r")).reshape(-1, rows.shape[1])
        if len(blocks) == 1:
            return rows


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
    levels: list[Array] = []
    while True:
        q, r = np.linalg.qr(_blocks(rows))
        levels.append(q)
        rows = r.reshape(-1, rows.shape[1])
        if len(q) == 1:
            return Factors(tuple(levels), rows)


@dataclass(frozen=True)
class LinearSegment:
    """One linearised segment.

    factors    of the weighted Jacobian, shape (m, nx + np)
    x_x, x_p   end state with respect to start state and parameters
    """

    factors: Factors
    x_x: Array
    x_p: Array

    def detached(self) -> LinearSegment:
        """The same segment, after which the next one starts from somewhere else."""
        return LinearSegment(self.factors, 0 * self.x_x, 0 * self.x_p)

    def condensed(self, recursion: Array, projected: Array) -> Array:
        """Its rows [start | parameters | residual] of the condensed problem."""
        nx = recursion.shape[0]
        rows: Array = self.factors.r[:, :nx] @ recursion
        rows[:, nx:-1] += self.factors.r[:, nx:]
        rows[:, -1] += projected
        return rows


@dataclass(frozen=True)
class Condensed:
    """One run condensed: rows [start | parameters | residual] in upper triangular form.

    recursion   per segment, shape (nx, nx + np + 1): ds_i = recursion (ds_0, dz, 1)
    """

    top: Array
    bottom: Array
    recursion: tuple[Array, ...]

    def states(self, dz: Array) -> list[Array]:
        """All ds_i of a step in the parameters."""
        nx = len(self.top)
        right = self.top[:, nx:-1] @ dz + self.top[:, -1]
        start = -np.linalg.solve(self.top[:, :nx], right) if nx else right
        full = np.concatenate([start, dz, [1.0]])
        return [rows @ full for rows in self.recursion]


def condense(
    segments: Sequence[LinearSegment], defects: Sequence[Array], projected: Sequence[Array], prior: Array
) -> Condensed:
    """Condense one run.

    defects     d_i, one fewer than segments
    projected   Q_i' r_i
    prior       rows [start | parameters | residual] of what is known about the start state
    """
    nx = segments[0].x_x.shape[0]
    rows: Array = np.hstack([np.eye(nx), np.zeros((nx, prior.shape[1] - nx))])
    recursion = [rows]
    for segment, defect in zip(segments[:-1], defects, strict=True):
        rows = segment.x_x @ rows
        rows[:, nx:-1] += segment.x_p
        rows[:, -1] += defect
        recursion.append(rows)
    blocks = [s.condensed(rows, c) for s, rows, c in zip(segments, recursion, projected, strict=True)]
    triangle = triangular(np.vstack([prior, *blocks]))
    return Condensed(triangle[:nx], triangle[nx:, nx:], tuple(recursion))


@dataclass(frozen=True)
class Iterate:
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
    linear     the linearisation; none if it was not asked for
    """

    residual: Array
    column: NDArray[np.int64]
    factor: Array
    end: Array
    linear: LinearSegment | None

    def projected(self, other: Segment) -> Array:
        """Q' r of this segment's linearisation, with the residuals of `other`."""
        assert self.linear is not None
        return self.linear.factors.project(self.factor * other.residual)


@dataclass(frozen=True)
class Evaluated:
    """The segments of each run at an iterate."""

    problem: EstimationProblem
    iterate: Iterate
    runs: tuple[tuple[Segment, ...], ...]

    @property
    def defects(self) -> list[list[Array]]:
        """Gaps: end of each segment minus start of the next, in nominal values."""
        return [
            [segment.end - start for segment, start in zip(segments[:-1], starts[1:], strict=True)]
            for segments, starts in zip(self.runs, self.iterate.starts, strict=True)
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

    inputs     per run, shape (n, nu)
    edges      per run the indices of the samples at which segments begin, and the last one
    detached   segments start from what is measured and need not meet: prediction over their length
    """

    problem: EstimationProblem
    simulator: Simulator
    inputs: tuple[Array, ...]
    edges: tuple[tuple[int, ...], ...]
    threads: int
    loss: Loss
    detached: bool = False

    def measured(self, z: Array) -> Iterate:
        """Start states from the measurements, those that are not measured by simulation."""
        p, nominal = self.problem.values_of(z), self.simulator.nominal

        def states(k: int) -> Array:
            run = self.problem.training[k]
            return first_states(run, self.simulator, p, self.inputs[k], self.edges[k]) / nominal

        return Iterate(z, tuple(parallel(states, range(len(self.edges)), self.threads)))

    def moved(
        self, iterate: Iterate, dz: Array, changes: Sequence[Sequence[Array]], length: float
    ) -> Iterate:
        """The iterate a fraction `length` of a step away."""
        if self.detached:
            return self.measured(iterate.z + length * dz)
        starts = [
            s + length * np.array(ds).reshape(s.shape) for s, ds in zip(iterate.starts, changes, strict=True)
        ]
        return Iterate(iterate.z + length * dz, tuple(starts))

    def evaluate(self, iterate: Iterate, scales: Scales, sensitivities: bool = True) -> Evaluated:
        """Integrate all segments; raises what the simulator raises."""
        p, slopes = self.problem.values_of(iterate.z), self.problem.slopes(iterate.z)

        def job(place: tuple[int, int]) -> Segment:
            run, i = place
            return self._segment(run, i, iterate.starts[run][i], p, slopes, scales, sensitivities)

        places = [(k, i) for k, cuts in enumerate(self.edges) for i in range(len(cuts) - 1)]
        segments: Iterator[Segment] = iter(parallel(job, places, self.threads))
        runs = tuple(tuple(next(segments) for _ in cuts[1:]) for cuts in self.edges)
        return Evaluated(self.problem, iterate, runs)

    def _segment(
        self, run: int, i: int, start: Array, p: Array, slopes: Array, scales: Scales, sensitivities: bool
    ) -> Segment:
        record, cuts = self.problem.training[run], self.edges[run]
        first, last = cuts[i], cuts[i + 1]
        nominal = self.simulator.nominal
        time, inputs = record.time[first : last + 1], self.inputs[run][first : last + 1]
        solution = self.simulator.segment(start * nominal, p, time, inputs, sensitivities)
        own = last - first + (i == len(cuts) - 2)  # a sample on an edge counts once
        weight = record.weight[first : first + own]
        use = weight > 0
        w, column = weight[use], np.nonzero(use)[1]
        residual = (solution.y[:own][use] - record.measured[first : first + own][use]) * w
        factor = scales.factor(residual, column, self.loss)
        linear = None
        if sensitivities:
            rows = np.hstack([solution.y_x[:own][use] * nominal, solution.y_p[:own][use] * slopes])
            x_x, x_p = solution.x_x * nominal / nominal[:, None], solution.x_p * slopes / nominal[:, None]
            linear = LinearSegment(factors(rows * (w * factor)[:, None]), x_x, x_p)
        return Segment(residual, column, factor, solution.x / nominal, linear)


def cut(time: Array, seconds: float) -> tuple[int, ...]:
    """Indices that cut `time` into about equal segments of about `seconds`."""
    count = max(1, round((time[-1] - time[0]) / seconds))
    inner = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[1:-1])
    return tuple(int(i) for i in np.unique([0, *inner, len(time) - 1]))
