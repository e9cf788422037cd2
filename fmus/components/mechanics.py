"""Mechanics of linkages: triangle of a cylinder at a joint, and equations of motion from energies.

**A cylinder** connects a pin at f (fixed link) and a pin at r (moving link), both relative to the joint.
Piston position x(q), x' = J q', torque = J F (eqs. 5 to 7):

    l = |f - R(q) r|      J = dl/dq = f x R(q) r / l      dJ/dq = (f . R(q) r - J^2) / l

Signs: q counter-clockwise; J > 0 if extending the cylinder increases q.

**Equations of motion**

    M(q) q'' + V(q, q') + G(q) = tau            (paper eq. 4)

with kinetic energy T = q'^T M q' / 2 and potential energy U:

    M = d2T/dq'2      V = d(M q')/dq q' - dT/dq      G = dU/dq      (Lagrange)

A mass m that comes and goes, at a point with the velocity v and the height z, takes momentum with it
(Meshchersky; Cveticanin, Dynamics of Bodies with Time-Variable Mass, 2016, chapter 2). With the velocity c at
which it comes or goes:

    M(q, m) q'' + V + G = tau + m' (dv/dq')^T (c - v)            V at constant m

Mass that is picked up comes from rest: m' > 0, c = 0. Mass that is let go keeps its velocity: m' < 0, c = v.
(dv/dq')^T v is d(M q')/dm, so that the additional force is -max(m', 0) d(M q')/dm. Its power balance:

    tau q' + m' g z + min(m', 0) v^2/2 = d(T + U)/dt + max(m', 0) v^2/2

On the left is the power that enters with the mass, on the right the heat of an inelastic impact.
"""

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
class ChangingMass:
    """Derivatives of M q' (n, 1), T and U with respect to a mass that comes and goes."""

    momentum: Scalar
    kinetic: Scalar
    potential: Scalar

    def drag(self, rate: Scalar) -> Scalar:
        """Generalised force, shape (n, 1), of mass that is picked up from rest at `rate` [kg/s]."""
        return -ca.fmax(rate, 0) * self.momentum

    def heat(self, rate: Scalar) -> Scalar:
        """Power [W] that the inelastic pick-up dissipates."""
        return ca.fmax(rate, 0) * self.kinetic

    def inflow(self, rate: Scalar) -> Scalar:
        """Power [W] that enters with the mass: it comes at rest, and leaves with the speed that it has."""
        return rate * self.potential + ca.fmin(rate, 0) * self.kinetic


@dataclass(frozen=True)
class EquationsOfMotion:
    """M shape (n, n), V and G shape (n, 1), energies [J], and what a kilogram of a changing mass adds."""

    mass: ca.SX
    coriolis: ca.SX
    gravity: ca.SX
    kinetic: Scalar
    potential: Scalar
    per_kilogram: ChangingMass

    def acceleration(self, tau: ca.SX) -> ca.SX:
        """q'', shape (n, 1), for generalised forces tau, by the LDL^T factors of M."""
        d, upper, order = ca.ldl(self.mass)
        return ca.ldl_solve(tau - self.coriolis - self.gravity, d, upper, order)


def equations_of_motion(
    kinetic: Callable[[ca.SX, ca.SX], Scalar],
    potential: Callable[[ca.SX], Scalar],
    q: ca.SX,
    speed: ca.SX,
    changing: tuple[ca.SX, Scalar] | None = None,
) -> EquationsOfMotion:
    """M, V and G derived from T(q, q') and U(q), evaluated at q and speed (columns).

    changing   symbol of a mass in T and U that comes and goes, and its value; without it none does
    """
    s, w = ca.SX.sym("q", q.shape[0]), ca.SX.sym("w", q.shape[0])
    t, u = kinetic(s, w), potential(s)
    momentum = ca.gradient(t, w)
    mass = ca.jacobian(momentum, w)
    coriolis = ca.jtimes(momentum, s, w) - ca.gradient(t, s)
    m, value = changing or (ca.SX.sym("m"), 0)
    terms = [mass, coriolis, ca.gradient(u, s), t, u, *(ca.jacobian(term, m) for term in (momentum, t, u))]
    mass, coriolis, gravity, t, u, *per_kilogram = ca.substitute(terms, [s, w, m], [q, speed, ca.SX(value)])
    return EquationsOfMotion(mass, coriolis, gravity, t, u, ChangingMass(*per_kilogram))
