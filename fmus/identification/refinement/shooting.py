"""Multiple shooting: the segments of all runs at one iterate, their condensed least squares, the search.

Each segment i of a run, with initial state s_i and parameters z, is linearised to

    residuals    r_i + J_i (ds_i, dz)          QR of (J_i, r_i): as many rows as columns matter
    continuity   d_i + X_i ds_i + P_i dz - ds_(i+1) = 0

The recursion writes every ds_i as a function of (ds_0, dz) [condensing: Bock and Plitt 1984]; a second QR per
run eliminates ds_0. The condensed problem has as many rows and columns as there are parameters.
States are scaled by their nominal values throughout.

QR works on small blocks (tall-skinny QR), for which the linear algebra library starts no threads. Segments
already run in threads, and the two kinds of threads would block each other.

The search is Gauss-Newton with bounds over all unknowns, globalised by a trust region. The merit of an
iterate is the sum of squared residuals that remains once the linearisation has closed the continuity defects
between segments. Defects thus count by their effect on the residuals, and no penalty has to be chosen. If the
merit does not decrease as predicted, the step of the parameters is damped [Levenberg, Marquardt] and a
smaller fraction of it is taken. Damping, unlike shortening alone, slows down mainly the parameters that the
data hardly determine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fmus.identification.recordings.masks import autocorrelation_time
from fmus.identification.refinement.compiled_model import CompiledModel, SimulationFailed
from fmus.identification.refinement.problem import EstimationProblem
from orchestrator.base.errors import Problem
from orchestrator.base.signals import rms
from orchestrator.data.table import Array

Task = TypeVar("Task")
Result = TypeVar("Result")

THREADS = 2  # segments simulated at a time
_HEIGHT = 3  # rows of a block per column: each level of the tree has a third of the rows of the level before
_LONGEST = 0.05  # largest correlation time, as a fraction of the samples; beyond that a residual is a trend
SD_AT_REST = 1e-3  # prior standard deviation of an initial state that is at rest, in nominal values
SD_UNKNOWN = 1.0  # the same for any other initial state
_STIFF = 1e6  # factor of the prior that fixes the initial state of a detached run
CONVERGED = "converged"
STUCK = "no step reduces the residuals"
INTERRUPTED = "interrupted"
TOLERANCE = 0.1  # standard deviations
ITERATIONS = 100
SMALLEST_RADIUS = 1e-5  # change of z; the search gives up if the linearisation does not hold even for that
SMALLEST_FRACTION = 1e-4  # fraction of a step; the search gives up below
LARGEST_RADIUS = 10.0  # change of z
_ACCEPTED = 0.01  # a step is accepted from this fraction of the predicted decrease on
_GOOD = 0.5  # the trust region grows from this fraction on
CLOSED = 1e-4  # nominal values; smaller continuity defects are negligible
DETACHED = 3.0  # standard deviations; tolerance of the search with detached segments
SETTLED = 0.05  # relative change of the scales that is negligible


@dataclass(frozen=True)
class Scales:
    """Scales of the residuals, per output.

    model_error        standard deviation of the model's own error in those of the sensor, 0 for none
    correlation_time   of the residuals [samples]: so many samples count as one
    """

    model_error: Array
    correlation_time: Array

    @property
    def sd(self) -> Array:
        """By this a residual in standard deviations of the sensor is divided."""
        return np.asarray(np.hypot(1.0, self.model_error) * np.sqrt(self.correlation_time))

    def change(self, other: Scales) -> float:
        """Largest relative difference."""
        errors = np.hypot(1.0, other.model_error) / np.hypot(1.0, self.model_error)
        times = np.sqrt(other.correlation_time) / np.sqrt(self.correlation_time)
        return float(np.max(np.abs(np.append(errors, times) - 1)))


def correlation_time(residual: Array) -> float:
    """Correlation time of a residual [samples], at least 1 and at most a fraction of all samples."""
    n = len(residual)
    if n < 4 or not float(residual @ residual) > 0:
        return 1.0
    return min(max(1.0, autocorrelation_time(residual)), max(1.0, _LONGEST * n))


def parallel(function: Callable[[Task], Result], tasks: Sequence[Task]) -> list[Result]:
    """Results in the order of the tasks; an interrupt cancels the tasks that have not begun."""
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(function, tasks))


def triangular(rows: Array) -> Array:
    """R of the QR factorisation: the same least-squares problem in as few rows as possible."""
    columns = rows.shape[1]
    while len(rows) > (height := max(1, _HEIGHT * columns)):
        padded = np.zeros((-(-len(rows) // height) * height, columns))
        padded[: len(rows)] = rows
        rows = np.asarray(np.linalg.qr(padded.reshape(-1, height, columns), mode="r")).reshape(-1, columns)
    return np.asarray(np.linalg.qr(rows, mode="r"))


@dataclass(frozen=True)
class CondensedRun:
    """One run condensed to rows [initial state | parameters | residual].

    recursion   per segment, shape (nx, nx + np + 1): ds_i = recursion (ds_0, dz, 1)
    blocks      per segment, its rows
    top         of the triangular form, the rows that determine the initial state of the run, nx of them
    bottom      the rows [parameters | residual] that remain
    """

    recursion: Sequence[Array]
    blocks: Sequence[Array]
    top: Array
    bottom: Array

    def states(self, dz: Array) -> Array:
        """ds_i of all segments for a step dz of the parameters, shape (segments, nx)."""
        nx = len(self.top)
        ds_0 = -np.linalg.solve(self.top[:, :nx], self.top[:, nx:-1] @ dz + self.top[:, -1])
        return np.asarray(np.array(self.recursion) @ np.concatenate([ds_0, dz, [1.0]]))


def condense(residuals: Sequence[Array], ends: Sequence[Array], prior: Array) -> CondensedRun:
    """Condense one run.

    residuals   per segment, rows (J_i, r_i)
    ends        per segment but the last, rows (X_i, P_i, d_i)
    prior       of the initial state, nx rows of the same columns
    """
    nx = len(prior)

    def from_start(rows: Array, recursion: Array) -> Array:
        """Rows for (ds_i, dz, 1) as rows for (ds_0, dz, 1)."""
        result: Array = rows[:, :nx] @ recursion
        result[:, nx:] += rows[:, nx:]
        return result

    recursion: list[Array] = [np.eye(nx, prior.shape[1])]
    for end in ends:
        recursion.append(from_start(end, recursion[-1]))
    blocks = [from_start(rows, r) for rows, r in zip(residuals, recursion, strict=True)]
    triangle = triangular(np.vstack([prior, *blocks]))
    return CondensedRun(recursion, blocks, triangle[:nx], triangle[nx:, nx:])


@dataclass(frozen=True)
class Segment:
    """One simulated segment; the derivatives are empty if no sensitivities were computed.

    residual   in standard deviations of the sensor, shape (m,)
    column     index of the output of each residual, shape (m,)
    end        final state in nominal values, shape (nx,)
    jacobian   of the residual by initial state and parameters, shape (m, nx + np)
    end_by     derivatives of the final state by the same, shape (nx, nx + np)
    """

    residual: Array
    column: NDArray[np.int64]
    end: Array
    jacobian: Array
    end_by: Array


@dataclass(frozen=True)
class Evaluation:
    """The segments of each run at an iterate.

    z        of the parameters, shape (np,)
    starts   per run the initial states in nominal values, shape (segments, nx)
    """

    z: Array
    starts: tuple[Array, ...]
    runs: tuple[tuple[Segment, ...], ...]

    def defects(self, k: int) -> list[Array]:
        """Continuity defects of a run: final state of a segment minus initial state of the next."""
        pairs = zip(self.runs[k][:-1], self.starts[k][1:], strict=True)
        return [segment.end - start for segment, start in pairs]

    def continuous(self, tolerance: float) -> bool:
        """Are all continuity defects smaller than a tolerance?"""
        defects = [d for k in range(len(self.runs)) for d in self.defects(k)]
        return bool(np.all(np.abs(defects) < tolerance))

    @property
    def segments(self) -> list[Segment]:
        """The segments of all runs, in the order of time."""
        return [segment for run in self.runs for segment in run]

    @cached_property
    def residual(self) -> Array:
        """The residuals of all segments, shape (m,)."""
        return np.concatenate([s.residual for s in self.segments])

    @cached_property
    def column(self) -> NDArray[np.int64]:
        """Index of the output of each residual, shape (m,)."""
        return np.concatenate([s.column for s in self.segments])

    def scales(self, outputs: int, correlated: bool) -> Scales:
        """Scales estimated from the residuals of each output.

        correlated   weight them by their correlation time, so that slow ones do not outweigh fast ones
        """
        residuals = [self.residual[self.column == k] for k in range(outputs)]
        error = [np.sqrt(max(0.0, float(np.mean(r**2)) - 1)) if r.size else 0.0 for r in residuals]
        times = [correlation_time(r) if correlated else 1.0 for r in residuals]
        return Scales(np.array(error), np.array(times))


@dataclass(frozen=True)
class Shooting:
    """A problem cut into segments.

    prior_states   per run the mean of the prior of its initial state, in nominal values
    edges          per run the indices of the samples at which segments begin, and of the last sample
    detached       segments begin at measured states and need not be continuous: prediction over their length
    """

    problem: EstimationProblem
    simulator: CompiledModel
    prior_states: tuple[Array, ...]
    edges: tuple[tuple[int, ...], ...]
    detached: bool = False

    def measured_starts(self, z: Array) -> tuple[Array, ...]:
        """Measured initial states; states that are not measured are simulated."""
        p, runs = self.problem.values_of(z), self.problem.training

        def states(k: int) -> Array:
            return runs[k].segment_states(self.simulator, p, self.edges[k]) / self.simulator.nominal

        return tuple(parallel(states, range(len(self.edges))))

    def start_prior(self, k: int, state: Array) -> Array:
        """Rows [initial state | parameters | residual] of the prior of a run's initial state."""
        at_rest = [name in self.problem.training[k].at_rest for name in self.simulator.states]
        weight = 1 / np.where(at_rest, SD_AT_REST, SD_UNKNOWN)
        residual = (state - self.prior_states[k]) * weight
        none = np.zeros((len(weight), len(self.problem.free)))
        return np.column_stack([np.diag(weight), none, residual])

    def evaluate(self, z: Array, starts: tuple[Array, ...], sensitivities: bool = True) -> Evaluation:
        """Simulate all segments; raises SimulationFailed."""
        p, p_z = self.problem.values_of(z), self.problem.derivatives(z)
        nominal = self.simulator.nominal
        inputs_of = [run.delayed(self.simulator, p) for run in self.problem.training]

        def segment(task: tuple[int, int]) -> Segment:
            k, i = task
            run, (first, last) = self.problem.training[k], self.edges[k][i : i + 2]
            time, inputs = run.time[first : last + 1], inputs_of[k][..., first : last + 1, :]
            solution = self.simulator.segment(starts[k][i] * nominal, p, time, inputs, sensitivities)
            count = last - first + (i == len(self.edges[k]) - 2)  # a sample on an edge counts once
            weight = run.weight[first : first + count]
            used = weight > 0
            w, column = weight[used], np.nonzero(used)[1]
            residual = (solution.y[:count][used] - run.measured[first : first + count][used]) * w
            jacobian = end_by = np.empty((0, 0))
            if sensitivities:
                by = np.hstack([solution.y_x[:count][used] * nominal, solution.y_p[:count][used] * p_z])
                jacobian = by * w[:, None]
                end_by = np.hstack([solution.x_x * nominal, solution.x_p * p_z]) / nominal[:, None]
            return Segment(residual, column, solution.x / nominal, jacobian, end_by)

        tasks = [(k, i) for k, edges in enumerate(self.edges) for i in range(len(edges) - 1)]
        segments = iter(parallel(segment, tasks))
        return Evaluation(z, starts, tuple(tuple(next(segments) for _ in e[1:]) for e in self.edges))


