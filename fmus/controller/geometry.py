"""The arm as the controller sees it: tip, pistons, damped inverse of the tip's Jacobian, and joint angles.

    (r', h') = J(q) (boom', stick')        (boom', stick') = J^T (J J^T + l^2 I)^(-1) (r', h')

The damping l is zero where the links are more than `singular_share` out of line (sine of the angle between
them) and rises smoothly to `singular_damping` where they are in line (Nakamura and Hanafusa 1986).

Joint angles for a place of the stick end follow from cosines in the triangle of both links. The stick hangs
below the line from the boom pivot to the tip (angle < 0), as its cylinder has it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.contract import Scalar
from fmus.manipulator import arm
from orchestrator.base.errors import Problem


@dataclass(frozen=True)
class Joints:
    """Joint angles [rad] and speeds [rad/s], named as those of the manipulator."""

    swing_angle: Scalar
    boom_angle: Scalar
    stick_angle: Scalar
    swing_speed: Scalar = 0
    boom_speed: Scalar = 0
    stick_speed: Scalar = 0


@dataclass(frozen=True)
class Tip:
    """The stick end in cylinder coordinates [m, m, rad]; also its velocity."""

    radius: Scalar
    height: Scalar
    angle: Scalar


def tip(q: Joints, p: Any) -> Tip:
    """Where the stick end is."""
    _, (radius, height) = arm.points(q, p)
    return Tip(radius, height, q.swing_angle)


def tip_velocity(q: Joints, p: Any) -> Tip:
    """How it moves."""
    return Tip(*arm.tip_velocity(q, p), q.swing_speed)


def distance(a: Tip, b: Tip) -> Scalar:
    """Distance in space [m], exact up to a micrometre; rounded where it is zero, to have a slope there."""
    square = (a.radius - b.radius) ** 2 + (a.height - b.height) ** 2
    square += 4 * a.radius * b.radius * ca.sin((a.angle - b.angle) / 2) ** 2
    tiny = 1e-6
    return ca.sqrt(square + tiny**2) - tiny


def pistons(q: Joints, p: Any) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    """(position [m], moment arm dx/dq [m]) of the boom and of the stick piston."""
    boom, stick = arm.triangles(q, p)
    return (boom.length - p.boom_closed_length, boom.arm), (stick.length - p.stick_closed_length, stick.arm)


def joint_speeds(q: Joints, velocity: Tip, p: Any) -> tuple[Scalar, Scalar, Scalar]:
    """Speeds [rad/s] of swing, boom and stick that move the tip as wanted, damped near a singularity."""
    elbow, end = arm.points(q, p)
    upper = elbow[0] - p.boom_pivot_x, elbow[1] - p.boom_pivot_z
    lower = end[0] - elbow[0], end[1] - elbow[1]
    # rows r, h; columns boom, stick
    a, b, c, d = -upper[1] - lower[1], -lower[1], upper[0] + lower[0], lower[0]
    determinant = a * d - b * c  # = |upper| |lower| sin(angle between them)
    sine_square = determinant**2 / ((upper[0] ** 2 + upper[1] ** 2) * (lower[0] ** 2 + lower[1] ** 2))
    near = ca.fmax(0, 1 - sine_square / (p.singular_share**2 + 1e-12))
    square = p.singular_damping**2 * near**2
    # (J J^T + l^2 I) y = v, then J^T y
    m11, m12, m22 = a**2 + b**2 + square, a * c + b * d, c**2 + d**2 + square
    size = determinant**2 + square * (a**2 + b**2 + c**2 + d**2) + square**2
    y1 = (m22 * velocity.radius - m12 * velocity.height) / size
    y2 = (m11 * velocity.height - m12 * velocity.radius) / size
    return velocity.angle, a * y1 + c * y2, b * y1 + d * y2


def joints(radius: float, height: float, p: Mapping[str, float]) -> tuple[float, float]:
    """Boom and stick angle [rad] that bring the stick end to (radius, height) [m]; p by name."""
    x, z = radius - p["boom_pivot_x"], height - p["boom_pivot_z"]
    upper, lower = math.hypot(p["stick_pivot_x"], p["stick_pivot_z"]), p["stick_length"]
    reach = math.hypot(x, z)
    if not abs(upper - lower) <= reach <= upper + lower:
        raise Problem(
            f"tip at radius {radius:g} m, height {height:g} m is {reach:.3g} m from the boom pivot,"
            f" expected {abs(upper - lower):.3g} to {upper + lower:.3g} m"
        )
    inner = math.acos(_within((upper**2 + reach**2 - lower**2) / (2 * upper * reach)))
    bend = math.acos(_within((reach**2 - upper**2 - lower**2) / (2 * upper * lower)))
    crank = math.atan2(p["stick_pivot_z"], p["stick_pivot_x"])  # of the upper link in the boom's frame
    return math.atan2(z, x) + inner - crank, crank - bend


def _within(cosine: float) -> float:
    return max(-1.0, min(1.0, cosine))
