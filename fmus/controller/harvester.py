"""The arm of the harvester as its controller knows it: column, boom and stick, with one valve for both."""

from typing import Any

from fmus.components.chamber import BulkModulus, Density, Liquid
from fmus.components.hose import ReferenceHose
from fmus.components.spool_valve import Valve
from fmus.contract import Group, Scalar, quantities
from fmus.controller.arm import COUNTER, Arm, ControlledAxis
from fmus.drives import cylinder, motor
from fmus.manipulator.model import ARM as JOINTS
from fmus.manipulator.model import tip
from fmus.manipulator.variables import CylinderMount, ManipulatorParameters, OnColumn


def _of_arm(name: str, angle: str, lever: str) -> ControlledAxis:
    speed = (f"{name}_speed", f"Speed of the {name} joint")
    return ControlledAxis(name, "revolute", lever, (f"{name}_angle", angle), speed)


AXES = (
    ControlledAxis(
        "swing",
        "column",
        "turns left",
        ("swing_angle", f"Swing angle, {COUNTER}"),
        ("swing_speed", f"Swing speed, {COUNTER}"),
    ),
    _of_arm("boom", "Boom angle above the horizontal", "raises the boom"),
    _of_arm("stick", "Stick angle relative to the boom, negative when folded", "folds the stick in"),
)


class ArmAxis(cylinder.VolumeDrive, CylinderMount):
    """A cylinder with its hoses, and its pins."""


class BoomAxis(cylinder.VolumeDrive, OnColumn):
    """The cylinder of the boom."""


class ArmGeometry(Group):
    """Joints and tip of the arm."""

    boom_pivot_x: Scalar = quantities(ManipulatorParameters)["boom_pivot_x"]
    boom_pivot_z: Scalar = quantities(ManipulatorParameters)["boom_pivot_z"]
    stick_pivot_x: Scalar = quantities(ManipulatorParameters)["stick_pivot_x"]
    stick_pivot_z: Scalar = quantities(ManipulatorParameters)["stick_pivot_z"]
    stick_length: Scalar = quantities(ManipulatorParameters)["stick_length"]


class OfMachine(
    Liquid,
    BulkModulus,
    ReferenceHose,
    ArmGeometry,
    boom=BoomAxis,
    stick=ArmAxis,
    valve=Valve,  # of its curves only the straight line
):
    """Parameters of boom, stick and manipulator."""


class MotorAxis(motor.MotorSize, line=(motor.VolumeLine, "{} line")):
    """Motor, gear and lines of the swing."""


class OfSwing(
    Group, swing=(MotorAxis, "swing", str), swing_valve=Valve, swing_oil=(Density, "oil", "swing_{}".format)
):
    """Parameters of the swing drive."""


def _hydraulics(axis: str, p: Any) -> tuple[Valve, Scalar]:
    """Valve of an axis, density of its oil."""
    return (p.swing_valve, p.swing_oil.density) if axis == "swing" else (p.valve, p.density)


ARM = Arm(AXES, (OfSwing, OfMachine), JOINTS, lambda p: tip(p)[1], _hydraulics)
