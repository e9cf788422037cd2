"""Cylinder in a triangle: piston position x(q), x' = J q', torque = J F (eqs. 5 to 7).

The cylinder joins a pin at f (fixed link) with a pin at r (moving link), both seen from the joint:

    l = |f - R(q) r|      J = dl/dq = f x R(q) r / l      dJ/dq = (f . R(q) r - J^2) / l

Signs: q counter-clockwise; J > 0 where extending the cylinder increases q.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from fmus.contract import Scalar

Point = tuple[Scalar, Scalar]


@dataclass(frozen=True)
class Triangle:
    """Pin-to-pin length l [m], moment arm J = dl/dq [m] and dJ/dq [m] at one angle."""

    length: Scalar
    arm: Scalar
    arm_slope: Scalar


def rotate(cos: Scalar, sin: Scalar, point: Point) -> Point:
    """R(q) r for a point [m] of the moving link."""
    x, z = point
    return cos * x - sin * z, sin * x + cos * z


def triangle(q: Scalar, base: Point, rod: Point) -> Triangle:
    """Geometry at the joint angle q [rad]; regular while the three pins are not in line."""
    x, z = rotate(ca.cos(q), ca.sin(q), rod)
    length = ca.sqrt((base[0] - x) ** 2 + (base[1] - z) ** 2)
    arm = (base[0] * z - base[1] * x) / length
    return Triangle(length, arm, (base[0] * x + base[1] * z - arm**2) / length)


def reach(base: Point, rod: Point) -> tuple[Scalar, Scalar]:
    """Shortest and longest pin-to-pin length [m] at which the triangle closes."""
    a, b = ca.sqrt(base[0] ** 2 + base[1] ** 2), ca.sqrt(rod[0] ** 2 + rod[1] ** 2)
    return ca.fabs(a - b), a + b
