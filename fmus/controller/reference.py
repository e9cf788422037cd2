"""Reference of the tip, in joint space: resolved-rate control within the limits of the machine.

    q' = e f g J(q)^+ v + e c (q_machine - q) + (1 - e) (q_machine' + (q_machine - q)/T)

e: engaged, 0 to 1. J^+: damped inverse of the Jacobian of the tip (geometry.py). T: `tracking_time`.
v: commanded velocity of the tip. Without a path v is the filtered velocity of the joystick; with `follow` v
is the unfiltered velocity of the path plus a velocity towards the point of the path.

f: factor of the speed and stroke limits, one for all joints, so the direction of motion is kept:

    f = 1 / max(1, z)        z = (sum_i (x_i'/v_i)^8 + (outward x_i'/b_i)^8)^(1/8)

with the speed limits v_i and, towards each end of a stroke, b = stroke_gain times the distance left up to the
margin. So a piston approaches an end exponentially and leaves it without a limit. max is rounded over 0.2.

g reduces the speed if the lag of the machine comes close to the error limits; c returns the reference to the
machine beyond them. So the reference never runs away from a machine that cannot follow. If the machine leads,
the reference goes on: a g below 1 would make the feedforward push an oscillating arm twice in each period and
sustain the oscillation.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.contract import Scalar
from fmus.controller import geometry
from fmus.controller.geometry import Cylindrical, Joints
from fmus.smooth import direction, ramp, s_curve

NORM_EXPONENT = 8  # 8-norm of the actuators: 1.15 at most if all three are at a limit
CREEP = 1e-6  # m/s, allowed speed at an end of the stroke: keeps the quotient finite
WIDTH = 0.2  # width over which max(1, z) is rounded
END_ROUNDING = 1e-3  # m, distance from an end over which the allowed speed is rounded


@dataclass(frozen=True)
class Utilisation:
    """Commanded speed over allowed speed: by the speed limits, and by the ends of the strokes."""

    speed: Scalar
    stroke: Scalar

    @property
    def factor(self) -> Scalar:
        """f, the factor on the commanded speed; 1 while no utilisation is above 0.9."""
        n = NORM_EXPONENT
        z = (self.speed**n + self.stroke**n + 1e-24) ** (1 / n)
        return 1 / (1 + ramp(z - 1 + WIDTH / 2, WIDTH))


def utilisation(swing: Scalar, pistons: list[tuple[str, Scalar, Scalar]], p: Any) -> Utilisation:
    """Utilisation at a swing speed [rad/s] and for pistons (name, position [m], velocity [m/s])."""
    n = NORM_EXPONENT
    speed = (swing / p.swing_speed_limit) ** n
    stroke: Scalar = 0
    for name, position, velocity in pistons:
        speed += (velocity / getattr(p, f"{name}_speed_limit")) ** n
        end = getattr(p, name).stroke - p.stroke_margin
        for left, outward in ((end - position, velocity), (position - p.stroke_margin, -velocity)):
            allowed = p.stroke_gain * ramp(left, END_ROUNDING) + CREEP
            stroke += (ca.fmax(0, outward) / allowed) ** n
    return Utilisation((speed + 1e-32) ** (1 / n), (stroke + 1e-32) ** (1 / n))


@dataclass(frozen=True)
class Reference:
    """Reference of joints and tip.

    speeds         speeds of the joints for the feedforward [rad/s]
    rates          time derivatives of the reference angles, with the terms towards the machine [rad/s]
    directions     rounded signs of the speeds of the actuators that the path demands
    lag_ratio      lag of the machine over the error limit
    speed_factor   f g, the factor on the commanded speed
    """

    joints: Joints
    tip: Cylindrical
    speeds: tuple[Scalar, Scalar, Scalar]
    rates: tuple[Scalar, Scalar, Scalar]
    utilisation: Utilisation
    directions: tuple[Scalar, ...]
    lag_ratio: Scalar
    speed_factor: Scalar


def engaged(u: Any) -> Scalar:
    """The input `engaged`, limited to 0 ... 1."""
    return ca.fmin(ca.fmax(u.engaged, 0), 1)


def reference_joints(x: Any) -> Joints:
    """Joint angles of the reference."""
    return Joints(x.reference_swing, x.reference_boom, x.reference_stick)


def commanded_velocity(x: Any, u: Any, p: Any, tip: Cylindrical) -> Cylindrical:
    """v, the commanded velocity of the tip, for the reference of the tip at `tip`."""
    follow = ca.fmin(ca.fmax(u.follow, 0), 1)
    k = p.follow_gain
    to_path = Cylindrical(
        k * (u.path_radius - tip.radius), k * (u.path_height - tip.height), k * (u.path_angle - tip.angle)
    )
    square = to_path.radius**2 + to_path.height**2 + (to_path.angle * tip.radius) ** 2
    limit = 1 / ca.sqrt(1 + square / p.follow_speed**2)

    def blended(lever: Scalar, velocity: Scalar, towards_path: Scalar) -> Scalar:
        return lever + follow * (velocity - lever + limit * towards_path)

    return Cylindrical(
        blended(x.radial_lever, u.radial_velocity, to_path.radius),
        blended(x.vertical_lever, u.vertical_velocity, to_path.height),
        blended(x.turning_lever, u.swing_velocity, to_path.angle),
    )


def errors(x: Any, u: Any, p: Any) -> tuple[Scalar, Scalar, Scalar]:
    """Reference minus machine: swing [rad], boom and stick piston [m]."""
    (boom, _), (stick, _) = geometry.strokes_and_moment_arms(reference_joints(x), p)
    (boom_now, _), (stick_now, _) = geometry.strokes_and_moment_arms(u, p)
    return x.reference_swing - u.swing_angle, boom - boom_now, stick - stick_now


def reference(x: Any, u: Any, p: Any) -> Reference:
    """The reference and its rates."""
    q, on = reference_joints(x), engaged(u)
    tip = geometry.tip_position(q, p)
    swing, boom, stick = geometry.joint_speeds(q, commanded_velocity(x, u, p, tip), p)
    (boom_at, boom_arm), (stick_at, stick_arm) = geometry.strokes_and_moment_arms(q, p)
    pistons = [("boom", boom_at, boom_arm * boom), ("stick", stick_at, stick_arm * stick)]
    used = utilisation(swing, pistons, p)
    error_limits = p.swing_error_limit, p.piston_error_limit, p.piston_error_limit
    relative = [e / limit for e, limit in zip(errors(x, u, p), error_limits, strict=True)]
    directions = tuple(
        direction(speed, p.learning_share * getattr(p, f"{name}_speed_limit"))
        for name, speed in (("swing", swing), *((name, velocity) for name, _, velocity in pistons))
    )
    error_square = p.feedback * sum(e**2 for e in relative)
    lag_square = p.feedback * sum(
        ca.fmax(0, e * sign) ** 2 for e, sign in zip(relative, directions, strict=True)
    )
    factor = used.factor * (1 - s_curve((lag_square - 0.25) / 0.75))
    return_rate = p.return_rate * ramp(error_square - 1, 0.5)
    speeds = swing * factor, boom * factor, stick * factor
    machine_angles = (u.swing_angle, u.boom_angle, u.stick_angle)
    machine_speeds = (u.swing_speed, u.boom_speed, u.stick_speed)
    to_machine = [
        a - b for a, b in zip(machine_angles, (q.swing_angle, q.boom_angle, q.stick_angle), strict=True)
    ]
    rates = [
        on * (v + return_rate * d) + (1 - on) * (w + d / p.tracking_time)
        for v, w, d in zip(speeds, machine_speeds, to_machine, strict=True)
    ]
    feedforward = [on * v + (1 - on) * w for v, w in zip(speeds, machine_speeds, strict=True)]
    lag_ratio = ca.sqrt(lag_square + 1e-12) - 1e-6
    return Reference(q, tip, tuple(feedforward), tuple(rates), used, directions, lag_ratio, factor)
