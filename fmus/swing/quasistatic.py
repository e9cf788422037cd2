"""Swing drive without line dynamics: a spool valve directly at a hydraulic motor with gear.

    C dP_a/dt = Q_a - D w - (P_a - P_b) / R_in - (P_a - P_t) / R_ex
    C dP_b/dt = Q_b + D w + (P_a - P_b) / R_in - (P_b - P_t) / R_ex
    torque    = D (P_a - P_b)           D = D_m N                   eqs. (8), (11), (12)

with the line flows Q_a, Q_b from the pressures (`fmus.components.spool_valve.direct_ports`): the limit of the
lumped drive for lines without inertance and laminar resistance, which costs 8 kPa at 74 L/min. The pressures
stand at the motor ports. Torque depends on states only.

Signs: flows are positive towards the motor; angle, speed and torque are positive counter-clockwise
seen from above; a positive command drives the positive way.
"""

from __future__ import annotations

from pathlib import Path

from fmus.components import chamber, motor, spool_valve
from fmus.components.motor import MotorNodes
from fmus.components.spool_valve import PortFlow
from fmus.contract import Group, Scalar, Subsystem
from fmus.swing.drive import TERMINALS, require
from fmus.swing.variables import QuasistaticParameters, SwingInputs, SwingOutputs


class QuasistaticState(Group):
    """State of the quasistatic drive: the pressures."""

    swing_pressure_a: Scalar = chamber.pressure("Pressure of swing line A")
    swing_pressure_b: Scalar = chamber.pressure("Pressure of swing line B")


def _ports(
    x: QuasistaticState, u: SwingInputs, p: QuasistaticParameters
) -> tuple[tuple[PortFlow, PortFlow], MotorNodes]:
    """The valve's ports and the motor's."""
    valve = spool_valve.direct_ports(
        p.valve,
        u.swing_command,
        x.swing_pressure_a,
        x.swing_pressure_b,
        u.supply_pressure,
        u.tank_pressure,
        p.density,
        p.line_turbulent_resistance,
    )
    displaced = p.motor_displacement * p.gear_ratio * u.swing_speed
    pressures = (x.swing_pressure_a, x.swing_pressure_b, u.tank_pressure)
    return valve, motor.at_ports(*pressures, displaced, *_leakage(p))


def _leakage(p: QuasistaticParameters) -> tuple[Scalar, Scalar]:
    return p.internal_leakage_resistance, p.external_leakage_resistance


def dynamics(x: QuasistaticState, u: SwingInputs, p: QuasistaticParameters) -> QuasistaticState:
    """Time derivative of the state, field by field."""
    (a, b), at = _ports(x, u, p)
    c = p.line_capacitance
    return QuasistaticState(
        swing_pressure_a=chamber.pressure_rate(x.swing_pressure_a, a.line - at.flow_1, c),
        swing_pressure_b=chamber.pressure_rate(x.swing_pressure_b, b.line - at.flow_2, c),
    )


def observe(x: QuasistaticState, u: SwingInputs, p: QuasistaticParameters) -> SwingOutputs:
    """Outputs."""
    (a, b), at = _ports(x, u, p)
    dx, displacement = dynamics(x, u, p), p.motor_displacement * p.gear_ratio
    lines = (x.swing_pressure_a, x.swing_pressure_b)
    edges = sum(spool_valve.throttling_loss(n, u.supply_pressure, u.tank_pressure) for n in (a, b))
    return SwingOutputs(
        **vars(x),
        swing_flow_a=a.line,
        swing_flow_b=b.line,
        swing_torque=displacement * (x.swing_pressure_a - x.swing_pressure_b),
        swing_torque_rate=displacement * (dx.swing_pressure_a - dx.swing_pressure_b),
        supply_flow=a.supply + b.supply,
        return_flow=a.tank + b.tank + at.drain,
        swing_motor_pressure_a=x.swing_pressure_a,
        swing_motor_pressure_b=x.swing_pressure_b,
        swing_drain_flow=at.drain,
        swing_void_volume=sum(chamber.void_volume(pressure) for pressure in lines),
        stored_energy=sum(chamber.stored_energy(pressure, p.line_capacitance) for pressure in lines),
        dissipated_power=edges + motor.leakage_loss(at, u.tank_pressure, *_leakage(p)),
    )


def initial(x: QuasistaticState, u: SwingInputs, p: QuasistaticParameters) -> dict[str, Scalar]:
    """Both lines at the preload: no torque."""
    preload = u.tank_pressure + p.initial_preload
    return {"swing_pressure_a": preload, "swing_pressure_b": preload}


SWING = Subsystem(
    name="swing",
    text="Hydraulic swing drive without line dynamics: spool valve, motor and gear",
    parameters=QuasistaticParameters,
    states=QuasistaticState,
    inputs=SwingInputs,
    outputs=SwingOutputs,
    dynamics=dynamics,
    observe=observe,
    initial=initial,
    require=require,
    values=Path(__file__).with_name("parameters.toml"),
    validity="motions slow beside the oil in the lines, below some 10 Hz; spool faster than the motion",
    terminals=TERMINALS,
    stiff=False,
)
