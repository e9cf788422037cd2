"""What the noise of measured inputs does to the parameters.

Smoothing leaves an error that is small but as slow as the window: the parameters follow it, and residuals
do not show it. So the smoothed noise is drawn anew, and what the parameters would make of it is computed
from the linearisation at the optimum.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.failed import Failed
from fmus.identification.refinement.priors import Priors
from fmus.identification.refinement.problem import Run
from fmus.identification.refinement.shooting import Shooting
from fmus.identification.refinement.smoothing import parabolas
from fmus.identification.refinement.solver import Solution
from fmus.identification.refinement.step import LARGEST, linear

Array = NDArray[np.float64]

DRAWS = 24  # standard deviations are then known to 15 %: one over sqrt(2 n)


def by_inputs(shooting: Shooting, solution: Solution, priors: Priors, seed: int = 0) -> Array:
    """Covariance of z, shape (np, np), by the noise of the inputs."""
    free = len(priors.z)
    if not any(run.input_noise for run in shooting.problem.training):
        return np.zeros((free, free))
    rng = np.random.default_rng(seed)
    now, unbounded = solution.evaluated, (np.full(free, -np.inf), np.full(free, np.inf))
    at_rest = solution.linear.step(now.point.z, unbounded, LARGEST).dz
    changes = []
    for _ in range(DRAWS):
        inputs = tuple(
            u + _noise(run, shooting.simulator.inputs, rng)
            for run, u in zip(shooting.problem.training, shooting.inputs, strict=True)
        )
        try:
            new = replace(shooting, inputs=inputs).evaluate(now.point, solution.scales, False)
        except Failed:
            continue
        step = linear(now, new, priors, shooting.loose).step(now.point.z, unbounded, LARGEST)
        changes.append(step.dz - at_rest)
    found = np.array(changes)
    return np.asarray(found.T @ found / max(1, len(found))) if changes else np.zeros((free, free))


def _noise(run: Run, names: tuple[str, ...], rng: np.random.Generator) -> Array:
    """Smoothed noise of a run's inputs, shape (n, nu)."""
    noise = np.zeros((len(run.time), len(names)))
    for j, name in enumerate(names):
        if name in run.input_noise:
            sd, window = run.input_noise[name]
            noise[:, j] = parabolas(sd * rng.standard_normal(len(run.time)), window)
    return noise
