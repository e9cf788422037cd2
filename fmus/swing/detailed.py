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

from dataclasses import dataclass
from functools import partial
from typing import Any

from fmus.components import chamber, hose, motor, spool_valve
from fmus.components.chamber import Fluid
from fmus.components.detailed_drive import DetailedState, ValveAndLines
from fmus.components.hose import HydraulicLine
from fmus.components.motor import MotorNodes
from fmus.components.oil import at_temperature
from fmus.components.spool_valve import SpoolState
from fmus.contract import Quantity, Scalar, Subsystem, family, make_group, quantities
from fmus.parameters import group_of
from fmus.swing import compensated, drive, lumped
from fmus.swing.drive import MotorValves, Pair
from fmus.swing.variables import SIDES, DetailedSwingOutputs, DetailedSwingParameters, SwingInputs, SwingState


def line(p: DetailedSwingParameters) -> HydraulicLine:
    """Parameters of each of the two lines."""
    wall = p.hose_wall_modulus
    return HydraulicLine(p.line_length, p.line_bore, p.line_turbulent_resistance, wall, Fluid.of(p))


@dataclass(frozen=True)
class _Evaluated:
    """The drive at one instant: valve with its lines, ports of the motor, valves at the motor."""

    valve: ValveAndLines
    nodes: MotorNodes
    valves: MotorValves


def _evaluate(names: DetailedState, x: Any, u: SwingInputs, p: DetailedSwingParameters) -> _Evaluated:
    state = names.apply(partial(getattr, x))
    displaced = drive.displacement(p) * u.swing_speed
    return _Evaluated(
        ValveAndLines.of(p, u, line(p), state),
        motor.nodes_at_port_pressures(*state.pressures, u.tank_pressure, displaced, *drive.leakage(p)),
        drive.motor_valves(p, u, x),
    )


def _pressure_rates(n: _Evaluated, p: DetailedSwingParameters) -> Pair:
    line_a, line_b = n.valve.x.lines
    nets = (
        line_a.flows[-1] - n.nodes.flow_1 - n.valves.cross + n.valves.anti[0],
        line_b.flows[-1] - n.nodes.flow_2 + n.valves.cross + n.valves.anti[1],
    )
    a, b = (
        chamber.pressure_rate(pressure, net, p.motor_volume * chamber.compliance(Fluid.of(p), pressure))
        for pressure, net in zip(n.valve.x.pressures, nets, strict=True)
    )
    return a, b


def _dynamics(
    names: DetailedState, group: type[Any], x: Any, u: SwingInputs, p: DetailedSwingParameters
) -> Any:
    """Time derivative of the state."""
    n = _evaluate(names, x, u, p)
    rates = n.valve.rates(u.swing_command, _pressure_rates(n, p))
    return group(**dict(zip(names.all(), rates.all(), strict=True)))


def _observe(names: DetailedState, x: Any, u: SwingInputs, p: DetailedSwingParameters) -> Any:
    """Outputs; the torque depends only on states."""
    n = _evaluate(names, x, u, p)
    swing_line, ports, lines, pressures = n.valve.line, n.valve.ports, n.valve.x.lines, n.valve.x.pressures
    rates, flows = _pressure_rates(n, p), (lines[0].flows[0], lines[1].flows[0])
    outputs = drive.observe(p, u, x, rates, flows, ports, n.nodes, load=n.valve.load_pressure(rates, u))
    for side, state, port, pressure in zip(SIDES, lines, ports, pressures, strict=True):
        outputs |= {
            f"swing_valve_pressure_{side}": port.pressure,
            f"swing_motor_flow_{side}": state.flows[-1],
            f"swing_bulk_modulus_{side}": chamber.bulk_modulus(swing_line.fluid, pressure),
        }
    chambers = sum(
        p.motor_volume * chamber.energy_density(swing_line.fluid, q) + chamber.stored_energy(q, 0.0)
        for q in pressures
    )
    outputs["return_flow"] -= sum(n.valves.anti)
    outputs["swing_void_volume"] += sum(map(hose.cavity_volume, lines))
    outputs["dissipated_power"] += n.valves.heat + sum(hose.heat(swing_line, state) for state in lines)
    return DetailedSwingOutputs(
        **outputs,
        stored_energy=chambers + sum(hose.stored_energy(swing_line, state) for state in lines),
        swing_spool_position=n.valve.x.spool.position,
        swing_relief_flow=n.valves.cross,
        swing_anti_cavitation_flow=sum(n.valves.anti),
    )


def _initial(names: DetailedState, x: Any, u: SwingInputs, p: DetailedSwingParameters) -> dict[str, Scalar]:
    """Initial state: both lines at the preload, oil at rest, no torque, spool at its command."""
    position = spool_valve.commanded_position(u.swing_command, p.valve_full_command)
    a, b = (u.tank_pressure + p.initial_preload for _ in SIDES)
    return names.start(position, (a, b))


def _names(lumps: int, unsteady_friction: bool) -> DetailedState:
    """Names of the states."""
    a, b = (
        hose.state_names(
            *(f"swing_flow_{side}", f"swing_motor_flow_{side}", "swing_line", f"_{side}"),
            *(lumps, unsteady_friction),
        )
        for side in SIDES
    )
    spool = SpoolState("swing_spool_position", "swing_spool_speed")
    return DetailedState(spool, (a, b), ("swing_pressure_a", "swing_pressure_b"))


def _state(names: DetailedState) -> type[Any]:
    """The group of the states."""
    declared = quantities(SwingState)
    lines = []
    for side in SIDES:
        text = f"swing line {side.upper()}"
        last = Quantity("m3/s", f"Flow from {text} to the motor", 1e-3)
        lines.append((text, declared[f"swing_flow_{side}"], last))
    return make_group("DetailedSwingState", dict(names.declarations("swing", lines, declared)))


def default_lumps() -> int:
    """Lumps per line for the values of parameters.toml."""
    return hose.default_lumps(line(group_of(drive.PARAMETERS, DetailedSwingParameters)))


def detailed(lumps: int | None = None, unsteady_friction: bool = False) -> Subsystem:
    """The subsystem of the detailed drive.

    lumps               T-lumps per line; default: from `hose.lumps_needed` for 75 Hz
    unsteady_friction   whether lines have frequency-dependent friction: three more states for each flow
    """
    count = default_lumps() if lumps is None else lumps
    names = _names(count, unsteady_friction)
    state = _state(names)
    sub = drive.variant(
        text="Detailed hydraulic swing drive: spool dynamics, lines, motor and gear, air, relief valves",
        parameters=DetailedSwingParameters,
        states=state,
        outputs=DetailedSwingOutputs,
        dynamics=partial(_dynamics, names, state),
        observe=partial(_observe, names),
        initial=partial(_initial, names),
        require=drive.require,
        validity="modes of the lines up to 75 Hz within 5 %; no flow forces on the spool, one temperature",
    )
    others = {"lumped": lumped.SWING, "compensated": compensated.SWING}
    return family("swing", **others, detailed=at_temperature(sub))["detailed"]


SWING = detailed()
