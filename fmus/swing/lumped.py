"""Swing drive at the paper's fidelity: a spool valve, two short lines and a hydraulic motor with gear.

    I dQ_a/dt = P_port,a - P_a - C_R,line Q_a|Q_a|      I dQ_b/dt = P_port,b - P_b - C_R,line Q_b|Q_b|
    C dP_a/dt = Q_a - (P_a - P_1) / R_line              C dP_b/dt = Q_b - (P_b - P_2) / R_line
    torque    = D_m N (P_1 - P_2)                       eqs. (8), (9a), corrections E1, E2, E5

with the motor ports P_1, P_2 from `fmus.components.motor`. Swing lines are short, so their friction is
laminar (R_line), and C_R,line is zero unless it is identified from measurements.

The torque depends on the speed with 2 D^2 R_line (28 N.m.s/rad), which is required for conservation of power.
"""

from fmus.components import circuit, motor, spool_valve
from fmus.components.circuit import Circuit, Node
from fmus.components.hose import column
from fmus.components.load_sensing import sensed
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import Valve
from fmus.contract import Scalar
from fmus.swing import drive
from fmus.swing.drive import LINES, Drive
from fmus.swing.variables import SwingInputs, SwingOutputs, SwingParameters, SwingState

PORTS = ("swing_valve_pressure_a", "swing_valve_pressure_b")
MOTOR = ("swing_motor_pressure_a", "swing_motor_pressure_b")


def _drive(x: SwingState, u: SwingInputs, p: SwingParameters) -> Drive:
    valve, curves = Valve.of(p, "valve"), OpeningCurves.of(p, "valve")
    a, b = spool_valve.ports_from_flow(
        *(valve, u.swing_command, x.swing_flow_a, x.swing_flow_b),
        *(u.supply_pressure, u.tank_pressure, p.density, curves),
    )
    line = (p.line_inertance, p.line_turbulent_resistance, p.valve_transition_flow)
    nodes = {
        **circuit.lines(u),
        "swing_valve_pressure_a": Node(a.pressure),
        "swing_valve_pressure_b": Node(b.pressure),
        "swing_pressure_a": Node(x.swing_pressure_a, "C_1", p.line_capacitance),
        "swing_pressure_b": Node(x.swing_pressure_b, "C_2", p.line_capacitance),
    }
    branches = {
        **spool_valve.branches((a, b), *PORTS),
        "swing_flow_a": column("swing_valve_pressure_a", "swing_pressure_a", x.swing_flow_a, "I_1", *line),
        "swing_flow_b": column("swing_valve_pressure_b", "swing_pressure_b", x.swing_flow_b, "I_2", *line),
    }
    displaced, *leakage = drive.motor(u, p)
    at_motor = motor.behind_lines(nodes, LINES, MOTOR, p.line_resistance, displaced, *leakage)
    whole = Circuit(nodes, branches) | at_motor
    # the motor's ports are linear in the pressures, so the rates of the pressures give their rates
    rates = motor.port_pressures(
        *(whole.rates["swing_pressure_a"], whole.rates["swing_pressure_b"], u.tank_pressure_rate),
        *(p.line_resistance, drive.displacement(p) * u.swing_acceleration, *leakage),
    )
    pressures = (whole.pressures["swing_motor_pressure_a"], whole.pressures["swing_motor_pressure_b"])
    return Drive(whole, sensed(p, u.swing_command, u.swing_command_rate), ports=(pressures, rates))


def initial(x: SwingState, u: SwingInputs, p: SwingParameters) -> dict[str, Scalar]:
    """Initial state: both lines at the preload, oil at rest, no torque."""
    return drive.initial_pressures(x, u, p) | {"swing_flow_a": 0, "swing_flow_b": 0}


SWING = drive.variant(
    _drive,
    SwingState,
    SwingOutputs,
    text="Hydraulic swing drive: spool valve, lines, motor and gear",
    parameters=SwingParameters,
    initial=initial,
    derive=drive.derive,
    validity="lines laminar and short against the wavelength, below 200 Hz; spool faster than the motion",
)
