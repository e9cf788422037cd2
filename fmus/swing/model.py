"""Swing drive: a spool valve, two short lines and a hydraulic motor with gear.

    I dQ_a/dt = P_port,a - P_a - C_R,line Q_a|Q_a|      I dQ_b/dt = P_port,b - P_b - C_R,line Q_b|Q_b|
    C dP_a/dt = Q_a - (P_a - P_1) / R_line              C dP_b/dt = Q_b - (P_b - P_2) / R_line
    torque    = D_m N (P_1 - P_2)                       eqs. (8), (9a), corrections E1, E2, E5

with the motor ports P_1, P_2 from `fmus.components.motor`. Swing lines are short: laminar (R_line),
and C_R,line is zero unless somebody measures one.

Signs: flows are positive towards the motor; angle, speed and torque are positive counter-clockwise
seen from above; a positive command drives the positive way. The torque depends on the speed by
2 D^2 R_line only (about 27 N.m.s/rad); it has to, or the port would not conserve power.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from fmus.components import chamber, hose, motor, spool_valve
from fmus.components.motor import MotorNodes
from fmus.components.spool_valve import PortFlow, Valve
from fmus.contract import Quantity, Scalar, Subsystem


@dataclass(frozen=True)
class SwingParameters:
    """Constants; their numbers and sources are in parameters.toml."""

    density: Annotated[Scalar, Quantity("kg/m3", "Density of the oil", 1e3, minimum=100.0)]
    valve_area: Annotated[
        Scalar, Quantity("m2", "Area of a metering edge at full command", 1e-5, minimum=0.0)
    ]
    valve_discharge_coefficient: Annotated[
        Scalar, Quantity("1", "Discharge coefficient of the metering edges", minimum=0.1, maximum=1.0)
    ]
    valve_dead_band: Annotated[
        Scalar, Quantity("V", "Command up to which the valve stays closed", minimum=0.0)
    ]
    valve_full_command: Annotated[
        Scalar, Quantity("V", "Command at which the valve is fully open", minimum=0.1)
    ]
    valve_command_rounding: Annotated[
        Scalar, Quantity("V", "Width over which the foot of the opening curve is rounded", minimum=1e-3)
    ]
    valve_leakage: Annotated[
        Scalar, Quantity("m3/(s.Pa)", "Laminar leakage of each metering edge", 1e-14, minimum=1e-17)
    ]
    valve_transition_flow: Annotated[
        Scalar, Quantity("m3/s", "Flow below which metering edges and lines are laminar", 1e-5, minimum=1e-8)
    ]
    initial_preload: Annotated[
        Scalar, Quantity("Pa", "Pressure of both lines at the start", 1e6, minimum=1e3)
    ]
    line_inertance: Annotated[Scalar, Quantity("kg/m4", "Inertance I of each swing line", 1e6, minimum=1.0)]
    line_capacitance: Annotated[
        Scalar, Quantity("m3/Pa", "Capacitance C of each line with its motor side", 1e-12, minimum=1e-18)
    ]
    line_resistance: Annotated[
        Scalar, Quantity("Pa.s/m3", "Laminar resistance R_1 = R_2 of each swing line", 1e6, minimum=1.0)
    ]
    line_turbulent_resistance: Annotated[
        Scalar, Quantity("Pa.s2/m6", "Turbulent resistance C_R of each swing line", 1e10, minimum=0.0)
    ]
    motor_displacement: Annotated[
        Scalar, Quantity("m3/rad", "Displacement D_m of the motor", 1e-5, minimum=1e-9)
    ]
    gear_ratio: Annotated[
        Scalar, Quantity("1", "Gear ratio N, motor speed over swing speed", 10.0, minimum=0.1)
    ]
    internal_leakage_resistance: Annotated[
        Scalar, Quantity("Pa.s/m3", "Cross-port leakage resistance R_in of the motor", 1e12, minimum=1e6)
    ]
    external_leakage_resistance: Annotated[
        Scalar,
        Quantity("Pa.s/m3", "Leakage resistance R_ex of each motor port to the drain", 1e12, minimum=1e6),
    ]


@dataclass(frozen=True)
class SwingState:
    """Pressures and flows of both lines."""

    swing_pressure_a: Annotated[Scalar, Quantity("Pa", "Pressure of line A", 1e7)]
    swing_pressure_b: Annotated[Scalar, Quantity("Pa", "Pressure of line B", 1e7)]
    swing_flow_a: Annotated[Scalar, Quantity("m3/s", "Flow into line A", 1e-3)]
    swing_flow_b: Annotated[Scalar, Quantity("m3/s", "Flow into line B", 1e-3)]


@dataclass(frozen=True)
class SwingInputs:
    """Command, supply and the motion of the column; the rate input carries an exact time derivative."""

    swing_command: Annotated[Scalar, Quantity("V", "Command to the swing valve, positive turns left", 10.0)]
    supply_pressure: Annotated[Scalar, Quantity("Pa", "Pressure of the supply line", 1e7)]
    tank_pressure: Annotated[Scalar, Quantity("Pa", "Pressure of the return line", 1e5)]
    swing_speed: Annotated[Scalar, Quantity("rad/s", "Swing speed", 1.0, rate="swing_acceleration")]
    swing_acceleration: Annotated[
        Scalar, Quantity("rad/s2", "Rate port: time derivative of swing_speed, may stay unconnected")
    ]


@dataclass(frozen=True)
class SwingOutputs(SwingState):
    """The state; torque and its rate for the mechanics; flows for the supply; and what a user looks at."""

    swing_torque: Annotated[Scalar, Quantity("N.m", "Hydraulic torque on the swing column", 1e4)]
    swing_torque_rate: Annotated[
        Scalar, Quantity("N.m/s", "Rate port: exact time derivative of swing_torque", 1e5)
    ]
    supply_flow: Annotated[Scalar, Quantity("m3/s", "Flow taken from the supply line", 1e-3)]
    return_flow: Annotated[
        Scalar, Quantity("m3/s", "Flow given to the return line, with the case drain", 1e-3)
    ]
    swing_motor_pressure_a: Annotated[Scalar, Quantity("Pa", "Pressure P_1 at motor port A", 1e7)]
    swing_motor_pressure_b: Annotated[Scalar, Quantity("Pa", "Pressure P_2 at motor port B", 1e7)]
    swing_drain_flow: Annotated[Scalar, Quantity("m3/s", "External leakage of the motor to the drain", 1e-5)]
    swing_void_volume: Annotated[
        Scalar, Quantity("m3", "Void in the swing lines: above 1e-7 the oil has torn", 1e-6, warn_above=1e-7)
    ]
    stored_energy: Annotated[
        Scalar, Quantity("J", "Energy of compression and of the moving oil columns", 1e3)
    ]
    dissipated_power: Annotated[Scalar, Quantity("W", "Heat of metering edges, lines and leakage", 1e4)]


def _ports(x: SwingState, u: SwingInputs, p: SwingParameters) -> tuple[PortFlow, PortFlow]:
    valve = Valve(
        p.valve_area,
        p.valve_discharge_coefficient,
        p.valve_dead_band,
        p.valve_full_command,
        p.valve_command_rounding,
        p.valve_leakage,
        p.valve_transition_flow,
    )
    return spool_valve.ports(
        valve, u.swing_command, x.swing_flow_a, x.swing_flow_b, u.supply_pressure, u.tank_pressure, p.density
    )


def _motor(pressures: tuple[Scalar, Scalar, Scalar], speed: Scalar, p: SwingParameters) -> MotorNodes:
    """The motor nodes; linear, so that of rates it returns the rates."""
    displaced = p.motor_displacement * p.gear_ratio * speed
    return motor.nodes(
        *pressures,
        displaced,
        p.line_resistance,
        p.line_resistance,
        p.internal_leakage_resistance,
        p.external_leakage_resistance,
    )


def dynamics(x: SwingState, u: SwingInputs, p: SwingParameters) -> SwingState:
    """Time derivative of the state, field by field."""
    port_a, port_b = _ports(x, u, p)
    nodes = _motor((x.swing_pressure_a, x.swing_pressure_b, u.tank_pressure), u.swing_speed, p)
    line = (p.line_inertance, p.line_turbulent_resistance, p.valve_transition_flow)
    c = p.line_capacitance
    return SwingState(
        swing_pressure_a=chamber.pressure_rate(x.swing_pressure_a, x.swing_flow_a - nodes.flow_1, c),
        swing_pressure_b=chamber.pressure_rate(x.swing_pressure_b, x.swing_flow_b - nodes.flow_2, c),
        swing_flow_a=hose.flow_rate(port_a.pressure, x.swing_pressure_a, x.swing_flow_a, *line),
        swing_flow_b=hose.flow_rate(port_b.pressure, x.swing_pressure_b, x.swing_flow_b, *line),
    )


def _dissipated_power(x: SwingState, u: SwingInputs, p: SwingParameters, nodes: MotorNodes) -> Scalar:
    edges = sum(spool_valve.throttling_loss(n, u.supply_pressure, u.tank_pressure) for n in _ports(x, u, p))
    lines = sum(q**2 * p.line_resistance for q in (nodes.flow_1, nodes.flow_2)) + sum(
        q * spool_valve.turbulent_drop(q, p.line_turbulent_resistance, p.valve_transition_flow)
        for q in (x.swing_flow_a, x.swing_flow_b)
    )
    p1, p2 = nodes.pressure_1, nodes.pressure_2
    drain = ((p1 - u.tank_pressure) ** 2 + (p2 - u.tank_pressure) ** 2) / p.external_leakage_resistance
    return edges + lines + drain + (p1 - p2) ** 2 / p.internal_leakage_resistance


def observe(x: SwingState, u: SwingInputs, p: SwingParameters) -> SwingOutputs:
    """Outputs."""
    ports, dx = _ports(x, u, p), dynamics(x, u, p)
    nodes = _motor((x.swing_pressure_a, x.swing_pressure_b, u.tank_pressure), u.swing_speed, p)
    rates = _motor((dx.swing_pressure_a, dx.swing_pressure_b, 0), u.swing_acceleration, p)
    displacement = p.motor_displacement * p.gear_ratio
    compression = sum(
        chamber.stored_energy(pressure, p.line_capacitance)
        for pressure in (x.swing_pressure_a, x.swing_pressure_b)
    )
    return SwingOutputs(
        **vars(x),
        swing_torque=displacement * (nodes.pressure_1 - nodes.pressure_2),
        swing_torque_rate=displacement * (rates.pressure_1 - rates.pressure_2),
        supply_flow=ports[0].supply + ports[1].supply,
        return_flow=ports[0].tank + ports[1].tank + nodes.drain,
        swing_motor_pressure_a=nodes.pressure_1,
        swing_motor_pressure_b=nodes.pressure_2,
        swing_drain_flow=nodes.drain,
        swing_void_volume=chamber.void_volume(x.swing_pressure_a) + chamber.void_volume(x.swing_pressure_b),
        stored_energy=compression + p.line_inertance * (x.swing_flow_a**2 + x.swing_flow_b**2) / 2,
        dissipated_power=_dissipated_power(x, u, p, nodes),
    )


def initial(u: SwingInputs, p: SwingParameters) -> dict[str, Scalar]:
    """Both lines at the preload, the oil at rest: no torque."""
    preload = u.tank_pressure + p.initial_preload
    return {"swing_pressure_a": preload, "swing_pressure_b": preload, "swing_flow_a": 0, "swing_flow_b": 0}


def require(x: SwingState, u: SwingInputs, p: SwingParameters) -> dict[str, Scalar]:  # noqa: ARG001
    """What must hold beyond the bounds of single parameters."""
    return {"valve_full_command exceeds valve_dead_band": p.valve_full_command - p.valve_dead_band}


SWING = Subsystem(
    name="swing",
    text="Hydraulic swing drive: spool valve, lines, motor and gear",
    parameters=SwingParameters,
    states=SwingState,
    inputs=SwingInputs,
    outputs=SwingOutputs,
    dynamics=dynamics,
    observe=observe,
    initial=initial,
    require=require,
    values=Path(__file__).with_name("parameters.toml"),
)
