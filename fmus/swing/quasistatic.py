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
from fmus.swing import drive
from fmus.swing.variables import LinePressures, QuasistaticSwingParameters, SwingInputs, SwingOutputs


def _ports(
    x: LinePressures, u: SwingInputs, p: QuasistaticSwingParameters
) -> tuple[tuple[EdgeFlows, EdgeFlows], MotorNodes]:
    """Ports of the valve, and nodes of the motor."""
    lines = drive.pressures(x)
    ports = spool_valve.ports_from_pressure(
        *(Valve.of(p, "valve"), u.swing_command, *lines, u.supply_pressure, u.tank_pressure),
        *(p.density, p.line_turbulent_resistance, OpeningCurves.of(p, "valve")),
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
    rates, flows = drive.pressures(dynamics(x, u, p)), (valve[0].line, valve[1].line)
    outputs = drive.observe(p, u, x, rates, flows, valve, nodes)
    energy = sum(chamber.stored_energy(q, p.line_capacitance) for q in drive.pressures(x))
    return SwingOutputs(**outputs, stored_energy=energy)


SWING = at_temperature(
    drive.variant(
        text="Hydraulic swing drive without line dynamics: spool valve, motor and gear",
        parameters=QuasistaticSwingParameters,
        states=LinePressures,
        outputs=SwingOutputs,
        dynamics=dynamics,
        observe=observe,
        initial=drive.initial_pressures,
        require=drive.require,
        derive=drive.derive_capacitance,
        validity="motions slow compared with the oil in the lines, below 10 Hz; spool faster than the motion",
        stiff=False,
    )
)
