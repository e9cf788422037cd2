"""The linearised components joined by their connections, and what they do over a step.

From a communication point on, with d the changes of all states and v those of all inputs,

    d' = f + A d + B v + drift,     v = C d + D v + w(s),     d(0) = 0

where w(s) are the changes of the inputs whose course is known. So  v = K (C d + w),  K = 1 / (1 - D),  and

    d' = f + (A + B K C) d + B K w(s) + drift

is solved up to h/3, 2h/3 and h by one step each of the L-stable Runge-Kutta method of order 3 whose three
stages have the same diagonal element (Alexander 1977, SIAM J. Numer. Anal. 14(6) 1006-1021). All stages share
the matrix  W = 1 / (1 - gamma h/3 (A + B K C)),  which is kept as long as the linearisation and h.

The drift is what an old linearisation misses: its error grew in proportion to its age T, and goes on like
that over the step: drift(s) = q (T s + s^2/2).

Matrices are stored column by column. native/foresight.c does the same, operation by operation.
"""

from __future__ import annotations

from math import inf

import numpy as np

from orchestrator.coupling.linear import inverted
from orchestrator.slaves.slave import Buffer

GAMMA = 0.43586652150845967
NODES = (GAMMA, (1.0 + GAMMA) / 2.0, 1.0)  # of the stages
EARLIER = (  # weights of the stages before
    (),
    ((1.0 - GAMMA) / 2.0,),
    (-1.5 * GAMMA * GAMMA + 4.0 * GAMMA - 0.25, 1.5 * GAMMA * GAMMA - 5.0 * GAMMA + 1.25),
)
ALIKE = 1e-9  # of a step: another one that differs by less is the same


class Joined:
    """n states and m inputs; shapes of matrices (columns, rows).

    slopes   A, B, C and D one after the other; a, b, c, d: views of it
    f, x     time derivatives of the states, and the states, at the communication point
    w        inputs there, where their course is known, else 0
    course   their coefficients of s, s^2 and s^3, shape (3, m)
    v        the changes of all inputs up to h/3, 2h/3 and h, shape (3, m)
    through  outputs depend on inputs directly: D is not 0
    """

    def __init__(self, n: int, m: int) -> None:
        self.n, self.m, self.through = n, m, False
        ends = np.cumsum([n * n, m * n, n * m, m * m])
        self.slopes = np.zeros(ends[-1])
        a, b, c, d, _ = np.split(self.slopes, ends)
        self.a, self.b, self.c, self.d = a.reshape(n, n), b.reshape(m, n), c.reshape(n, m), d.reshape(m, m)
        self.k, self.kc, self.closed, self.inverse = (np.zeros(s) for s in ((m, m), (n, m), (n, n), (n, n)))
        self.f, self.x, self.f0, self.x0, self.q = (np.zeros(n) for _ in range(5))
        self.w, self.w0, self.felt = (np.zeros(m) for _ in range(3))
        self.course, self.v = np.zeros((3, m)), np.zeros((3, m))
        self.rows = np.zeros(max(n, m), np.int32)
        self.length = 0.0  # that `inverse` is made for; 0: it is not made
        self.usable = False

    def place(self, of_input: bool, column: int, to_input: bool, row: int) -> int:
        """Where in `slopes` the change of a state or an input (`to_input`) with one (`of_input`) stands."""
        n, m = self.n, self.m
        first = (n * n if of_input else 0) if not to_input else n * n + n * m + (n * m if of_input else 0)
        return first + column * (m if to_input else n) + row

    def join(self) -> None:
        """Make one system of the slopes; `usable` tells whether that is possible."""
        self.length, self.usable = 0.0, True
        self.kc[:] = self.c
        if self.through:
            self.k[:] = np.eye(self.m) - self.d
            self.usable = inverted(self.k, self.rows)
            self.kc[:] = 0.0
            for j in range(self.n):
                add_product(self.k, self.c[j], self.kc[j])
        self.closed[:] = self.a
        for j in range(self.n):
            add_product(self.b, self.kc[j], self.closed[j])

    def find_drift(self, last: float, since: float) -> None:
        """Find q from the step before, `last` [s] long; `since` [s]: age of the linearisation."""
        self.q[:] = 0.0
        if since == 0.0:
            return
        add_product(self.closed, self.x - self.x0, self.q)
        self._feel(self.w - self.w0)
        add_product(self.b, self.felt, self.q)
        self.q[:] = (self.f - self.f0 - self.q) / (last * (since - 0.5 * last))

    def accept(self) -> None:
        """This communication point becomes the one before."""
        self.f0[:], self.x0[:], self.w0[:] = self.f, self.x, self.w

    def prepare(self, h: float) -> None:
        """Get ready for a step of length h."""
        if not self.usable or abs(h - self.length) <= ALIKE * h:
            return
        self.length = h
        self.inverse[:] = np.eye(self.n) - (GAMMA * (h / 3.0)) * self.closed
        self.usable = inverted(self.inverse, self.rows)

    def foretell(self, since: float) -> None:
        """Find v; `since` [s]: age of the linearisation."""
        delta, d = self.length / 3.0, np.zeros(self.n)
        for third in range(3):
            rates: list[Buffer] = []
            for node, earlier in zip(NODES, EARLIER, strict=True):
                base = d.copy()
                for weight, rate in zip(earlier, rates, strict=True):
                    base += (delta * weight) * rate
                base_and_forcing = base + (GAMMA * delta) * self._forcing(delta * (third + node), since)
                stage = np.zeros(self.n)
                add_product(self.inverse, base_and_forcing, stage)
                rates.append((stage - base) / (GAMMA * delta))
            d = stage  # the last stage is the end
            self.v[third] = self.felt if self.through else 0.0
            add_product(self.kc, d, self.v[third])

    def _forcing(self, s: float, since: float) -> Buffer:
        """All that does not depend on the states, s [s] after the communication point."""
        c1, c2, c3 = self.course
        self._feel(s * (c1 + s * (c2 + s * c3)))
        forcing = self.f + (since * s + 0.5 * s * s) * self.q
        add_product(self.b, self.felt, forcing)
        return forcing

    def _feel(self, known: Buffer) -> None:
        """What the known changes are to all inputs, through outputs that depend on inputs directly."""
        self.felt[:] = known
        if self.through:
            self.felt[:] = 0.0
            add_product(self.k, known, self.felt)


def add_product(matrix: Buffer, by: Buffer, to: Buffer) -> None:
    """Add matrix times vector, column by column."""
    for column, factor in zip(matrix, by.tolist(), strict=True):
        if factor != 0.0:
            to += column * factor


def is_finite(values: Buffer) -> bool:
    """Are all of them numbers?"""
    return all(abs(v) < inf for v in values.tolist())
