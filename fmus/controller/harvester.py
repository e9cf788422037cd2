"""The arm of the harvester as its controller knows it: two links, column, boom and stick.

The two links are the lines boom pivot-elbow and elbow-tip. Inverse position kinematics by the law of cosines,
in the triangle of boom pivot, elbow and tip. The elbow is above the line from the boom pivot to the tip; the
stick cylinder cannot reach the other solution.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from fmus.components.chamber import BulkModulus, Density, Liquid
from fmus.components.hose import ReferenceHose
from fmus.components.mechanics import Point
from fmus.components.spool_valve import Valve
from fmus.contract import Group, Scalar, quantities
from fmus.controller.arm import Arm, Choice, ControlledAxis, Coordinates, Pistons
from fmus.controller.valve import Actuator
from fmus.drives import cylinder, motor
from fmus.manipulator.model import ARM as JOINTS
from fmus.manipulator.model import in_plane
from fmus.manipulator.variables import CylinderMount, ManipulatorParameters, OnColumn
from orchestrator.base.errors import Problem


def cylinder_sides(name: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Pressures of a cylinder, with their descriptions."""
    head, rod = (
        (f"{name}_{side}_pressure", f"Pressure at the {side} side of the {name} cylinder")
        for side in ("head", "rod")
    )
    return head, rod


def line_sides(name: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Pressures of the lines of a motor, with their descriptions."""
    a, b = ((f"{name}_pressure_{side.lower()}", f"Pressure of {name} line {side}") for side in "AB")
    return a, b


def _of_arm(name: str, angle: str, lever: str) -> ControlledAxis:
    speed = (f"{name}_speed", f"Speed of the {name} joint")
    sides = cylinder_sides(name)
    return ControlledAxis(name, "revolute", lever, (f"{name}_angle", angle), speed, sides, "")


COUNTER = "counter-clockwise from above"
AXES = (
    ControlledAxis(
        "swing",
        "column",
        "turns left",
        ("swing_angle", f"Swing angle, {COUNTER}"),
        ("swing_speed", f"Swing speed, {COUNTER}"),
        line_sides("swing"),
        "swing_",
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


def motor_actuator(own: Any, valve: Valve, density: Scalar, flow: Scalar, p: Any) -> Actuator:
    """A motor with its lines; flow: of a compensated section [m3/s]; p: with the oil."""
    d, c = own.displacement, own.line.capacitance
    return Actuator(d, d, c, c, own.line.friction(p), valve, density, (flow, flow))


def cylinder_actuator(own: Any, position: Scalar, valve: Valve, p: Any, flows: Sequence[Scalar]) -> Actuator:
    """A cylinder at a position [m], with its hoses; flows: of a compensated section [m3/s]."""
    c_head, c_rod = (own.hose.capacitance + v / p.bulk_modulus for v in own.volumes(position))
    (head, rod), (to_head, to_rod) = own.areas, flows
    return Actuator(head, rod, c_head, c_rod, own.hose.friction(p), valve, p.density, (to_head, to_rod))


def section_flows(name: str, p: Any) -> tuple[Scalar, Scalar]:
    """Flows of the section of a cylinder at full command, to head and rod side [m3/s]."""
    return getattr(p, f"{name}_section_flow"), getattr(p, f"{name}_rod_section_flow")


class HarvesterArm(Arm):
    """Column, boom and stick."""

    axes = AXES
    parameters = (OfSwing, OfMachine)

    def point(self, q: Coordinates, p: Any) -> Point:
        """Radius and height of the end of the stick."""
        return in_plane(q[1], q[2], p)[1]

    def columns(self, q: Coordinates, p: Any) -> list[Point]:
        """Of boom and stick."""
        (elbow_x, elbow_z), (tip_x, tip_z) = in_plane(q[1], q[2], p)
        upper, lower = (
            (elbow_x - p.boom_pivot_x, elbow_z - p.boom_pivot_z),
            (tip_x - elbow_x, tip_z - elbow_z),
        )
        return [(-upper[1] - lower[1], upper[0] + lower[0]), (-lower[1], lower[0])]

    def choice(self, columns: Sequence[Point], *_: Any) -> Choice:
        """None but the only one. The largest determinant is |upper| |lower|: links at a right angle."""
        (a, c), (b, d) = columns  # the first is perpendicular to the sum of both links, the other to `lower`
        return Choice(((a - b) ** 2 + (c - d) ** 2) * (b**2 + d**2), (1, 1))

    def pistons(self, q: Coordinates, p: Any) -> Pistons:
        """Swing angle, pistons of boom and stick."""
        found = (j.drive(p).at(x) for j, x in zip(JOINTS, q, strict=True) if j.drive)
        return [(q[0], 1), *((t.position, t.arm) for t in found)]

    def actuators(self, positions: Sequence[Scalar], p: Any) -> dict[str, Actuator]:
        """Swing, boom and stick."""
        of_swing = p.swing_valve, p.swing_oil.density, p.swing_section_flow
        result = {"swing": motor_actuator(p.swing, *of_swing, p)}
        for name, position in zip(("boom", "stick"), positions[1:], strict=True):
            own, flows = getattr(p, name), section_flows(name, p)
            result[name] = cylinder_actuator(own, position, p.valve, p, flows)
        return result

    def valve(self, axis: ControlledAxis, p: Any) -> Valve:
        """That of the swing, or that of boom and stick."""
        valve: Valve = p.swing_valve if axis.turns else p.valve
        return valve

    def derive(self, p: Any) -> dict[str, Scalar]:
        """Hoses and lines by the equations of the drives."""
        boom, stick = (
            {f"{n}_{k}": v for k, v in cylinder.derive(own, p).items()}
            for n, own in (("boom", p.boom), ("stick", p.stick))
        )
        return boom | stick | motor.derive(p.swing, p)


ARM = HarvesterArm()


def arm_angles(radius: float, height: float, p: Mapping[str, float]) -> tuple[float, float]:
    """Boom and stick angle [rad] for the tip at (radius, height) [m]; p: parameter values by name."""
    x, z = radius - p["boom_pivot_x"], height - p["boom_pivot_z"]
    upper, lower = math.hypot(p["stick_pivot_x"], p["stick_pivot_z"]), p["stick_length"]
    reach = math.hypot(x, z)
    if not abs(upper - lower) <= reach <= upper + lower:
        raise Problem(
            f"tip at radius {radius:g} m, height {height:g} m is {reach:.3g} m from the boom pivot,"
            f" expected {abs(upper - lower):.3g} to {upper + lower:.3g} m"
        )
    cos_pivot = (upper**2 + reach**2 - lower**2) / (2 * upper * reach)
    cos_elbow = (reach**2 - upper**2 - lower**2) / (2 * upper * lower)
    pivot_angle, elbow_angle = (math.acos(max(-1.0, min(1.0, c))) for c in (cos_pivot, cos_elbow))
    # angle of the line boom pivot-elbow in the frame of the boom
    upper_link_offset = math.atan2(p["stick_pivot_z"], p["stick_pivot_x"])
    return math.atan2(z, x) + pivot_angle - upper_link_offset, upper_link_offset - elbow_angle
