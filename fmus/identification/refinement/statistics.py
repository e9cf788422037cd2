"""How well the data determine the parameters: covariances, noise of inputs, what the data leave open.

Everything is in the search variable z, relative changes for most parameters. The starts of the runs are
unknown too; their uncertainty is in all numbers.

Noise of measured inputs: smoothing leaves an error that is small but as slow as the window. The parameters
follow it, and residuals do not show it. So the smoothed noise is drawn anew, and what the parameters would
make of it is computed from the linearisation at the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fmus.identification.refinement.data import parabolas
from fmus.identification.refinement.gauss_newton import LARGEST, Solution, linearise
from fmus.identification.refinement.problem import FreeParameter, MeasuredRun
from fmus.identification.refinement.shooting import Shooting
from fmus.identification.refinement.simulation import SimulationFailed
from fmus.identification.refinement.weights import Priors

Array = NDArray[np.float64]

VAGUE = 100.0  # of z: a standard deviation given to everything, so that all numbers stay finite
DRAWS = 24  # of the inputs' noise: standard deviations are then known to 15 %, one over sqrt(2 n)
LIMIT = 0.5  # of z: a combination with a larger standard deviation is not determined by the data
_TAKES_PART = 0.05  # share of a parameter in such a combination, and bond between two, that count


@dataclass(frozen=True)
class Statistics:
    """Covariances of z, shape (np, np), and what they rest on.

    plain        right if residuals are independent, but for the memory that the search saw in them
    clustered    over segments, honest for residuals with a memory no longer than a segment
    data         that of the data alone, without priors
    residual     variance of a weighted residual, 1 if its weight is right
    freedom      samples that count, those of one memory as one, minus unknowns
    clusters     number of segments
    condition    of the Jacobian of the data, columns scaled to length one
    inputs       the part of the covariances that comes from the noise of measured inputs
    """

    plain: Array
    clustered: Array
    data: Array
    residual: float
    freedom: int
    clusters: int
    condition: float
    inputs: Array | None = None

    def sd(self, robust: bool) -> Array:
        """Standard deviations of z."""
        return np.sqrt(np.diag(self.clustered if robust else self.plain))

    def degrees(self, robust: bool) -> int:
        """Degrees of freedom of these standard deviations."""
        return max(1, self.clusters - 1) if robust else self.freedom

    @property
    def correlation(self) -> Array:
        """Of the plain covariance."""
        sd = self.sd(False)
        return np.asarray(self.plain / np.outer(sd, sd))


def statistics(solution: Solution, priors: Priors, inputs: Array) -> Statistics:
    """Statistics where a search ended; `inputs` is the covariance by the noise of inputs."""
    free = len(priors.z)
    segments = [s for run in solution.evaluated.runs for s in run]
    weighted = np.concatenate([s.residual * s.factor for s in segments])
    counted = sum(float(np.sum(1 / solution.scales.memory[s.column])) for s in segments)
    freedom = max(1, round(counted) - free - sum(len(run.top) for run in solution.linear.runs))
    variance = float(weighted @ weighted) / freedom
    data = np.vstack([run.bottom[:, :-1] for run in solution.linear.runs])
    prior = np.diag(1 / priors.z_sd**2 + 1 / VAGUE**2)
    information = data.T @ data
    lengths = np.linalg.norm(data, axis=0)
    singular = np.linalg.svd(data / np.where(lengths > 0, lengths, 1.0), compute_uv=False)
    smallest = float(singular[-1]) if len(data) >= free else 0.0
    return Statistics(
        plain=_inverse(information / variance + prior) + inputs,
        clustered=_clustered(solution, prior, _inverse(information + prior)) + inputs,
        data=_inverse(information / variance + np.eye(free) / VAGUE**2) + inputs,
        inputs=inputs,
        residual=variance,
        freedom=freedom,
        clusters=len(segments),
        condition=float(singular[0]) / smallest if smallest > 0 else float("inf"),
    )


def _inverse(matrix: Array) -> Array:
    """Of a positive definite matrix; scaled, because the magnitudes differ widely.

    What rounding has made of zero is not taken for information: eigenvalues stay above it.
    """
    diagonal = np.diag(matrix)
    scale = 1 / np.sqrt(np.maximum(diagonal, np.finfo(float).eps * max(diagonal.max(), 1.0)))
    sizes, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    sizes = np.maximum(sizes, np.finfo(float).eps * (sizes[-1] or 1.0))  # 1: no information at all
    return np.asarray((vectors / sizes) @ vectors.T * np.outer(scale, scale))


def _clustered(solution: Solution, prior: Array, inverse: Array) -> Array:
    """Jackknife over segments [CR3: Bell and McCaffrey 2002]; the priors are one more, of known variance.

    Each segment is left out in turn, and z changes by what the others ask for, to first order.
    """
    changes: list[Array] = []
    bottoms = [run.bottom[:, :-1].T @ run.bottom[:, :-1] for run in solution.linear.runs]
    for run, segments in zip(solution.linear.runs, solution.evaluated.runs, strict=True):
        nx = len(run.top)
        whole = np.zeros((nx + len(prior), nx + len(prior)))
        whole[nx:, nx:] = sum(bottoms, prior)
        whole += run.top[:, :-1].T @ run.top[:, :-1]
        for segment, recursion in zip(segments, run.recursion, strict=True):
            assert segment.linear is not None
            rows = segment.linear.condensed(recursion, segment.projected(segment))
            own, gradient = rows[:, :-1].T @ rows[:, :-1], rows[:, :-1].T @ rows[:, -1]
            changes.append((_inverse(whole - own) @ gradient)[nx:])
    count, all_changes = len(changes), np.array(changes)
    if count == 1:
        return inverse
    return np.asarray((count - 1) / count * all_changes.T @ all_changes + inverse @ prior @ inverse)


def input_covariance(shooting: Shooting, solution: Solution, priors: Priors) -> Array:
    """Covariance of z, shape (np, np), by the noise of the inputs."""
    free = len(priors.z)
    if not any(run.input_noise for run in shooting.problem.training):
        return np.zeros((free, free))
    rng = np.random.default_rng(0)
    now, unbounded = solution.evaluated, (np.full(free, -np.inf), np.full(free, np.inf))
    reference = solution.linear.step(now.iterate.z, unbounded, LARGEST)
    changes = []
    for _ in range(DRAWS):
        inputs = tuple(
            u + _smoothed_noise(run, shooting.simulator.inputs, rng)
            for run, u in zip(shooting.problem.training, shooting.inputs, strict=True)
        )
        try:
            new = replace(shooting, inputs=inputs).evaluate(now.iterate, solution.scales, False)
        except SimulationFailed:
            continue
        step = linearise(now, new, priors, shooting.detached).step(now.iterate.z, unbounded, LARGEST)
        changes.append(step - reference)
    drawn = np.array(changes).reshape(-1, free)
    return np.asarray(drawn.T @ drawn / max(1, len(drawn)))


def _smoothed_noise(run: MeasuredRun, names: tuple[str, ...], rng: np.random.Generator) -> Array:
    """Noise of a run's inputs as smoothing leaves it, shape (n, nu)."""
    noise = np.zeros((len(run.time), len(names)))
    for j, name in enumerate(names):
        if name in run.input_noise:
            sd, window = run.input_noise[name]
            noise[:, j] = parabolas(sd * rng.standard_normal(len(run.time)), window)
    return noise


