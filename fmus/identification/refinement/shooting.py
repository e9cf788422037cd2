"""Multiple shooting: the segments of all runs at one iterate, and the condensed least-squares problem.

Each segment i of a run, with initial state s_i and parameters z, is linearised to

    residuals    r_i + J_i (ds_i, dz)          QR: only R_i (ds_i, dz) + Q_i' r_i matters
    continuity   d_i + X_i ds_i + P_i dz - ds_(i+1) = 0

The recursion writes every ds_i as a function of (ds_0, dz) [condensing: Bock and Plitt 1984]; a second QR per
run eliminates ds_0. The condensed problem has as many rows and columns as there are parameters.
States are scaled by their nominal values throughout.

QR works on small blocks (tall-skinny QR), for which the linear algebra library starts no threads. Segments
already run in threads, and the two kinds of threads would block each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fmus.identification.recordings.masks import autocorrelation_time
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.simulation import Simulator
from orchestrator.data.table import Array

Task = TypeVar("Task")
Result = TypeVar("Result")

_HEIGHT = 3  # rows of a block per column: each level of the tree has a third of the rows of the level before
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


def parallel(function: Callable[[Task], Result], tasks: Sequence[Task], threads: int) -> list[Result]:
    """Results in the order of the tasks; an interrupt cancels the tasks that have not begun."""
    if threads == 1 or len(tasks) == 1:
        return [function(task) for task in tasks]
    pool = ThreadPoolExecutor(threads)
    try:
        return list(pool.map(function, tasks))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _blocks(rows: Array) -> Array:
    """The rows in blocks of equal height, padded with zeros, shape (blocks, height, columns)."""
    columns = rows.shape[1]
    height = max(1, _HEIGHT * columns)
    blocks = max(1, -(-len(rows) // height))
    padded = np.zeros((blocks * (len(rows) if blocks == 1 else height), columns))
    padded[: len(rows)] = rows
    return padded.reshape(blocks, -1, columns) if padded.size else padded[None]


def triangular(rows: Array) -> Array:
    """R of the QR factorisation: the same least-squares problem in as few rows as possible."""
    while True:
        blocks = _blocks(rows)
        rows = np.asarray(np.linalg.qr(blocks, mode="r")).reshape(-1, rows.shape[1])
        if len(blocks) == 1:
            return rows


@dataclass(frozen=True)
class TreeQR:
    """QR factors: Q as a tree of block factors, each (blocks, rows, k), and R, shape (k, columns)."""

    levels: tuple[Array, ...]
    r: Array

    def project(self, vector: Array) -> Array:
        """Q' v, shape (k,)."""
        for q in self.levels:
            padded = np.zeros(q.shape[0] * q.shape[1])
            padded[: len(vector)] = vector
            vector = np.matmul(padded.reshape(q.shape[0], 1, q.shape[1]), q).ravel()
        return vector


def tree_qr(rows: Array) -> TreeQR:
    """QR factors of `rows`, shape (m, columns)."""
    levels: list[Array] = []
    while True:
        q, r = np.linalg.qr(_blocks(rows))
        levels.append(q)
        rows = r.reshape(-1, rows.shape[1])
        if len(q) == 1:
            return TreeQR(tuple(levels), rows)


@dataclass(frozen=True)
class LinearSegment:
    """One linearised segment.

    factors    QR factors of the weighted Jacobian, shape (m, nx + np)
    x_x, x_p   sensitivities of the final state to initial state and parameters
    """

    factors: TreeQR
    x_x: Array
    x_p: Array

    def detached(self) -> LinearSegment:
        """The same segment without influence on the next one."""
        return LinearSegment(self.factors, 0 * self.x_x, 0 * self.x_p)

    def condensed(self, recursion: Array, projected: Array) -> Array:
        """Its rows [initial state | parameters | residual] of the condensed problem."""
        nx = recursion.shape[0]
        rows: Array = self.factors.r[:, :nx] @ recursion
        rows[:, nx:-1] += self.factors.r[:, nx:]
        rows[:, -1] += projected
        return rows


@dataclass(frozen=True)
class CondensedRun:
    """One run condensed to the upper triangular form of rows [initial state | parameters | residual].

    top         the rows that determine the initial state of the run, shape (nx, nx + np + 1)
    bottom      rows [parameters | residual] that remain
    recursion   per segment, shape (nx, nx + np + 1): ds_i = recursion (ds_0, dz, 1)
    """

    top: Array
    bottom: Array
    recursion: tuple[Array, ...]

    def states(self, dz: Array) -> list[Array]:
        """ds_i of all segments for a step dz of the parameters."""
        nx = len(self.top)
        right = self.top[:, nx:-1] @ dz + self.top[:, -1]
        ds_0 = -np.linalg.solve(self.top[:, :nx], right) if nx else right
        full = np.concatenate([ds_0, dz, [1.0]])
        return [rows @ full for rows in self.recursion]


