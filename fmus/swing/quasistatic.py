"""Swing drive without line dynamics: a spool valve directly at a hydraulic motor with gear.

    C dP_a/dt = Q_a - D w - (P_a - P_b) / R_in - (P_a - P_t) / R_ex
    C dP_b/dt = Q_b + D w + (P_a - P_b) / R_in - (P_b - P_t) / R_ex
    torque    = D (P_a - P_b)           D = D_m N                   eqs. (8), (11), (12)

with the line flows Q_a, Q_b from the pressures (`spool_valve.ports_from_pressure`). This is the limit of the
lumped drive for lines without inertance and without laminar resistance, whose drop is 8 kPa at 74 L/min. The
pressures are those of the motor ports. The torque depends only on states.
"""

from fmus.components import circuit, motor, spool_valve
from fmus.components.circuit import Circuit, Node
from fmus.components.load_sensing import sensed
from fmus.components.opening_curve import OpeningCurves
from fmus.components.spool_valve import Valve
from fmus.swing import drive
from fmus.swing.drive import LINES, Drive
from fmus.swing.variables import LinePressures, QuasistaticSwingParameters, SwingInputs, SwingOutputs


def _drive(x: LinePressures, u: SwingInputs, p: QuasistaticSwingParameters) -> Drive:
    ports = spool_valve.ports_from_pressure(
        *(Valve.of(p, "valve"), u.swing_command, x.swing_pressure_a, x.swing_pressure_b),
        *(u.supply_pressure, u.tank_pressure, p.density),
        *(p.line_turbulent_resistance, OpeningCurves.of(p, "valve")),
    )
    whole = Circuit(
        {
            **circuit.lines(u),
            "swing_pressure_a": Node(x.swing_pressure_a, "C_1", p.line_capacitance),
            "swing_pressure_b": Node(x.swing_pressure_b, "C_2", p.line_capacitance),
        },
        {**spool_valve.branches(ports, *LINES), **motor.branches(LINES, *drive.motor(u, p))},
    )
    flows = {"swing_flow_a": ports[0].line, "swing_flow_b": ports[1].line}
    return Drive(whole, sensed(p, u.swing_command, u.swing_command_rate), shown=flows)


SWING = drive.variant(
    _drive,
    LinePressures,
    SwingOutputs,
    text="Hydraulic swing drive without line dynamics: spool valve, motor and gear",
    parameters=QuasistaticSwingParameters,
    initial=drive.initial_pressures,
    derive=drive.derive_capacitance,
    validity="motions slow compared with the oil in the lines, below 10 Hz; spool faster than the motion",
    stiff=False,
)
