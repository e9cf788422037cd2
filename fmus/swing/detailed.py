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

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fmus.components import chamber, hose, load_sensing, motor, opening_curve, orifice, spool_valve
from fmus.components.chamber import Fluid
from fmus.components.hose import HydraulicLine, LineState
from fmus.components.motor import MotorNodes
from fmus.components.oil import at_temperature
from fmus.components.opening_curve import OpeningCurves
from fmus.components.orifice import PressureValve
from fmus.components.spool_valve import EdgeFlows, Edges, Spool, SpoolState
from fmus.contract import Quantity, Scalar, Subsystem, family, make_group, quantities
from fmus.parameters import group_of
from fmus.swing import compensated, drive, lumped
from fmus.swing.drive import Pair
from fmus.swing.variables import SIDES, DetailedSwingOutputs, DetailedSwingParameters, SwingInputs, SwingState

PARAMETERS = Path(__file__).with_name("parameters.toml")

Names = tuple[LineState, LineState]  # names of the states of both lines


def line(p: DetailedSwingParameters) -> HydraulicLine:
    """Parameters of each of the two lines."""
    wall = p.hose_wall_modulus
    return HydraulicLine(p.line_length, p.line_bore, p.line_turbulent_resistance, wall, Fluid.of(p))


@dataclass(frozen=True)
class _Evaluated:
    """The drive at one instant: states, ports of valve and motor, flows [m3/s] of the valves at the motor."""

    spool: SpoolState
    lines: tuple[LineState, LineState]
    pressures: tuple[Scalar, Scalar]
    ports: tuple[EdgeFlows, EdgeFlows]
    nodes: MotorNodes
    cross: Scalar
    anti: tuple[Scalar, Scalar]


def _evaluate(names: Names, x: Any, u: SwingInputs, p: DetailedSwingParameters) -> _Evaluated:
    a, b = (n.apply(partial(getattr, x)) for n in names)
    state, tank = SpoolState(x.swing_spool_position, x.swing_spool_speed), u.tank_pressure
    pressures = (x.swing_pressure_a, x.swing_pressure_b)
    anti = PressureValve.of(p, "anti_cavitation")
    line_ends = (a.flows[0], b.flows[0], u.supply_pressure, tank, p.density)
    return _Evaluated(
        state,
        (a, b),
        pressures,
        spool_valve.spool_ports(
            *(Edges.of(p, "valve"), Spool.of(p, "spool"), state.position, *line_ends),
            curves=OpeningCurves.of(p, "valve"),
        ),
        motor.nodes_at_port_pressures(
            *pressures, tank, drive.displacement(p) * u.swing_speed, *drive.leakage(p)
        ),
        orifice.cross_flow(PressureValve.of(p, "relief"), pressures[0] - pressures[1]),
        (orifice.relief_flow(anti, tank - pressures[0]), orifice.relief_flow(anti, tank - pressures[1])),
    )


def _pressure_rates(n: _Evaluated, p: DetailedSwingParameters) -> Pair:
    nets = (
        n.lines[0].flows[-1] - n.nodes.flow_1 - n.cross + n.anti[0],
        n.lines[1].flows[-1] - n.nodes.flow_2 + n.cross + n.anti[1],
    )
    a, b = (
        chamber.pressure_rate(pressure, net, p.motor_volume * chamber.compliance(Fluid.of(p), pressure))
        for pressure, net in zip(n.pressures, nets, strict=True)
    )
    return a, b


def _rates(names: Names, x: Any, u: SwingInputs, p: DetailedSwingParameters) -> dict[str, Scalar]:
    n = _evaluate(names, x, u, p)
    commanded = spool_valve.commanded_position(u.swing_command, p.valve_full_command)
    spool = spool_valve.spool_rates(Spool.of(p, "spool"), n.spool, commanded)
    rates = {"swing_spool_position": spool.position, "swing_spool_speed": spool.speed}
    sides = zip(SIDES, names, n.lines, n.ports, n.pressures, _pressure_rates(n, p), strict=True)
    for side, line_names, state, port, pressure, rate in sides:
        line_rates = hose.rates(line(p), state, port.pressure, pressure)
        rates |= {
            f"swing_pressure_{side}": rate,
            **dict(zip(line_names.all(), line_rates.all(), strict=True)),
        }
    return rates


