"""Reference of the tip, in joint space: resolved-rate control within the limits of the machine.

    q' = e f g J(q)^+ v + e c (q_machine - q) + (1 - e) (q_machine' + (q_machine - q)/T)

e: engaged, 0 to 1. J^+: damped inverse of the Jacobian of the tip (arm.py). T: `tracking_time`.
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

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.contract import Scalar
from fmus.controller.arm import Arm, Coordinates, Cylindrical, Pistons
from fmus.controller.valve import section_speeds
from fmus.smooth import direction, ramp, s_curve

NORM_EXPONENT = 8  # 8-norm of the actuators: 1.15 at most if all three are at a limit
CREEP = 1e-6  # m/s, allowed speed at an end of the stroke: keeps the quotient finite
SECTION_SHARE = 0.9  # of the speed that the flow of a compensated section gives
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


def utilisation(
    speeds: Mapping[str, Scalar], limits: Mapping[str, Scalar], positions: Mapping[str, Scalar], p: Any
) -> Utilisation:
    """Utilisation at these speeds of actuators [m/s, rad/s], with their limits; positions of pistons [m]."""
    n = NORM_EXPONENT
    speed: Scalar = sum((v / limits[name]) ** n for name, v in speeds.items())
    stroke: Scalar = 0
    for name, position in positions.items():
        end, velocity = getattr(p, name).stroke - p.stroke_margin, speeds[name]
        for left, outward in ((end - position, velocity), (position - p.stroke_margin, -velocity)):
            allowed = p.stroke_gain * ramp(left, END_ROUNDING) + CREEP
            stroke += (ca.fmax(0, outward) / allowed) ** n
    return Utilisation((speed + 1e-32) ** (1 / n), (stroke + 1e-32) ** (1 / n))


def speed_limits(arm: Arm, pistons: Pistons, p: Any) -> dict[str, Scalar]:
    """Largest speeds of the actuators; a compensated section has no more than its flow."""
    found = {}
    for name, a in arm.actuators([x for x, _ in pistons], p).items():
        limit, flow = getattr(p, f"{name}_speed_limit"), a.section_flows[0]
        slower = SECTION_SHARE * ca.fmin(*section_speeds(a))
        found[name] = ca.if_else(flow > 0, ca.fmin(limit, slower), limit)
    return found


@dataclass(frozen=True)
class Reference:
    """Reference of joints and tip.

    joints         coordinates [rad or m]
    pistons        positions and levers of the actuators there
    speeds         speeds of the joints for the feedforward [rad/s or m/s]
    rates          time derivatives of the reference, with the terms towards the machine [rad/s or m/s]
    errors         reference minus machine: column [rad], pistons [m]
    directions     rounded signs of the speeds of the actuators that the path demands
    lag_ratio      lag of the machine over the error limit
    speed_factor   f g, the factor on the commanded speed
    """

    joints: Coordinates
    pistons: Pistons
    tip: Cylindrical
    speeds: Coordinates
    rates: Coordinates
    utilisation: Utilisation
    errors: tuple[Scalar, ...]
    directions: tuple[Scalar, ...]
    lag_ratio: Scalar
    speed_factor: Scalar


def engaged(u: Any) -> Scalar:
    """The input `engaged`, limited to 0 ... 1."""
    return ca.fmin(ca.fmax(u.engaged, 0), 1)


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


def reference(arm: Arm, x: Any, u: Any, p: Any) -> Reference:
    """The reference and its rates."""
    q, on = arm.coordinates(x, "reference_{}"), engaged(u)
    tip = arm.tip(q, p)
    joints = arm.joint_speeds(q, commanded_velocity(x, u, p, tip), p)
    pistons, now = arm.pistons(q, p), arm.pistons(arm.coordinates(u), p)
    names = [a.name for a in arm.axes]
    moved = {n: lever * v for n, (_, lever), v in zip(names, pistons, joints, strict=True)}
    places = {n: x for n, (x, _) in zip(names[1:], pistons[1:], strict=True)}
    used = utilisation(moved, speed_limits(arm, pistons, p), places, p)
    errors = [x - x_now for (x, _), (x_now, _) in zip(pistons, now, strict=True)]
    relative = [e / getattr(p, f"{a.loop}_error_limit") for e, a in zip(errors, arm.axes, strict=True)]
    directions = tuple(
        direction(v, p.learning_share * getattr(p, f"{n}_speed_limit")) for n, v in moved.items()
    )
    error_square = p.feedback * sum(e**2 for e in relative)
    lag_square = p.feedback * sum(
        ca.fmax(0, e * sign) ** 2 for e, sign in zip(relative, directions, strict=True)
    )
    factor = used.factor * (1 - s_curve((lag_square - 0.25) / 0.75))
    return_rate = p.return_rate * ramp(error_square - 1, 0.5)
    to_machine = [at - r for at, r in zip(arm.coordinates(u), q, strict=True)]
    feedforward, rates = list[Scalar](), list[Scalar]()
    for joint, w, d in zip(joints, arm.speeds(u), to_machine, strict=True):
        v = joint * factor
        rates.append(on * (v + return_rate * d) + (1 - on) * (w + d / p.tracking_time))
        feedforward.append(on * v + (1 - on) * w)
    lag_ratio = ca.sqrt(lag_square + 1e-12) - 1e-6
    return Reference(q, pistons, tip, feedforward, rates, used, tuple(errors), directions, lag_ratio, factor)
