"""The head hangs from the stick end in a Hooke joint and swings, instead of a point mass there.

It is a slender body: centre of mass the length L from the joint in the direction n, inertia J about its
centre across its axis, none about the axis. With the angle a in the plane of the arm, from the vertical,
outwards positive, and the angle b out of that plane, to the left positive:

    n = (sin a cos b, sin b, -cos a cos b)                 outwards, to the left, upwards
    T = m |v + L n'|^2 / 2 + J |n'|^2 / 2                  v of the stick end; n' with the swing of the arm
    U = m g (z + L n_z)                                    z height of the stick end

The joint's first axis is the pin through the stick end, across the plane of the arm; the second one sits in
the yoke below. Angles from the vertical instead of those of the joint keep gravity of the arm what it is with
a point mass: G_boom and G_stick do not depend on a and b, so the forces that hold the arm with the head at
rest are those of `rigid`. The joint itself turns by a - f about its pin, f = boom + stick angle. Its damping

    d (a' - f')  on the pin, opposite on boom and stick;       d b'  in the yoke

turns the head with the stick. The yoke hits stops at b = +-B, soft ones with contact damping (Hunt and
Crossley, J. Appl. Mech. 42 (1975) 440), r the `ramp` of `fmus.components.smooth`:

    -k r(b - B) (1 + c b') + k r(-b - B) (1 - c b')       on b; stored k (R(b - B) + R(-b - B)), R' = r

Singular at b = +-90 degrees, where the head lies along the pin: there a is
nothing. (Goldstein, Poole and Safko, Classical Mechanics, chapters 1 and 2, for T, U and dissipation.)

Validity: |b| below 1.4 rad (80 degrees); no stops on the pin, no slewing of the rotator below the joint, no
load that swings by itself.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from fmus.components.smooth import ramp, ramp_integral
from fmus.contract import Quantity, Scalar
from fmus.manipulator import arm
from fmus.manipulator.design import Head, Joint, TipMotion
from fmus.manipulator.friction import BRISTLES, FrictionOutputs, FrictionParameters, FrictionState
from fmus.manipulator.model import manipulator
from fmus.manipulator.variables import ManipulatorOutputs, ManipulatorParameters, ManipulatorState

SIDE_LIMIT = 1.4  # rad; at the singularity the inertia of the first axis, (J + m L^2) cos(b)^2, is zero
STOP_ROUNDING = 0.01  # rad over which a stop takes hold


class PendulumParameters(ManipulatorParameters):
    """Those of the arm, and of the joint of the head."""

    head_length: Scalar = Quantity(
        "m", "Centre of mass of the head below its joint", minimum=1e-3, group="Swinging head"
    )
    head_inertia: Scalar = Quantity(
        "kg.m2", "Inertia of the head about its centre of mass, across its axis", minimum=0.0
    )
    head_joint_damping: Scalar = Quantity(
        "N.m.s/rad", "Viscous friction of each axis of the head's joint", minimum=0.0, tunable=True
    )
    head_stop_angle: Scalar = Quantity(
        "rad", "Side angle of the head at which its joint's stops begin", minimum=0.1, maximum=1.3
    )
    head_stop_stiffness: Scalar = Quantity(
        "N.m/rad", "Stiffness of the stops of the head's joint", 1e6, minimum=0.0
    )
    head_stop_damping: Scalar = Quantity(
        "s/rad", "Contact damping of these stops (Hunt and Crossley)", 0.1, minimum=0.0
    )
    initial_head_angle: Scalar = Quantity(
        "rad", "Head angle at the start, from the vertical, outwards positive"
    )
    initial_head_side_angle: Scalar = Quantity(
        "rad", "Side angle of the head at the start, to the left positive"
    )


class PendulumState(ManipulatorState):
    """Those of the arm, and the head's."""

    head_angle: Scalar = Quantity(
        "rad", "Angle of the head from the vertical in the plane of the arm, outwards"
    )
    head_side_angle: Scalar = Quantity("rad", "Angle of the head out of the plane of the arm, to the left")
    head_speed: Scalar = Quantity("rad/s", "Rate of the head angle")
    head_side_speed: Scalar = Quantity("rad/s", "Rate of the side angle of the head")


class PendulumOutputs(ManipulatorOutputs, PendulumState):
    """Those of the arm, and where the head is."""

    head_x: Scalar = Quantity("m", "Centre of mass of the head, forward at swing angle zero")
    head_y: Scalar = Quantity("m", "Centre of mass of the head, to the left at swing angle zero")
    head_height: Scalar = Quantity("m", "Centre of mass of the head, height above the foot of the column")
    head_stop_torque: Scalar = Quantity(
        "N.m", "Torque of the stops of the head's joint on its side angle", 1e4
    )
    stored_energy: Scalar = Quantity("J", "Elastic energy in the stops of the head's joint", 1e3)


