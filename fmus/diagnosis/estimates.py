"""The mechanism of the diagnosis: states, one least squares, one cumulative sum, and when something is told.

**Least squares** with a fading memory, in the information form, whose sums are states:

    N' = w sum(c c^T) - N/T        b' = w sum(c y) - b/T        T counts only time with w > 0

of residuals y = c^T s with columns c and unknowns s. Each unknown has a prior, `reference` with a standard
deviation, so one without data stays there. The covariance is r^2 N^-1 with the standard deviation r of the
right side: that of the residual, in which one assumed before any data counts as `DOUBT` samples, and no less
than the known one. Samples, of one per time constant of the weight, count as independent. A size is a fault
if it is beyond its limit by `CERTAIN` deviations.

**Cumulative sum** (Page, Biometrika 41 (1954) 100): an excess beyond a margin is summed, and never negative;
a fault at a limit of the sum.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca

from fmus.contract import Quantity, Scalar

SAMPLING = QUICK = 0.01  # s, between two samples of the diagnosis; in which a latch or a sum is set
FORGOTTEN = 0.1  # s, in which a sum is forgotten
UNSEEN = (
    5.0  # s, for which "none" holds after a fault would have been told the last time: a stroke and a pause
)
DOUBT = 4.0  # samples
FEWEST = 10.0  # samples, from which a size is told
# deviations by which a size is above its limit: of 27 sizes, new every 10 s, one by chance in 100 h
CERTAIN = 4.75
NOMINAL = {"V": 10.0, "Pa": 1e7, "m3": 1e-3, "m3/s": 1e-3}

Equations = Sequence[tuple[Sequence[Scalar], Scalar]]  # columns and right side of each
Told = tuple[Scalar, Scalar, Scalar]  # size, deviation; 1: a fault, 0: none, -1: cannot be told


@dataclass(frozen=True)
class States:
    """States of an algorithm, each declared where its rate is written.

    x        their values; None: new symbols, to find out which states there are
    reset    1: forget what is latched
    of       what they describe, and begin of their names
    declared, rates, starts   by full name, for all parts of an algorithm
    """

    x: Any = None
    reset: Scalar = 0
    of: str = ""
    declared: dict[str, Quantity] = field(default_factory=dict)
    rates: dict[str, Scalar] = field(default_factory=dict)
    starts: dict[str, Scalar] = field(default_factory=dict)

    def full(self, name: str) -> str:
        """Its name."""
        return f"{self.of}_{name}" if self.of else name

    def state(self, name: str, text: str, unit: str = "1", start: Scalar | None = None) -> Scalar:
        """Its value; `moves` or `latch` gives its rate."""
        full, text = self.full(name), f"{text}: {self.of}" if self.of else text
        self.declared[full] = Quantity(unit, text, NOMINAL.get(unit, 1.0))
        if start is not None:
            self.starts[full] = start
        return ca.SX.sym(full) if self.x is None else getattr(self.x, full)

    def moves(self, name: str, rate: Scalar) -> None:
        """Its rate."""
        self.rates[self.full(name)] = rate

    def latch(self, name: str, value: Scalar, size: Scalar) -> None:
        """It goes up to a size, and stays there until the reset."""
        self.moves(name, (ca.fmax(size - value, 0) - value * self.reset) / QUICK)

    def lag(
        self, name: str, now: Scalar, time: Scalar, text: str, unit: str = "1", zero: bool = False
    ) -> Scalar:
        """A signal behind a lag of first order [s], which starts at the signal, or at zero."""
        late = self.state(name, f"{text}, behind a lag", unit, None if zero else now)
        self.moves(name, (now - late) / time)
        return late

    def sum(
        self, name: str, text: str, excess: Scalar, counts: Scalar, unit: str = "s", fade: float = QUICK
    ) -> Scalar:
        """Cumulative sum of an excess [unit/s] while it counts, forgotten while not."""
        total = self.state(name, text, unit)
        self.moves(name, ca.fmax(excess * counts - (1 - counts) * total / fade, -total / QUICK))
        return total

    def power(self, name: str, text: str, rate: Scalar, fades: Scalar) -> Scalar:
        """1: a fault would have been told, as a rate [1/s] summed up to 1; for `UNSEEN` while it fades."""
        seen = self.state(name, text)
        rate = ca.if_else(rate > 0, ca.fmin(rate, (2 - seen) / QUICK), -fades / UNSEEN)
        self.moves(name, ca.fmax(rate, -seen / QUICK))
        return whether(seen > 1)


@dataclass
class Fit:
    """Least squares of an equation, without units.

    priors   standard deviation and reference of each size
    least    standard deviation of the right side, at least
    rough    that before any data
    most     that at most: what differs more is a change
    rare     how many of the first sizes are faults, of which there is one at most
    signed   whether such a fault may be negative
    weighed  whether a prior counts by the deviation that the right side turned out to have a sample ago, not
             the least one
    """

    m: States
    name: str
    priors: Sequence[tuple[Scalar, Scalar]]
    least: float
    rough: float
    most: float = math.inf
    rare: int = 0
    signed: bool = False
    weighed: bool = False

    def __post_init__(self) -> None:
        self.size = len(self.priors)
        size = range(self.size)
        self.products = [(i, j) for j in size for i in range(j + 1)]
        keys = [*(f"{i}_{j}" for i, j in self.products), *(f"{i}_y" for i in size), "yy", "w"]
        text = f"Sum of normal equations, {self.name}"
        self.sums = {k: self.m.state(f"{self.name}_{k}", f"{text} {k}") for k in keys}
        self.samples = self.sums["w"]  # in the memory
        self.turned_out = f"{self.name}_spread{'_rare' * bool(self.rare)}"
        text = f"Deviation of the right side, {self.name}"
        self.before = self.m.state(self.turned_out, text) if self.weighed else 0
        self.spread = ca.fmax(self.before, self.least)

    def adds(
        self,
        weight: Scalar,
        equations: Equations,
        memory: Scalar,
        count: Scalar | None = None,
        changes: Scalar = 0,
    ) -> None:
        """Rates of the sums; weight [1/s], memory [s]; count: of equations, without it all.

        changes   rate [1/s] at which the last size is forgotten, not what is known of the others without it
        """
        terms = [sum(c[i] * c[j] for c, _ in equations) for i, j in self.products]
        terms += [sum(c[i] * y for c, y in equations) for i in range(self.size)]
        terms += [sum(y * y for _, y in equations), len(equations) if count is None else count]
        fade = ca.if_else(weight > 0, 1 / memory, 0)
        end = self.size - 1
        last = [*(self.sums[f"{i}_{end}"] for i in range(self.size)), self.sums[f"{end}_y"]]
        share = changes / ca.fmax(last[-2], 1e-9)
        by_last = [last[i] * last[j] for i, j in self.products] + [v * last[-1] for v in last] + [0]
        for (key, total), term, gone in zip(self.sums.items(), terms, by_last, strict=True):
            self.m.moves(f"{self.name}_{key}", weight * term - fade * total - share * gone)

    def centre(self, k: int) -> list[Scalar]:
        """Mean of the columns, where the column k is -1 and not 0: what is known best along it."""
        rows = [self.sums[f"{min(i, k)}_{max(i, k)}"] for i in range(self.size)]
        return [-row / ca.fmax(rows[k], 1e-9) for row in rows]

    @cached_property
    def solution(self) -> tuple[list[Scalar], ca.SX, Scalar]:
        """Sizes, their covariance, variance of the right side."""
        n, b, squares = ca.SX(self.size, self.size), ca.SX(self.size, 1), self.sums["yy"]
        for i, j in self.products:
            n[i, j] = n[j, i] = self.sums[f"{i}_{j}"]
        for i, (deviation, reference) in enumerate(self.priors):
            weight = (self.spread / deviation) ** 2
            b[i] = self.sums[f"{i}_y"] + weight * reference
            n[i, i] += weight
            squares += weight * reference**2
        if self.rare:
            found, inverse = self._most_likely(n, b)
        else:
            factors = ca.ldl(ca.densify(n))
            inverse = ca.ldl_solve(ca.SX.eye(self.size), *factors)
            found = ca.vertsplit(ca.ldl_solve(b, *factors))
        s = ca.vertcat(*found)
        residual = ca.fmax(squares - 2 * ca.dot(b, s) + s.T @ n @ s, 0)
        variance = (residual + DOUBT * self.rough**2) / (self.samples + DOUBT)
        variance = ca.fmin(ca.fmax(variance, self.least**2), self.most**2)
        if self.weighed:
            self.m.moves(self.turned_out, (ca.sqrt(variance) - self.before) / QUICK)
        return found, variance * inverse, variance

    def _most_likely(self, n: ca.SX, b: ca.SX) -> tuple[list[Scalar], ca.SX]:
        """Least squares with one of the first sizes, or none of them; variances on a diagonal.

        Faults are rare: a leak of one side is no leak of the seals with one of the other side. By the
        generalised likelihood ratio the one is told that lessens the sum of squares most, by more than
        `CERTAIN` of its least deviations. The other sizes, which are free, are eliminated.
        """
        rare = range(self.rare)
        factors = ca.ldl(ca.densify(n[self.rare :, self.rare :]))
        columns, sums = n[self.rare :, : self.rare], b[self.rare :]
        without, free = ca.ldl_solve(columns, *factors), ca.ldl_solve(sums, *factors)
        alone = [n[k, k] - ca.dot(columns[:, k], without[:, k]) for k in rare]
        right = [b[k] - ca.dot(without[:, k], sums) for k in rare]
        gains = [(r if self.signed else ca.fmax(r, 0)) ** 2 / v for r, v in zip(right, alone, strict=True)]
        best = ca.fmax(ca.mmax(ca.vertcat(*gains)), (CERTAIN * self.least) ** 2)
        sizes = [ca.if_else(g >= best, r / v, 0) for g, r, v in zip(gains, right, alone, strict=True)]
        left = free - without @ ca.vertcat(*sizes)
        inverse = ca.ldl_solve(ca.SX.eye(self.size - self.rare), *factors)
        return [*sizes, *ca.vertsplit(left)], ca.diagcat(*(1 / v for v in alone), inverse)

    @property
    def sizes(self) -> list[tuple[Scalar, Scalar]]:
        """Each size with its deviation."""
        found, covariance, _ = self.solution
        return [(s, ca.sqrt(ca.fmax(covariance[i, i], 0))) for i, s in enumerate(found)]

    def along(self, *weights: Scalar) -> tuple[Scalar, Scalar]:
        """A sum of sizes with these weights, and its deviation."""
        w, (found, covariance, _) = ca.vertcat(*weights), self.solution
        return ca.dot(w, ca.vertcat(*found)), ca.sqrt(ca.fmax(w.T @ covariance @ w, 0))


def whether(condition: Scalar) -> Scalar:
    """1 or 0."""
    return ca.if_else(condition, 1, 0)


def either(*conditions: Scalar) -> Scalar:
    """1 if one of them is, else 0."""
    found: Scalar = 0
    for c in conditions:
        found = ca.fmax(found, c)
    return found


def judged(size: Scalar, deviation: Scalar, limit: Scalar, usable: Scalar) -> Scalar:
    """1: above the limit, 0: not known to be, -1: not usable, or its deviation is too large to tell."""
    certain = size - CERTAIN * deviation > limit
    blind = ca.if_else(deviation > limit, -1, 0)
    return ca.if_else(usable > 0, ca.if_else(certain, 1, blind), -1)


def shown(state: Scalar, usable: Scalar = 1) -> Told:
    """What is told of a latch or a size that is zero without a fault."""
    return state, 0, ca.if_else(state > 0, 1, ca.if_else(usable > 0, 0, -1))
