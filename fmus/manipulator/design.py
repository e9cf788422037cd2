"""What a variant of the manipulator is put together from: a head and a law of friction.

`fmus.manipulator.model` makes the subsystem of them; the arm is the same in all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fmus.components.friction import Resistance, viscous
from fmus.contract import Scalar

CONTACTS = ("swing", "boom_joint", "stick_joint", "boom_piston", "stick_piston")


@dataclass(frozen=True)
class TipMotion:
    """Motion of the stick end: velocity outwards, to the left and upwards [m/s]; yaw rate of the arm."""

    velocity: tuple[Scalar, Scalar, Scalar]
    yaw_rate: Scalar


@dataclass(frozen=True)
class Joint:
    """What the joint of a head does: torques on the pitch of the stick and on its own angles, heat [W].

    stored   energy in it [J]
    """

    on_stick: Scalar = 0
    own: tuple[Scalar, ...] = ()
    heat: Scalar = 0
    stored: Scalar = 0


def _nothing(*_: Any) -> Scalar:
    return 0


def _no_joint(*_: Any) -> Joint:
    return Joint()


def _no_variables(*_: Any) -> dict[str, Scalar]:
    return {}


@dataclass(frozen=True)
class Head:
    """A processing head, as what it adds to a point mass at the stick end; by default nothing.

    angles, speeds   states that are its coordinates and their rates
    kinetic          (tip, angles, speeds, p) -> energy [J] above that of the point mass
    potential        (angles, p) -> energy [J] above that of the point mass
    joint            (x, p) -> what the friction of its joint does
    outputs          (x, p) -> {output: value}
    initial          (p) -> {state: value at the start}
    require          (x, p) -> {statement: expression > 0}
    """

    angles: tuple[str, ...] = ()
    speeds: tuple[str, ...] = ()
    kinetic: Callable[[TipMotion, Any, Any, Any], Scalar] = _nothing
    potential: Callable[[Any, Any], Scalar] = _nothing
    joint: Callable[[Any, Any], Joint] = _no_joint
    outputs: Callable[[Any, Any], Mapping[str, Scalar]] = _no_variables
    initial: Callable[[Any], Mapping[str, Scalar]] = _no_variables
    require: Callable[[Any, Any], Mapping[str, Scalar]] = _no_variables


def _viscous(contact: str, speed: Scalar, _: Any, p: Any) -> Resistance:
    return viscous(speed, getattr(p, f"{contact}_damping"))


@dataclass(frozen=True)
class Friction:
    """A law of friction, the same for all CONTACTS; by default viscous.

    resist        (contact, speed, x, p) -> its resistance
    deflections   states that are the deflections, in the order of CONTACTS; none if the law has no memory
    outputs       {contact: resistance} -> {output: value}
    """

    resist: Callable[[str, Scalar, Any, Any], Resistance] = _viscous
    deflections: tuple[str, ...] = ()
    outputs: Callable[[Mapping[str, Resistance]], Mapping[str, Scalar]] = _no_variables


POINT_MASS = Head()
VISCOUS = Friction()
