"""Coordinated control of the tip: from a commanded tip velocity or path to three valve commands.

    reference (reference.py) -> speed of each actuator (actuator.py) -> command (valve.py) -> amplifier
    -> compensation of the play (play.py)

    spool' = (target - spool)/T        target = lever + m (control - lever),  m' = (engaged - m)/T_blend

m is the weight of coordinated control, control the command of the actuator's control law, T `amplifier_time`
and T_blend `blend_time`.

Signs: radius outwards, height upwards, angle counter-clockwise seen from above. Commands have the signs of
the levers: a positive one turns left, raises the boom, extends the stick cylinder (which folds the stick in).
Errors are reference minus machine. Values that the machine has, too, are those of its subsystems.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca

from fmus import ports
from fmus.boom_stick import BOOM_STICK
from fmus.contract import Scalar, Subsystem, quantities, symbolic
from fmus.controller import geometry
from fmus.controller.actuator import ActuatorCommand, actuator_command
from fmus.controller.gains import Gains
from fmus.controller.play import Compensation, beyond_limits, learned_rate
from fmus.controller.reference import Reference, engaged, errors, reference
from fmus.controller.valve import MARGIN, Actuator, needed_pressures
from fmus.controller.variables import (
    AXES,
    ControllerInputs,
    ControllerOutputs,
    ControllerParameters,
    ControllerState,
)
from fmus.drives import cylinder, motor
from fmus.manipulator import MANIPULATOR
from fmus.parameters import Number, Tables, numbers, read, values
from fmus.swing import SWING

GAINS = tuple(quantities(Gains))
NOMINAL = ("supply_pressure", "boom_holding_force", "stick_holding_force")  # start values of boom_stick
PRESSURES = tuple(n for n, q in quantities(ControllerInputs).items() if q.unit == "Pa")
FILE = Path(__file__).with_name("parameters.toml")


LEAST_SUPPLY = 1e5  # Pa: keeps the use of the supply pressure finite


def derive(p: Any) -> dict[str, Scalar]:
    """Hoses and lines by the equations of the drives; sections with equal flows to both sides."""
    boom, stick = (
        {f"{n}_{k}": v for k, v in cylinder.derive(own, p).items()}
        for n, own in (("boom", p.boom), ("stick", p.stick))
    )
    rods = {f"{n}_rod_section_flow": getattr(p, f"{n}_section_flow") for n in ("boom", "stick")}
    return boom | stick | motor.derive(p.swing, p) | rods


def actuators(positions: tuple[Scalar, Scalar], p: Any) -> dict[str, Actuator]:
    """Swing, boom and stick with the pistons at these positions [m]."""
    d, line = p.swing.displacement, p.swing.line
    c, flow, density = line.capacitance, p.swing_section_flow, p.swing_oil.density
    result = {"swing": Actuator(d, d, c, c, line.turbulent_resistance, p.swing_valve, density, (flow, flow))}
    for name, position, own in zip(("boom", "stick"), positions, (p.boom, p.stick), strict=True):
        sections = getattr(p, f"{name}_section_flow"), getattr(p, f"{name}_rod_section_flow")
        c_head, c_rod = (own.hose.capacitance + v / p.bulk_modulus for v in own.volumes(position))
        (head, rod), resistance = own.areas, own.hose.resistance
        result[name] = Actuator(head, rod, c_head, c_rod, resistance, p.valve, p.density, sections)
    return result


def _measured(u: Any) -> dict[str, tuple[Scalar, Scalar]]:
    """Measured pressures [Pa] of each actuator: head side (A), rod side (B)."""
    return {
        "swing": (u.swing_pressure_a, u.swing_pressure_b),
        "boom": (u.boom_head_pressure, u.boom_rod_pressure),
        "stick": (u.stick_head_pressure, u.stick_rod_pressure),
    }


def _actuator_commands(x: Any, u: Any, p: Any, ref: Reference) -> dict[str, ActuatorCommand]:
    """Command of the control law for each actuator."""
    (boom_at, boom_arm), (stick_at, stick_arm) = geometry.strokes_and_moment_arms(ref.joints, p)
    driven, measured = actuators((boom_at, stick_at), p), _measured(u)
    result = {}
    for name, speed, arm, error in zip(
        AXES, ref.speeds, (1, boom_arm, stick_arm), errors(x, u, p), strict=True
    ):
        filtered = getattr(x, f"{name}_late_speed")
        change = (speed - filtered) / p.lead_filter_time
        leading = speed + p.lead_time * change
        motion = (arm * leading, arm * change)
        result[name] = actuator_command(name, driven[name], measured[name], motion, error, x, u, p)
    return result


def _pressure_use(x: Any, u: Any, p: Any, ref: Reference) -> Scalar:
    """Supply pressure that loads and valves need, in the directions demanded, over the one that there is."""
    (boom, _), (stick, _) = geometry.strokes_and_moment_arms(ref.joints, p)
    most: Scalar = 0
    for (name, a), sign in zip(actuators((boom, stick), p).items(), ref.directions, strict=True):
        up, down = needed_pressures(a, getattr(x, f"{name}_load"), u.tank_pressure)
        most = ca.fmax(most, ca.fmax(ca.fmax(0, sign) * (up + MARGIN), ca.fmax(0, -sign) * (down + MARGIN)))
    return most / ca.fmax(u.supply_pressure, LEAST_SUPPLY)


def _full_command(name: str, p: Any) -> Scalar:
    return (p.swing_valve if name == "swing" else p.valve).full_command


def _compensation(name: str, x: Any, p: Any) -> Compensation:
    spool, trailing, half_width = (getattr(x, f"{name}_{n}") for n in ("spool", "trailing", "half_width"))
    full = _full_command(name, p)
    return Compensation(spool, trailing, half_width, x.coordination, full, p.reversal)


def _valve_rates(x: Any, u: Any, p: Any, commands: Mapping[str, ActuatorCommand]) -> dict[str, Scalar]:
    """Rates of the states of the valves, and of the weight of coordinated control."""
    rates: dict[str, Scalar] = {"coordination": (engaged(u) - x.coordination) / p.blend_time}
    for name, command in commands.items():
        full, play = _full_command(name, p), _compensation(name, x, p)
        lever = ca.fmin(ca.fmax(getattr(u, f"{name}_lever"), -full), full)  # range of the amplifier
        target = lever + x.coordination * (command.command - lever)
        learning = ca.if_else(p.hysteresis > 0, p.hysteresis_gain, 0)
        learned = learned_rate(learning * command.missing)
        beyond = beyond_limits(play.half_width, full * p.hysteresis_limit / 2)
        rates[f"{name}_spool"] = (target - play.spool) / p.amplifier_time
        rates[f"{name}_trailing"] = play.trailing_rate
        rates[f"{name}_half_width"] = engaged(u) * p.feedback * learned - beyond / p.unwinding_time
    return rates


def dynamics(x: Any, u: ControllerInputs, p: Any) -> Any:
    """Time derivative of the state."""
    on, ref = engaged(u), reference(x, u, p)
    commands = _actuator_commands(x, u, p, ref)
    measured = geometry.tip_velocity(u, p)
    rates = _valve_rates(x, u, p, commands)
    for name, speed, rate in zip(AXES, ref.speeds, ref.rates, strict=True):
        command, gain = commands[name], getattr(x, f"{name}_gain")
        rates[f"reference_{name}"] = rate
        rates[f"{name}_late_speed"] = (speed - getattr(x, f"{name}_late_speed")) / p.lead_filter_time
        rates[f"{name}_load"] = command.load_rate
        rates[f"{name}_gain"] = on * p.feedback * command.gain_rate - (1 - on) * gain / p.tracking_time
    velocities = (
        ("radial_lever", u.radial_velocity, measured.radius),
        ("vertical_lever", u.vertical_velocity, measured.height),
        ("turning_lever", u.swing_velocity, measured.angle),
    )
    for name, commanded, actual in velocities:
        value = getattr(x, name)
        rates[name] = on * (commanded - value) / p.lever_time + (1 - on) * (actual - value) / p.tracking_time
    return ControllerState(**rates)


def observe(x: Any, u: ControllerInputs, p: Any) -> ControllerOutputs:
    """Outputs; commands depend on the state alone."""
    ref = reference(x, u, p)
    rates = _valve_rates(x, u, p, _actuator_commands(x, u, p, ref))
    plays, weight_rate = {n: _compensation(n, x, p) for n in AXES}, rates["coordination"]
    tip = geometry.tip_position(u, p)
    return ControllerOutputs(
        **{f"{n}_command": play.command for n, play in plays.items()},
        **{
            f"{n}_command_rate": play.command_rate(rates[f"{n}_spool"], rates[f"{n}_half_width"], weight_rate)
            for n, play in plays.items()
        },
        reference_radius=ref.tip.radius,
        reference_height=ref.tip.height,
        reference_angle=ref.tip.angle,
        radial_error=ref.tip.radius - tip.radius,
        vertical_error=ref.tip.height - tip.height,
        angle_error=ref.tip.angle - tip.angle,
        tip_error=geometry.distance(ref.tip, tip),
        speed_use=ref.utilisation.speed,
        stroke_use=ref.utilisation.stroke,
        wait_use=ref.lag_ratio,
        pressure_use=_pressure_use(x, u, p, ref),
        reference_share=ref.speed_factor,
    )


def initial(x: Any, u: ControllerInputs, p: Any) -> dict[str, Scalar]:
    """Reference angles and loads as measured; weight of coordinated control as `engaged`; assumed play."""
    pressures = _measured(u)
    (boom, _), (stick, _) = geometry.strokes_and_moment_arms(u, p)
    loads = {f"{n}_load": a.force(*pressures[n]) for n, a in actuators((boom, stick), p).items()}
    angles = {f"reference_{n}": getattr(u, f"{n}_angle") for n in AXES}
    half_widths = {f"{n}_half_width": p.hysteresis * _full_command(n, p) / 2 for n in AXES}
    return angles | loads | half_widths | {"coordination": engaged(u)}


def require(x: Any, u: ControllerInputs, p: Any) -> dict[str, Scalar]:
    """Requirements: rods thinner than bores, valves that open, margins within the strokes."""
    requirements: dict[str, Scalar] = {}
    for name, own in (("boom", p.boom), ("stick", p.stick)):
        requirements[f"{name}_rod is thinner than {name}_bore"] = own.bore - own.rod
        requirements[f"stroke_margin is below half of {name}_stroke"] = own.stroke / 2 - p.stroke_margin
    for prefix, valve in (("", p.valve), ("swing_", p.swing_valve)):
        margin = valve.full_command - valve.dead_band
        requirements[f"{prefix}valve_full_command exceeds {prefix}valve_dead_band"] = margin
    return requirements


def controller_tables(swing: Subsystem, boom_stick: Subsystem, manipulator: Subsystem) -> Tables:
    """Parameter and start values of the controller for a machine built from these subsystems."""
    of_boom_stick, of_swing, of_manipulator = numbers(boom_stick), numbers(swing), numbers(manipulator)
    gains, poses = read(FILE)["parameters"], of_manipulator["parameters"]
    known: dict[str, Number] = {}  # of what several parts have, the manipulator's counts first
    for component, numbers_of in (
        ("swing", of_swing),
        ("boom_stick", of_boom_stick),
        ("manipulator", of_manipulator),
    ):
        known |= {n: _noted(number, component) for n, number in numbers_of["parameters"].items()}
    known |= {f"swing_{n}": _noted(number, "swing") for n, number in of_swing["parameters"].items()}
    known |= {f"nominal_{n}": _noted(of_boom_stick["start"][n], "boom_stick") for n in NOMINAL}
    parameters = {n: (known | gains)[n] for n in quantities(ControllerParameters)}
    start = {f"{axis}_angle": _noted(poses[f"initial_{axis}_angle"], "manipulator") for axis in AXES}
    start |= {
        n: _noted(of_boom_stick["start"][n], "boom_stick") for n in ("supply_pressure", "tank_pressure")
    }
    pressures = start_pressures(swing) | start_pressures(boom_stick)
    at_rest = "pressure at rest in the nominal pose"
    start |= {n: Number(value, "Pa", "derived", at_rest) for n, value in pressures.items()}
    return {"parameters": parameters, "start": start}


def start_pressures(sub: Subsystem, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
    """Initial pressures of a drive that are inputs of the controller, rounded to nine digits.

    inputs   values by name that replace start values of the drive's inputs
    """
    v = values(sub)
    u = {**v.u, **(inputs or {})}
    x = symbolic(sub).initial()(*(list(group.values()) for group in (v.x, u, v.p))).full()[:, 0]
    return {n: float(f"{a:.9g}") for n, a in zip(v.x, x, strict=True) if n in PRESSURES}


def _noted(number: Number, component: str) -> Number:
    """The same value, with the component in its note."""
    return replace(number, note=f"{number.note} (as in {component})")


def controller(
    swing: Subsystem = SWING, boom_stick: Subsystem = BOOM_STICK, manipulator: Subsystem = MANIPULATOR
) -> Subsystem:
    """The controller of a machine built from these subsystems, with their parameter values."""
    return Subsystem(
        name="controller",
        text="Coordinated control of the tip: resolved rates, flow feedforward, pressure feedback",
        parameters=ControllerParameters,
        states=ControllerState,
        inputs=ControllerInputs,
        outputs=ControllerOutputs,
        dynamics=dynamics,
        observe=observe,
        derive=derive,
        initial=initial,
        require=require,
        values=FILE,
        numbers=controller_tables(swing, boom_stick, manipulator),
        terminals=tuple(ports.lever(axis) for axis in AXES),
        stiff=False,
        validity="valves and oil much faster than the commanded motion; swing angle not wrapped",
    )


CONTROLLER = controller()
