"""Coordinated control of the tip: from the velocity or the path of the stick end to three valve commands.

    reference (`reference`) -> speed of each actuator (`drive`) -> command (`valve`) -> amplifier

    command' = (target - command)/T        target = lever + m (control - lever),  m' = (engaged - m)/T_blend

Signs: radius outwards, height upwards, angle counter-clockwise seen from above; commands as those of the
levers: a positive one turns left, raises the boom, extends the stick cylinder (which folds the stick in).
Errors are reference less machine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import casadi as ca

from fmus.boom_stick import BOOM_STICK
from fmus.boom_stick import drive as boom_stick_drive
from fmus.components import ports
from fmus.components.cylinder import Cylinder
from fmus.components.hose import VolumeHose
from fmus.components.spool_valve import Valve
from fmus.contract import Scalar, Subsystem
from fmus.controller import actuator, geometry
from fmus.controller.actuator import Action, Demand, Loop, Measured
from fmus.controller.reference import Reference, engaged, errors, machine, reference
from fmus.controller.valve import Actuator
from fmus.controller.variables import (
    AXES,
    FILE,
    ControllerInputs,
    ControllerOutputs,
    ControllerParameters,
    ControllerState,
    merged,
)
from fmus.manipulator import MANIPULATOR
from fmus.swing import SWING
from fmus.swing import drive as swing_drive


def derive(p: Any) -> dict[str, Scalar]:
    """Numbers of hoses and lines, as the parts of the machine derive them."""
    return boom_stick_drive.derive(VolumeHose, p) | swing_drive.derive_capacitance(p)


def actuators(positions: tuple[Scalar, Scalar], p: Any) -> dict[str, Actuator]:
    """Swing, boom and stick with the pistons at these positions [m]."""
    d = p.motor_displacement * p.gear_ratio
    lines = (p.line_capacitance, p.line_capacitance, p.line_turbulent_resistance)
    found = {"swing": Actuator(d, d, *lines, Valve.of(p, "swing_valve"), p.swing_density)}
    for name, position in zip(("boom", "stick"), positions, strict=True):
        own, hose = Cylinder.of(p, name), getattr(p, f"{name}_hose_capacitance")
        c_head, c_rod = (hose + v / p.bulk_modulus for v in own.volumes(position))
        resistance = getattr(p, f"{name}_hose_resistance")
        found[name] = Actuator(*own.areas, c_head, c_rod, resistance, Valve.of(p, "valve"), p.density)
    return found


def _measured(u: Any) -> dict[str, Measured]:
    rest = (u.supply_pressure, u.tank_pressure)
    return {
        "swing": Measured(u.swing_pressure_a, u.swing_pressure_b, *rest),
        "boom": Measured(u.boom_head_pressure, u.boom_rod_pressure, *rest),
        "stick": Measured(u.stick_head_pressure, u.stick_rod_pressure, *rest),
    }


def _actions(x: Any, u: Any, p: Any, ref: Reference) -> dict[str, Action]:
    """What each drive does."""
    (boom_at, boom_arm), (stick_at, stick_arm) = geometry.pistons(ref.joints, p)
    acting, measured = actuators((boom_at, stick_at), p), _measured(u)
    found = {}
    for name, speed, arm, error in zip(
        AXES, ref.speeds, (1, boom_arm, stick_arm), errors(x, u, p), strict=True
    ):
        late = getattr(x, f"{name}_late_speed")
        ahead = speed + p.lead_time * (speed - late) / p.lead_filter_time
        task = Demand(arm * ahead, error, getattr(p, f"{name}_speed_limit"))
        nominal = 0 if name == "swing" else getattr(p, f"nominal_{name}_holding_force")
        kind = "swing" if name == "swing" else "piston"
        loop = Loop(**{f.name: getattr(p, f"{kind}_{f.name}") for f in fields(Loop)})
        state = (getattr(x, f"{name}_gain"), getattr(x, f"{name}_load"))
        found[name] = actuator.action(acting[name], measured[name], task, loop, *state, nominal, p)
    return found


def _command_rates(x: Any, u: Any, p: Any, actions: Mapping[str, Action]) -> dict[str, Scalar]:
    def rate(name: str) -> Scalar:
        most = p.swing_valve_full_command if name == "swing" else p.valve_full_command
        lever = ca.fmin(ca.fmax(getattr(u, f"{name}_lever"), -most), most)  # an amplifier gives no more
        target = lever + x.coordination * (actions[name].command - lever)
        return (target - getattr(x, f"{name}_command")) / p.amplifier_time

    return {name: rate(name) for name in AXES}


def dynamics(x: Any, u: ControllerInputs, p: Any) -> Any:
    """Time derivative of the state."""
    on, ref = engaged(u), reference(x, u, p)
    actions = _actions(x, u, p, ref)
    moving = geometry.tip_velocity(machine(u), p)
    rates = {f"{n}_command": rate for n, rate in _command_rates(x, u, p, actions).items()}
    for name, speed, rate in zip(AXES, ref.speeds, ref.rates, strict=True):
        a, late, gain = actions[name], getattr(x, f"{name}_late_speed"), getattr(x, f"{name}_gain")
        rates[f"reference_{name}"] = rate
        rates[f"{name}_late_speed"] = (speed - late) / p.lead_filter_time
        rates[f"{name}_load"] = a.load_rate
        rates[f"{name}_gain"] = on * p.feedback * a.gain_rate - (1 - on) * gain / p.tracking_time
    levers = (
        ("radial_lever", u.radial_velocity, moving.radius),
        ("vertical_lever", u.vertical_velocity, moving.height),
        ("turning_lever", u.swing_velocity, moving.angle),
    )
    for name, wanted, now in levers:
        value = getattr(x, name)
        rates[name] = on * (wanted - value) / p.lever_time + (1 - on) * (now - value) / p.tracking_time
    return ControllerState(coordination=(on - x.coordination) / p.blend_time, **rates)


def observe(x: Any, u: ControllerInputs, p: Any) -> ControllerOutputs:
    """Outputs; commands depend on the state alone."""
    ref = reference(x, u, p)
    rates = _command_rates(x, u, p, _actions(x, u, p, ref))
    tip = geometry.tip(machine(u), p)
    return ControllerOutputs(
        **{f"{n}_command": getattr(x, f"{n}_command") for n in AXES},
        **{f"{n}_command_rate": rate for n, rate in rates.items()},
        reference_radius=ref.tip.radius,
        reference_height=ref.tip.height,
        reference_angle=ref.tip.angle,
        radial_error=ref.tip.radius - tip.radius,
        vertical_error=ref.tip.height - tip.height,
        angle_error=ref.tip.angle - tip.angle,
        tip_error=geometry.distance(ref.tip, tip),
        speed_use=ref.use.speed,
        stroke_use=ref.use.stroke,
        wait_use=ref.wait,
        reference_share=ref.share,
    )


def initial(x: Any, u: ControllerInputs, p: Any) -> dict[str, Scalar]:
    """The reference where the machine is, loads as measured, coordination as engaged."""
    now, measured = machine(u), _measured(u)
    (boom, _), (stick, _) = geometry.pistons(now, p)
    loads = {f"{n}_load": actuator.force(a, measured[n]) for n, a in actuators((boom, stick), p).items()}
    at = {"swing": now.swing_angle, "boom": now.boom_angle, "stick": now.stick_angle}
    return {f"reference_{n}": angle for n, angle in at.items()} | loads | {"coordination": engaged(u)}


def require(x: Any, u: ControllerInputs, p: Any) -> dict[str, Scalar]:
    """What must hold: rods thinner than bores, valves that open, margins within the strokes."""
    found: dict[str, Scalar] = {}
    for name in ("boom", "stick"):
        stroke, rod = getattr(p, f"{name}_stroke"), getattr(p, f"{name}_rod")
        found[f"{name}_rod is thinner than {name}_bore"] = getattr(p, f"{name}_bore") - rod
        found[f"stroke_margin is below half of {name}_stroke"] = stroke / 2 - p.stroke_margin
    for prefix in ("", "swing_"):
        full, band = getattr(p, f"{prefix}valve_full_command"), getattr(p, f"{prefix}valve_dead_band")
        found[f"{prefix}valve_full_command exceeds {prefix}valve_dead_band"] = full - band
    return found


def controller(
    swing: Subsystem = SWING, boom_stick: Subsystem = BOOM_STICK, manipulator: Subsystem = MANIPULATOR
) -> Subsystem:
    """The controller of a machine of these parts, with their numbers."""
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
        numbers=merged(swing, boom_stick, manipulator),
        terminals=tuple(ports.lever(axis) for axis in AXES),
        stiff=False,
        validity="valves and oil much faster than the wanted motion; swing angle not taken round",
    )


CONTROLLER = controller()