@dataclass(frozen=True)
class Linearisation:
    """The runs condensed around an iterate; rows [parameters | residual] of the runs and the priors.

    at       the iterate, with its residuals and defects
    scales   by which the residuals are divided
    """

    at: Evaluation
    scales: Scales
    runs: tuple[CondensedRun, ...]
    rows: Array

    def merit(self, dz: Array | None = None) -> float:
        """Sum of squared residuals with the defects closed, after a step dz if one is given."""
        if dz is not None:
            return float(np.sum((self.rows[:, -1] + self.rows[:, :-1] @ dz) ** 2))
        starts = sum(float(np.sum(run.top[:, -1] ** 2)) for run in self.runs)
        return float(np.sum(self.rows[:, -1] ** 2)) + starts

    def step(self, radius: float, bounds: tuple[Array, Array] | None = None) -> Array:
        """Damped least squares within bounds of z, dz; `radius` is the change of z that is hardly damped."""
        z = self.at.z
        damping = np.eye(len(z), len(z) + 1) / radius
        triangle = triangular(np.vstack([self.rows, damping]))
        least, largest = bounds or (np.full(len(z), -np.inf), np.full(len(z), np.inf))
        low, high = np.minimum(least - z, 0.0), np.maximum(largest - z, 0.0)
        dz: Array = lsq_linear(triangle[:, :-1], -triangle[:, -1], (low, high), method="bvls").x
        return dz


