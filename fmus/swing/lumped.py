"""Swing drive at the paper's fidelity: a spool valve, two short lines and a hydraulic motor with gear.

    I dQ_a/dt = P_port,a - P_a - C_R,line Q_a|Q_a|      I dQ_b/dt = P_port,b - P_b - C_R,line Q_b|Q_b|
    C dP_a/dt = Q_a - (P_a - P_1) / R_line              C dP_b/dt = Q_b - (P_b - P_2) / R_line
    torque    = D_m N (P_1 - P_2)                       eqs. (8), (9a), corrections E1, E2, E5

with the motor ports P_1, P_2 from `fmus.components.motor`. Swing lines are short, so their friction is
laminar (R_line), and C_R,line is zero unless it is identified from measurements.

The torque depends on the speed with 2 D^2 R_line (28 N.m.s/rad), which is required for conservation of power.
"""

from fmus.components import chamber, hose, motor, spool_valve
from fmus.components.motor import MotorNodes
from fmus.components.oil import at_temperature
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import EdgeFlows, Valve
from fmus.contract import Scalar
from fmus.swing import drive
from fmus.swing.variables import SwingInputs, SwingOutputs, SwingParameters, SwingState


def _ports(x: SwingState, u: SwingInputs, p: SwingParameters) -> tuple[EdgeFlows, EdgeFlows]:
    flows, pressures = (x.swing_flow_a, x.swing_flow_b), (u.supply_pressure, u.tank_pressure)
    valve, curves = Valve.of(p, "valve"), OpeningCurves.of(p, "valve")
    return spool_valve.ports_from_flow(valve, u.swing_command, *flows, *pressures, p.density, curves)


def _motor(pressures: tuple[Scalar, Scalar, Scalar], speed: Scalar, p: SwingParameters) -> MotorNodes:
    """Motor nodes from (P_a, P_b, P_t); linear, so from their rates it returns the rates of the nodes."""
    lines = (p.line_resistance, p.line_resistance)
    return motor.nodes(*pressures, drive.displacement(p) * speed, *lines, *drive.leakage(p))


def dynamics(x: SwingState, u: SwingInputs, p: SwingParameters) -> SwingState:
    """Time derivative of the state, field by field."""
    port_a, port_b = _ports(x, u, p)
    nodes = _motor((*drive.pressures(x), u.tank_pressure), u.swing_speed, p)
    line = (p.line_inertance, p.line_turbulent_resistance, p.valve_transition_flow)
    c = p.line_capacitance
    return SwingState(
        swing_pressure_a=chamber.pressure_rate(x.swing_pressure_a, x.swing_flow_a - nodes.flow_1, c),
        swing_pressure_b=chamber.pressure_rate(x.swing_pressure_b, x.swing_flow_b - nodes.flow_2, c),
        swing_flow_a=hose.flow_rate(port_a.pressure, x.swing_pressure_a, x.swing_flow_a, *line),
        swing_flow_b=hose.flow_rate(port_b.pressure, x.swing_pressure_b, x.swing_flow_b, *line),
    )


def observe(x: SwingState, u: SwingInputs, p: SwingParameters) -> SwingOutputs:
    """Outputs."""
    line_rates, flows = drive.pressures(dynamics(x, u, p)), (x.swing_flow_a, x.swing_flow_b)
    nodes = _motor((*drive.pressures(x), u.tank_pressure), u.swing_speed, p)
    rates = _motor((*line_rates, u.tank_pressure_rate), u.swing_acceleration, p)
    node_rates = (rates.pressure_1, rates.pressure_2)
    outputs = drive.observe(p, u, x, line_rates, flows, _ports(x, u, p), nodes, node_rates)
    compression = sum(chamber.stored_energy(q, p.line_capacitance) for q in drive.pressures(x))
    outputs["stored_energy"] = compression + p.line_inertance * (x.swing_flow_a**2 + x.swing_flow_b**2) / 2
    outputs["dissipated_power"] += sum(q**2 * p.line_resistance for q in (nodes.flow_1, nodes.flow_2)) + sum(
        q * spool_valve.turbulent_drop(q, p.line_turbulent_resistance, p.valve_transition_flow) for q in flows
    )
    return SwingOutputs(**outputs)


def initial(x: SwingState, u: SwingInputs, p: SwingParameters) -> dict[str, Scalar]:
    """Initial state: both lines at the preload, oil at rest, no torque."""
    return drive.initial_pressures(x, u, p) | {"swing_flow_a": 0, "swing_flow_b": 0}


SWING = at_temperature(
    drive.variant(
        text="Hydraulic swing drive: spool valve, lines, motor and gear",
        parameters=SwingParameters,
        states=SwingState,
        outputs=SwingOutputs,
        dynamics=dynamics,
        observe=observe,
        initial=initial,
        require=drive.require,
        derive=drive.derive,
        validity="lines laminar and short against the wavelength, below 200 Hz; spool faster than the motion",
    )
)
