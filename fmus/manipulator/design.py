"""`Design`, what a variant of the manipulator consists of: a processing head and a friction law.

`fmus.manipulator.model` builds the subsystem from them; the arm is the same in all variants.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from fmus.components.friction import Resistance, viscous
from fmus.contract import Scalar

# contact -> output of its friction, in variants with dry friction
CONTACTS = {
    "swing": "swing_friction_torque",
    "boom_joint": "boom_friction_torque",
    "stick_joint": "stick_friction_torque",
    "boom_piston": "boom_friction_force",
    "stick_piston": "stick_friction_force",
}
# a friction law, the same for all contacts: (contact, speed, x, p) -> resistance
FrictionLaw: TypeAlias = Callable[[str, Scalar, Any, Any], Resistance]


@dataclass(frozen=True)
class TipMotion:
    """Motion of the tip: velocity outwards, to the left and upwards [m/s]; yaw rate of the arm [rad/s]."""

    velocity: tuple[Scalar, Scalar, Scalar]
    yaw_rate: Scalar


@dataclass(frozen=True)
class Joint:
    """Effect of the joint between head and stick.

    on_stick   torque on the pitch of the stick [N.m]
    on_head    torques on the angles of the head [N.m]
    heat       dissipated power [W]
    stored     elastic energy [J]
    """

    on_stick: Scalar = 0
    on_head: tuple[Scalar, ...] = ()
    heat: Scalar = 0
    stored: Scalar = 0


def _zero(*_: Any) -> Scalar:
    return 0


def _no_joint(*_: Any) -> Joint:
    return Joint()


def _no_variables(*_: Any) -> dict[str, Scalar]:
    return {}


@dataclass(frozen=True)
class Head:
    """A processing head: its difference from a point mass at the tip; by default none.

    angles, speeds   states: coordinates of the head and their rates
    kinetic          (tip, angles, speeds, p) -> kinetic energy [J] minus that of the point mass
    potential        (angles, p) -> potential energy [J] minus that of the point mass
    joint            (x, p) -> friction and stops of its joint
    outputs          (x, p) -> {output: value}
    initial          (p) -> {state: initial value}
    require          (x, p) -> {requirement: expression > 0}
    """

    angles: tuple[str, ...] = ()
    speeds: tuple[str, ...] = ()
    kinetic: Callable[[TipMotion, Any, Any, Any], Scalar] = _zero
    potential: Callable[[Any, Any], Scalar] = _zero
    joint: Callable[[Any, Any], Joint] = _no_joint
    outputs: Callable[[Any, Any], Mapping[str, Scalar]] = _no_variables
    initial: Callable[[Any], Mapping[str, Scalar]] = _no_variables
    require: Callable[[Any, Any], Mapping[str, Scalar]] = _no_variables


def viscous_friction(contact: str, speed: Scalar, _: Any, p: Any) -> Resistance:
    """Friction without states."""
    return viscous(speed, damping(contact, p))


def damping(contact: str, p: Any) -> Scalar:
    """Viscous coefficient of a contact [N.s/m, N.m.s/rad]."""
    return {
        "swing": p.swing_damping,
        "boom_joint": p.boom.joint_damping,
        "stick_joint": p.stick.joint_damping,
        "boom_piston": p.boom.piston_damping,
        "stick_piston": p.stick.piston_damping,
    }[contact]


POINT_MASS = Head()


@dataclass(frozen=True)
class Design:
    """A head, a friction law, and the groups of states and outputs that they need."""

    states: type[Any]
    outputs: type[Any]
    head: Head = POINT_MASS
    friction: FrictionLaw = viscous_friction
