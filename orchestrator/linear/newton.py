"""The equations of a steady state, scaled, and Newton's method for them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from orchestrator.errors import Problem
from orchestrator.linear.member import Array
from orchestrator.linear.plant import Plant

ROUNDS, HALVES = 40, 8
ENOUGH = 1e-11  # of what the terms of a time derivative amount to: rounding
FLAT = 1e-13  # of the largest singular value: a direction in which nothing changes
TINY = 1e-14  # of the size of the unknowns: rounding


@dataclass(frozen=True)
class Joint:
    """Places of a position and its speed among the states, and of the input that moves them."""

    name: str
    position: int
    speed: int
    input: int


class Equations:
    """Unknowns: the states `states`, then `inputs`. To be zero: the time derivatives of the states `rows`.

    size   magnitudes of the unknowns, shape (n,); those of the inputs are the last ones
    free   directions that are steady anyway, at the last solution
    """

    def __init__(self, plant: Plant, joints: Iterable[Joint], idle: Iterable[int]) -> None:
        """idle: states that need not be steady."""
        self.plant, self.joints, self.free = plant, list(joints), 0
        fixed = {*idle, *(i for j in self.joints for i in (j.position, j.speed))}
        self.states = [i for i in range(len(plant.x)) if i not in fixed]
        self.rows = [*self.states, *(j.speed for j in self.joints)]
        self.inputs = [j.input for j in self.joints]
        ports = [inlet.targets[0][0] for inlet in plant.choice.inputs]
        magnitude = [plant.system.variable(ports[i]).nominal or 1.0 for i in self.inputs]
        self.size = np.concatenate([plant.nominal[self.states], magnitude])

    @property
    def off(self) -> Array:
        """The time derivatives that are to be zero, now."""
        return self.plant.f[self.rows]

    def look(self, x: Array, u: Array) -> bool:
        """Ask the plant there; False where it has no answer."""
        try:
            self.plant.settle(x, u)
        except Problem:
            return False
        return bool(np.isfinite(self.plant.f).all())

    def moved(self, x: Array, u: Array, change: Array) -> tuple[Array, Array]:
        """States and inputs, changed by a change of the unknowns in their size."""
        x, u, by, n = x.copy(), u.copy(), change * self.size, len(self.states)
        x[self.states] += by[:n]
        u[self.inputs] += by[n:]
        return x, u

    def matrix(self) -> tuple[Array, Array]:
        """The Jacobian by the size of the unknowns, each row by what its terms amount to; and that."""
        m = self.plant.matrices()
        own = np.hstack([m.a[np.ix_(self.rows, self.states)], m.b[np.ix_(self.rows, self.inputs)]])
        own = own * self.size
        amount = np.abs(m.a) @ np.maximum(np.abs(self.plant.x), self.plant.nominal)
        scale = amount[self.rows] + np.abs(own).sum(axis=1)
        scale[scale == 0.0] = 1.0
        return own / scale[:, None], scale

    def worst(self) -> str:
        """The state that is furthest from rest."""
        off = np.abs(self.off / self.matrix()[1])
        return str(self.plant.states[self.rows[int(np.argmax(off))]])

    def solve(self) -> bool:
        """Newton's method from where the plant is; where it does not get there, the plant is put back."""
        x, u = before = self.plant.x.copy(), self.plant.u
        for _ in range(ROUNDS):
            matrix, scale = self.matrix()
            done = (np.abs(self.off / scale) <= ENOUGH).all()
            found = self._step(x, u, np.linalg.pinv(matrix, rcond=FLAT) / scale)
            if done:  # with one more step if it helps: of the large terms of fast states ENOUGH is much
                self.free = matrix.shape[1] - int(np.linalg.matrix_rank(matrix, rtol=FLAT))
                if found is None:
                    self.look(x, u)
                return True
            if found is None:
                break
            x, u = found
        self.look(*before)
        return False

    def _step(self, x: Array, u: Array, inverse: Array) -> tuple[Array, Array] | None:
        """Go as far as the next correction, with the same matrix, gets smaller; None where none does.

        That test does not depend on how the equations are scaled (Deuflhard, Newton Methods for Nonlinear
        Problems, 2011, 3.3: the natural level function).
        """
        change = -inverse @ self.off
        length = float(np.linalg.norm(change))
        for share in 0.5 ** np.arange(HALVES if length > TINY else 0):
            there = self.moved(x, u, share * change)
            if self.look(*there) and np.linalg.norm(inverse @ self.off) <= (1.0 - share / 4.0) * length:
                return there
        return None
