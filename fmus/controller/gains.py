"""Gains, limits and time constants of the controller; values, sources and notes are in parameters.toml."""

from collections.abc import Sequence
from typing import Any

from fmus.contract import Group, Quantity, Scalar, make_group, quantities
from fmus.controller.arm import ControlledAxis

HEAD, ROD, ALIKE = " to the head side", " to the rod side", "as to the head side"


def _section_flow(
    axis: str, group: str = "", side: str = "", zero: str = "its valve has no compensator"
) -> Quantity:
    text = f"Flow of the pressure-compensated {axis} section{side} at full command; 0: {zero}"
    return Quantity("m3/s", text, 1e-3, minimum=0.0, group=group)


def _gain(unit: str, text: str, nominal: float, group: str = "") -> Quantity:
    return Quantity(unit, text, nominal, minimum=0.0, tunable=True, group=group)


class Feedback(Group):
    """Whether there is one."""

    feedback: Scalar = Quantity(
        "1",
        "0: feedforward at nominal pressures only, 1: with feedback of motion and pressures",
        minimum=0.0,
        maximum=1.0,
        tunable=True,
        group="Feedback",
    )


class ColumnLoop(Group):
    """Of the column."""

    position_gain: Scalar = _gain("1/s", "Commanded {} speed per error of the {} angle", 5.0)
    integral_gain: Scalar = _gain(
        "1/s2", "Rate of the commanded speed by the integrator of the {}, per error", 10.0
    )
    damping_rate: Scalar = _gain(
        "1/s", "Rate at which pressure feedback damps oscillations of the {} torque", 5.0
    )
    load_time: Scalar = Quantity(
        "s", "Time constant of the high-pass of that feedback: slower torques are steady loads"
    )


class Loops(Group):
    """Of all pistons, the valves and the reference."""

    piston_position_gain: Scalar = _gain(
        "1/s", "Commanded piston speed per error of the piston position", 5.0
    )
    piston_integral_gain: Scalar = _gain(
        "1/s2", "Rate of the commanded speed by the integrator of a piston, per error", 10.0
    )
    piston_damping_rate: Scalar = _gain(
        "1/s", "Rate at which pressure feedback damps oscillations of a piston force", 5.0
    )
    piston_load_time: Scalar = Quantity(
        "s", "Time constant of the high-pass of that feedback: slower forces are steady loads"
    )
    frequency_share: Scalar = Quantity(
        "1", "Largest position gain over the natural frequency of the load on its oil", 0.1, minimum=1e-3
    )
    gain_limit: Scalar = Quantity(
        "1", "Largest correction of the feedforward, as a fraction of it", minimum=1e-3
    )
    learning_share: Scalar = Quantity(
        "1", "Fraction of the speed limit below which the correction adapts slowly", 0.01, minimum=1e-6
    )
    unwinding_time: Scalar = Quantity(
        "s", "Anti-windup: time in which an integrator unwinds when the valve saturates", 0.1
    )
    lead_time: Scalar = _gain(
        "s", "Lead of the reference speed, equal to the lag of amplifier and valve", 0.1, "Feedforward"
    )
    lead_filter_time: Scalar = Quantity(
        "s", "Time constant of the filter for the rate of the reference speed", 0.1, minimum=1e-3
    )
    amplifier_time: Scalar = Quantity("s", "Time constant of the valve amplifier", 0.01, minimum=1e-3)
    hysteresis: Scalar = Quantity(
        "1",
        "Hysteresis of the valves at the start, over full command; then it is learned; 0: there is none",
        0.01,
        minimum=0.0,
        maximum=0.5,
    )
    hysteresis_limit: Scalar = Quantity(
        "1", "Largest hysteresis that is learned", 0.1, minimum=1e-3, maximum=0.5
    )
    hysteresis_gain: Scalar = _gain("1/s2", "Rate at which the hysteresis is learned, per error", 10.0)
    learning: Scalar = Quantity(
        "1",
        "1: dead bands, flows and play of the valves are learned from motion, 0: only the play, from errors",
        minimum=0.0,
        maximum=1.0,
        tunable=True,
    )
    learning_time: Scalar = Quantity(
        "s", "Time of motion in which an error of the dead band falls to 1/e", minimum=0.1
    )
    learning_filter_time: Scalar = Quantity(
        "s", "Time constant of the filter of the speed that the oil gives", 0.1, minimum=1e-3
    )
    learning_lag: Scalar = Quantity(
        "s", "Lag of spool and sensors, behind that of the amplifier", 0.01, minimum=0.0
    )
    dead_band_limit: Scalar = Quantity(
        "V", "Largest difference of a dead band from that of the parameters", 0.1, minimum=1e-3
    )
    reversal: Scalar = Quantity(
        "V", "Change of a command that counts as a reversal of its valve", 0.1, minimum=1e-3
    )
    foot_share: Scalar = Quantity(
        "1", "Valve opening below which the step over the dead band is rounded", 1e-3, minimum=1e-5
    )
    follow_gain: Scalar = Quantity(
        "1/s", "Speed of the reference towards the path, per distance", minimum=0.0, group="Reference"
    )
    follow_speed: Scalar = Quantity("m/s", "Largest speed of the reference towards the path", minimum=1e-3)
    lever_time: Scalar = Quantity(
        "s",
        "Time constant of the filter of the commanded velocities while no path is followed",
        0.1,
        minimum=1e-3,
    )
    blend_time: Scalar = Quantity(
        "s", "Time constant of the change between levers and coordinated control", 0.1, minimum=1e-3
    )
    tracking_time: Scalar = Quantity(
        "s", "Time constant at which the reference follows the machine when not engaged", 0.1
    )
    singular_share: Scalar = Quantity(
        "1",
        "Sine of the angle between the links below which the inverse Jacobian is damped",
        0.1,
        minimum=0.0,
    )
    singular_damping: Scalar = Quantity(
        "m", "Damping of the inverse Jacobian when the links are collinear", minimum=1e-3
    )


