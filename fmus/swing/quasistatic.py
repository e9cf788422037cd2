"""Swing drive without line dynamics: a spool valve directly at a hydraulic motor with gear.

    C dP_a/dt = Q_a - D w - (P_a - P_b) / R_in - (P_a - P_t) / R_ex
    C dP_b/dt = Q_b + D w + (P_a - P_b) / R_in - (P_b - P_t) / R_ex
    torque    = D (P_a - P_b)           D = D_m N                   eqs. (8), (11), (12)

with the line flows Q_a, Q_b from the pressures (`spool_valve.ports_from_pressure`). This is the limit of the
lumped drive for lines without inertance and without laminar resistance, whose drop is 8 kPa at 74 L/min. The
pressures are those of the motor ports. The torque depends only on states.
"""

from fmus.components import chamber, motor, spool_valve
from fmus.components.motor import MotorNodes
from fmus.components.oil import at_temperature
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import EdgeFlows, Valve
from fmus.contract import Scalar
from fmus.swing import drive
from fmus.swing.variables import LinePressures, QuasistaticSwingParameters, SwingInputs, SwingOutputs


def _ports(
    x: LinePressures, u: SwingInputs, p: QuasistaticSwingParameters
) -> tuple[tuple[EdgeFlows, EdgeFlows], MotorNodes]:
    """Ports of the valve, and nodes of the motor."""
    lines, valve = (x.swing_pressure_a, x.swing_pressure_b), Valve.of(p, "valve")
    pressures = (*lines, u.supply_pressure, u.tank_pressure)
    ports = spool_valve.ports_from_pressure(
        valve,
        u.swing_command,
        *pressures,
        p.density,
        p.line_turbulent_resistance,
        OpeningCurves.of(p, "valve"),
    )
    displaced = drive.displacement(p) * u.swing_speed
    return ports, motor.nodes_at_port_pressures(*lines, u.tank_pressure, displaced, *drive.leakage(p))


def dynamics(x: LinePressures, u: SwingInputs, p: QuasistaticSwingParameters) -> LinePressures:
    """Time derivative of the state, field by field."""
    (a, b), nodes = _ports(x, u, p)
    c = p.line_capacitance
    return LinePressures(
        swing_pressure_a=chamber.pressure_rate(x.swing_pressure_a, a.line - nodes.flow_1, c),
        swing_pressure_b=chamber.pressure_rate(x.swing_pressure_b, b.line - nodes.flow_2, c),
    )


def observe(x: LinePressures, u: SwingInputs, p: QuasistaticSwingParameters) -> SwingOutputs:
    """Outputs."""
    valve, nodes = _ports(x, u, p)
    dx, pressures = dynamics(x, u, p), (x.swing_pressure_a, x.swing_pressure_b)
    flows = (valve[0].line, valve[1].line)
    rates = (dx.swing_pressure_a, dx.swing_pressure_b)
    load = drive.load_pressure(p, u, pressures, rates)
    outputs = drive.observe(p, u, pressures, flows, valve, nodes, rates, load)
    energy = sum(chamber.stored_energy(pressure, p.line_capacitance) for pressure in pressures)
    return SwingOutputs(**outputs, stored_energy=energy)


def initial(x: LinePressures, u: SwingInputs, p: QuasistaticSwingParameters) -> dict[str, Scalar]:
    """Initial state: both lines at the preload, no torque."""
    return drive.initial_pressures(u, p)


SWING = at_temperature(
    drive.variant(
        text="Hydraulic swing drive without line dynamics: spool valve, motor and gear",
        parameters=QuasistaticSwingParameters,
        states=LinePressures,
        outputs=SwingOutputs,
        dynamics=dynamics,
        observe=observe,
        initial=initial,
        require=drive.require,
        derive=drive.derive_capacitance,
        validity="motions slow compared with the oil in the lines, below 10 Hz; spool faster than the motion",
        stiff=False,
    )
)
