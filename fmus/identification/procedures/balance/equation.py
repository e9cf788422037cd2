"""The balance of momenta of one recording, filtered: e = phi * f - phi' * h, with slopes over parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fmus.identification.procedures.balance import modulation
from fmus.identification.procedures.balance.motion import motion
from fmus.identification.procedures.balance.samples import Samples

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Equation:
    """e (rows, t) [N.m] at some parameters, E = de/dtheta (m, rows, t); zero where it does not hold."""

    error: Array
    slope: Array

    def moved(self, step: Array) -> Equation:
        """The same at parameters `step` further; linear in them."""
        return Equation(self.error + np.einsum("mrt,m->rt", self.slope, step), self.slope)


def equation(s: Samples, rows: Sequence[int], theta: tuple[str, ...], p: Array) -> Equation:
    """The balance of the joints `rows` at the parameters p."""
    f, m = motion(theta), len(theta)
    momentum, force = (_columns(x, 1)[0] for x in f.balance(*s.known, p))
    by_momentum, by_force = (_columns(x, m) for x in f.slopes(*s.known, p))
    error = _filtered(s, force[list(rows)], momentum[list(rows)])
    slope = [_filtered(s, a[list(rows)], b[list(rows)]) for a, b in zip(by_force, by_momentum, strict=True)]
    return Equation(error, np.array(slope).reshape(m, *error.shape))


def _filtered(s: Samples, force: Array, momentum: Array) -> Array:
    e: Array = modulation.apply(s.filters.bump, force) - modulation.apply(s.filters.slope, momentum)
    return e * s.good


def _columns(stacked: ca.DM, count: int) -> Array:
    """(3 m, n) column by column -> (m, 3, n)."""
    full: Array = np.array(stacked.full())
    return full.reshape(count, 3, full.shape[1])
