"""Small systems of linear equations; C has the same, operation by operation.

One component in an algebraic loop: its inputs and outputs there, and how these change with those.

Newton's method for the inputs of an algebraic loop; native/loop.c does the same, operation by operation.

The unknowns u are the inputs of a loop. The FMUs make outputs y of them, and the connections should make the
same inputs of those:

    r(u) = u - g(u) = 0,   g_i = factor_i y_k(u) + offset_i                  r_i in the unit of u_i

A step d of Newton's method solves  dr/du d = r  and goes from u to u - d. dy/du comes from directional
derivatives where an FMU has them, else from differences, one input after the other. The Jacobian is kept, to
the next communication point, too, as long as the residual falls fast with it. A step that does not make the
residual smaller is halved.

Where nobody declared a loop and none is seen at the start, values are first carried round: without one they
settle, exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from math import copysign, inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.fmi.calls import Buffer, Call, Slave, access

Matrix = list[list[float]]


def factorised(a: Matrix, rows: list[int]) -> bool:
    """Put the triangular factors in the place of `a`, and the exchanges of rows into `rows`.

    Gaussian elimination; the pivot is the largest element of its column. False where there is none.
    """
    n = len(a)
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(a[i][k]) > abs(a[best][k]):
                best = i
        rows[k] = best
        a[k], a[best] = a[best], a[k]
        if a[k][k] == 0.0 or not abs(a[k][k]) < inf:
            return False
        for i in range(k + 1, n):
            a[i][k] /= a[k][k]
            for j in range(k + 1, n):
                a[i][j] -= a[i][k] * a[k][j]
    return True


def solve(a: Matrix, rows: Sequence[int], b: list[float]) -> None:
    """Put the solution into `b`; `a` and `rows` as `factorised` left them."""
    n = len(b)
    for k in range(n):
        b[k], b[rows[k]] = b[rows[k]], b[k]
    for k in range(n):
        for i in range(k + 1, n):
            b[i] -= a[i][k] * b[k]
    for k in reversed(range(n)):
        for j in range(k + 1, n):
            b[k] -= a[k][j] * b[j]
        b[k] /= a[k][k]


def inverted(a: NDArray[Any], rows: NDArray[np.int32]) -> bool:
    """Put the inverse of `a`, shape (n, n), in its place, by the method of Gauss and Jordan.

    The pivot is the largest element of its column; `rows` notes the exchanges. False where there is none.
    """
    n = len(a)
    for k in range(n):
        best = k
        column = a[:, k].tolist()
        for i in range(k + 1, n):
            if abs(column[i]) > abs(column[best]):
                best = i
        rows[k] = best
        if best != k:
            a[[k, best]] = a[[best, k]]
        pivot = float(a[k, k])
        if pivot == 0.0 or not abs(pivot) < inf:
            return False
        a[k, k] = 1.0
        a[k] /= pivot
        for i, factor in enumerate(a[:, k].tolist()):
            if i != k and factor != 0.0:
                a[i, k] = 0.0
                a[i] -= a[k] * factor
    for k in reversed(range(n)):
        if rows[k] != k:
            a[:, [k, rows[k]]] = a[:, [rows[k], k]]
    return True


SHIFT = 1e-6  # of the magnitude: far above rounding, even of single precision; below what bends a function
ALIKE = 0.1  # derivatives further from differences than this share of the largest would spoil convergence


@dataclass(frozen=True)
class Slots:
    """Variables of a component, those of one type side by side, and their places in an array of a loop."""

    names: Sequence[str]
    values: Buffer
    first: int

    @property
    def range(self) -> range:
        """Their places."""
        return range(self.first, self.first + len(self.names))

    @property
    def own(self) -> Buffer:
        """Their values, as a view."""
        return self.values[self.first : self.first + len(self.names)]

    def calls(self, slave: Slave, make: Callable[[Sequence[str], Buffer], Call]) -> list[Call]:
        """One call for each type of variable."""
        made, at, types = list[Call](), 0, slave.interface.variables
        for _, group in groupby(self.names, key=lambda name: access(types[name])):
            same = list(group)
            made.append(make(same, self.own[at : at + len(same)]))
            at += len(same)
        return made


class Member:
    """Sets its inputs and reads its outputs in the arrays of a loop.

    derivative   call that puts into `into` how the outputs change when the inputs move along `seed`; None
                 where the FMU offers none
    trusted      shape (1,): 1 as long as it is used
    """

    def __init__(self, slave: Slave, inputs: Slots, outputs: Slots) -> None:
        self.inputs, self.outputs = inputs, outputs
        self._starters = inputs.calls(slave, slave.reader)
        self.writers, self.readers = inputs.calls(slave, slave.writer), outputs.calls(slave, slave.reader)
        self.seed, self.into = np.zeros(len(inputs.names)), np.zeros(len(outputs.names))
        self.derivative: Call | None = None
        self.trusted = np.array([slave.interface.directional], np.int32)
        if slave.interface.directional:
            self.derivative = slave.derivative(outputs.names, inputs.names, self.seed, self.into)

    def start(self) -> None:
        """Read from the FMU what its inputs are."""
        for read in self._starters:
            read()

    def __call__(self) -> None:
        for call in (*self.writers, *self.readers):
            call()

    def slope(self, unit: Buffer, slopes: Buffer) -> None:
        """Put into `slopes`, shape (outputs, inputs) of the loop, how outputs change with inputs.

        unit   magnitudes of the inputs of the loop
        Inputs and outputs of the FMU are not what they were afterwards, those in the arrays are.
        """
        if self.derivative and self.trusted[0]:
            self._told(self.derivative, slopes)
        else:
            self._measured(unit, slopes)

    def _told(self, derivative: Call, slopes: Buffer) -> None:
        for k, j in enumerate(self.inputs.range):
            self.seed[:] = 0.0
            self.seed[k] = 1.0
            derivative()
            slopes[self.outputs.range, j] = self.into

    def _measured(self, unit: Buffer, slopes: Buffer) -> None:
        u, before = self.inputs.values, self.outputs.own.tolist()
        for j in self.inputs.range:
            here = float(u[j])
            u[j] = here + copysign(SHIFT * float(unit[j]), here)
            moved = float(u[j]) - here
            self()
            after = self.outputs.own.tolist()
            slopes[self.outputs.range, j] = [(a - b) / moved for a, b in zip(after, before, strict=True)]
            u[j] = here
        self.outputs.own[:] = before

    def trust(self, unit: Buffer) -> None:
        """Do without derivatives that fail, or that are not what the outputs do."""
        if not self.derivative:
            return
        told, measured = (np.zeros((len(self.outputs.values), len(unit))) for _ in range(2))
        self._measured(unit, measured)
        self()
        with suppress(Problem), np.errstate(invalid="ignore", over="ignore"):
            self._told(self.derivative, told)
            largest = np.max(np.abs(measured) * unit, axis=1, keepdims=True)
            if np.all(np.abs(told - measured) * unit <= ALIKE * largest):
                return
        self.trusted[0] = 0


# Residuals as shares of the magnitude of the input: its largest value until now, or its nominal value.
NEAR = 1e-10  # wanted: below the error of any coupling, above the rounding of a model in double precision
ENOUGH = 1e-6  # accepted where no step makes it smaller: single precision, or an FMU that iterates inside
LIMIT = 20  # steps; Newton's method doubles the digits with each, so this is long after it failed
FAST = 1e-3  # a kept Jacobian is good while each step takes three digits off the residual
HALVINGS = 10  # of a step; then its direction is wrong
SOLVED, SINGULAR, STUCK = 0, -1, -2
USABLE, CIRCULAR = 0, 1  # flags: there is a Jacobian; values that were carried round did not settle
SOLVES, EVALUATIONS = 0, 1  # counts
NORM, SHARE, WORST = 0, 1, 2  # residuals: over the magnitude at first; over the one now; largest accepted

Wire = tuple[int, float, float]  # number of an output, factor and offset from there to an input


class Newton:
    """Solves for `u`, from where it is. All that lasts stands in arrays, which C uses, too.

    u, y, g, residual   inputs, outputs, what these make of the inputs, and the difference; shapes (n,), (m,)
    seen, unit          magnitudes of the inputs: largest so far; those that the Jacobian is made for
    """

    def __init__(
        self, u: Buffer, y: Buffer, members: Sequence[Member], wires: Sequence[Wire], seen: Buffer
    ) -> None:
        """seen: magnitudes of the inputs that are known before."""
        n, m = len(u), len(y)
        self.members, self.wires = members, wires
        self.u, self.y, self.seen = u, y, seen
        self.source = np.array([k for k, _, _ in wires], np.int64)
        self.factor, self.offset = (np.array([w[i] for w in wires]) for i in (1, 2))
        self.g, self.residual, self.step, self.before = (np.zeros(n) for _ in range(4))
        self.start, self.scale, self.unit = (np.zeros(n) for _ in range(3))
        self.slopes, self.matrix, self.rows = np.zeros((m, n)), np.zeros((n, n)), np.zeros(n, np.int32)
        self.flags, self.counts, self.shares = np.zeros(2, np.int32), np.zeros(2, np.int64), np.zeros(3)

    def begin(self, declared: bool) -> None:
        """Start at what the inputs of the FMUs are, and try what their outputs do.

        declared   use the derivatives of the FMUs, where they prove right; else see whether there is a loop
        """
        for member in self.members:
            member.start()
        self._evaluate()
        self._measure_units()
        for member in self.members:
            if declared:
                member.trust(self.unit)
            else:
                member.trusted[0] = 0
                member.slope(self.unit, self.slopes)
        self.flags[CIRCULAR] = not declared and self._circular()
        self.counts[:] = 0

    def _circular(self) -> bool:
        """Do inputs change themselves? Those that no other changes are taken away until none is left."""
        left = set(range(len(self.u)))
        while free := {i for i in left if not any(self.slopes[self.wires[i][0], j] for j in left)}:
            left -= free
        return bool(left)

    def solve(self, sweeps: int) -> int:
        """SOLVED, or why not. sweeps: how often values are carried round before."""
        self.scale[:] = 0.0
        self.counts[SOLVES] += 1
        if sweeps and not self.flags[CIRCULAR]:
            self.start[:] = self.u
            if self._carry_round(sweeps):
                return self._accept()
            self.flags[CIRCULAR] = 1
            self.u[:] = self.start
        self._evaluate()
        verdict = self._iterate()
        return self._accept() if self.shares[SHARE] <= ENOUGH and verdict != SINGULAR else verdict

    def _carry_round(self, sweeps: int) -> bool:
        """Set the inputs to what the outputs make of them, until that changes nothing."""
        for _ in range(sweeps):
            self._evaluate()
            if self.shares[SHARE] == 0.0:
                return True
            self.u[:] = self.g
        self._evaluate()
        return bool(self.shares[SHARE] <= NEAR)

    def _iterate(self) -> int:
        """From an evaluated start to where the residual is small, or no longer becomes smaller."""
        fresh = False
        for _ in range(LIMIT):
            if self.shares[SHARE] <= NEAR:
                return SOLVED
            if not self.flags[USABLE]:
                if not self._linearise():
                    return SINGULAR
                fresh = True
            norm = float(self.shares[NORM])
            better = self._descend(norm, fresh)
            if fresh and not better:
                return STUCK
            self.flags[USABLE] = better and self.shares[NORM] <= FAST * norm
            fresh = False
        return SOLVED if self.shares[SHARE] <= NEAR else STUCK

    def _descend(self, norm: float, fresh: bool) -> bool:
        """Take a step, so long that the residual becomes smaller; with an old Jacobian try it only once."""
        unit, residual = self.unit.tolist(), self.residual.tolist()
        step = [r / w for r, w in zip(residual, unit, strict=True)]
        solve(self.matrix.tolist(), self.rows.tolist(), step)
        self.step[:] = [d * w for d, w in zip(step, unit, strict=True)]
        self.before[:] = self.u
        size = 1.0
        for _ in range(HALVINGS if fresh else 1):
            before, step = self.before.tolist(), self.step.tolist()
            self.u[:] = [a - size * d for a, d in zip(before, step, strict=True)]
            self._evaluate()
            if self.shares[NORM] < norm:
                return True
            size *= 0.5
        self.u[:] = self.before
        self._evaluate()
        return False

    def _evaluate(self) -> None:
        """The outputs that belong to the inputs, and the residual."""
        for member in self.members:
            member()
        self.counts[EVALUATIONS] += 1
        norm = share = 0.0
        y = self.y.tolist()
        for i, (u, (k, factor, offset)) in enumerate(zip(self.u.tolist(), self.wires, strict=True)):
            g = y[k] * factor + offset
            r = u - g
            self.g[i], self.residual[i] = g, r
            if not abs(r) < inf:
                norm = share = inf
            elif r != 0.0:
                size = max(float(self.seen[i]), abs(u), abs(g))
                if self.scale[i] == 0.0:
                    self.scale[i] = size
                norm, share = max(norm, abs(r) / float(self.scale[i])), max(share, abs(r) / size)
        self.shares[NORM], self.shares[SHARE] = norm, share

    def _measure_units(self) -> None:
        """The magnitudes of the inputs."""
        for i, u in enumerate(self.u.tolist()):
            size = max(float(self.seen[i]), abs(u))
            self.unit[i] = 1.0 if size == 0.0 else size

    def _linearise(self) -> bool:
        """Find the Jacobian, of residuals and inputs over their magnitudes, and its factors."""
        self._measure_units()
        for member in self.members:
            member.slope(self.unit, self.slopes)
        unit, slopes = self.unit.tolist(), self.slopes.tolist()
        matrix = [
            [float(i == j) - factor * slopes[k][j] * unit[j] / unit[i] for j in range(len(unit))]
            for i, (k, factor, _) in enumerate(self.wires)
        ]
        rows = [0] * len(unit)
        found = factorised(matrix, rows)
        self.matrix[:], self.rows[:] = matrix, rows
        return found

    def _accept(self) -> int:
        for i, u in enumerate(self.u.tolist()):
            self.seen[i] = max(float(self.seen[i]), abs(u))
        self.shares[WORST] = max(float(self.shares[WORST]), float(self.shares[SHARE]))
        return SOLVED
