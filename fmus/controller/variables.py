"""Variables of the controller: parameters, states, inputs, outputs; signs as in model.py.

The controller declares its gains (gains.py). Geometry and hydraulics are those of the machine's subsystems,
which give their values (`model.controller_tables`).
"""

from collections.abc import Sequence
from typing import Any

from fmus.contract import Group, Quantity, Scalar, make_group, quantities
from fmus.controller.arm import Arm, ControlledAxis
from fmus.controller.gains import gains
from fmus.ports import rate_output

Axes = Sequence[ControlledAxis]
LEARNED = {
    "dead_band_up": (
        "Learned dead band of the {} valve for positive commands, beyond that of the parameters",
        "V",
    ),
    "dead_band_down": (
        "Learned dead band of the {} valve for negative commands, beyond that of the parameters",
        "V",
    ),
    "flow_up": (
        "Learned flow of the {} valve for positive commands, over that of the parameters, less 1",
        "1",
    ),
    "flow_down": (
        "Learned flow of the {} valve for negative commands, over that of the parameters, less 1",
        "1",
    ),
}


def parameters(arm: Arm) -> type[Any]:
    """Gains, and parameters of the machine."""
    nominal = {
        "nominal_supply_pressure": Quantity(
            "Pa", "Supply pressure at which the feedforward needs no correction", 1e7, group="Nominal"
        )
    }
    for a in arm.axes:
        if not a.turns:
            text = f"Force of the {a.name} cylinder at which the feedforward needs no correction"
            nominal[f"nominal_{a.name}_holding_force"] = Quantity("N", text, 1e5)
    return make_group("ControllerParameters", nominal, *arm.parameters, gains(arm.axes))


def states(axes: Axes) -> type[Any]:
    """Reference, corrections, loads, plays; each of all axes."""
    found = dict[str, Quantity]()
    for a in axes:
        of = a.coordinate[0].removeprefix(f"{a.name}_")
        found[f"reference_{a.name}"] = Quantity(a.units[0], f"Reference of the {a.name} {of}")
    for a in axes:
        text = f"Correction of the feedforward of the {a.name} drive"
        found[f"{a.name}_gain"] = Quantity("1", text, 0.1)
    for a in axes:
        unit = "N.m" if a.turns else "N"
        found[f"{a.name}_load"] = Quantity(unit, f"Steady load of the {a.name} drive", 1e5)
    for a in axes:
        text = f"Reference speed of the {a.name} joint, filtered"
        found[f"{a.name}_late_speed"] = Quantity(a.units[1], text, 0.1)
    for name, text, nominal in (
        ("spool", "Command that the {} spool is to follow", 10.0),
        ("trailing", "That command of the {} behind a play of `reversal`", 10.0),
        ("half_width", "Learned half width of the play of the {} valve", 0.1),
    ):
        found |= {f"{a.name}_{name}": Quantity("V", text.format(a.name), nominal) for a in axes}
    for a in axes:
        for name, (text, unit) in LEARNED.items():
            found[f"{a.name}_{name}"] = Quantity(unit, text.format(a.name), 0.1)
        for n in ("11", "12", "22"):
            text = f"Covariance of dead band and flow of the {a.name} valve, relative, element {n}"
            found[f"{a.name}_covariance_{n}"] = Quantity("1", text)
        text = f"Commanded speed of the {a.name} drive behind the lag of amplifier, spool and sensors"
        found[f"{a.name}_late_command"] = Quantity("rad/s" if a.turns else "m/s", text, 0.1)
        text = f"Path of the oil in the {a.name} drive as commanded, less that of the reference"
        found[f"{a.name}_oil_shift"] = Quantity("rad" if a.turns else "m", text, 0.01)
    found |= {
        "radial_lever": Quantity("m/s", "Commanded radial velocity of the tip, filtered"),
        "vertical_lever": Quantity("m/s", "Commanded vertical velocity of the tip, filtered"),
        "turning_lever": Quantity("rad/s", "Commanded swing speed, filtered"),
        "coordination": Quantity("1", "Weight of coordinated control in the valve commands, 0 to 1"),
    }
    return make_group("ControllerState", found)


class Setpoints(Group):
    """Velocity or path of the tip."""

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


class Lines(Group):
    """Measured pressures of the supply."""

    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7)
    tank_pressure: Scalar = Quantity("Pa", "Pressure of the return line", 1e5)


def inputs(axes: Axes) -> type[Any]:
    """Setpoints, operator levers, measurements."""
    found = {
        f"{a.name}_lever": Quantity("V", f"Lever of the {a.name} valve, positive {a.lever}", 10.0)
        for a in axes
    }
    found |= {a.coordinate[0]: Quantity(a.units[0], a.coordinate[1]) for a in axes}
    found |= {a.speed[0]: Quantity(a.units[1], a.speed[1]) for a in axes}
    found |= {name: Quantity("Pa", text, 1e7) for a in axes for name, text in a.sides}
    levers = make_group("Measured", found, Setpoints)
    return make_group("ControllerInputs", quantities(Lines), levers)


def outputs(axes: Axes) -> type[Any]:
    """Commands and their rates, reference, errors, limit indicators."""
    commands = {
        f"{a.name}_command": Quantity("V", f"Command to the {a.name} valve, positive {a.lever}", 10.0)
        for a in axes
    }
    commands |= {f"{a.name}_command_rate": rate_output(f"{a.name}_command", "V/s", 10.0) for a in axes}
    known = quantities(states(axes))
    learned = (*(f"{a.name}_{n}" for a in axes for n in LEARNED), *(f"{a.name}_half_width" for a in axes))
    commands |= {n: known[n] for n in learned}
    return make_group("ControllerOutputs", quantities(Indicators), make_group("Commands", commands))


class Indicators(Group):
    """Reference, errors, use of the limits."""

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