def linearise(shooting: Shooting, old: Evaluation, new: Evaluation, scales: Scales) -> Linearisation:
    """Linearisation of `old`, residuals and defects of `new`; without defects if segments are detached."""

    def rows(pair: tuple[Segment, Segment]) -> Array:
        segment, other = pair
        both = np.column_stack([segment.jacobian, other.residual])
        return triangular(both / scales.sd[segment.column, None])

    pairs = zip(old.segments, new.segments, strict=True)
    residuals, runs = iter(parallel(rows, list(pairs))), []
    for k, segments in enumerate(old.runs):
        defects, start = new.defects(k), shooting.start_prior(k, new.starts[k][0])
        ends = [np.column_stack([s.end_by, d]) for s, d in zip(segments[:-1], defects, strict=True)]
        if shooting.detached:
            ends = [0 * end for end in ends]
            start[:, : len(start)] *= _STIFF
        runs.append(condense([next(residuals) for _ in segments], ends, start))
    sd = shooting.problem.prior_sd()
    priors = np.column_stack([np.eye(len(new.z)), new.z - shooting.problem.initial()]) / sd[:, None]
    rows_of_all = np.vstack([*(run.bottom for run in runs), priors[np.isfinite(sd)]])
    return Linearisation(new, scales, tuple(runs), rows_of_all)