def unidentified(free: tuple[FreeParameter, ...], data: Array) -> tuple[str, ...]:
    """One sentence per group of parameters that the data leave open, alone or in combination.

    data   covariance of z by the data alone, shape (np, np)
    """
    variances, vectors = np.linalg.eigh(data)
    undetermined = vectors[:, variances > LIMIT**2]
    bond = undetermined @ undetermined.T  # projector: its blocks are the groups
    left = [j for j in range(len(bond)) if bond[j, j] > _TAKES_PART]
    sentences = []
    while left:
        group, new = [left[0]], [left[0]]
        while new:
            j = new.pop()
            more = [i for i in left if i not in group and abs(bond[i, j]) > _TAKES_PART]
            group, new = group + more, new + more
        left = [j for j in left if j not in group]
        group.sort()
        own = np.ix_(group, group)
        sentences.append(_sentence([free[j] for j in group], bond[own], data[own]))
    return tuple(sentences)


def _sentence(group: list[FreeParameter], bond: Array, data: Array) -> str:
    names = [f.name for f in group]
    dimension = round(float(np.trace(bond)))
    if len(names) == 1:
        sd = float(np.sqrt(data[0, 0]))
        reason = "do not show it" if sd > 0.5 * VAGUE else f"leave it open by {100 * sd:.0f} %"
        if group[0].sd is None:
            return f"{names[0]}: the data {reason}"
        return (
            f"{names[0]}: these recordings alone {reason}; its interval is that of what was known before, "
            "such as from the bench"
        )
    listed = ", ".join(names[:-1]) + f" and {names[-1]}"
    if len(names) > 2 or dimension > 1 or not all(f.log for f in group):
        return f"{listed}: the data show {len(names) - dimension} of {len(names)} combinations"
    # along the undetermined direction (a, b) of two logarithms z_1 - a / b z_2 stays the same
    exponent = float(bond[0, 1] / bond[1, 1])
    power = "" if abs(abs(exponent) - 1) < 0.05 else f"^{abs(exponent):.2g}"
    together = f"{names[0]} {'/' if exponent > 0 else '*'} {names[1]}{power}"
    return f"{listed}: the data show only {together}, not each"
