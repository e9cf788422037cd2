"""Equations of motion from energies.

    M(q) q'' + V(q, q') + G(q) = tau            (paper eq. 4)

with kinetic energy T = q'^T M q' / 2 and potential energy U:

    M = d2T/dq'2      V = d(M q')/dq q' - dT/dq      G = dU/dq      (Lagrange)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from fmus.contract import Scalar


@dataclass(frozen=True)
class EquationsOfMotion:
    """M shape (n, n), V and G shape (n, 1), energies [J]."""

    mass: ca.SX
    coriolis: ca.SX
    gravity: ca.SX
    kinetic: Scalar
    potential: Scalar

    def acceleration(self, tau: ca.SX) -> ca.SX:
        """q'' shape (n, 1) for generalised forces tau, by the square-root-free Cholesky factors of M."""
        d, upper, order = ca.ldl(self.mass)
        return ca.ldl_solve(tau - self.coriolis - self.gravity, d, upper, order)


def equations_of_motion(
    kinetic: Callable[[ca.SX, ca.SX], Scalar],
    potential: Callable[[ca.SX], Scalar],
    q: ca.SX,
    speed: ca.SX,
) -> EquationsOfMotion:
    """Derive M, V, G from T(q, q') and U(q) and evaluate them at q, speed (columns)."""
    s, w = ca.SX.sym("q", q.shape[0]), ca.SX.sym("w", q.shape[0])
    t, u = kinetic(s, w), potential(s)
    momentum = ca.gradient(t, w)
    mass = ca.jacobian(momentum, w)
    coriolis = ca.jtimes(momentum, s, w) - ca.gradient(t, s)
    terms = [mass, coriolis, ca.gradient(u, s), t, u]
    return EquationsOfMotion(*ca.substitute(terms, [s, w], [q, speed]))