def cut(time: Array, seconds: float) -> tuple[int, ...]:
    """Indices that cut `time` into segments of about `seconds` and about equal length."""
    count = max(1, round((time[-1] - time[0]) / seconds))
    inner = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[1:-1])
    return tuple(int(i) for i in np.unique([0, *inner, len(time) - 1]))


# ---- search ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Iteration:
    """One iteration.

    residual     root mean square of the residuals, 1 if the sensors explain them
    remaining    predicted change of all residuals by the best step, in standard deviations
    parameters   values by name
    """

    iteration: int
    residual: float
    remaining: float
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Minimum:
    """The end of a search: the last iterate with its linearisation, the reason of the end."""

    linear: Linearisation
    history: tuple[Iteration, ...]
    reason: str

    @property
    def z(self) -> Array:
        """z of the parameters."""
        return self.linear.at.z


def minimise(
    shooting: Shooting,
    z: Array,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    progress: Callable[[Iteration], None] | None = None,
    previous: Minimum | None = None,
) -> Minimum:
    """Search from z, or from the end of the search `previous`, with measured initial states.

    After an interrupt, or if no step reduces the merit, the result is the best iterate so far.
    Far from the optimum, each output is weighted by its residuals without their correlation.

    Raises Problem if the start cannot be simulated.
    """
    problem, outputs = shooting.problem, len(shooting.problem.outputs)
    z = previous.z if previous else z
    try:
        start = shooting.evaluate(z, shooting.measured_starts(z))
    except SimulationFailed as failed:
        what = "cannot be simulated with the initial parameter values"
        raise Problem(f"{problem.sub.name}: {what}: {failed}") from None
    linear = linearise(shooting, start, start, start.scales(outputs, correlated=False))
    history, reason = list(previous.history) if previous else [], f"{iterations} iterations"
    if previous and previous.reason == INTERRUPTED:
        return Minimum(linear, tuple(history), INTERRUPTED)
    far, trust = True, (1.0, 1.0)
    try:
        for _ in range(iterations):
            current = linear.at
            best = linear.merit(linear.step(LARGEST_RADIUS, problem.bounds()))
            remaining = math.sqrt(max(0.0, linear.merit() - best))
            history.append(
                Iteration(len(history), rms(current.residual), remaining, problem.by_name(current.z))
            )
            if progress:
                progress(history[-1])
            scales = current.scales(outputs, correlated=not far)
            settled = scales.change(linear.scales) < SETTLED
            converged = settled and not far and remaining < tolerance and current.continuous(CLOSED)
            if remaining < DETACHED if shooting.detached else converged:
                reason = CONVERGED
                break
            if far and settled and remaining < 1:
                far, scales = False, current.scales(outputs, correlated=True)
            new, trust = _next(shooting, linear, trust)
            if new is None:
                reason = STUCK
                break
            linear = linearise(shooting, new, new, scales)
    except KeyboardInterrupt:
        reason = INTERRUPTED
    return Minimum(linear, tuple(history), reason)


