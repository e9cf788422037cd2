"""How well the data determine the parameters: covariances, correlations, what they cannot tell.

Everything is in the search variable z, relative changes for most parameters. The starts of the runs are
unknown too; their uncertainty is in all numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fmus.identification.refinement.condense import Local, spread
from fmus.identification.refinement.priors import Priors
from fmus.identification.refinement.solver import Solution

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
