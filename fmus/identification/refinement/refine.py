"""Joint refinement: all free parameters against all recordings at once, and what it gives.

Output error: the weighted squares of simulation minus measurement, with priors and bounds. Multiple
shooting: the recordings are cut into segments with start states of their own, which have to meet in the
end [Bock 1987]. A bad guess is then corrected by the data every few seconds instead of running away.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fmus.identification.estimate import Estimate, confidence_interval, coverage_factor
from fmus.identification.refinement.compiled_model import CompiledModel
from fmus.identification.refinement.data import input_matrix
from fmus.identification.refinement.gauss_newton import (
    INTERRUPTED,
    STUCK,
    Iteration,
    Options,
    Solution,
    minimise,
)
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.residuals import Traces, Whiteness, simulated, whiteness
from fmus.identification.refinement.shooting import Shooting, cut, parallel
from fmus.identification.refinement.simulation import SimulationFailed, Simulator
from fmus.identification.refinement.statistics import (
    VAGUE,
    Statistics,
    input_covariance,
    statistics,
    unidentified,
)
from fmus.identification.refinement.weights import Loss, Priors, priors
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]

SEGMENT = 2.0  # s
HORIZON = 0.5  # s
_AT_BOUND = 1e-9  # of z
_OPEN = math.log(1000)  # half width in logarithms: a factor of a thousand either way is no interval
FEW = 10  # segments: a standard deviation from so many is known to a quarter, 1 / sqrt(2 (n - 1))


@dataclass(frozen=True)
class Refined:
    """Parameters with what is known about them, and how well they explain the recordings.

    z              of the parameters at the end
    converged, reason   did the search end by itself, and why it ended
    history        one entry per iteration
    unidentified   sentences about parameters that the data leave open
    at_bound       parameters that would have left their bounds
    whiteness      tests per output
    training, held_out   pure simulations of the runs from their starts
    floor          per output: the model's own error as estimated, in standard deviations of the sensor
    starts         per run: the first state, by name
    """

    problem: EstimationProblem
    z: Array
    converged: bool
    reason: str
    history: tuple[Iteration, ...]
    statistics: Statistics
    unidentified: tuple[str, ...]
    at_bound: tuple[str, ...]
    whiteness: Mapping[str, Whiteness]
    training: tuple[Traces, ...]
    held_out: tuple[Traces, ...]
    floor: Mapping[str, float]
    starts: tuple[Mapping[str, float], ...]

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name."""
        return self.problem.by_name(self.z)

    @property
    def robust(self) -> bool:
        """Have the residuals a memory or a size that the sensors do not explain?"""
        return not all(w.white for w in self.whiteness.values() if np.isfinite(w.rms))

    def estimates(
        self, robust: bool | None = None, names: Mapping[str, str] | None = None
    ) -> tuple[Estimate, ...]:
        """One estimate per parameter, called as `names` says.

        robust   intervals over segments instead of the plain ones; by default where residuals ask for it

        Intervals end at a bound if that is nearer, and are open where the data leave the parameter open.
        """
        robust = self.robust if robust is None else robust
        how = "errors over segments" if robust else "errors of independent residuals"
        runs = len(self.problem.training)
        note = f"joint refinement of {len(self.z)} parameters on {runs} recording{'s' * (runs > 1)}, {how}"
        note += "" if self.converged else f"; the search did not converge: {self.reason}"
        sd, freedom = self.statistics.sd(robust), self.statistics.degrees(robust)
        estimates = []
        for free, z, one, lowest, highest in zip(
            self.problem.free, self.z.tolist(), sd.tolist(), *self.problem.bounds(), strict=True
        ):
            vague = one > VAGUE / 2 or (free.log and coverage_factor(freedom) * one > _OPEN)
            width = math.inf if vague else one
            low, high = confidence_interval(z, width, freedom, minimum=lowest, maximum=highest)
            estimates.append(
                Estimate(
                    name=(names or {}).get(free.name, free.name),
                    value=free.value_of(z),
                    unit=free.unit,
                    sd=one * free.slope(z),
                    low=free.value_of(low),
                    high=free.value_of(high),
                    note=note + "; at its bound" * (free.name in self.at_bound),
                )
            )
        return tuple(estimates)

    def fit(self) -> dict[str, dict[str, dict[str, float]]]:
        """NRMSE as use -> run -> output -> number; NaN where an output was not measured."""
        return {
            use: {
                t.run.name: dict(zip(self.problem.outputs, t.nrmse().tolist(), strict=True)) for t in traces
            }
            for use, traces in (("train", self.training), ("test", self.held_out))
        }


def refine(
    problem: EstimationProblem,
    simulator: Simulator | None = None,
    *,
    segment: float = SEGMENT,
    horizon: float = HORIZON,
    threads: int = 2,
    loss: Loss = "linear",
    options: Options | None = None,
    start: Array | None = None,
    progress: Callable[[Iteration], None] | None = None,
) -> Refined:
    """Refine the free parameters of a problem.

    simulator   by default the compiled model with exact sensitivities; others are in `simulation`
    segment     length of a segment [s], infinite for single shooting
    horizon     before, the parameters are fitted to predictions over so many seconds from what is measured;
                not if it is longer than a segment
    start       z to begin with, by default that of the problem
    """
    simulator = simulator or compiled(problem)
    _check(problem, simulator)
    inputs = tuple(input_matrix(run, simulator) for run in problem.training)
    if not simulator.states:  # what cannot be set cannot be cut
        segment = horizon = np.inf
    edges = tuple(cut(run.time, segment) for run in problem.training)
    shooting = Shooting(problem, simulator, inputs, edges, threads, loss)
    z = problem.initial() if start is None else start
    solution, known = _search(shooting, z, horizon if horizon < segment else None, options, progress)
    return _refined(shooting, solution, known)