def _next(
    shooting: Shooting, linear: Linearisation, trust: tuple[float, float]
) -> tuple[Evaluation | None, tuple[float, float]]:
    """The next iterate, None if no step reduces the merit.

    trust   how far the linearisation is trusted: change of z, and fraction of a step; also the second result

    Along a step, of which the whole is predicted to decrease the merit by `full`, the merit decreases by
    2 full t - c t^2. The decrease at the fraction t that was taken determines c, and c the best t.
    """
    (radius, fraction), current, merit = trust, linear.at, linear.merit()
    slack = 1e-9 * merit  # rounding and the solver's error
    while radius > SMALLEST_RADIUS and fraction > SMALLEST_FRACTION:
        dz = linear.step(radius, shooting.problem.bounds())
        full = max(merit - linear.merit(dz), 0.0)
        predicted = full * fraction * (2 - fraction)
        z, runs = current.z + fraction * dz, zip(current.starts, linear.runs, strict=True)
        try:
            if shooting.detached:
                starts = shooting.measured_starts(z)
            else:
                starts = tuple(states + fraction * run.states(dz) for states, run in runs)
            new = shooting.evaluate(z, starts)
            decrease = merit - linearise(shooting, current, new, linear.scales).merit() + slack
        except SimulationFailed:
            decrease = -math.inf
        if decrease > _ACCEPTED * predicted:
            curvature = (2 * full * fraction - decrease) / fraction**2
            best = full / curvature if curvature > 0 else 1.0
            if decrease > _GOOD * predicted:
                radius = min(LARGEST_RADIUS, 3 * radius)
            return new, (radius, float(np.clip(best, fraction / 2, min(1.0, 2 * fraction))))
        radius, fraction = radius / 4, fraction / 2
    return None, (radius, fraction)
