"""Mechanics of linkages: triangle of a cylinder at a joint, and equations of motion from energies.

**A cylinder** connects a pin at f (fixed link) and a pin at r (moving link), both relative to the joint.
Piston position x(q), x' = J q', torque = J F (eqs. 5 to 7):

    l = |f - R(q) r|      J = dl/dq = f x R(q) r / l      dJ/dq = (f . R(q) r - J^2) / l

Signs: q counter-clockwise; J > 0 if extending the cylinder increases q.

**Equations of motion**

    M(q) q'' + V(q, q') + G(q) = tau            (paper eq. 4)

with kinetic energy T = q'^T M q' / 2 and potential energy U:

    M = d2T/dq'2      V = d(M q')/dq q' - dT/dq      G = dU/dq      (Lagrange)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from fmus.contract import Scalar

Point = tuple[Scalar, Scalar]


@dataclass(frozen=True)
class Triangle:
    """Pin-to-pin length l [m], moment arm J = dl/dq [m] and dJ/dq [m] at one angle."""

    length: Scalar
    arm: Scalar
    arm_derivative: Scalar


def rotate(cos: Scalar, sin: Scalar, point: Point) -> Point:
    """R(q) r for a point [m] of the moving link."""
    x, z = point
    return cos * x - sin * z, sin * x + cos * z


def triangle(q: Scalar, base: Point, rod: Point) -> Triangle:
    """Triangle at the joint angle q [rad]; singular for collinear pins."""
    x, z = rotate(ca.cos(q), ca.sin(q), rod)
    length = ca.sqrt((base[0] - x) ** 2 + (base[1] - z) ** 2)
    arm = (base[0] * z - base[1] * x) / length
    return Triangle(length, arm, (base[0] * x + base[1] * z - arm**2) / length)


def reach(base: Point, rod: Point) -> tuple[Scalar, Scalar]:
    """Shortest and longest pin-to-pin length [m] at which the triangle closes."""
    a, b = ca.sqrt(base[0] ** 2 + base[1] ** 2), ca.sqrt(rod[0] ** 2 + rod[1] ** 2)
    return ca.fabs(a - b), a + b


@dataclass(frozen=True)
class EquationsOfMotion:
    """M shape (n, n), V and G shape (n, 1), energies [J]."""

    mass: ca.SX
    coriolis: ca.SX
    gravity: ca.SX
    kinetic: Scalar
    potential: Scalar

    def acceleration(self, tau: ca.SX) -> ca.SX:
        """q'', shape (n, 1), for generalised forces tau, by the LDL^T factors of M."""
        d, upper, order = ca.ldl(self.mass)
        return ca.ldl_solve(tau - self.coriolis - self.gravity, d, upper, order)


def equations_of_motion(
    kinetic: Callable[[ca.SX, ca.SX], Scalar],
    potential: Callable[[ca.SX], Scalar],
    q: ca.SX,
    speed: ca.SX,
) -> EquationsOfMotion:
    """M, V and G derived from T(q, q') and U(q), evaluated at q and speed (columns)."""
    s, w = ca.SX.sym("q", q.shape[0]), ca.SX.sym("w", q.shape[0])
    t, u = kinetic(s, w), potential(s)
    momentum = ca.gradient(t, w)
    mass = ca.jacobian(momentum, w)
    coriolis = ca.jtimes(momentum, s, w) - ca.gradient(t, s)
    terms = [mass, coriolis, ca.gradient(u, s), t, u]
    return EquationsOfMotion(*ca.substitute(terms, [s, w], [q, speed]))
