"""Detailed swing drive: spool dynamics, lines of lumps, oil with air, relief and anti-cavitation valves.

    C_a dP_a/dt = Q_a - D w - (P_a - P_b)/R_in - (P_a - P_t)/R_ex - Q_cross + Q_anti,a
    C_b dP_b/dt = Q_b + D w + (P_a - P_b)/R_in - (P_b - P_t)/R_ex + Q_cross + Q_anti,b      C = V_m kappa(P)
    torque      = D (P_a - P_b)           D = D_m N                                   eqs. (8), (11), (12)

with the flows Q_a, Q_b out of the lines of `fmus.components.hose`, kappa of `chamber`, the spool of
`spool_valve` and the valves of `orifice` at the motor: cross-port relief valves, and anti-cavitation valves
from the return line. The volume V_m of a motor side is separate here, while `lumped` adds it to the
capacitance of the line. So the pressures of the motor ports are states, and the torque depends only on
states. `swing_flow_a` is the flow at the valve, `swing_motor_flow_a` that at the motor. The arguments of
`detailed` change the number of states.
"""

from functools import partial
from typing import Any

from fmus.components import circuit, hose, motor, spool_valve
from fmus.components.chamber import Fluid
from fmus.components.circuit import Circuit, Node
from fmus.components.detailed_drive import DetailedStates
from fmus.components.hose import HydraulicLine
from fmus.components.spool_valve import SpoolState
from fmus.contract import Scalar, Subsystem, family, make_group, quantities
from fmus.parameters import group_of
from fmus.swing import compensated, drive, lumped
from fmus.swing.drive import LINES, Drive
from fmus.swing.variables import SIDES, DetailedSwingOutputs, DetailedSwingParameters, SwingInputs


def line(p: DetailedSwingParameters) -> HydraulicLine:
    """Parameters of each of the two lines."""
    wall = p.hose_wall_modulus
    return HydraulicLine(p.line_length, p.line_bore, p.line_turbulent_resistance, wall, Fluid.of(p))


def _drive(states: DetailedStates, x: Any, u: SwingInputs, p: DetailedSwingParameters) -> Drive:
    oil = Fluid.of(p)
    valve, load, spool_rates = states.valve_and_lines(p, u, u.swing_command, line(p), x)
    whole = valve | Circuit(
        {
            **circuit.lines(u),
            "swing_pressure_a": Node(x.swing_pressure_a, "C_1", 0, p.motor_volume, oil),
            "swing_pressure_b": Node(x.swing_pressure_b, "C_2", 0, p.motor_volume, oil),
        },
        {**motor.branches(LINES, *drive.motor(u, p)), **drive.reliefs(p)},
    )
    shown = {
        "swing_spool_position": x.swing_spool_position,
        "swing_bulk_modulus_a": 1 / oil.compliance(x.swing_pressure_a),
        "swing_bulk_modulus_b": 1 / oil.compliance(x.swing_pressure_b),
    }
    return Drive(whole, load, spool_rates, shown)


def _initial(states: DetailedStates, x: Any, u: SwingInputs, p: DetailedSwingParameters) -> dict[str, Scalar]:
    """Initial state: both lines at the preload, oil at rest, no torque, spool at its command."""
    position = spool_valve.commanded_position(u.swing_command, p.valve_full_command)
    a, b = (u.tank_pressure + p.initial_preload for _ in SIDES)
    return states.start(position, (a, b))


def _states(lumps: int) -> DetailedStates:
    declared = quantities(DetailedSwingOutputs)
    a, b = (
        hose.line_states(
            {name: declared[name] for name in (f"swing_flow_{side}", f"swing_motor_flow_{side}")},
            *("swing_line", f"_{side}", f"swing line {side.upper()}", lumps),
        )
        for side in SIDES
    )
    spool = SpoolState("swing_spool_position", "swing_spool_speed")
    pressures = {name: declared[name] for name in LINES}
    return DetailedStates(spool, (a, b), pressures, ("swing_valve_pressure_a", "swing_valve_pressure_b"))


def default_lumps() -> int:
    """Lumps per line for the values of parameters.toml."""
    return hose.default_lumps(line(group_of(drive.PARAMETERS, DetailedSwingParameters)))


def detailed(lumps: int | None = None) -> Subsystem:
    """The subsystem of the detailed drive.

    lumps   T-lumps per line; default: from `hose.lumps_needed` for 75 Hz
    """
    count = default_lumps() if lumps is None else lumps
    states = _states(count)
    sub = drive.variant(
        partial(_drive, states),
        make_group("DetailedSwingState", states.all("swing")),
        DetailedSwingOutputs,
        text="Detailed hydraulic swing drive: spool dynamics, lines, motor and gear, air, relief valves",
        parameters=DetailedSwingParameters,
        initial=partial(_initial, states),
        validity="modes of the lines up to 75 Hz within 5 %; no flow forces on the spool, one temperature",
    )
    others = {"lumped": lumped.SWING, "compensated": compensated.SWING}
    return family("swing", **others, detailed=sub)["detailed"]


SWING = detailed()
