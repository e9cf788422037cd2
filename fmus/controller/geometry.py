"""Kinematics of the arm for the controller: tip position and velocity, their inverses, and piston strokes.

Inverse velocity kinematics by damped least squares (Nakamura and Hanafusa 1986), where J is the Jacobian of
the tip position (r, h) = (radius, height) with respect to the angles q = (boom, stick):

    (r', h') = J(q) (boom', stick')        (boom', stick') = J^T (J J^T + l^2 I)^(-1) (r', h')

The two links are the lines boom pivot-elbow and elbow-tip. The damping l is zero if the sine of the angle
between the links exceeds `singular_share`; below, l rises continuously to `singular_damping` in the singular
position, with collinear links.

Inverse position kinematics by the law of cosines, in the triangle of boom pivot, elbow and tip. The elbow is
above the line from the boom pivot to the tip; the stick cylinder cannot reach the other solution.
"""

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
    """Joint angles [rad] and speeds [rad/s], named like those of the manipulator; inputs have them, too."""

    swing_angle: Scalar
    boom_angle: Scalar
    stick_angle: Scalar
    swing_speed: Scalar = 0
    boom_speed: Scalar = 0
    stick_speed: Scalar = 0


@dataclass(frozen=True)
class Cylindrical:
    """Position [m, m, rad] or velocity [m/s, m/s, rad/s] in cylindrical coordinates about the swing axis."""

    radius: Scalar
    height: Scalar
    angle: Scalar


def tip_position(q: Any, p: Any) -> Cylindrical:
    """Position of the tip."""
    _, (radius, height) = arm.points(q, p)
    return Cylindrical(radius, height, q.swing_angle)


def tip_velocity(q: Any, p: Any) -> Cylindrical:
    """Velocity of the tip."""
    return Cylindrical(*arm.tip_velocity(q, p), q.swing_speed)


def distance(a: Cylindrical, b: Cylindrical) -> Scalar:
    """Distance [m] of two positions, smoothed near zero so that it is differentiable; error below 1 um."""
    square = (a.radius - b.radius) ** 2 + (a.height - b.height) ** 2
    square += 4 * a.radius * b.radius * ca.sin((a.angle - b.angle) / 2) ** 2
    smoothing = 1e-6
    return ca.sqrt(square + smoothing**2) - smoothing


def strokes_and_moment_arms(q: Any, p: Any) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    """(position x [m], moment arm dx/dq [m]) of the boom and of the stick piston; q: angle of its joint."""
    boom, stick = arm.triangles(q, p)
    return (boom.length - p.boom.closed_length, boom.arm), (stick.length - p.stick.closed_length, stick.arm)


def joint_speeds(q: Any, velocity: Cylindrical, p: Any) -> tuple[Scalar, Scalar, Scalar]:
    """Speeds [rad/s] of swing, boom and stick that give the tip a velocity; damped near a singularity."""
    elbow, tip = arm.points(q, p)
    upper = elbow[0] - p.boom_pivot_x, elbow[1] - p.boom_pivot_z
    lower = tip[0] - elbow[0], tip[1] - elbow[1]
    # J = [a b; c d]: rows r, h; columns boom, stick
    a, b, c, d = -upper[1] - lower[1], -lower[1], upper[0] + lower[0], lower[0]
    determinant = a * d - b * c  # = |upper| |lower| sin(angle between them)
    sine_square = determinant**2 / ((upper[0] ** 2 + upper[1] ** 2) * (lower[0] ** 2 + lower[1] ** 2))
    singularity = ca.fmax(0, 1 - sine_square / (p.singular_share**2 + 1e-12))
    damping_square = p.singular_damping**2 * singularity**2
    # (J J^T + l^2 I) y = v by Cramer's rule, then J^T y
    m11, m12, m22 = a**2 + b**2 + damping_square, a * c + b * d, c**2 + d**2 + damping_square
    damped_determinant = determinant**2 + damping_square * (a**2 + b**2 + c**2 + d**2) + damping_square**2
    y1 = (m22 * velocity.radius - m12 * velocity.height) / damped_determinant
    y2 = (m11 * velocity.height - m12 * velocity.radius) / damped_determinant
    return velocity.angle, a * y1 + c * y2, b * y1 + d * y2


def arm_angles(radius: float, height: float, p: Mapping[str, float]) -> tuple[float, float]:
    """Boom and stick angle [rad] for the tip at (radius, height) [m]; p: parameter values by name."""
    x, z = radius - p["boom_pivot_x"], height - p["boom_pivot_z"]
    upper, lower = math.hypot(p["stick_pivot_x"], p["stick_pivot_z"]), p["stick_length"]
    reach = math.hypot(x, z)
    if not abs(upper - lower) <= reach <= upper + lower:
        raise Problem(
            f"tip at radius {radius:g} m, height {height:g} m is {reach:.3g} m from the boom pivot,"
            f" expected {abs(upper - lower):.3g} to {upper + lower:.3g} m"
        )
    cos_pivot = (upper**2 + reach**2 - lower**2) / (2 * upper * reach)
    cos_elbow = (reach**2 - upper**2 - lower**2) / (2 * upper * lower)
    pivot_angle, elbow_angle = (math.acos(max(-1.0, min(1.0, c))) for c in (cos_pivot, cos_elbow))
    # angle of the line boom pivot-elbow in the frame of the boom
    upper_link_offset = math.atan2(p["stick_pivot_z"], p["stick_pivot_x"])
    return math.atan2(z, x) + pivot_angle - upper_link_offset, upper_link_offset - elbow_angle
