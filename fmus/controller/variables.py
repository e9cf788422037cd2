"""Variables and numbers of the controller; signs as in model.py.

It declares its own gains. Geometry and hydraulics are declared by the parts of the machine, with numbers;
here they are only named.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from fmus.boom_stick.variables import BoomStickParameters
from fmus.components.hose import VolumeHose
from fmus.contract import Group, Quantity, Scalar, Subsystem, make_group, quantities, symbolic
from fmus.controller.gains import Gains
from fmus.manipulator.variables import ManipulatorParameters
from fmus.parameters import Number, Tables, numbers, read, values
from fmus.swing.variables import SwingParameters

AXES = ("swing", "boom", "stick")
VALVE = (*(n for n in quantities(SwingParameters) if n.startswith("valve_")), "density")
GEOMETRY = (
    *("boom_pivot_x", "boom_pivot_z", "stick_pivot_x", "stick_pivot_z", "stick_length"),
    *(f"{a}_{pin}_{axis}" for a in ("boom", "stick") for pin in ("base", "pin") for axis in "xz"),
    *(f"{a}_{n}" for a in ("boom", "stick") for n in ("closed_length", "stroke")),
)
CYLINDERS = (
    *(
        f"{a}_{n}"
        for a in ("boom", "stick")
        for n in ("bore", "rod", "dead_volume", *(f"hose_{own}" for own in quantities(VolumeHose)))
    ),
    "hose_reference_resistance",
    "bulk_modulus",
    *VALVE,
)
MOTOR = (
    *("motor_displacement", "gear_ratio", "motor_volume"),
    *("line_length", "line_bore", "line_capacitance", "line_turbulent_resistance"),
)
NOMINAL = ("supply_pressure", "boom_holding_force", "stick_holding_force")  # start values of boom_stick


def _taken(declared: type[Group], names: Iterable[str], prefix: str = "") -> dict[str, Quantity]:
    return {prefix + n: quantities(declared)[n] for n in names}


ControllerParameters = make_group(
    "ControllerParameters",
    {
        **quantities(Gains),
        **_taken(ManipulatorParameters, GEOMETRY),
        **_taken(BoomStickParameters, CYLINDERS),
        **_taken(SwingParameters, VALVE, "swing_"),
        **_taken(SwingParameters, MOTOR),
        "nominal_supply_pressure": Quantity(
            "Pa", "Supply pressure for which the feedforward alone is made", 1e7, group="Nominal"
        ),
        **{
            f"nominal_{a}_holding_force": Quantity(
                "N", f"Force of the {a} cylinder for which the feedforward alone is made", 1e5
            )
            for a in ("boom", "stick")
        },
    },
)


class Commands(Group):
    """Commands, which are states because the amplifier lags."""

    swing_command: Scalar = Quantity("V", "Command to the swing valve, positive turns left", 10.0)
    boom_command: Scalar = Quantity("V", "Command to the boom valve, positive raises the boom", 10.0)
    stick_command: Scalar = Quantity("V", "Command to the stick valve, positive folds the stick in", 10.0)


def _per_axis(pattern: str, units: tuple[str, str], text: str, nominal: float = 1.0) -> dict[str, Quantity]:
    """One variable for each axis; units of swing and of the pistons."""
    return {
        pattern.format(axis): Quantity(units[axis != "swing"], text.format(axis=axis), nominal)
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
        "radial_lever": Quantity("m/s", "Radial velocity wanted, filtered"),
        "vertical_lever": Quantity("m/s", "Vertical velocity wanted, filtered"),
        "turning_lever": Quantity("rad/s", "Swing velocity wanted, filtered"),
        "coordination": Quantity("1", "Share of the coordination in the commands"),
    },
    Commands,
)


class ControllerInputs(Group):
    """What is wanted, the levers, and what is measured."""

    radial_velocity: Scalar = Quantity("m/s", "Wanted velocity of the tip away from the swing axis")
    vertical_velocity: Scalar = Quantity("m/s", "Wanted velocity of the tip upwards")
    swing_velocity: Scalar = Quantity("rad/s", "Wanted swing speed, counter-clockwise from above")
    follow: Scalar = Quantity(
        "1", "1: the reference is also drawn to the point of the path, 0: velocities alone"
    )
    path_radius: Scalar = Quantity("m", "Point of the path, radius from the swing axis")
    path_height: Scalar = Quantity("m", "Point of the path, height above the column's foot")
    path_angle: Scalar = Quantity("rad", "Point of the path, swing angle")
    engaged: Scalar = Quantity("1", "1: coordinated control of the tip, 0: the levers go straight through")
    swing_lever: Scalar = Quantity("V", "Lever of the swing valve, positive turns left", 10.0)
    boom_lever: Scalar = Quantity("V", "Lever of the boom valve, positive raises the boom", 10.0)
    stick_lever: Scalar = Quantity("V", "Lever of the stick valve, positive folds the stick in", 10.0)
    swing_angle: Scalar = Quantity("rad", "Swing angle")
    boom_angle: Scalar = Quantity("rad", "Boom angle above the horizontal")
    stick_angle: Scalar = Quantity("rad", "Stick angle relative to the boom")
    swing_speed: Scalar = Quantity("rad/s", "Swing speed")
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


class ControllerOutputs(Commands):
    """Commands with their rates; reference, errors, and what limits."""

    swing_command_rate: Scalar = Quantity("V/s", "Rate port: exact time derivative of swing_command", 10.0)
    boom_command_rate: Scalar = Quantity("V/s", "Rate port: exact time derivative of boom_command", 10.0)
    stick_command_rate: Scalar = Quantity("V/s", "Rate port: exact time derivative of stick_command", 10.0)
    reference_radius: Scalar = Quantity("m", "Reference of the tip, radius from the swing axis")
    reference_height: Scalar = Quantity("m", "Reference of the tip, height above the column's foot")
    reference_angle: Scalar = Quantity("rad", "Reference of the tip, swing angle")
    radial_error: Scalar = Quantity("m", "Reference less tip, radius", 0.01)
    vertical_error: Scalar = Quantity("m", "Reference less tip, height", 0.01)
    angle_error: Scalar = Quantity("rad", "Reference less tip, swing angle", 0.01)
    tip_error: Scalar = Quantity("m", "Distance in space between reference and tip", 0.01)
    speed_use: Scalar = Quantity(
        "1", "Speed wanted over speed limit of the most loaded actuator; acts above 1"
    )
    stroke_use: Scalar = Quantity(
        "1", "Speed wanted over speed allowed so near the ends of the strokes; acts above 1"
    )
    wait_use: Scalar = Quantity(
        "1", "Lag of the machine over that at which the reference waits; acts from a half on"
    )
    reference_share: Scalar = Quantity(
        "1", "Share of the speed wanted that the limits let the reference have"
    )


JOINTS = ("swing", "boom", "stick")
MEASURED = tuple(n for n, q in quantities(ControllerInputs).items() if q.unit == "Pa")
OWN = tuple(quantities(Gains))
FILE = Path(__file__).with_name("parameters.toml")


def merged(swing: Subsystem, boom_stick: Subsystem, manipulator: Subsystem) -> Tables:
    """All numbers of the controller of a machine of these parts."""
    own, oil, motor, arm = read(FILE), numbers(boom_stick), numbers(swing), numbers(manipulator)
    found = {n: own["parameters"][n] for n in OWN}
    found |= {n: _of(arm["parameters"][n], "manipulator") for n in GEOMETRY}
    found |= {n: _of(oil["parameters"][n], "boom_stick") for n in CYLINDERS}
    found |= {f"swing_{n}": _of(motor["parameters"][n], "swing") for n in VALVE}
    found |= {n: _of(motor["parameters"][n], "swing") for n in MOTOR}
    found |= {f"nominal_{n}": _of(oil["start"][n], "boom_stick") for n in NOMINAL}
    start = {f"{j}_angle": _of(arm["parameters"][f"initial_{j}_angle"], "manipulator") for j in JOINTS}
    start |= {n: _of(oil["start"][n], "boom_stick") for n in ("supply_pressure", "tank_pressure")}
    pressures = start_pressures(swing) | start_pressures(boom_stick)
    at_rest = "pressure at rest in the nominal pose"
    start |= {n: Number(value, "Pa", "derived", at_rest) for n, value in pressures.items()}
    return {"parameters": found, "start": start}


def start_pressures(sub: Subsystem, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
    """Pressures of a drive at the start that the controller measures; `inputs` by name, else its own."""
    v = values(sub)
    u = {**v.u, **(inputs or {})}
    x = symbolic(sub).initial()(*(list(group.values()) for group in (v.x, u, v.p))).full()[:, 0]
    return {n: float(f"{a:.9g}") for n, a in zip(v.x, x, strict=True) if n in MEASURED}


def _of(number: Number, part: str) -> Number:
    return replace(number, note=f"{number.note} (as in {part})")
