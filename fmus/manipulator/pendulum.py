"""Manipulator with a head that hangs from the tip in a Hooke joint and swings.

The head is a slender body. Its centre of mass is at the distance L from the joint in the direction n. Its
moment of inertia is J about the centre of mass perpendicular to its axis, and zero about the axis. With the
angle a in the plane of the arm, from the vertical, outwards positive, and the angle b out of that plane, to
the left positive:

    n = (sin a cos b, sin b, -cos a cos b)                 outwards, to the left, upwards
    T = m |v + L n'|^2 / 2 + J |n'|^2 / 2                  v of the tip; n' includes the yaw of the arm
    U = m g (z + L n_z)                                    z height of the tip

The first axis of the joint is the pin through the tip, perpendicular to the plane of the arm; the second axis
is in the yoke below. Because a and b are measured from the vertical and not from the stick, G_boom and
G_stick do not depend on them: with the head at rest the holding forces of the arm are those of `rigid`. The
angle of the joint about its pin is a - f, f = boom + stick angle. Its damping

    d (a' - f')  on the pin, opposite on boom and stick;       d b'  in the yoke

couples the head to the stick. The yoke has stops at b = +-B, those of `cylinder.stop`.

The coordinates are singular at b = +-90 degrees: the head is parallel to the pin and a is undefined.
T, U and dissipation: Goldstein, Poole and Safko, Classical Mechanics, chapters 1 and 2.

Validity: |b| below 1.4 rad (80 degrees). Not modelled: stops on the pin, slewing of the rotator below the
joint, a load that swings relative to the head.
"""

from typing import Any

import casadi as ca

from fmus.components import cylinder, friction
from fmus.components.cylinder import Stop
from fmus.contract import Quantity, Scalar
from fmus.manipulator import arm
from fmus.manipulator.design import Design, Head, Joint, TipMotion
from fmus.manipulator.friction import FrictionOutputs, FrictionParameters, FrictionState, resist
from fmus.manipulator.model import manipulator
from fmus.manipulator.variables import ManipulatorOutputs, ManipulatorParameters, ManipulatorState

SIDE_LIMIT = 1.4  # rad; at the singularity the inertia of the first axis, (J + m L^2) cos(b)^2, is zero
STOP_ROUNDING = 0.01  # rad, smoothing angle of the stop torque


class PendulumParameters(ManipulatorParameters):
    """Parameters of the arm, and of the head with its joint."""

    head_length: Scalar = Quantity(
        "m", "Centre of mass of the head below its joint", minimum=1e-3, group="Swinging head"
    )
    head_inertia: Scalar = Quantity(
        "kg.m2",
        "Moment of inertia of the head about its centre of mass, perpendicular to its axis",
        minimum=0.0,
    )
    head_joint_damping: Scalar = friction.damping("N.m.s/rad", "each axis of the head's joint")
    head_stop_angle: Scalar = Quantity(
        "rad", "Side angle of the head at which the stops of its joint begin", minimum=0.1, maximum=1.3
    )
    head_stop_stiffness: Scalar = Quantity(
        "N.m/rad", "Stiffness of the stops of the head's joint", 1e6, minimum=0.0
    )
    head_stop_damping: Scalar = Quantity(
        "s/rad", "Contact damping of the stops of the head's joint (Hunt and Crossley)", 0.1, minimum=0.0
    )
    initial_head_angle: Scalar = Quantity(
        "rad", "Head angle at the start, from the vertical, outwards positive"
    )
    initial_head_side_angle: Scalar = Quantity(
        "rad", "Side angle of the head at the start, to the left positive"
    )


class PendulumState(ManipulatorState):
    """States of the arm and of the head."""

    head_angle: Scalar = Quantity(
        "rad", "Angle of the head from the vertical in the plane of the arm, outwards"
    )
    head_side_angle: Scalar = Quantity("rad", "Angle of the head out of the plane of the arm, to the left")
    head_speed: Scalar = Quantity("rad/s", "Rate of the head angle")
    head_side_speed: Scalar = Quantity("rad/s", "Rate of the side angle of the head")


class PendulumOutputs(ManipulatorOutputs, PendulumState):
    """Outputs of the arm, and position and stops of the head."""

    head_x: Scalar = Quantity("m", "Centre of mass of the head, forward at swing angle zero")
    head_y: Scalar = Quantity("m", "Centre of mass of the head, to the left at swing angle zero")
    head_height: Scalar = Quantity("m", "Centre of mass of the head, height above the foot of the column")
    head_stop_torque: Scalar = Quantity(
        "N.m", "Torque of the stops of the head's joint on its side angle", 1e4
    )
    stored_energy: Scalar = Quantity("J", "Elastic energy in the stops of the head's joint", 1e3)


