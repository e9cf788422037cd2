"""Least squares with a fading memory, as sums that are states, and when a size is told.

    N' = w sum(c c^T) - N/T        b' = w sum(c y) - b/T        T counts only time with w > 0

of the equations y = c^T s with columns c and sizes s. Each size has a prior, `reference` with a standard
deviation, so a size without data stays there. The covariance is r^2 N^-1 with the standard deviation r of the
right side: that of the residual, in which one assumed before any data counts as `DOUBT` samples, and no less
than the known one. Samples, of one per time constant of the weight, count as independent.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import casadi as ca

from fmus.contract import Scalar

SAMPLING = 0.01  # s, between two samples of the diagnosis
QUICK = SAMPLING  # s, in which a latch or a clock is set
FORGOTTEN = 0.1  # s, in which a volume is forgotten
DOUBT = 4.0  # samples
FEWEST = 10.0  # samples, from which a size is told
ROUGH = 0.1  # of the squares that a size explains, may be left because its model is not exact
CERTAIN = 3.0  # deviations by which a size is above its limit

Equations = Sequence[tuple[Sequence[Scalar], Scalar]]  # columns and right side of each
Told = tuple[Scalar, Scalar, Scalar]  # size, deviation; 1: a fault, 0: none, -1: cannot be told


@dataclass(frozen=True)
class Solution:
    """Of normal equations: sizes, their covariance, number of samples, deviation of the right side."""

    sizes: list[Scalar]
    covariance: ca.SX
    samples: Scalar
    scatter: Scalar

    def __iter__(self) -> Iterator[tuple[Scalar, Scalar]]:
        """Each size with its deviation."""
        return ((s, _root(self.covariance[i, i])) for i, s in enumerate(self.sizes))

    def along(self, *weights: Scalar) -> tuple[Scalar, Scalar]:
        """A sum of sizes with these weights, and its deviation."""
        w = ca.vertcat(*weights)
        return ca.dot(w, ca.vertcat(*self.sizes)), _root(w.T @ self.covariance @ w)


@dataclass(frozen=True)
class Prior:
    """What is known before any data.

    deviations, references   of the sizes
    least                    standard deviation of the right side, at least
    rough                    that before any data
    most                     that at most: what differs more is a change
    """

    deviations: Sequence[Scalar]
    references: Sequence[Scalar]
    least: float
    rough: float
    most: float = math.inf


@dataclass(frozen=True)
class Fit:
    """Least squares of an equation, without units.

    apart   pairs of columns of which one is always zero
    """

    name: str
    columns: tuple[str, ...]
    apart: frozenset[frozenset[str]] = frozenset()

    @property
    def _products(self) -> list[tuple[int, int]]:
        pairs = [(i, j) for j in range(len(self.columns)) for i in range(j + 1)]
        return [(i, j) for i, j in pairs if frozenset((self.columns[i], self.columns[j])) not in self.apart]

    @property
    def states(self) -> list[str]:
        """Names of the sums."""
        sums = [f"{i}{j}" for i, j in self._products] + [f"{i}y" for i in range(len(self.columns))]
        return [f"{self.name}_{s}" for s in (*sums, "yy", "w")]

    def rates(
        self, x: Any, weight: Scalar, equations: Equations, memory: Scalar, count: Scalar | None = None
    ) -> dict[str, Scalar]:
        """Of the sums; weight [1/s], memory [s]; count: of equations, without it all."""
        terms = [sum(c[i] * c[j] for c, _ in equations) for i, j in self._products]
        terms += [sum(c[i] * y for c, y in equations) for i in range(len(self.columns))]
        terms += [sum(y * y for _, y in equations), len(equations) if count is None else count]
        fade = ca.if_else(weight > 0, 1 / memory, 0)
        return {n: weight * t - fade * getattr(x, n) for n, t in zip(self.states, terms, strict=True)}

    def centre(self, x: Any, k: int) -> list[Scalar]:
        """Mean of the columns, where the column k is -1 and not 0: what is known best along it."""
        sums = {frozenset(pair): getattr(x, f"{self.name}_{pair[0]}{pair[1]}") for pair in self._products}
        count = ca.fmax(sums[frozenset((k,))], 1e-9)
        return [-sums.get(frozenset((k, i)), 0) / count for i in range(len(self.columns))]

    def solved(self, x: Any, prior: Prior, rare: int = 0, weighed: bool = False) -> Solution:
        """Sizes with their covariance.

        rare      how many of the first ones are faults, see `few`
        weighed   a prior counts by the deviation that the right side turns out to have, not by the least one
        """
        if weighed:
            scatter = self.solved(x, prior, rare).scatter
            prior = replace(prior, deviations=[d * prior.least / scatter for d in prior.deviations])
        size = len(self.columns)
        n, b = ca.SX(size, size), ca.SX(size, 1)
        for i, j in self._products:
            n[i, j] = n[j, i] = getattr(x, f"{self.name}_{i}{j}")
        weights = [(prior.least / d) ** 2 for d in prior.deviations]
        for i, (weight, reference) in enumerate(zip(weights, prior.references, strict=True)):
            b[i] = getattr(x, f"{self.name}_{i}y") + weight * reference
            n[i, i] += weight
        if rare:
            found, inverse = _with_few(n, b, rare, (CERTAIN * prior.least) ** 2)
        else:
            factors = ca.ldl(ca.densify(n))
            inverse = ca.ldl_solve(ca.SX.eye(size), *factors)
            found = ca.vertsplit(ca.ldl_solve(b, *factors))
        s, samples = ca.vertcat(*found), getattr(x, f"{self.name}_w")
        squares = getattr(x, f"{self.name}_yy") + sum(
            w * r**2 for w, r in zip(weights, prior.references, strict=True)
        )
        residual = ca.fmax(squares - 2 * ca.dot(b, s) + s.T @ n @ s, 0)
        variance = (residual + DOUBT * prior.rough**2) / (samples + DOUBT)
        variance = ca.fmin(ca.fmax(variance, prior.least**2), prior.most**2)
        return Solution(found, variance * inverse, samples, ca.sqrt(variance))


def _root(variance: Scalar) -> Scalar:
    return ca.sqrt(ca.fmax(variance, 0))


def _with_few(n: ca.SX, b: ca.SX, rare: int, worth: float) -> tuple[list[Scalar], ca.SX]:
    """Least squares in which the first sizes are few and the last one is free; variances on a diagonal."""
    some: Any = list(range(rare))
    shared = n[some, rare] / n[rare, rare]
    sizes, variances = few(n[some, some] - shared @ n[rare, some], b[some] - shared * b[rare], worth, ROUGH)
    free = b[rare] / n[rare, rare] - ca.dot(shared, ca.vertcat(*sizes))
    return [*sizes, free], ca.diag(ca.vertcat(*variances, 1 / n[rare, rare]))


def few(
    n: ca.SX, b: ca.SX, worth: float = 0.0, rough: float = 0.0, most: int = 2
) -> tuple[list[Scalar], list[Scalar]]:
    """Least squares with at most `most` sizes that are not negative, the others zero, and their variances.

    The best of all such solutions; a further size has to lessen the sum of squares by `worth`, and by the
    share `rough` of what is explained, because no model is exact. Faults are rare: a leak of one side is no
    leak of the seals with one of the other side. The variance of a size at zero is that which it had alone.
    """
    best, found = ca.SX(0), [ca.SX(0)] * n.shape[0]
    variances = [1 / n[i, i] for i in range(n.shape[0])]
    for kept in (k for size in range(1, most + 1) for k in combinations(range(n.shape[0]), size)):
        some: Any = list(kept)
        inverse = ca.inv_minor(n[some, some])
        sizes = inverse @ b[some]
        gain = (1 - rough * (len(some) - 1)) * ca.dot(b[some], sizes) - worth * len(some)
        gain = ca.if_else(ca.mmin(sizes) >= 0, gain, -1)
        better, best = gain > best, ca.fmax(gain, best)
        own = dict(zip(some, ca.vertsplit(sizes), strict=True))
        found = [ca.if_else(better, own.get(k, 0), value) for k, value in enumerate(found)]
        if len(some) > 1:
            its = {k: inverse[i, i] for i, k in enumerate(some)}
            variances = [ca.if_else(better, its.get(k, v), v) for k, v in enumerate(variances)]
    return found, variances


def whether(condition: Scalar) -> Scalar:
    """1 or 0."""
    return ca.if_else(condition, 1, 0)


def either(*conditions: Scalar) -> Scalar:
    """1 if one of them is, else 0."""
    found: Scalar = 0
    for c in conditions:
        found = ca.fmax(found, c)
    return found


def latched(state: Scalar, condition: Scalar, reset: Scalar) -> Scalar:
    """Rate of a state that goes to 1 with a condition, and stays until the reset."""
    return (condition * (1 - state) - state * reset) / QUICK


def counted(clock: Scalar, condition: Scalar, rate: Scalar = 1, forgotten: float = QUICK) -> Scalar:
    """Rate of a clock that counts while a condition is 1, and else goes back to 0."""
    return ca.if_else(condition > 0, rate, -clock / forgotten)


def gathered(volume: Scalar, excess: Scalar, counts: Scalar) -> Scalar:
    """Rate of a volume [m3] that gathers an excess [m3/s], and is forgotten while it does not count."""
    return ca.fmax(excess * counts - (1 - counts) * volume / FORGOTTEN, -volume / QUICK)


def judged(size: Scalar, deviation: Scalar, limit: Scalar, usable: Scalar) -> Scalar:
    """1: above the limit, 0: not known to be, -1: not usable, or its deviation is too large to tell."""
    certain = size - CERTAIN * deviation > limit
    blind = ca.if_else(CERTAIN * deviation > 3 * limit, -1, 0)
    return ca.if_else(usable > 0, ca.if_else(certain, 1, blind), -1)


def shown(state: Scalar, usable: Scalar = 1) -> Told:
    """What is told of a latch or a size that is zero without a fault."""
    return state, 0, ca.if_else(state > 0, 1, ca.if_else(usable > 0, 0, -1))
