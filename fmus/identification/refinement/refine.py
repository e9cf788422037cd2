"""Joint refinement: all free parameters are estimated from all recordings at once.

The output-error method minimises the weighted squares of simulation minus measurement, with priors and
bounds. Multiple shooting cuts the recordings into segments with initial states of their own, which have to be
continuous at the optimum [Bock 1987]. Even with poor initial values the simulation cannot diverge, because
the data correct it at the start of each segment. A first search fits predictions over a short horizon from
measured states, a second one whole recordings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fmus.identification.refinement.compiled_model import CompiledModel
from fmus.identification.refinement.problem import EstimationProblem, MeasuredRun
from fmus.identification.refinement.shooting import (
    CONVERGED,
    INTERRUPTED,
    ITERATIONS,
    STUCK,
    TOLERANCE,
    Iteration,
    Minimum,
    Shooting,
    cut,
    minimise,
    parallel,
)
from fmus.identification.refinement.statistics import (
    VAGUE,
    SimulatedRun,
    Statistics,
    Whiteness,
    input_covariance,
    simulate,
    statistics,
    unidentified,
    whiteness,
)
from fmus.identification.results import Estimate, coverage_factor
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

SEGMENT = 2.0  # s, default length of a segment
HORIZON = 0.5  # s, default prediction horizon of the first search
_AT_BOUND = 1e-9  # distance of z from its bound
_OPEN = math.log(1000)  # an interval of a logarithm with a larger half width is reported as open
FEW = 10  # segments; from so many a standard deviation has an error of a quarter, 1 / sqrt(2 (n - 1))


@dataclass(frozen=True)
class RefinementResult:
    """Estimated parameters with their uncertainty, and how well they explain the recordings.

    z                    search variables of the parameters at the optimum
    reason               why the search ended
    history              one entry per iteration
    unidentified         sentences about parameters that the data do not determine
    at_bound             parameters at one of their bounds
    whiteness            tests of the residuals per signal
    training, held_out   simulations of the runs from their initial states
    model_error          estimated error of the model in standard deviations of each sensor, shape (ny,)
    simulator            with which the parameters were estimated
    """

    problem: EstimationProblem
    z: Array
    reason: str
    history: tuple[Iteration, ...]
    statistics: Statistics
    unidentified: tuple[str, ...]
    at_bound: tuple[str, ...]
    whiteness: Mapping[str, Whiteness]
    training: tuple[SimulatedRun, ...]
    held_out: tuple[SimulatedRun, ...]
    model_error: Array
    simulator: CompiledModel

    @property
    def converged(self) -> bool:
        """Has the search converged?"""
        return self.reason == CONVERGED

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name."""
        return self.problem.by_name(self.z)

    @property
    def robust(self) -> bool:
        """Are the residuals correlated or larger than the sensors explain?"""
        return not all(w.white for w in self.whiteness.values() if np.isfinite(w.rms))

    def estimates(self) -> tuple[Estimate, ...]:
        """One estimate per parameter; its interval comes from the scatter between segments if `robust`.

        Intervals end at a bound if that is nearer, and are open if the data do not determine the parameter.
        """
        robust, problem, runs = self.robust, self.problem, len(self.problem.training)
        basis = "errors over segments" if robust else "errors of independent residuals"
        note = f"joint refinement of {len(self.z)} parameters on {runs} recording{'s' * (runs > 1)}, {basis}"
        note += "" if self.converged else f"; the search did not converge: {self.reason}"
        sd = self.statistics.sd(robust)
        half = coverage_factor(self.statistics.degrees(robust)) * sd
        log = np.array([f.log for f in problem.free])
        half = np.where((sd > VAGUE / 2) | (log & (half > _OPEN)), math.inf, half)
        ends = np.clip([self.z - half, self.z + half], *problem.bounds())
        values, lows, highs = (problem.values_of(z).tolist() for z in (self.z, *ends))
        sds = (sd * problem.derivatives(self.z)).tolist()
        rows = zip(map(problem.label, problem.names), problem.free, values, sds, lows, highs, strict=True)
        return tuple(
            Estimate(name, value, f.unit, own, low, high, note + "; at its bound" * (name in self.at_bound))
            for name, f, value, own, low, high in rows
        )

    def uncertainty(self, run: MeasuredRun) -> tuple[Array, Array]:
        """Derivatives of the outputs over a run by z, shape (n, ny, np), and their uncertainty, (n, ny).

        The second is the standard deviation of measured minus predicted outputs. It contains the covariance
        of the parameters, the errors of a measured initial state, noise of sensors, and error of the model.
        """
        p, outputs = self.problem.values_of(self.z), self.problem.outputs
        state, state_p = run.initial_state(self.simulator, p)
        solution = self.simulator.segment(state, p, run.time, run.delayed(self.simulator, p))
        by_z: Array = (solution.y_p + solution.y_x @ state_p) * self.problem.derivatives(self.z)
        noise = np.array([1 / max(w.max(), np.finfo(float).tiny) if w.any() else 0.0 for w in run.weight.T])
        start = [
            noise[outputs.index(n)] * (n in run.measured_states) if n in outputs else 0.0
            for n in self.simulator.states
        ]
        statistics = self.statistics
        covariance = statistics.robust_covariance if self.robust else statistics.covariance
        variance = np.einsum("kij,jl,kil->ki", by_z, covariance, by_z, optimize=True)
        variance = np.maximum(variance, 0.0) + np.sum((solution.y_x * start) ** 2, axis=-1)
        return by_z, np.sqrt(variance + noise**2 * (1 + self.model_error**2))