def direction(a: Scalar, b: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """n, the unit vector from the joint to the centre of mass."""
    return ca.sin(a) * ca.cos(b), ca.sin(b), -ca.cos(a) * ca.cos(b)


def kinetic(tip: TipMotion, angles: Any, speeds: Any, p: PendulumParameters) -> Scalar:
    """T minus that of the point mass: m L v n' + (J + m L^2) |n'|^2 / 2."""
    n = direction(angles[0], angles[1])
    n_rate = [
        ca.jtimes(c, angles, speeds) + yaw
        for c, yaw in zip(n, (-tip.yaw_rate * n[1], tip.yaw_rate * n[0], 0), strict=True)
    ]
    v_n_rate = sum(v * d for v, d in zip(tip.velocity, n_rate, strict=True))
    square = sum(d**2 for d in n_rate)
    about_joint = p.head_inertia + p.head_mass * p.head_length**2
    return p.head_mass * p.head_length * v_n_rate + about_joint * square / 2


def potential(angles: Any, p: PendulumParameters) -> Scalar:
    """U minus that of the point mass."""
    return p.head_mass * p.gravity * p.head_length * direction(angles[0], angles[1])[2]


def joint(x: PendulumState, p: PendulumParameters) -> Joint:
    """Damping of the joint and stops of its yoke."""
    pin_speed, yoke_speed = x.head_speed - x.boom_speed - x.stick_speed, x.head_side_speed
    pin, yoke = p.head_joint_damping * pin_speed, p.head_joint_damping * yoke_speed
    stops = stop(x, p)
    return Joint(
        on_stick=pin,
        on_head=(-pin, -yoke + stops.force),
        heat=pin * pin_speed + yoke * yoke_speed + stops.heat,
        stored=stops.stored,
    )


def stop(x: PendulumState, p: PendulumParameters) -> Stop:
    """End stops of the yoke."""
    end, law = p.head_stop_angle, (p.head_stop_stiffness, p.head_stop_damping, STOP_ROUNDING)
    return cylinder.stop(x.head_side_angle + end, x.head_side_speed, 2 * end, *law)


def outputs(x: PendulumState, p: PendulumParameters) -> dict[str, Scalar]:
    """Position of the head's centre of mass, and torque of the stops."""
    n = direction(x.head_angle, x.head_side_angle)
    _, tip = arm.points(x, p)
    out, left = tip[0] + p.head_length * n[0], p.head_length * n[1]
    cos, sin = ca.cos(x.swing_angle), ca.sin(x.swing_angle)
    return {
        "head_x": out * cos - left * sin,
        "head_y": out * sin + left * cos,
        "head_height": tip[1] + p.head_length * n[2],
        "head_stop_torque": stop(x, p).force,
    }


def initial(p: PendulumParameters) -> dict[str, Scalar]:
    """Initial angles of the head."""
    return {"head_angle": p.initial_head_angle, "head_side_angle": p.initial_head_side_angle}


def require(x: PendulumState, p: PendulumParameters) -> dict[str, Scalar]:
    """Requirement: the side angle stays away from the singular position."""
    requirement = (
        f"head_side_angle [rad] stays between -{SIDE_LIMIT} and {SIDE_LIMIT}, clear of the pin's line"
    )
    return {requirement: SIDE_LIMIT - ca.fabs(x.head_side_angle)}


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
    Design(PendulumState, PendulumOutputs, HANGING),
    text="Swing column, boom, stick and a processing head that swings in a Hooke joint",
    validity="rigid slender links, viscous friction; head within 80 degrees of the arm's plane",
    parameters=PendulumParameters,
)


# ---- with dry friction: the equations of this file and of `friction`


class PendulumFrictionParameters(PendulumParameters, FrictionParameters):
    """Parameters of both."""


class PendulumFrictionState(PendulumState, FrictionState):
    """States of both."""


class PendulumFrictionOutputs(PendulumOutputs, FrictionOutputs):
    """Outputs of both."""

    stored_energy: Scalar = Quantity(
        "J", "Elastic energy in the friction of joints and pistons and in the head's stops"
    )


PENDULUM_FRICTION = manipulator(
    Design(PendulumFrictionState, PendulumFrictionOutputs, HANGING, resist),
    text="Swing column, boom, stick with dry friction and a processing head that swings in a Hooke joint",
    validity="rigid slender links; head within 80 degrees of the arm's plane; friction independent of load",
    parameters=PendulumFrictionParameters,
)