class Ends(Group):
    """Of the strokes."""

    stroke_margin: Scalar = Quantity("m", "Distance of the reference from the ends of the strokes", 0.01)
    stroke_gain: Scalar = Quantity(
        "1/s", "Largest speed of a piston towards the end of its stroke, per distance left", minimum=0.1
    )


class Lags(Group):
    """Of the machine behind its reference."""

    piston_error_limit: Scalar = Quantity(
        "m", "Lag of a piston at which the reference waits for the machine", 0.01, minimum=1e-5
    )
    return_rate: Scalar = Quantity(
        "1/s", "Rate at which the reference returns to the machine beyond that error", minimum=0.0
    )


def gains(axes: Sequence[ControlledAxis]) -> type[Any]:
    """Parameters that only the controller has; geometry and hydraulics come from the machine's subsystems."""
    turn, *arm = axes
    column = {f"{turn.name}_{n}": q.of(turn.name, str) for n, q in quantities(ColumnLoop).items()}
    text = f"Largest {turn.name} speed of the reference"
    speeds = {f"{turn.name}_speed_limit": Quantity("rad/s", text, minimum=1e-3, group="Limits")}
    for a in arm:
        text = f"Largest speed of the {a.name} piston in the reference"
        speeds[f"{a.name}_speed_limit"] = Quantity("m/s", text, 0.1, minimum=1e-4)
    text = f"Lag of the {turn.name} at which the reference waits for the machine"
    error = {f"{turn.name}_error_limit": Quantity("rad", text, 0.1, minimum=1e-4)}
    flows = {f"{turn.name}_section_flow": _section_flow(turn.name, group="Compensated sections")}
    for a in arm:
        flows[f"{a.name}_section_flow"] = _section_flow(a.name, side=HEAD)
        flows[f"{a.name}_rod_section_flow"] = _section_flow(a.name, side=ROD, zero=ALIKE)
    of = [quantities(group) for group in (Feedback, Loops, Ends, Lags)]
    return make_group("Gains", of[0] | column | of[1] | speeds | of[2] | error | of[3] | flows)
