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
BLOCK = 8
ALIKE = 1e-9  # of a step: another one that differs by less is the same


class Joined:
    """n states and m inputs; shapes of matrices (columns, rows), the rows filled up to a multiple of BLOCK.

    slopes   A, B, C and D one after the other; a, b, c, d: views of it
    f, x     time derivatives of the states, and the states, at the communication point
    w        inputs there, where their course is known, else 0
    course   their coefficients of s, s^2 and s^3, shape (3, m)
    felt     K times that, and push: B times that
    v        the changes of all inputs up to h/3, 2h/3 and h, shape (3, m)
    through  outputs depend on inputs directly: D is not 0
    """

    def __init__(self, n: int, m: int) -> None:
        self.n, self.m, self.through = n, m, False
        self.wide, self.broad = wide, broad = _padded(n), _padded(m)
        self._ends = np.cumsum([n * wide, m * wide, n * broad, m * broad])
        self.slopes = np.zeros(self._ends[-1])
        a, b, c, d, _ = np.split(self.slopes, self._ends)
        self.a, self.b, self.c, self.d = (
            part.reshape(columns, -1) if columns else part.reshape(0, rows)
            for part, columns, rows in ((a, n, wide), (b, m, wide), (c, n, broad), (d, m, broad))
        )
        self.k, self.kc = np.zeros((m, broad)), np.zeros((n, broad))
        self.closed, self.inverse = np.zeros((n, wide)), np.zeros((n, wide))
        self.f, self.x, self.f0, self.x0, self.q = (np.zeros(wide) for _ in range(5))
        self.w, self.w0 = np.zeros(broad), np.zeros(broad)
        self.course, self.felt, self.v = (np.zeros((3, broad)) for _ in range(3))
        self.push = np.zeros((3, wide))
        self.rows = np.zeros(max(n, m), np.int32)
        self.length = 0.0  # that `inverse` is made for; 0: it is not made
        self.usable = False

    def place(self, of_input: bool, column: int, to_input: bool, row: int) -> int:
        """Where in `slopes` the change of a state or an input (`to_input`) with one (`of_input`) stands."""
        part = 2 * to_input + of_input
        first = int(self._ends[part - 1]) if part else 0
        return first + column * (self.broad if to_input else self.wide) + row

    def join(self) -> None:
        """Make one system of the slopes; `usable` tells whether that is possible."""
        self.length, self.usable = 0.0, True
        self.kc[:] = self.c
        if self.through:
            self.k[:] = np.eye(self.m, self.broad) - self.d
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
        felt, before = self._felt(self.w), self._felt(self.w0)
        add_product(self.b, felt - before, self.q)
        self.q[:] = (self.f - self.f0 - self.q) / (last * (since - 0.5 * last))

    def accept(self) -> None:
        """This communication point becomes the one before."""
        self.f0[:], self.x0[:], self.w0[:] = self.f, self.x, self.w

    def prepare(self, h: float) -> None:
        """Get ready for a step of length h."""
        if not self.usable or abs(h - self.length) <= ALIKE * h:
            return
        self.length = h
        self.inverse[:] = np.eye(self.n, self.wide) - (GAMMA * (h / 3.0)) * self.closed
        self.usable = inverted(self.inverse, self.rows)

    def foretell(self, since: float) -> None:
        """Find v; `since` [s]: age of the linearisation."""
        delta, d = self.length / 3.0, np.zeros(self.wide)
        for k in range(3):
            self.felt[k] = self._felt(self.course[k])
            self.push[k] = 0.0
            add_product(self.b, self.felt[k], self.push[k])
        for third in range(3):
            rates: list[Buffer] = []
            for node, earlier in zip(NODES, EARLIER, strict=True):
                base, s = d.copy(), delta * (third + node)
                for weight, rate in zip(earlier, rates, strict=True):
                    base += (delta * weight) * rate
                stage, forcing = np.zeros(self.wide), self.f + (since * s + 0.5 * s * s) * self.q
                forcing = base + (GAMMA * delta) * (forcing + _curve(self.push, s))
                add_product(self.inverse, forcing, stage)
                rates.append((stage - base) / (GAMMA * delta))
            d = stage  # the last stage is the end
            self.v[third] = _curve(self.felt, delta * (third + 1))
            add_product(self.kc, d, self.v[third])

    def _felt(self, known: Buffer) -> Buffer:
        """What known changes are to all inputs, through outputs that depend on inputs directly."""
        if not self.through:
            return known
        felt = np.zeros(self.broad)
        add_product(self.k, known, felt)
        return felt


def _curve(c: Buffer, s: float) -> Buffer:
    """Polynomials of s with the coefficients c of s, s^2 and s^3, shape (3, n)."""
    found: Buffer = s * (c[0] + s * (c[1] + s * c[2]))
    return found


def add_product(matrix: Buffer, by: Buffer, to: Buffer) -> None:
    """Add matrix times vector, column by column."""
    for column, factor in zip(matrix, by.tolist(), strict=False):
        if factor != 0.0:
            to += column * factor


def _padded(n: int) -> int:
    """So many rows make full blocks, which C computes at once."""
    return -(-n // BLOCK) * BLOCK