def refine(
    problem: EstimationProblem,
    simulator: CompiledModel | None = None,
    *,
    segment: float = SEGMENT,
    horizon: float = HORIZON,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    start: Array | None = None,
    progress: Callable[[Iteration], None] | None = None,
) -> RefinementResult:
    """Estimate the free parameters of a problem.

    simulator   by default the compiled model with exact sensitivities
    segment     length of a segment [s], infinite for single shooting
    horizon     a first search fits predictions over so many seconds [s] from measured states; it is left out
                if the horizon is not shorter than a segment
    tolerance   the search has converged if the best step changes all residuals together by less, in
                standard deviations; no parameter then moves by more than this fraction of its own
    start       initial z, by default that of the problem
    """
    z = problem.initial() if start is None else start
    shooting = cut_into_segments(problem, simulator or compiled(problem), z, segment)
    first = fit_predictions(shooting, z, horizon, progress) if horizon < segment else None
    return result(shooting, minimise(shooting, z, iterations, tolerance, progress, first))


def cut_into_segments(
    problem: EstimationProblem, simulator: CompiledModel, z: Array, segment: float = SEGMENT
) -> Shooting:
    """The recordings of a problem in segments; priors of the initial states are those at z."""
    if not problem.training:
        raise Problem(f"{problem.sub.name}: expected at least one recording to fit, got none")
    if not any(run.compared.any() for run in problem.training):
        names = ", ".join(run.name for run in problem.training)
        raise Problem(f"{names}: expected outputs with usable samples, got only missing or faulty ones")
    edges, p = tuple(cut(run.time, segment) for run in problem.training), problem.values_of(z)
    states = (run.initial_state(simulator, p, corrected=False)[0] for run in problem.training)
    return Shooting(problem, simulator, tuple(state / simulator.nominal for state in states), edges)


def fit_predictions(
    shooting: Shooting,
    z: Array,
    horizon: float = HORIZON,
    progress: Callable[[Iteration], None] | None = None,
) -> Minimum:
    """The first search: predictions over the horizon [s] from measured states."""
    edges = tuple(cut(run.time, horizon) for run in shooting.problem.training)
    return minimise(replace(shooting, edges=edges, detached=True), z, progress=progress)


def result(shooting: Shooting, solution: Minimum) -> RefinementResult:
    """Statistics, and simulations with the estimated parameters."""
    problem, simulator = shooting.problem, shooting.simulator
    z, p = solution.z, problem.values_of(solution.z)
    starts = [states[0] * simulator.nominal for states in solution.linear.at.starts]
    training = parallel(lambda k: simulate(problem.training[k], simulator, p, starts[k]), range(len(starts)))
    by_inputs = np.zeros((len(z), len(z)))
    if solution.reason != INTERRUPTED:  # after an interrupt nobody waits for more simulations
        by_inputs = input_covariance(shooting, solution)
    found = statistics(solution, problem.prior_sd(), by_inputs)
    low, high = problem.bounds()
    bound = np.minimum(z - low, high - z) < _AT_BOUND
    free = [replace(f, name=problem.label(f.name)) for f in problem.free]
    return RefinementResult(
        problem=problem,
        z=z,
        reason=solution.reason,
        history=solution.history,
        statistics=found,
        unidentified=unidentified(free, found.data_covariance),
        at_bound=tuple(f.name for f, at in zip(free, bound, strict=True) if at),
        whiteness={n: whiteness(training, k) for k, n in enumerate(problem.signals)},
        training=tuple(training),
        held_out=tuple(simulate(run, simulator, p) for run in problem.held_out),
        model_error=solution.linear.scales.model_error,
        simulator=simulator,
    )


def compiled(problem: EstimationProblem, tolerance: float = 1e-6) -> CompiledModel:
    """The problem's subsystem with exact sensitivities; the compiled library is cached."""
    return CompiledModel(problem.sub, problem.outputs, problem.names, problem.fixed, tolerance)


def advice(refined: RefinementResult) -> tuple[str, ...]:
    """Sentences on how the search ended and on the validity of the intervals; empty if all is well."""
    segments, outcome = refined.statistics.segments, f"The search did not converge: {refined.reason}"
    ends = {
        CONVERGED: "",
        INTERRUPTED: f"{outcome}. Values and intervals are those of the best point so far.",
        STUCK: f"{outcome}, because a parameter has hardly any effect or the model switches there, such as "
        "dry friction or a stop. The values are the best so far. Fix the parameters that the data do not "
        "determine (--free names the others), or begin from other values.",
    }
    too_few = (
        f"{outcome} were not enough. The values are the best so far, the intervals are too narrow. "
        "Look for a signal with a wrong sign or unit, and free fewer parameters (--free)."
    )
    short = (
        "There is a single segment, from which the effect of correlated residuals cannot be estimated: "
        "the intervals are a guess, and wide. Longer recordings help."
        if segments == 1
        else f"The intervals come from the scatter between {segments} segments, fewer than {FEW}: "
        "they are wide and inaccurate. Longer recordings help."
    )
    sentences = (ends.get(refined.reason, too_few), short if refined.robust and segments < FEW else "")
    return tuple(filter(None, sentences))
