"""Variables of the controller: parameters, states, inputs, outputs; signs as in model.py.

The controller declares its gains (gains.py). Geometry and hydraulics are those of the machine's subsystems,
which give their values (`model.controller_tables`).
"""

from fmus.components.chamber import BulkModulus, Density, Liquid
from fmus.components.hose import ReferenceHose
from fmus.components.spool_valve import Valve
from fmus.contract import Group, Quantity, Scalar, make_group, quantities
from fmus.controller.gains import Gains
from fmus.drives import cylinder, motor
from fmus.manipulator.variables import CylinderMount, ManipulatorParameters, OnColumn
from fmus.ports import CommandOutputs

AXES = ("swing", "boom", "stick")


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


class ControllerParameters(OfSwing, OfMachine, Gains):
    """Gains, and parameters of the machine."""

    nominal_supply_pressure: Scalar = Quantity(
        "Pa", "Supply pressure at which the feedforward needs no correction", 1e7, group="Nominal"
    )
    nominal_boom_holding_force: Scalar = Quantity(
        "N", "Force of the boom cylinder at which the feedforward needs no correction", 1e5
    )
    nominal_stick_holding_force: Scalar = Quantity(
        "N", "Force of the stick cylinder at which the feedforward needs no correction", 1e5
    )


def _per_axis(pattern: str, units: tuple[str, str], text: str, nominal: float = 1.0) -> dict[str, Quantity]:
    """One variable for each axis; units: of the swing, and of boom and stick."""
    unit_swing, unit_arm = units
    return {
        pattern.format(axis): Quantity(
            unit_swing if axis == "swing" else unit_arm, text.format(axis=axis), nominal
        )
        for axis in AXES
    }


ControllerState = make_group(
    "ControllerState",
    {
        **_per_axis("reference_{}", ("rad", "rad"), "Reference of the {axis} angle"),
        **_per_axis("{}_gain", ("1", "1"), "Correction of the feedforward of the {axis} drive", 0.1),
        **_per_axis("{}_load", ("N.m", "N"), "Steady load of the {axis} drive", 1e5),
        **_per_axis(
            "{}_late_speed", ("rad/s", "rad/s"), "Reference speed of the {axis} joint, filtered", 0.1
        ),
        **_per_axis("{}_spool", ("V", "V"), "Command that the {axis} spool is to follow", 10.0),
        **_per_axis(
            "{}_trailing", ("V", "V"), "That command of the {axis} behind a play of `reversal`", 10.0
        ),
        **_per_axis("{}_half_width", ("V", "V"), "Learned half width of the play of the {axis} valve", 0.1),
        "radial_lever": Quantity("m/s", "Commanded radial velocity of the tip, filtered"),
        "vertical_lever": Quantity("m/s", "Commanded vertical velocity of the tip, filtered"),
        "turning_lever": Quantity("rad/s", "Commanded swing speed, filtered"),
        "coordination": Quantity("1", "Weight of coordinated control in the valve commands, 0 to 1"),
    },
)


class ControllerInputs(Group):
    """Setpoints, operator levers, measurements."""

    radial_velocity: Scalar = Quantity("m/s", "Commanded velocity of the tip away from the swing axis")
    vertical_velocity: Scalar = Quantity("m/s", "Commanded velocity of the tip upwards")
    swing_velocity: Scalar = Quantity("rad/s", "Commanded swing speed, counter-clockwise from above")
    follow: Scalar = Quantity(
        "1", "1: position feedback to the point of the path is active, 0: velocity control only"
    )
    path_radius: Scalar = Quantity("m", "Point of the path, radius from the swing axis")
    path_height: Scalar = Quantity("m", "Point of the path, height above the foot of the column")
    path_angle: Scalar = Quantity("rad", "Point of the path, swing angle")
    engaged: Scalar = Quantity("1", "1: coordinated control of the tip, 0: levers act directly on the valves")
    swing_lever: Scalar = Quantity("V", "Lever of the swing valve, positive turns left", 10.0)
    boom_lever: Scalar = Quantity("V", "Lever of the boom valve, positive raises the boom", 10.0)
    stick_lever: Scalar = Quantity("V", "Lever of the stick valve, positive folds the stick in", 10.0)
    swing_angle: Scalar = Quantity("rad", "Swing angle, counter-clockwise from above")
    boom_angle: Scalar = Quantity("rad", "Boom angle above the horizontal")
    stick_angle: Scalar = Quantity("rad", "Stick angle relative to the boom, negative when folded")
    swing_speed: Scalar = Quantity("rad/s", "Swing speed, counter-clockwise from above")
    boom_speed: Scalar = Quantity("rad/s", "Speed of the boom joint")
    stick_speed: Scalar = Quantity("rad/s", "Speed of the stick joint")
    swing_pressure_a: Scalar = Quantity("Pa", "Pressure of swing line A", 1e7)
    swing_pressure_b: Scalar = Quantity("Pa", "Pressure of swing line B", 1e7)
    boom_head_pressure: Scalar = Quantity("Pa", "Pressure at the head side of the boom cylinder", 1e7)
    boom_rod_pressure: Scalar = Quantity("Pa", "Pressure at the rod side of the boom cylinder", 1e7)
    stick_head_pressure: Scalar = Quantity("Pa", "Pressure at the head side of the stick cylinder", 1e7)
    stick_rod_pressure: Scalar = Quantity("Pa", "Pressure at the rod side of the stick cylinder", 1e7)
    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7)
    tank_pressure: Scalar = Quantity("Pa", "Pressure of the return line", 1e5)


class ControllerOutputs(CommandOutputs):
    """Commands and their rates, reference, errors, limit indicators."""

    reference_radius: Scalar = Quantity("m", "Reference of the tip, radius from the swing axis")
    reference_height: Scalar = Quantity("m", "Reference of the tip, height above the foot of the column")
    reference_angle: Scalar = Quantity("rad", "Reference of the tip, swing angle")
    radial_error: Scalar = Quantity("m", "Reference minus tip, radius", 0.01)
    vertical_error: Scalar = Quantity("m", "Reference minus tip, height", 0.01)
    angle_error: Scalar = Quantity("rad", "Reference minus tip, swing angle", 0.01)
    tip_error: Scalar = Quantity("m", "Distance between reference and tip", 0.01)
    speed_use: Scalar = Quantity(
        "1", "Commanded speed over speed limit of the most loaded actuator; limiting above 1"
    )
    stroke_use: Scalar = Quantity(
        "1", "Commanded speed over speed allowed close to the ends of the strokes; limiting above 1"
    )
    wait_use: Scalar = Quantity(
        "1", "Lag of the machine over the lag at which the reference stops; limiting above 0.5"
    )
    pressure_use: Scalar = Quantity(
        "1", "Supply pressure that loads and valves need, over the supply pressure; above 1 the arm waits"
    )
    reference_share: Scalar = Quantity("1", "Factor by which the limits reduce the speed of the reference")
