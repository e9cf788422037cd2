"""Radau IIA of order 5: implicit steps from a state alone, so that a restart costs nothing.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd edition, 1996, section IV.8:
stages (8.2) by simplified Newton iterations, error estimate (8.20), step size (8.21). States inside a step
are those of the collocation polynomial. A co-simulation begins steps with other inputs all the time, where a
multistep method would start again with order 1.
"""

from __future__ import annotations

from math import ceil, sqrt, ulp

import numpy as np

from orchestrator.data.table import Array
from orchestrator.engine.integration import Integration, known

R = sqrt(6.0)
C = np.array([(4 - R) / 10, (4 + R) / 10, 1.0])
POWERS = np.array([1, 2, 3])
TO_COEFFICIENTS = np.linalg.inv(C[:, None] ** POWERS)  # of the polynomial, from the stages
A = C[:, None] ** POWERS / POWERS @ np.linalg.inv(C[:, None] ** (POWERS - 1))  # collocation, (IV.5.6)
GAMMA = 1.0 / (3.0 + 3.0 ** (2 / 3) - 3.0 ** (1 / 3))  # the real eigenvalue of A
ERROR = GAMMA / 3.0 * np.array([-13 - 7 * R, -13 + 7 * R, -1.0])
ITERATIONS = 8  # of Newton's method
SLOW = 3  # with more, the Jacobian is computed anew before the next step
AGREEMENT = 1e-3  # last change of an iteration, over the tolerance
GROW, SHRINK, SAFETY = 8.0, 0.2, 0.9  # factors of the step
ROUNDING = 4e-16  # of a state
SOON = 1e-3  # of a step: there an indicator that is 0 at its beginning has its sign
SHORTEST = 10  # step over the rounding unit of the time


class Radau:
    """Steps of one plant; `toward` begins from any state."""

    def __init__(self, of: Integration) -> None:
        self._of, n = of, len(of.plant.x)
        self._absolute = of.tolerance * of.plant.magnitudes()
        self._stages, self._f = np.zeros((3, n)), np.zeros(n)
        self._jacobian, self._age = np.zeros((n, n)), ITERATIONS
        self._h = self._h_of_inverse = np.inf

    def toward(self, target: float, t: float, x: Array) -> Radau:
        """Begin at a time and a state; no step goes beyond the target [s]."""
        self._t, self._x, self._target = t, x, target
        return self

    def advance(self) -> tuple[float, Array, bool]:
        """One step, up to the first state event at most: time [s], states, True for an event."""
        of, t, x = self._of, self._t, self._x
        before = known(self._of.plant, t, self._signs(t, x))
        of.rates(t, x, self._f)
        f, rest = self._f.copy(), self._target - t
        while True:
            if of.broken:
                raise of.failed(t, "")
            count = max(ceil(rest / self._h - 1e-9), 1)  # of equal steps, which share a matrix
            h = rest / count
            if h < SHORTEST * ulp(max(abs(t), abs(self._target))) or not np.isfinite(f).all():
                raise of.failed(t, "the step is too short")
            fresh = self._prepare(t, x, h)
            z = self._solve(t, x, h)
            if z is None:
                self._h = h if not fresh else 0.5 * h
                self._age = ITERATIONS if not fresh else self._age
                continue
            scale = self._absolute + of.tolerance * np.maximum(np.abs(x), np.abs(x + z[2]))
            error = self._error_inverse @ (GAMMA * h * f + ERROR @ z)
            size = float(np.sqrt(np.mean((error / scale) ** 2)))
            self._h = h * min(GROW, max(SHRINK, SAFETY * max(size, 1e-9) ** -0.25))
            if size <= 1.0:
                break
        of.problem = None
        begin, end = t, self._target if count == 1 else t + h
        self._begin, self._span, self._start, self._z = begin, end - begin, x, TO_COEFFICIENTS @ z
        if not before.all():  # as just after an event
            soon = begin + SOON * self._span
            signs = known(self._of.plant, soon, self._signs(soon, self.inside(soon)))
            before = np.where(before, before, signs)
        changed = self._signs(end, x + z[2]) != before
        if not changed.any():
            self._t, self._x = end, x + z[2]
            return end, self._x, False
        while begin < (middle := 0.5 * (begin + end)) < end:
            if (self._signs(middle, self.inside(middle))[changed] != before[changed]).any():
                end = middle
            else:
                begin = middle
        return end, self.inside(end), True

    def inside(self, t: float) -> Array:
        """The states at a time [s] inside the last step."""
        states: Array = self._start + ((t - self._begin) / self._span) ** POWERS @ self._z
        return states

    def _signs(self, t: float, x: Array) -> Array:
        """Of the event indicators."""
        if not self._of.plant.indicator_count:
            return np.zeros(0)
        self._of.settle(t, x)
        return np.sign(self._of.plant.indicators())

    def _prepare(self, t: float, x: Array, h: float) -> bool:
        """Compute the inverse matrices for a step; True if the Jacobian is that of this state."""
        fresh, n = self._age > SLOW, len(x)
        if fresh:
            self._of.jacobian(t, x, x, self._jacobian)
        if fresh or h != self._h_of_inverse:
            finite = np.where(np.isfinite(self._jacobian), self._jacobian, 0.0)
            self._inverse = _inverse(np.eye(3 * n) - h * np.kron(A, finite))
            self._error_inverse = _inverse(np.eye(n) - h * GAMMA * finite)
            self._h_of_inverse = h
        return fresh

    def _solve(self, t: float, x: Array, h: float) -> Array | None:
        """The stages less x, shape (3, n); None if Newton's method does not converge."""
        of, z, last = self._of, np.zeros_like(self._stages), np.inf
        scale = AGREEMENT * (self._absolute + of.tolerance * np.abs(x)) + ROUNDING * np.abs(x)
        for k in range(1, ITERATIONS + 1):
            for c, stage, into in zip(C, z, self._stages, strict=True):
                of.rates(t + c * h, x + stage, into)
            change = self._inverse @ (h * (A @ self._stages) - z).reshape(-1)
            z += change.reshape(z.shape)
            size = float(np.abs(change.reshape(z.shape) / scale).max())
            if not size < 2.0 * last:  # not a number, too
                return None
            self._age, rate = k, size / last
            if size <= 1.0 or (k > 1 and rate < 1.0 and rate / (1.0 - rate) * size <= 1.0):
                return z
            last = size
        return None


def _inverse(matrix: Array) -> Array:
    """The inverse; NaN, with which no step is accepted, if the matrix is singular to rounding."""
    try:
        return np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)
