"""The paper's manipulator as data for `fmus.joints`: its joints, and what its outputs show of them.

    M(q) q'' + V(q, q') + G(q) = tau + tau_pick-up             eq. (4), q = (swing, boom, stick, head)
    tau_swing = swing_torque - R_swing + tau_stop              eq. (8)
    tau_i     = J_i (F_i - R_piston,i + F_stop,i) - R_joint,i  eqs. (5) to (7), i = boom, stick

Signs: the boom angle is measured from the horizontal, upwards positive. The stick angle is measured from the
boom, upwards positive; it is negative for a folded stick. The swing angle is counter-clockwise seen from
above. Extending the boom cylinder raises the boom; extending the stick cylinder folds the stick in (J < 0).

The links are slender: they have no inertia about their own axis, so the inertia of a link at pitch f about
the vertical is m r^2 + I cos(f)^2. The head is a point mass at the tip (correction E4), or hangs there
(`fmus.manipulator.pendulum`). The payload is a point mass at the place of the head's mass, because rollers
and knives hold the stem there; the moment of inertia is that of the empty head.

The same equations by hand, in NumPy: tests/equations/transcription.py.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca

from fmus import ports
from fmus.components.chain import Link, Payload, Vector
from fmus.components.linkage import Cylinder
from fmus.contract import Scalar, Subsystem
from fmus.joints import Friction, JointModel, Mechanics
from fmus.manipulator.variables import (
    ManipulatorInputs,
    ManipulatorOutputs,
    ManipulatorParameters,
    ManipulatorState,
)

SWING_STOP_ROUNDING = 1e-3  # rad, smoothing angle of the torque of the column's end stops
PORTS = (
    ports.shaft("swing", drives=False),
    *(ports.rod(axis, drives=False) for axis in ("boom", "stick")),
    ports.grip(),
)


def _swing_stop(p: ManipulatorParameters) -> tuple[Scalar, ...]:
    """At +- `swing_stop_angle`, none if that is 0."""
    stiffness = ca.if_else(p.swing_stop_angle > 0, p.swing_stop_stiffness, 0)
    end = p.swing_stop_angle
    return -end, end, stiffness, p.swing_stop_damping, SWING_STOP_ROUNDING


def boom_pivot(p: Any) -> Vector:
    """Place on the column."""
    return p.boom_pivot_x, 0, p.boom_pivot_z


def elbow(p: Any) -> Vector:
    """Place of the stick's pivot on the boom."""
    return p.stick_pivot_x, 0, p.stick_pivot_z


def _joint(name: str, parent: int, at: Callable[[Any], Vector], lever: float) -> JointModel:
    """Boom or stick, in the plane of the arm, with its cylinder."""

    def of(p: Any) -> Any:
        return getattr(p, name)

    def body(p: Any) -> dict[str, Any]:
        own = of(p)
        slender = (0, own.inertia, own.inertia, 0, 0, 0)
        return {"mass": own.mass, "centre": (own.centre_x, 0, own.centre_z), "inertia": slender}

    def drive(p: Any) -> Cylinder:
        base, rod = of(p).pins
        return Cylinder(base, rod, of(p).closed_length)

    return JointModel(
        name=name,
        coordinate=f"{name}_angle",
        link=lambda p: Link(name, "revolute", "-y", at(p), parent),
        body=body,
        damping=lambda p: of(p).joint_damping,
        drive=drive,
        piston=lambda p: (of(p).stroke, of(p).piston_damping),
        lever=lever,
        contacts=(f"{name}_joint", f"{name}_piston"),
    )


SWING = JointModel(
    name="swing",
    coordinate="swing_angle",
    link=lambda _: Link("swing", "revolute", "z"),
    body=lambda p: {"inertia": (0, 0, p.column_inertia, 0, 0, 0)},
    damping=lambda p: p.swing_damping,
    motor=True,
    stop=_swing_stop,
    stop_shown="swing_stop_torque",
    contacts=("swing", ""),
)
ARM = (SWING, _joint("boom", 0, boom_pivot, 1.0), _joint("stick", 1, elbow, -1.0))


def gravity(p: Any) -> Vector:
    """Downwards."""
    return 0, 0, -p.gravity


def tip(p: Any) -> tuple[int, Vector]:
    """Link and place of the end of the stick."""
    return 2, (p.stick_length, 0, 0)


def head(mass: Scalar, p: Any) -> Payload:
    """A point mass at the tip."""
    return Payload(*tip(p), p.head_mass + mass)


def views(of: Mechanics, q: ca.SX, w: ca.SX, x: Any, p: Any) -> dict[str, Scalar]:
    """Places of elbow and tip, velocity of the tip in the plane of the arm."""
    in_place, turning, chain = ca.vertcat(0, q[1:]), ca.vertcat(0, w[1:]), of.chain(p)
    joint, end = (chain.position(in_place, *place) for place in ((2, (0, 0, 0)), tip(p)))
    velocity = chain.velocity(in_place, turning, *tip(p))
    return {
        "elbow_radius": joint[0],
        "elbow_height": joint[2],
        "tip_radius": end[0],
        "tip_height": end[2],
        "tip_x": end[0] * ca.cos(x.swing_angle),
        "tip_y": end[0] * ca.sin(x.swing_angle),
        "tip_radial_velocity": velocity[0],
        "tip_vertical_velocity": velocity[2],
        "tip_depth": ca.fmax(p.ground_height - end[2], 0),
    }


def _no_limits(*_: Any) -> dict[str, Scalar]:
    return {}


@dataclass(frozen=True)
class Head:
    """What is at the tip: its joints, and payload, views, turn and limits of `Mechanics` with it."""

    joints: tuple[JointModel, ...] = ()
    payload: Callable[[Scalar, Any], Payload] = head
    views: Callable[..., Mapping[str, Scalar]] = views
    turn: Sequence[Sequence[float]] | None = None
    limits: Callable[[Any, Any], Mapping[str, Scalar]] = _no_limits


POINT_MASS = Head()


def manipulator(
    *,
    text: str,
    validity: str,
    parameters: type[Any] = ManipulatorParameters,
    states: type[Any] = ManipulatorState,
    outputs: type[Any] = ManipulatorOutputs,
    dry: Friction | None = None,
    at_tip: Head = POINT_MASS,
) -> Subsystem:
    """The subsystem with a law of dry friction and a head."""
    model = Mechanics(
        joints=(*ARM, *at_tip.joints),
        parameters=parameters,
        states=states,
        inputs=ManipulatorInputs,
        outputs=outputs,
        gravity=gravity,
        payload=at_tip.payload,
        views=at_tip.views,
        turn=at_tip.turn,
        dry=dry,
        limits=at_tip.limits,
    )
    return Subsystem(
        **model.declared,
        name="manipulator",
        text=text,
        validity=validity,
        values=Path(__file__).with_name("parameters.toml"),
        terminals=PORTS,
        stiff=dry is not None,  # bristles are stiff; end stops are as well, but seldom reached
    )


# the friction is viscous: R = B x' in the pistons, B_sw q1' in the swing gear, b_i q_i' in the joints
RIGID = manipulator(
    text="Swing column, boom, stick and rigid processing head; viscous friction of joints and pistons",
    validity="rigid slender links, the head does not swing, viscous friction",
)