def condense(
    segments: Sequence[LinearSegment], defects: Sequence[Array], projected: Sequence[Array], prior: Array
) -> CondensedRun:
    """Condense one run.

    defects     d_i, one fewer than segments
    projected   Q_i' r_i
    prior       rows [initial state | parameters | residual] of the prior of the initial state
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
    return CondensedRun(triangle[:nx], triangle[nx:, nx:], tuple(recursion))


@dataclass(frozen=True)
class Iterate:
    """Unknowns: z of the parameters, and per run the initial states (segments, nx) in nominal values."""

    z: Array
    starts: tuple[Array, ...]


@dataclass(frozen=True)
class Segment:
    """Residuals and linearisation of one segment.

    residual   in standard deviations of the sensor, shape (m,)
    column     index of the output of each residual, shape (m,)
    factor     square root of the weight by model error and correlation, shape (m,)
    end        final state in nominal values
    linear     the linearisation, None if no sensitivities were computed
    """

    residual: Array
    column: NDArray[np.int64]
    factor: Array
    end: Array
    linear: LinearSegment | None

    def projected(self, other: Segment) -> Array:
        """Q' r: Q of this segment's linearisation, r the residuals of `other` with this segment's weights."""
        assert self.linear is not None
        return self.linear.factors.project(self.factor * other.residual)


@dataclass(frozen=True)
class Evaluation:
    """The segments of each run at an iterate."""

    problem: EstimationProblem
    iterate: Iterate
    runs: tuple[tuple[Segment, ...], ...]

    @property
    def defects(self) -> list[list[Array]]:
        """Continuity defects in nominal values: final state of a segment minus initial state of the next."""
        return [
            [segment.end - start for segment, start in zip(segments[:-1], starts[1:], strict=True)]
            for segments, starts in zip(self.runs, self.iterate.starts, strict=True)
        ]

    def largest_defect(self) -> float:
        """Largest magnitude of a continuity defect."""
        return max((float(np.abs(d).max(initial=0.0)) for run in self.defects for d in run), default=0.0)

    def residuals(self) -> list[Array]:
        """The residuals of each output in standard deviations of the sensor, in the order of time."""
        segments = [s for run in self.runs for s in run]
        outputs = range(len(self.problem.outputs))
        return [np.concatenate([s.residual[s.column == k] for s in segments]) for k in outputs]


@dataclass(frozen=True)
class Shooting:
    """A problem cut into segments.

    inputs     per run, shape (n, nu)
    edges      per run the indices of the samples at which segments begin, and of the last sample
    detached   segments begin at measured states and need not be continuous: prediction over their length
    """

    problem: EstimationProblem
    simulator: Simulator
    inputs: tuple[Array, ...]
    edges: tuple[tuple[int, ...], ...]
    threads: int
    detached: bool = False

    def measured_iterate(self, z: Array) -> Iterate:
        """The iterate with measured initial states; states that are not measured are simulated."""
        p, nominal = self.problem.values_of(z), self.simulator.nominal

        def states(k: int) -> Array:
            run = self.problem.training[k]
            return run.segment_states(self.simulator, p, self.inputs[k], self.edges[k]) / nominal

        return Iterate(z, tuple(parallel(states, range(len(self.edges)), self.threads)))

    def stepped(self, iterate: Iterate, dz: Array, ds: Sequence[Sequence[Array]], fraction: float) -> Iterate:
        """The iterate after a fraction of the step (dz, ds)."""
        if self.detached:
            return self.measured_iterate(iterate.z + fraction * dz)
        starts = [
            s + fraction * np.array(d).reshape(s.shape) for s, d in zip(iterate.starts, ds, strict=True)
        ]
        return Iterate(iterate.z + fraction * dz, tuple(starts))

    def evaluate(self, iterate: Iterate, scales: Scales, sensitivities: bool = True) -> Evaluation:
        """Simulate all segments; raises SimulationFailed."""
        p, p_z = self.problem.values_of(iterate.z), self.problem.derivatives(iterate.z)

        def evaluate_segment(task: tuple[int, int]) -> Segment:
            run, i = task
            return self._segment(run, i, iterate.starts[run][i], p, p_z, scales, sensitivities)

        tasks = [(k, i) for k, edges in enumerate(self.edges) for i in range(len(edges) - 1)]
        segments: Iterator[Segment] = iter(parallel(evaluate_segment, tasks, self.threads))
        runs = tuple(tuple(next(segments) for _ in edges[1:]) for edges in self.edges)
        return Evaluation(self.problem, iterate, runs)

    def _segment(
        self, run: int, i: int, start: Array, p: Array, p_z: Array, scales: Scales, sensitivities: bool
    ) -> Segment:
        record, edges = self.problem.training[run], self.edges[run]
        first, last = edges[i], edges[i + 1]
        nominal = self.simulator.nominal
        time, inputs = record.time[first : last + 1], self.inputs[run][first : last + 1]
        solution = self.simulator.segment(start * nominal, p, time, inputs, sensitivities)
        count = last - first + (i == len(edges) - 2)  # a sample on an edge counts once
        weight = record.weight[first : first + count]
        used = weight > 0
        w, column = weight[used], np.nonzero(used)[1]
        residual = (solution.y[:count][used] - record.measured[first : first + count][used]) * w
        factor = scales.factor(column)
        linear = None
        if sensitivities:
            rows = np.hstack([solution.y_x[:count][used] * nominal, solution.y_p[:count][used] * p_z])
            x_x, x_p = solution.x_x * nominal / nominal[:, None], solution.x_p * p_z / nominal[:, None]
            linear = LinearSegment(tree_qr(rows * (w * factor)[:, None]), x_x, x_p)
        return Segment(residual, column, factor, solution.x / nominal, linear)


def cut(time: Array, seconds: float) -> tuple[int, ...]:
    """Indices that cut `time` into segments of about `seconds` and about equal length."""
    count = max(1, round((time[-1] - time[0]) / seconds))
    inner = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[1:-1])
    return tuple(int(i) for i in np.unique([0, *inner, len(time) - 1]))
