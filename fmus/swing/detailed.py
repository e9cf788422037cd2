"""Swing drive in detail: a moving spool, two lines of lumps, oil with air, relief and anti-cavitation valves.

    C_a dP_a/dt = Q_a - D w - (P_a - P_b)/R_in - (P_a - P_t)/R_ex - Q_cross + Q_anti,a
    C_b dP_b/dt = Q_b + D w + (P_a - P_b)/R_in - (P_b - P_t)/R_ex + Q_cross + Q_anti,b      C = V_m kappa(P)
    torque      = D (P_a - P_b)           D = D_m N                                   eqs. (8), (11), (12)

with the flows Q_a, Q_b out of the lines of `fmus.components.hose_line`, kappa of `oil`, the spool of
`spool_dynamics` and the valves of `relief` at the motor: relief valves from line to line, anti-cavitation
valves from the return line. The motor's volume V_m holds what `lumped` puts into the line's capacitance, so
its ports are states and the torque depends on states only. `swing_flow_a` is the flow at the valve,
`swing_motor_flow_a` that at the motor. `detailed` chooses what changes the number of states.

Signs: flows are positive towards the motor; angle, speed and torque are positive counter-clockwise
seen from above; a positive command drives the positive way.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from fmus.components import chamber, hose_line, motor, oil, orifice, spool_dynamics, spool_valve
from fmus.components.detailed_parameters import BANDWIDTH, ERROR, fluid
from fmus.components.hose_line import Line, LineState, lumps_needed
from fmus.components.motor import MotorNodes
from fmus.components.spool_dynamics import SpoolState
from fmus.components.spool_valve import PortFlow
from fmus.contract import Scalar, Subsystem, family
from fmus.parameters import read
from fmus.swing import lumped
from fmus.swing.detailed_variables import SIDES, DetailedOutputs, DetailedParameters, line_names, states
from fmus.swing.drive import TERMINALS
from fmus.swing.variables import SwingInputs

NUMBERS = Path(__file__).with_name("parameters.toml")

Names = tuple[LineState, LineState]


def hose(p: DetailedParameters) -> Line:
    """Each of the two lines."""
    oils = fluid(p, p.density, p.bulk_modulus)
    return Line(p.line_length, p.line_bore, p.line_turbulent_resistance, p.hose_wall_modulus, oils)


@dataclass(frozen=True)
class _Now:
    """The drive at one instant: state, and what follows from it at once."""

    spool: SpoolState
    lines: tuple[LineState, LineState]
    pressures: tuple[Scalar, Scalar]
    ports: tuple[PortFlow, PortFlow]
    nodes: MotorNodes
    cross: Scalar
    anti: tuple[Scalar, Scalar]


def _now(names: Names, x: Any, u: SwingInputs, p: DetailedParameters) -> _Now:
    a, b = (n.each(lambda name: getattr(x, name)) for n in names)
    spool, tank = SpoolState(x.swing_spool_position, x.swing_spool_speed), u.tank_pressure
    pressures = (x.swing_pressure_a, x.swing_pressure_b)
    displaced = p.motor_displacement * p.gear_ratio * u.swing_speed
    line_ends = (a.flows[0], b.flows[0], u.supply_pressure, tank, p.density)
    drawn_a, drawn_b = (orifice.relief_flow(p.anti_cavitation, tank - pressure) for pressure in pressures)
    return _Now(
        spool,
        (a, b),
        pressures,
        spool_dynamics.ports(p.edges, spool.position, *line_ends),
        motor.at_ports(*pressures, tank, displaced, *_leakage(p)),
        orifice.cross_flow(p.relief, pressures[0] - pressures[1]),
        (drawn_a, drawn_b),
    )


def _leakage(p: DetailedParameters) -> tuple[Scalar, Scalar]:
    return p.internal_leakage_resistance, p.external_leakage_resistance


def _pressure_rates(n: _Now, p: DetailedParameters) -> tuple[Scalar, Scalar]:
    of = hose(p).fluid
    nets = (
        n.lines[0].flows[-1] - n.nodes.flow_1 - n.cross + n.anti[0],
        n.lines[1].flows[-1] - n.nodes.flow_2 + n.cross + n.anti[1],
    )
    a, b = (
        oil.pressure_rate(pressure, net, p.motor_volume * oil.compliance(of, pressure))
        for pressure, net in zip(n.pressures, nets, strict=True)
    )
    return a, b


def _rates(names: Names, x: Any, u: SwingInputs, p: DetailedParameters) -> dict[str, Scalar]:
    n = _now(names, x, u, p)
    spool = spool_dynamics.rates(
        p.spool, n.spool, spool_dynamics.share(u.swing_command, p.valve_full_command)
    )
    rates = {"swing_spool_position": spool.position, "swing_spool_speed": spool.speed}
    motor_side = zip(SIDES, names, n.lines, n.ports, n.pressures, _pressure_rates(n, p), strict=True)
    for side, name, of, port, pressure, rate in motor_side:
        along = hose_line.rates(hose(p), of, port.pressure, pressure)
        rates |= {f"swing_pressure_{side}": rate, **dict(zip(name.all(), along.all(), strict=True))}
    return rates


def _stored_energy(n: _Now, p: DetailedParameters) -> Scalar:
    of = hose(p)
    sides = sum(p.motor_volume * oil.energy_density(of.fluid, q) + oil.void_energy(q) for q in n.pressures)
    return sides + sum(hose_line.stored_energy(of, one) for one in n.lines)


def _dissipated_power(n: _Now, u: SwingInputs, p: DetailedParameters) -> Scalar:
    tank, (p_a, p_b) = u.tank_pressure, n.pressures
    edges = sum(spool_valve.throttling_loss(node, u.supply_pressure, tank) for node in n.ports)
    valves = n.cross * (p_a - p_b) + sum(q * (tank - at) for q, at in zip(n.anti, n.pressures, strict=True))
    friction = sum(hose_line.heat(hose(p), one) for one in n.lines)
    return edges + valves + friction + motor.leakage_loss(n.nodes, tank, *_leakage(p))


def _observe(names: Names, x: Any, u: SwingInputs, p: DetailedParameters) -> DetailedOutputs:
    """Outputs; the torque depends on states alone."""
    n, displacement = _now(names, x, u, p), p.motor_displacement * p.gear_ratio
    rate_a, rate_b = _pressure_rates(n, p)
    shown: dict[str, Scalar] = {}
    for side, of, port, pressure in zip(SIDES, n.lines, n.ports, n.pressures, strict=True):
        shown |= {
            f"swing_pressure_{side}": pressure,
            f"swing_motor_pressure_{side}": pressure,
            f"swing_valve_pressure_{side}": port.pressure,
            f"swing_flow_{side}": of.flows[0],
            f"swing_motor_flow_{side}": of.flows[-1],
            f"swing_bulk_modulus_{side}": oil.bulk_modulus(hose(p).fluid, pressure),
        }
    voids = sum(map(chamber.void_volume, n.pressures)) + sum(map(hose_line.void_volume, n.lines))
    return DetailedOutputs(
        **shown,
        swing_torque=displacement * (n.pressures[0] - n.pressures[1]),
        swing_torque_rate=displacement * (rate_a - rate_b),
        supply_flow=n.ports[0].supply + n.ports[1].supply,
        return_flow=n.ports[0].tank + n.ports[1].tank + n.nodes.drain - sum(n.anti),
        swing_drain_flow=n.nodes.drain,
        swing_void_volume=voids,
        stored_energy=_stored_energy(n, p),
        dissipated_power=_dissipated_power(n, u, p),
        swing_spool_position=n.spool.position,
        swing_relief_flow=n.cross,
        swing_anti_cavitation_flow=sum(n.anti),
    )


def _initial(names: Names, x: Any, u: SwingInputs, p: DetailedParameters) -> dict[str, Scalar]:
    """Both lines at the preload, the oil at rest: no torque; the spool where it is told."""
    position = spool_dynamics.share(u.swing_command, p.valve_full_command)
    state: dict[str, Scalar] = {"swing_spool_position": position, "swing_spool_speed": 0.0}
    for side, of in zip(SIDES, names, strict=True):
        state |= dict.fromkeys(of.all(), 0.0)
        pressures = (f"swing_pressure_{side}", *of.pressures)
        state |= dict.fromkeys(pressures, u.tank_pressure + p.initial_preload)
    return state


def advised_lumps() -> int:
    """Lumps per line that `BANDWIDTH` and `ERROR` need with the numbers of parameters.toml."""
    found = read(NUMBERS)["parameters"]
    h = hose(DetailedParameters(**{f.name: found[f.name].value for f in fields(DetailedParameters)}))
    return lumps_needed(h.length, h.bore, BANDWIDTH, ERROR, h.fluid, h.wall_modulus)


def detailed(lumps: int | None = None, unsteady_friction: bool = False) -> Subsystem:
    """The detailed drive.

    lumps               T-lumps per line; by default what `lumps_needed` advises up to 75 Hz
    unsteady_friction   with the frequency-dependent friction of the lines: three more states for each flow
    """
    names = line_names(advised_lumps() if lumps is None else lumps, unsteady_friction)
    state = states(names)
    sub = Subsystem(
        name="swing",
        text="Hydraulic swing drive in detail: moving spool, lines, motor and gear, air, relief valves",
        parameters=DetailedParameters,
        states=state,
        inputs=SwingInputs,
        outputs=DetailedOutputs,
        dynamics=lambda x, u, p: state(**_rates(names, x, u, p)),
        observe=lambda x, u, p: _observe(names, x, u, p),
        initial=lambda x, u, p: _initial(names, x, u, p),
        values=NUMBERS,
        validity="modes of the lines up to 75 Hz within 5 %; no flow forces on the spool, one temperature",
        terminals=TERMINALS,
    )
    return family("swing", lumped=lumped.SWING, detailed=sub)["detailed"]


SWING = detailed()
