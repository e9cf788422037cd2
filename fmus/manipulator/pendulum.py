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

from fmus.components import friction
from fmus.components.chain import Link, Payload
from fmus.contract import Quantity, Scalar
from fmus.joints import JointModel, Mechanics
from fmus.manipulator.friction import FrictionOutputs, FrictionParameters, FrictionState, resist
from fmus.manipulator.model import Head, manipulator
from fmus.manipulator.model import views as of_arm
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


HEAD = JointModel(
    name="head",
    coordinate="head_angle",
    link=lambda p: Link("head", "revolute", "-y", (p.stick_length, 0, 0), 2),
    damping=lambda p: p.head_joint_damping,
)
YOKE = JointModel(
    name="head_side",
    coordinate="head_side_angle",
    link=lambda _: Link("head_side", "revolute", "x", parent=3),
    body=lambda p: {
        "centre": (0, 0, -p.head_length),
        "inertia": (p.head_inertia, p.head_inertia, 0, 0, 0, 0),
    },
    damping=lambda p: p.head_joint_damping,
    stop=lambda p: (
        *(-p.head_stop_angle, p.head_stop_angle),
        *(p.head_stop_stiffness, p.head_stop_damping, STOP_ROUNDING),
    ),
    stop_shown="head_stop_torque",
)
# swing, boom, stick, pin and yoke over the coordinates: the angle of the head is that from the vertical
TURN = ((1, 0, 0, 0, 0), (0, 1, 0, 0, 0), (0, 0, 1, 0, 0), (0, -1, -1, 1, 0), (0, 0, 0, 0, 1))


def head(mass: Scalar, p: PendulumParameters) -> Payload:
    """The mass of the head and what it holds, at its centre of mass."""
    return Payload(4, (0, 0, -p.head_length), p.head_mass + mass)


def views(of: Mechanics, q: ca.SX, w: ca.SX, x: Any, p: Any) -> dict[str, Scalar]:
    """Those of the arm, and the head's centre of mass."""
    place = of.chain(p).position(q, 4, (0, 0, -p.head_length))
    names = ("head_x", "head_y", "head_height")
    return {**of_arm(of, q, w, x, p), **{n: place[k] for k, n in enumerate(names)}}


def limits(x: Any, p: Any) -> dict[str, Scalar]:
    """The side angle stays away from the singular position."""
    requirement = (
        f"head_side_angle [rad] stays between -{SIDE_LIMIT} and {SIDE_LIMIT}, clear of the pin's line"
    )
    return {requirement: SIDE_LIMIT - ca.fabs(x.head_side_angle)}


HANGING = Head((HEAD, YOKE), head, views, TURN, limits)
PENDULUM = manipulator(
    text="Swing column, boom, stick and a processing head that swings in a Hooke joint",
    validity="rigid slender links, viscous friction; head within 80 degrees of the arm's plane",
    parameters=PendulumParameters,
    states=PendulumState,
    outputs=PendulumOutputs,
    at_tip=HANGING,
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
    text="Swing column, boom, stick with dry friction and a processing head that swings in a Hooke joint",
    validity="rigid slender links; head within 80 degrees of the arm's plane; friction independent of load",
    parameters=PendulumFrictionParameters,
    states=PendulumFrictionState,
    outputs=PendulumFrictionOutputs,
    dry=resist,
    at_tip=HANGING,
)
