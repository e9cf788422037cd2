"""How much of the wanted speed the reference may have: one share for all joints, so the direction is kept.

    share = 1 / max(1, z)        z = (sum_i (x_i'/v_i)^8 + (outward x_i'/b_i)^8)^(1/8)

with the speed limits v_i and, towards each end of a stroke, b = stroke_gain times what is left of it up to
the margin: a piston comes to an end exponentially and leaves it freely. max is rounded over 0.2.

The reference of the tip, in joint space: resolved rates of what is wanted, within the limits.

    q' = e s g J(q)^+ v + e c (q_machine - q) + (1 - e) (q_machine' + (q_machine - q)/T)

with e engaged, s the share of `limits`, v the velocity wanted: of the joystick, filtered; or with `follow` of
the path as it is, and drawn to its point. Where the machine is behind by nearly the error limits, g lets the
reference wait, and beyond them c draws it back: it never runs away from a machine that cannot follow. Where
the machine is ahead, the reference goes on: if it waited then too, its feedforward would push a swinging arm
twice in each period, and both would swing on for ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.components.smooth import direction, ramp, s_curve
from fmus.contract import Scalar
from fmus.controller import geometry
from fmus.controller.geometry import Joints, Tip

SHARPNESS = 8  # of the norm: 1.15 at most where all three actuators are at a limit
CREEP = 1e-6  # m/s, speed into an end of the stroke that remains: keeps the quotient finite
WIDTH = 0.2
FOOT = 1e-3  # m, over which the allowed speed is rounded at the end


@dataclass(frozen=True)
class Use:
    """Speed wanted over speed allowed: by the speed limits, and by the ends of the strokes."""

    speed: Scalar
    stroke: Scalar

    @property
    def share(self) -> Scalar:
        """Of the speed wanted, 1 while nothing is above 0.9."""
        n = SHARPNESS
        z = (self.speed**n + self.stroke**n + 1e-24) ** (1 / n)
        return 1 / (1 + ramp(z - 1 + WIDTH / 2, WIDTH))


def use(swing: Scalar, pistons: list[tuple[str, Scalar, Scalar]], p: Any) -> Use:
    """Of the swing speed [rad/s] and the pistons (name, position [m], velocity [m/s])."""
    n = SHARPNESS
    speed = (swing / p.swing_speed_limit) ** n
    stroke: Scalar = 0
    for name, position, velocity in pistons:
        speed += (velocity / getattr(p, f"{name}_speed_limit")) ** n
        end = getattr(p, f"{name}_stroke") - p.stroke_margin
        for left, outward in ((end - position, velocity), (position - p.stroke_margin, -velocity)):
            allowed = p.stroke_gain * ramp(left, FOOT) + CREEP
            stroke += (ca.fmax(0, outward) / allowed) ** n
    return Use((speed + 1e-32) ** (1 / n), (stroke + 1e-32) ** (1 / n))


@dataclass(frozen=True)
class Reference:
    """Where the reference is and how it moves.

    speeds   of the joints, of the reference alone [rad/s]
    rates    of the states, with what ties it to the machine [rad/s]
    wait     how far the machine is behind, over the error limit
    """

    joints: Joints
    tip: Tip
    speeds: tuple[Scalar, Scalar, Scalar]
    rates: tuple[Scalar, Scalar, Scalar]
    use: Use
    wait: Scalar
    share: Scalar


def engaged(u: Any) -> Scalar:
    """The input within 0 ... 1."""
    return ca.fmin(ca.fmax(u.engaged, 0), 1)


def machine(u: Any) -> Joints:
    """The machine as measured."""
    return Joints(u.swing_angle, u.boom_angle, u.stick_angle, u.swing_speed, u.boom_speed, u.stick_speed)


def own(x: Any) -> Joints:
    """The reference's angles."""
    return Joints(x.reference_swing, x.reference_boom, x.reference_stick)


def wanted(x: Any, u: Any, p: Any, at: Tip) -> Tip:
    """Velocity of the tip that is asked for."""
    follow = ca.fmin(ca.fmax(u.follow, 0), 1)
    k = p.follow_gain
    away = Tip(
        k * (u.path_radius - at.radius), k * (u.path_height - at.height), k * (u.path_angle - at.angle)
    )
    square = away.radius**2 + away.height**2 + (away.angle * at.radius) ** 2
    cut = 1 / ca.sqrt(1 + square / p.follow_speed**2)

    def mixed(lever: Scalar, velocity: Scalar, drawn: Scalar) -> Scalar:
        return lever + follow * (velocity - lever + cut * drawn)

    return Tip(
        mixed(x.radial_lever, u.radial_velocity, away.radius),
        mixed(x.vertical_lever, u.vertical_velocity, away.height),
        mixed(x.turning_lever, u.swing_velocity, away.angle),
    )


def errors(x: Any, u: Any, p: Any) -> tuple[Scalar, Scalar, Scalar]:
    """Reference less machine: swing [rad], boom and stick piston [m]."""
    (boom, _), (stick, _) = geometry.pistons(own(x), p)
    (boom_now, _), (stick_now, _) = geometry.pistons(machine(u), p)
    return x.reference_swing - u.swing_angle, boom - boom_now, stick - stick_now


def reference(x: Any, u: Any, p: Any) -> Reference:
    """The reference and its rates."""
    q, now, on = own(x), machine(u), engaged(u)
    at = geometry.tip(q, p)
    swing, boom, stick = geometry.joint_speeds(q, wanted(x, u, p, at), p)
    (boom_at, boom_arm), (stick_at, stick_arm) = geometry.pistons(q, p)
    moving = [("boom", boom_at, boom_arm * boom), ("stick", stick_at, stick_arm * stick)]
    share_used = use(swing, moving, p)
    scale = p.swing_error_limit, p.piston_error_limit, p.piston_error_limit
    off = [e / s for e, s in zip(errors(x, u, p), scale, strict=True)]
    ways = (
        direction(speed, p.learning_share * getattr(p, f"{name}_speed_limit"))
        for name, speed in (("swing", swing), *((name, velocity) for name, _, velocity in moving))
    )
    error = p.feedback * sum(e**2 for e in off)
    wait = p.feedback * sum(ca.fmax(0, e * way) ** 2 for e, way in zip(off, ways, strict=True))
    share = share_used.share * (1 - s_curve((wait - 0.25) / 0.75))
    back = p.return_rate * ramp(error - 1, 0.5)
    speeds = swing * share, boom * share, stick * share
    here = (now.swing_angle, now.boom_angle, now.stick_angle)
    there = (q.swing_angle, q.boom_angle, q.stick_angle)
    machine_speeds = (now.swing_speed, now.boom_speed, now.stick_speed)
    behind = [a - b for a, b in zip(here, there, strict=True)]
    rates = [
        on * (v + back * d) + (1 - on) * (w + d / p.tracking_time)
        for v, w, d in zip(speeds, machine_speeds, behind, strict=True)
    ]
    own_speeds = [on * v + (1 - on) * w for v, w in zip(speeds, machine_speeds, strict=True)]
    return Reference(q, at, tuple(own_speeds), tuple(rates), share_used, ca.sqrt(wait + 1e-12) - 1e-6, share)
