"""How well the data determine the parameters: covariances, correlations, what they cannot tell.

Everything is in the search variable z, relative changes for most parameters. The starts of the runs are
unknown too; their uncertainty is in all numbers.

What the noise of measured inputs does to the parameters.

Smoothing leaves an error that is small but as slow as the window: the parameters follow it, and residuals
do not show it. So the smoothed noise is drawn anew, and what the parameters would make of it is computed
from the linearisation at the optimum.

Names of what the data cannot tell: single parameters, and those of which only a combination shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fmus.identification.refinement.data import parabolas
from fmus.identification.refinement.gauss_newton import LARGEST, Solution, linear
from fmus.identification.refinement.problem import Free, Run
from fmus.identification.refinement.shooting import Local, Shooting, spread
from fmus.identification.refinement.simulation import Failed
from fmus.identification.refinement.weights import Priors

Array = NDArray[np.float64]

VAGUE = 100.0  # of z: a standard deviation given to everything, so that all numbers stay finite


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

    def quantile(self, robust: bool) -> float:
        """Half width of a 95 % interval in standard deviations."""
        return float(student.ppf(0.975, max(1, self.clusters - 1) if robust else self.freedom))

    @property
    def correlation(self) -> Array:
        """Of the plain covariance."""
        sd = self.sd(False)
        return np.asarray(self.plain / np.outer(sd, sd))


def statistics(solution: Solution, priors: Priors, inputs: Array) -> Statistics:
    """Statistics at the point where a search ended; `inputs` is the covariance by the noise of inputs."""
    free = len(priors.z)
    segments = [s for run in solution.evaluated.runs for s in run]
    weighted = np.concatenate([s.residual * s.factor for s in segments])
    counted = sum(float(np.sum(1 / solution.scales.memory[s.column])) for s in segments)
    freedom = max(1, round(counted) - free - sum(len(run.top) for run in solution.linear.runs))
    variance = float(weighted @ weighted) / freedom
    data = np.vstack([run.bottom[:, :-1] for run in solution.linear.runs])
    known = np.diag(1 / priors.z_sd**2 + 1 / VAGUE**2)
    information = data.T @ data
    lengths = np.linalg.norm(data, axis=0)
    singular = np.linalg.svd(data / np.where(lengths > 0, lengths, 1.0), compute_uv=False)
    clusters = influences(solution, priors)
    smallest = float(singular[-1]) if len(data) >= free else 0.0
    return Statistics(
        plain=_inverse(information / variance + known) + inputs,
        clustered=_clustered(clusters, information + known, priors) + inputs,
        data=_inverse(information / variance + np.eye(free) / VAGUE**2) + inputs,
        inputs=inputs,
        residual=variance,
        freedom=freedom,
        clusters=len(clusters),
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


def _clustered(clusters: Sequence[Array], information: Array, priors: Priors) -> Array:
    """Jackknife over clusters [CR3: Bell and McCaffrey 2002]; the priors are one more, of known variance."""
    count = len(clusters)
    changes = np.array(clusters)
    inverse = _inverse(information)
    prior = inverse @ np.diag(1 / priors.z_sd**2 + 1 / VAGUE**2) @ inverse
    return np.asarray((count - 1) / count * changes.T @ changes + prior) if count > 1 else inverse


def influences(solution: Solution, priors: Priors) -> list[Array]:
    """By how much z changes, to first order, without each segment."""
    found: list[Array] = []
    free = len(priors.z)
    known = np.diag(1 / priors.z_sd**2 + 1 / VAGUE**2)
    bottoms = [run.bottom[:, :-1].T @ run.bottom[:, :-1] for run in solution.linear.runs]
    for k, (run, segments) in enumerate(zip(solution.linear.runs, solution.evaluated.runs, strict=True)):
        nx = len(run.top)
        others = sum((b for j, b in enumerate(bottoms) if j != k), known)
        whole = np.zeros((nx + free, nx + free))
        whole[nx:, nx:] = others + bottoms[k]
        whole += run.top[:, :-1].T @ run.top[:, :-1]
        for segment, chain in zip(segments, run.recursion, strict=True):
            assert isinstance(segment.local, Local)
            rows = spread(segment.local, chain, segment.projected(segment))
            gradient, own = rows[:, :-1].T @ rows[:, -1], rows[:, :-1].T @ rows[:, :-1]
            found.append((_inverse(whole - own) @ gradient)[nx:])
    return found


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


LIMIT = 0.5  # of z: a combination with a larger standard deviation is not determined by the data
_TAKES_PART = 0.05  # share of a parameter in such a combination, and bond between two, that count


def unidentified(free: tuple[Free, ...], data: Array, limit: float = LIMIT) -> tuple[str, ...]:
    """One sentence per group of parameters that the data leave open.

    data   covariance of z by the data alone, shape (np, np)
    """
    variances, vectors = np.linalg.eigh(data)
    open_ = vectors[:, variances > limit**2]
    bond = open_ @ open_.T  # projector on what is open: its blocks are the groups
    return tuple(
        _sentence([free[j] for j in group], bond[np.ix_(group, group)], data[np.ix_(group, group)])
        for group in _groups(bond)
    )


def _groups(bond: Array) -> list[list[int]]:
    """Parameters that hang together."""
    left = [j for j in range(len(bond)) if bond[j, j] > _TAKES_PART]
    groups = []
    while left:
        group, new = [left[0]], [left[0]]
        while new:
            j = new.pop()
            more = [i for i in left if i not in group and abs(bond[i, j]) > _TAKES_PART]
            group, new = group + more, new + more
        left = [j for j in left if j not in group]
        groups.append(sorted(group))
    return groups


def _sentence(group: list[Free], bond: Array, data: Array) -> str:
    names = [f.name for f in group]
    dimension = round(float(np.trace(bond)))
    if len(names) == 1:
        sd = float(np.sqrt(data[0, 0]))
        told = "do not show it" if sd > 0.5 * VAGUE else f"leave it open by {100 * sd:.0f} %"
        if group[0].sd is not None:
            return (
                f"{names[0]}: these recordings alone {told}; its interval is that of what was known before, "
                "such as from the bench"
            )
        return f"{names[0]}: the data {told}"
    listed = ", ".join(names[:-1]) + f" and {names[-1]}"
    if len(names) == 2 and dimension == 1 and all(f.log for f in group):
        return f"{listed}: the data show only {_together(names, bond)}, not each"
    return f"{listed}: the data show {len(names) - dimension} of {len(names)} combinations"


def _together(names: list[str], bond: Array) -> str:
    """What stays the same along the open direction (a, b) of two logarithms: z_1 - a / b z_2."""
    exponent = float(bond[0, 1] / bond[1, 1])
    power = "" if abs(abs(exponent) - 1) < 0.05 else f"^{abs(exponent):.2g}"
    return f"{names[0]} {'/' if exponent > 0 else '*'} {names[1]}{power}"
