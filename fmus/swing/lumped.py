"""Swing drive at the paper's fidelity: a spool valve, two short lines and a hydraulic motor with gear.

    I dQ_a/dt = P_port,a - P_a - C_R,line Q_a|Q_a|      I dQ_b/dt = P_port,b - P_b - C_R,line Q_b|Q_b|
    C dP_a/dt = Q_a - (P_a - P_1) / R_line              C dP_b/dt = Q_b - (P_b - P_2) / R_line
    torque    = D_m N (P_1 - P_2)                       eqs. (8), (9a), corrections E1, E2, E5

with the motor ports P_1, P_2 from `fmus.components.motor`. Swing lines are short: laminar (R_line),
and C_R,line is zero unless somebody measures one.

Signs: flows are positive towards the motor; angle, speed and torque are positive counter-clockwise
seen from above; a positive command drives the positive way. The torque depends on the speed by
2 D^2 R_line only (28 N.m.s/rad); it has to, or the port would not conserve power.
"""

from __future__ import annotations

from pathlib import Path

from fmus.components import chamber, hose, motor, spool_valve
from fmus.components.motor import MotorNodes
from fmus.components.spool_valve import PortFlow
from fmus.contract import Scalar, Subsystem
from fmus.swing.drive import TERMINALS, require
from fmus.swing.variables import SwingInputs, SwingOutputs, SwingParameters, SwingState


def _ports(x: SwingState, u: SwingInputs, p: SwingParameters) -> tuple[PortFlow, PortFlow]:
    flows, pressures = (x.swing_flow_a, x.swing_flow_b), (u.supply_pressure, u.tank_pressure)
    return spool_valve.ports(p.valve, u.swing_command, *flows, *pressures, p.density)


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
    leakage = (p.internal_leakage_resistance, p.external_leakage_resistance)
    return edges + lines + motor.leakage_loss(nodes, u.tank_pressure, *leakage)


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


def initial(x: SwingState, u: SwingInputs, p: SwingParameters) -> dict[str, Scalar]:
    """Both lines at the preload, the oil at rest: no torque."""
    preload = u.tank_pressure + p.initial_preload
    return {"swing_pressure_a": preload, "swing_pressure_b": preload, "swing_flow_a": 0, "swing_flow_b": 0}


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
    validity="lines laminar and short beside the wavelength, below 200 Hz; spool faster than the motion",
    terminals=TERMINALS,
)