def _observe(names: Names, x: Any, u: SwingInputs, p: DetailedSwingParameters) -> DetailedSwingOutputs:
    """Outputs; the torque depends only on states."""
    n, swing_line, tank = _evaluate(names, x, u, p), line(p), u.tank_pressure
    (p_a, p_b), flows = n.pressures, (n.lines[0].flows[0], n.lines[1].flows[0])
    rates = _pressure_rates(n, p)
    bands = opening_curve.meter_in_dead_bands(
        OpeningCurves.of(p, "valve"), p.spool_overlap_pa, p.spool_overlap_pb, p.valve_full_command
    )
    load = load_sensing.load_pressure(
        *(n.spool.position, n.spool.speed, bands, 1),
        *(n.pressures, rates, u),
    )
    outputs = drive.observe(p, u, n.pressures, flows, n.ports, n.nodes, rates, load)
    for side, state, port, pressure in zip(SIDES, n.lines, n.ports, n.pressures, strict=True):
        outputs |= {
            f"swing_valve_pressure_{side}": port.pressure,
            f"swing_motor_flow_{side}": state.flows[-1],
            f"swing_bulk_modulus_{side}": chamber.bulk_modulus(swing_line.fluid, pressure),
        }
    chambers = sum(
        p.motor_volume * chamber.energy_density(swing_line.fluid, q) + chamber.stored_energy(q, 0.0)
        for q in n.pressures
    )
    valves = n.cross * (p_a - p_b) + sum(
        q * (tank - pressure) for q, pressure in zip(n.anti, n.pressures, strict=True)
    )
    outputs["return_flow"] -= sum(n.anti)
    outputs["swing_void_volume"] += sum(map(hose.cavity_volume, n.lines))
    outputs["dissipated_power"] += valves + sum(hose.heat(swing_line, state) for state in n.lines)
    return DetailedSwingOutputs(
        **outputs,
        stored_energy=chambers + sum(hose.stored_energy(swing_line, state) for state in n.lines),
        swing_spool_position=n.spool.position,
        swing_relief_flow=n.cross,
        swing_anti_cavitation_flow=sum(n.anti),
    )


def _initial(names: Names, x: Any, u: SwingInputs, p: DetailedSwingParameters) -> dict[str, Scalar]:
    """Initial state: both lines at the preload, oil at rest, no torque, spool at its command."""
    position = spool_valve.commanded_position(u.swing_command, p.valve_full_command)
    state: dict[str, Scalar] = {"swing_spool_position": position, "swing_spool_speed": 0.0}
    for side, line_names in zip(SIDES, names, strict=True):
        state |= dict.fromkeys(line_names.all(), 0.0)
        pressures = (f"swing_pressure_{side}", *line_names.pressures)
        state |= dict.fromkeys(pressures, u.tank_pressure + p.initial_preload)
    return state


def _states(names: Names) -> Iterator[tuple[str, Quantity]]:
    """(name, declaration) of the states."""
    lumped_states = quantities(SwingState)
    yield "swing_spool_position", Quantity("1", "Spool position of the swing valve, relative to its stroke")
    yield "swing_spool_speed", Quantity("1/s", "Spool speed of the swing valve", 10.0)
    for side, line_names in zip(SIDES, names, strict=True):
        line_text = f"swing line {side.upper()}"
        first = lumped_states[f"swing_flow_{side}"]
        last = Quantity("m3/s", f"Flow from {line_text} to the motor", 1e-3)
        yield f"swing_pressure_{side}", lumped_states[f"swing_pressure_{side}"]
        yield from hose.state_quantities(line_names, line_text, first, last)


def default_lumps() -> int:
    """Lumps per line for the values of parameters.toml."""
    return hose.default_lumps(line(group_of(PARAMETERS, DetailedSwingParameters)))


def detailed(lumps: int | None = None, unsteady_friction: bool = False) -> Subsystem:
    """The subsystem of the detailed drive.

    lumps               T-lumps per line; default: from `hose.lumps_needed` for 75 Hz
    unsteady_friction   whether lines have frequency-dependent friction: three more states for each flow
    """
    count = default_lumps() if lumps is None else lumps
    a, b = (
        hose.state_names(
            *(f"swing_flow_{side}", f"swing_motor_flow_{side}", "swing_line", f"_{side}"),
            *(count, unsteady_friction),
        )
        for side in SIDES
    )
    names = (a, b)
    state = make_group("DetailedSwingState", dict(_states(names)))
    sub = drive.variant(
        text="Detailed hydraulic swing drive: spool dynamics, lines, motor and gear, air, relief valves",
        parameters=DetailedSwingParameters,
        states=state,
        outputs=DetailedSwingOutputs,
        dynamics=lambda x, u, p: state(**_rates(names, x, u, p)),
        observe=lambda x, u, p: _observe(names, x, u, p),
        initial=lambda x, u, p: _initial(names, x, u, p),
        require=drive.require_tables,
        validity="modes of the lines up to 75 Hz within 5 %; no flow forces on the spool, one temperature",
    )
    others = {"lumped": lumped.SWING, "compensated": compensated.SWING}
    return family("swing", **others, detailed=at_temperature(sub))["detailed"]


SWING = detailed()
