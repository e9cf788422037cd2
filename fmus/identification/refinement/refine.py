"""Joint refinement: all free parameters against all recordings at once.

Output error: the weighted squares of simulation minus measurement, with priors and bounds. Multiple
shooting: the recordings are cut into segments with start states of their own, which have to meet in the
end [Bock 1987]. A bad guess is then corrected by the data every few seconds instead of running away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.data import input_matrix
from fmus.identification.refinement.gauss_newton import INTERRUPTED, Options, Progress, Solution, minimise
from fmus.identification.refinement.problem import EstimationProblem
from fmus.identification.refinement.residuals import simulated, whiteness
from fmus.identification.refinement.result import Refined
from fmus.identification.refinement.shooting import Shooting, cut
from fmus.identification.refinement.simulation import Failed, Model, Simulator, parallel
from fmus.identification.refinement.statistics import by_inputs, statistics, unidentified
from fmus.identification.refinement.weights import Loss, Priors, priors
from orchestrator.base.errors import Problem

Array = NDArray[np.float64]

SEGMENT = 2.0  # s
HORIZON = 0.5  # s
_AT_BOUND = 1e-9  # of z


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
    progress: Callable[[Progress], None] | None = None,
) -> Refined:
    """Refine the free parameters of a problem.

    simulator   by default the compiled model with exact sensitivities; others are in `differences`
    segment     length of a segment [s], infinite for single shooting
    horizon     before, the parameters are fitted to predictions over so many seconds from what is measured;
                not if it is longer than a segment
    start       z to begin with, by default that of the problem
    """
    simulator = simulator or compiled(problem)
    shooting, solution, known = _searched(
        problem, simulator, segment, horizon, threads, loss, options, start, progress
    )
    z = solution.evaluated.point.z
    p = problem.values_of(z)
    begins = [run[0] * simulator.nominal for run in solution.evaluated.point.starts]
    training = parallel(
        lambda k: simulated(problem.training[k], simulator, p, begins[k], shooting.inputs[k]),
        range(len(begins)),
        threads,
    )
    held_out = [simulated(run, simulator, p) for run in problem.held_out]
    done = solution.reason != INTERRUPTED  # who interrupts does not wait for errors of inputs
    noise = by_inputs(shooting, solution, known) if done else np.zeros((len(z), len(z)))
    found = statistics(solution, known, noise)
    low, high = problem.bounds()
    return Refined(
        problem=problem,
        z=z,
        converged=solution.converged,
        reason=solution.reason,
        history=solution.history,
        statistics=found,
        unidentified=unidentified(problem.free, found.data),
        at_bound=tuple(
            n for n, a, b in zip(problem.names, z - low, high - z, strict=True) if min(a, b) < _AT_BOUND
        ),
        whiteness={n: whiteness(training, simulator.inputs, k) for k, n in enumerate(problem.outputs)},
        training=tuple(training),
        held_out=tuple(held_out),
        floor=dict(zip(problem.outputs, solution.scales.floor.tolist(), strict=True)),
        starts=tuple(dict(zip(simulator.states, x.tolist(), strict=True)) for x in begins),
    )


def compiled(problem: EstimationProblem, tolerance: float = 1e-6) -> Model:
    """The problem's subsystem with exact sensitivities, compiled on first use."""
    return Model(problem.sub, problem.outputs, problem.names, problem.fixed, tolerance)


def _searched(
    problem: EstimationProblem,
    simulator: Simulator,
    segment: float,
    horizon: float,
    threads: int,
    loss: Loss,
    options: Options | None,
    start: Array | None,
    progress: Callable[[Progress], None] | None,
) -> tuple[Shooting, Solution, Priors]:
    """Cut, guess a trajectory, search."""
    _check(problem, simulator)
    z = problem.search() if start is None else start
    whole = not simulator.states  # what cannot be set cannot be cut
    inputs = tuple(input_matrix(run, simulator) for run in problem.training)
    edges = tuple(cut(run.time, np.inf if whole else segment) for run in problem.training)
    shooting = Shooting(problem, simulator, inputs, edges, threads, loss)
    before: Solution | None = None
    try:
        known = priors(problem, simulator, [states[0] for states in shooting.guessed(z).starts])
        if horizon < segment and not whole:
            edges = tuple(cut(run.time, horizon) for run in problem.training)
            near = replace(shooting, edges=edges, loose=True)
            before = minimise(near, near.guessed(z), known, Options(), progress)
            z = before.evaluated.point.z
        solution = minimise(shooting, shooting.guessed(z), known, options or Options(), progress, before)
    except Failed as failed:
        raise Problem(
            f"{problem.sub.name}: cannot be simulated with the values to start from: {failed}"
        ) from None
    return shooting, solution, known


def _check(problem: EstimationProblem, simulator: Simulator) -> None:
    for found, expected, what in (
        (simulator.outputs, problem.outputs, "outputs"),
        (simulator.free, problem.names, "free parameters"),
    ):
        if tuple(found) != tuple(expected):
            raise Problem(f"{problem.sub.name}: {what} of the simulator are {found}, expected {expected}")
    if not problem.training:
        raise Problem(f"{problem.sub.name}: no recording to fit, expected at least one")