def compiled(problem: EstimationProblem, tolerance: float = 1e-6) -> CompiledModel:
    """The problem's subsystem with exact sensitivities, compiled on first use."""
    return CompiledModel(problem.sub, problem.outputs, problem.names, problem.fixed, tolerance)


def _check(problem: EstimationProblem, simulator: Simulator) -> None:
    for names, expected, what in (
        (simulator.outputs, problem.outputs, "outputs"),
        (simulator.free, problem.names, "free parameters"),
    ):
        if tuple(names) != tuple(expected):
            raise Problem(f"{problem.sub.name}: {what} of the simulator are {names}, expected {expected}")
    if not problem.training:
        raise Problem(f"{problem.sub.name}: no recording to fit, expected at least one")


def _search(
    shooting: Shooting,
    z: Array,
    horizon: float | None,
    options: Options | None,
    progress: Callable[[Iteration], None] | None,
) -> tuple[Solution, Priors]:
    """Predictions over the horizon first, then whole recordings."""
    problem, simulator = shooting.problem, shooting.simulator
    before: Solution | None = None
    try:
        known = priors(problem, simulator, [states[0] for states in shooting.measured(z).starts])
        if horizon is not None:
            edges = tuple(cut(run.time, horizon) for run in problem.training)
            near = replace(shooting, edges=edges, detached=True)
            before = minimise(near, near.measured(z), known, Options(), progress)
            z = before.evaluated.iterate.z
        return minimise(shooting, shooting.measured(z), known, options or Options(), progress, before), known
    except SimulationFailed as failed:
        raise Problem(
            f"{problem.sub.name}: cannot be simulated with the values to start from: {failed}"
        ) from None


def _refined(shooting: Shooting, solution: Solution, known: Priors) -> Refined:
    """The result of a search: statistics, and pure simulations with the parameters at its end."""
    problem, simulator, last = shooting.problem, shooting.simulator, solution.evaluated.iterate
    z, p = last.z, problem.values_of(last.z)
    begins = [starts[0] * simulator.nominal for starts in last.starts]
    training = parallel(
        lambda k: simulated(problem.training[k], simulator, p, begins[k], shooting.inputs[k]),
        range(len(begins)),
        shooting.threads,
    )
    noise = np.zeros((len(z), len(z)))
    if solution.reason != INTERRUPTED:  # who interrupts does not wait for errors of inputs
        noise = input_covariance(shooting, solution, known)
    result = statistics(solution, known, noise)
    low, high = problem.bounds()
    near = np.minimum(z - low, high - z) < _AT_BOUND
    return Refined(
        problem=problem,
        z=z,
        converged=solution.converged,
        reason=solution.reason,
        history=solution.history,
        statistics=result,
        unidentified=unidentified(problem.free, result.data),
        at_bound=tuple(n for n, bound in zip(problem.names, near, strict=True) if bound),
        whiteness={n: whiteness(training, simulator.inputs, k) for k, n in enumerate(problem.outputs)},
        training=tuple(training),
        held_out=tuple(simulated(run, simulator, p) for run in problem.held_out),
        floor=dict(zip(problem.outputs, solution.scales.floor.tolist(), strict=True)),
        starts=tuple(dict(zip(simulator.states, x.tolist(), strict=True)) for x in begins),
    )


def advice(refined: Refined) -> tuple[str, ...]:
    """How the search ended and how far intervals hold, with what to do; nothing if all is well."""
    sentences = []
    ended = f"The search did not converge: {refined.reason}"
    if refined.converged:
        pass
    elif refined.reason == INTERRUPTED:
        sentences.append(f"{ended}. Values and intervals are those of the best point so far.")
    elif refined.reason == STUCK:
        sentences.append(
            f"{ended}, because a parameter hardly acts or something switches there, such as dry friction or "
            "a stop. The values are the best so far. Hold what the data cannot tell (--free names the "
            "others), or begin from other numbers."
        )
    else:
        sentences.append(
            f"{ended} were not enough. The values are the best so far, the intervals are too narrow. "
            "Look for a signal with a wrong sign or unit, and free fewer parameters (--free)."
        )
    clusters = refined.statistics.clusters
    if refined.robust and clusters == 1:
        sentences.append(
            "There is a single segment, so that nothing tells how far residuals with a memory move values: "
            "the intervals are a guess, and wide. Longer recordings help."
        )
    elif refined.robust and clusters < FEW:
        sentences.append(
            f"The intervals rest on the scatter between {clusters} segments, fewer than {FEW}: "
            "they are wide, and known roughly. Longer recordings help."
        )
    return tuple(sentences)
