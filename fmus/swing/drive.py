"""Common equations of all variants of the swing drive: motor and gear, outputs, requirements, terminals.

torque = D (P_1 - P_2)           D = D_m N                                   eqs. (8), (11), (12)
"""

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fmus import ports
from fmus.components import chamber, hose, load_sensing, motor, opening_curve, orifice, spool_valve
from fmus.components.load_sensing import LoadPressure
from fmus.components.motor import MotorNodes
from fmus.components.opening_curve import OpeningCurves
from fmus.components.orifice import PressureValve
from fmus.components.spool_valve import EdgeFlows
from fmus.contract import Scalar, Subsystem, Terminal, quantities
from fmus.swing.variables import LinePressures, SwingInputs

PARAMETERS = Path(__file__).with_name("parameters.toml")
Pair = tuple[Scalar, Scalar]  # (line A, line B), or (motor port 1, motor port 2)


def displacement(p: Any) -> Scalar:
    """D [m3/rad], displacement per swing angle."""
    return p.motor_displacement * p.gear_ratio


def leakage(p: Any) -> Pair:
    """Leakage resistances R_in and R_ex [Pa.s/m3]."""
    return p.internal_leakage_resistance, p.external_leakage_resistance


@dataclass(frozen=True)
class MotorValves:
    """Flows [m3/s] of the valves at the motor: relief from line A to line B, anti-cavitation into each line.

    heat   that they dissipate [W]
    """

    cross: Scalar
    anti: Pair
    heat: Scalar


def motor_valves(p: Any, u: SwingInputs, x: Any) -> MotorValves:
    """Crossover relief valves, and make-up from the return line."""
    (a, b), tank, anti = pressures(x), u.tank_pressure, PressureValve.of(p, "anti_cavitation")
    cross = orifice.cross_flow(PressureValve.of(p, "relief"), a - b)
    into_a, into_b = orifice.relief_flow(anti, tank - a), orifice.relief_flow(anti, tank - b)
    make_up = into_a * (tank - a) + into_b * (tank - b)
    return MotorValves(cross, (into_a, into_b), cross * (a - b) + make_up)


def derive_capacitance(p: Any) -> dict[str, Scalar]:
    """Capacitance of a line with its motor side; walls are rigid in variants without a modulus for them."""
    wall = getattr(p, "hose_wall_modulus", math.inf)
    line = hose.capacitance(p.line_length, p.line_bore, p.bulk_modulus, wall)
    return {"line_capacitance": line + p.motor_volume / p.bulk_modulus}


def derive(p: Any) -> dict[str, Scalar]:
    """Parameters of the lines that are derived from length and bore."""
    size = (p.line_length, p.line_bore)
    return derive_capacitance(p) | {
        "line_inertance": hose.inertance(*size, p.density),
        "line_resistance": hose.laminar_resistance(*size, p.viscosity),
    }


def pressures(x: Any) -> Pair:
    """Pressures [Pa] of the lines in a state, or their rates [Pa/s] in its rates."""
    return x.swing_pressure_a, x.swing_pressure_b


def observe(
    p: Any,
    u: SwingInputs,
    x: Any,
    rates: Pair,
    flows: Pair,
    valve: tuple[EdgeFlows, EdgeFlows],
    nodes: MotorNodes,
    node_rates: Pair | None = None,
    load: LoadPressure | None = None,
) -> dict[str, Scalar]:
    """Outputs except `stored_energy`.

    x                   state, with the pressures of the lines
    rates, flows        rates of the pressures of the lines, and their flows
    valve, nodes        ports of valve and motor
    node_rates          rates of the motor's port pressures; default: those of the lines
    load                load pressure; default: that of a valve without dynamics

    The dissipated power is that of edges and leakage; lines are added by the variants.
    """
    node_rates, load = node_rates or rates, load or _load_pressure(p, u, x, rates)
    edges = sum(spool_valve.throttling_loss(n, u.supply_pressure, u.tank_pressure) for n in valve)
    return {
        "swing_pressure_a": x.swing_pressure_a,
        "swing_pressure_b": x.swing_pressure_b,
        "swing_flow_a": flows[0],
        "swing_flow_b": flows[1],
        "swing_torque": displacement(p) * (nodes.pressure_1 - nodes.pressure_2),
        "swing_torque_rate": displacement(p) * (node_rates[0] - node_rates[1]),
        "supply_flow": valve[0].supply + valve[1].supply,
        "return_flow": valve[0].tank + valve[1].tank + nodes.drain,
        "swing_load_pressure": load.value,
        "swing_load_pressure_rate": load.rate,
        "swing_motor_pressure_a": nodes.pressure_1,
        "swing_motor_pressure_b": nodes.pressure_2,
        "swing_drain_flow": nodes.drain,
        "swing_void_volume": sum(map(chamber.cavity_volume, pressures(x))),
        "dissipated_power": edges + motor.leakage_loss(nodes, u.tank_pressure, *leakage(p)),
    }


def _load_pressure(p: Any, u: SwingInputs, x: Any, rates: Pair) -> LoadPressure:
    """Load pressure of a valve without dynamics."""
    curves = OpeningCurves.of(p, "valve")
    bands = opening_curve.meter_in_dead_bands(curves, p.valve_dead_band, p.valve_dead_band)
    command = (u.swing_command, u.swing_command_rate)
    return load_sensing.load_pressure(*command, bands, p.valve_full_command, pressures(x), rates, u)


def initial_pressures(x: object, u: SwingInputs, p: Any) -> dict[str, Scalar]:
    """Initial state of both lines: at the preload, no torque."""
    return dict.fromkeys(quantities(LinePressures), u.tank_pressure + p.initial_preload)


def require(x: object, u: object, p: Any) -> dict[str, Scalar]:
    """Requirements of the valve."""
    return spool_valve.requirements(p)


TERMINALS: tuple[Terminal, ...] = (
    ports.shaft("swing", drives=True),
    ports.lever("swing"),
    ports.supply_line(),
    ports.return_line(),
    ports.load_sensing_line("swing"),
)


# what all variants declare alike
variant = partial(Subsystem, name="swing", inputs=SwingInputs, values=PARAMETERS, terminals=TERMINALS)