def direction(a: Scalar, b: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """n, from the joint to the centre of mass."""
    return ca.sin(a) * ca.cos(b), ca.sin(b), -ca.cos(a) * ca.cos(b)


def kinetic(tip: TipMotion, angles: Any, speeds: Any, p: PendulumParameters) -> Scalar:
    """T less that of the point mass: m L v n' + (J + m L^2) |n'|^2 / 2."""
    n = direction(angles[0], angles[1])
    turning = [
        ca.jtimes(c, angles, speeds) + carried
        for c, carried in zip(n, (-tip.yaw_rate * n[1], tip.yaw_rate * n[0], 0), strict=True)
    ]
    along = sum(v * d for v, d in zip(tip.velocity, turning, strict=True))
    square = sum(d**2 for d in turning)
    about_joint = p.head_inertia + p.head_mass * p.head_length**2
    return p.head_mass * p.head_length * along + about_joint * square / 2


def potential(angles: Any, p: PendulumParameters) -> Scalar:
    """U less that of the point mass."""
    return p.head_mass * p.gravity * p.head_length * direction(angles[0], angles[1])[2]


def joint(x: PendulumState, p: PendulumParameters) -> Joint:
    """The damping of the joint and the stops of its yoke."""
    turn, speed = x.head_speed - x.boom_speed - x.stick_speed, x.head_side_speed
    pin, yoke = p.head_joint_damping * turn, p.head_joint_damping * speed
    left, right = _beyond(x, p)
    contact = p.head_stop_damping * p.head_stop_stiffness * speed * sum(map(_ramp, (left, right)))
    return Joint(
        on_stick=pin,
        own=(-pin, -yoke + stop_torque(x, p)),
        heat=pin * turn + (yoke + contact) * speed,
        stored=p.head_stop_stiffness * sum(ramp_integral(d, STOP_ROUNDING) for d in (left, right)),
    )


def _beyond(x: PendulumState, p: PendulumParameters) -> tuple[Scalar, Scalar]:
    """How far the head is beyond the left and the right stop [rad]."""
    return x.head_side_angle - p.head_stop_angle, -x.head_side_angle - p.head_stop_angle


def _ramp(depth: Scalar) -> Scalar:
    return ramp(depth, STOP_ROUNDING)


def stop_torque(x: PendulumState, p: PendulumParameters) -> Scalar:
    """Torque [N.m] of the stops on the side angle."""
    left, right = map(_ramp, _beyond(x, p))
    closing = p.head_stop_damping * x.head_side_speed
    return p.head_stop_stiffness * (right * (1 - closing) - left * (1 + closing))


def outputs(x: PendulumState, p: PendulumParameters) -> dict[str, Scalar]:
    """Where the head is."""
    n = direction(x.head_angle, x.head_side_angle)
    _, tip = arm.points(x, p)
    out, left = tip[0] + p.head_length * n[0], p.head_length * n[1]
    cos, sin = ca.cos(x.swing_angle), ca.sin(x.swing_angle)
    return {
        "head_x": out * cos - left * sin,
        "head_y": out * sin + left * cos,
        "head_height": tip[1] + p.head_length * n[2],
        "head_stop_torque": stop_torque(x, p),
    }


def initial(p: PendulumParameters) -> dict[str, Scalar]:
    """The angles to start from."""
    return {"head_angle": p.initial_head_angle, "head_side_angle": p.initial_head_side_angle}


def require(x: PendulumState, p: PendulumParameters) -> dict[str, Scalar]:
    """The side angle stays away from the singular position."""
    statement = f"head_side_angle [rad] stays between -{SIDE_LIMIT} and {SIDE_LIMIT}, clear of the pin's line"
    return {statement: SIDE_LIMIT - ca.fabs(x.head_side_angle)}


HANGING = Head(
    angles=("head_angle", "head_side_angle"),
    speeds=("head_speed", "head_side_speed"),
    kinetic=kinetic,
    potential=potential,
    joint=joint,
    outputs=outputs,
    initial=initial,
    require=require,
)

PENDULUM = manipulator(
    text="Swing column, boom, stick and a processing head that swings in a Hooke joint",
    validity="rigid slender links, viscous friction; head within 80 degrees of the arm's plane",
    parameters=PendulumParameters,
    states=PendulumState,
    outputs=PendulumOutputs,
    head=HANGING,
)


# ---- with dry friction: the equations of this file and of `friction`


class PendulumFrictionParameters(PendulumParameters, FrictionParameters):
    """Those of both."""


class PendulumFrictionState(PendulumState, FrictionState):
    """Those of both."""


class PendulumFrictionOutputs(PendulumOutputs, FrictionOutputs):
    """Those of both."""

    stored_energy: Scalar = Quantity(
        "J", "Elastic energy in the friction of joints and pistons and in the head's stops"
    )


PENDULUM_FRICTION = manipulator(
    text="Swing column, boom, stick with dry friction and a processing head that swings in a Hooke joint",
    validity="rigid slender links; head within 80 degrees of the arm's plane; friction independent of load",
    parameters=PendulumFrictionParameters,
    states=PendulumFrictionState,
    outputs=PendulumFrictionOutputs,
    head=HANGING,
    friction=BRISTLES,
)
