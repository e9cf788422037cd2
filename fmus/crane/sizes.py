"""Numbers that the file of a crane does not have: those of the paper's machine, at the size of the crane.

    f = Q/Q_0       flow of a part's largest section over that of the paper's boom
    d = D/D_0       displacement of the pump over that of the paper's machine
    s = D w/(D_0 w_0)       its flow           e = w/w_0      speed of the engine
    t = T/T_0       torque of the engine       P = T w        its power

A pump without a displacement gives the two largest sections together their flow, and a tenth more. An engine
without a power has that of the paper's machine times s and the pressure. Leakages, gains of valves, volumes
and capacitances follow the flow, resistances its inverse, friction and inertia the torque, heat the power.
Times and shares are those of the paper's machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from fmus.boom_stick import BOOM_STICK
from fmus.contract import quantities
from fmus.crane.description import SECTION, CraneDescription, JointDescription
from fmus.parameters import Number, numbers
from fmus.supply import VARIANTS
from fmus.swing import SWING

SPARE = 1.1  # flow of the pump over that of the two largest sections
SCALED = "at the size of the crane"  # begin of the note of such a number
SHIPPED = {n: x for sub in VARIANTS.values() for n, x in numbers(sub)["parameters"].items()}
BOUNDS = {n: q.minimum for sub in VARIANTS.values() for n, q in quantities(sub.parameters).items()}
DRIVE, MOTOR = numbers(BOOM_STICK)["parameters"], numbers(SWING)["parameters"]
LEAKAGE = ("internal_leakage_resistance", "external_leakage_resistance")
# parameters of the supply by what they follow
FLOW = (
    *("pump_leakage", "main_pump_leakage", "rail_leakage", "relief_gain", "return_bypass_gain"),
    *("pump_line_capacitance", "main_pump_line_capacitance", "rail_capacitance", "return_capacitance"),
    *("reservoir_volume_start", "suction_volume"),
)
RESISTANCE = ("check_resistance", "main_pump_check_resistance", "return_resistance")
DISPLACEMENT = (
    *("pump_displacement", "main_pump_displacement"),
    *("pump_viscous_friction", "main_pump_viscous_friction"),
)
TORQUE = (
    "engine_rated_torque",
    "engine_friction",
    "engine_viscous_friction",
    "engine_inertia",
    "torque_limit",
)
SPEED = tuple(f"engine_{n}_speed" for n in ("rated", "peak", "no_load", "idle", "stall"))
HEAT = ("heat_capacity", "tank_conductance", "cooler_conductance")
# of drives, with the flow of the largest section
VALVES = (
    *("relief_gain", "port_relief_gain", "anti_cavitation_area", "neutral_area"),
    *("counterbalance_area", "counterbalance_check_area"),
)


def section_flow(crane: CraneDescription, joint: JointDescription, setting: float) -> float:
    """Flow of its section [m3/s]: the rated one, or that of the valve at a compensator's setting [Pa]."""
    density = crane.numbers["oil"]["density"].value
    jet = DRIVE["valve_discharge_coefficient"].value * math.sqrt(2 * setting / density)
    return joint["rated_flow"] or joint["valve_area"] * jet


def _times(shipped: Mapping[str, Number], factors: Mapping[str, float]) -> Iterator[tuple[str, Number]]:
    """Those whose factor is not 1, not below their bounds."""
    for n, factor in factors.items():
        if n in shipped and factor != 1:
            value, note = max(factor * shipped[n].value, BOUNDS.get(n) or 0.0), f"{SCALED}: {shipped[n].note}"
            yield n, Number(value, shipped[n].unit, "derived", note)


def of_drives(flow: float, shipped: Mapping[str, Number]) -> dict[str, Number]:
    """Valves that the axes of a part share; flow: of its largest section [m3/s]."""
    return dict(_times(shipped, dict.fromkeys(VALVES, flow / SECTION)))


def of_motor(joint: JointDescription) -> dict[str, Number]:
    """Leakage: of a motor smaller than the paper's as much smaller, of a larger one the same."""
    factor = max(MOTOR["motor_displacement"].value / joint["motor_displacement"], 1.0)
    return dict(_times(MOTOR, dict.fromkeys(LEAKAGE, factor)))


def of_supply(crane: CraneDescription, setting: float) -> dict[str, Number]:
    """Pump, engine, lines, tank and cooler; setting: of the compensators [Pa]."""
    pump, engine = ({n: x.value for n, x in crane.numbers[table].items()} for table in ("pump", "engine"))
    pressure = crane.numbers["supply"]["pressure_setting"].value / SHIPPED["pressure_setting"].value
    of = {n: SHIPPED[n].value for n in (*DISPLACEMENT, *TORQUE, *SPEED)}
    speed = engine["rated_speed"] or of["engine_rated_speed"]
    flows = sorted(section_flow(crane, j, setting) for j in crane.driven)
    displacement = pump["displacement"] or (pump["flow"] or SPARE * sum(flows[-2:])) / speed
    displacement = displacement or of["main_pump_displacement"]
    d, e = displacement / of["main_pump_displacement"], speed / of["engine_rated_speed"]
    rated = of["engine_rated_speed"] * of["engine_rated_torque"]
    p = engine["rated_power"] / rated if engine["rated_power"] else d * e * pressure
    if math.isclose(p, 1, rel_tol=1e-6):  # digits of a power
        p = 1.0
    factors = {
        **dict.fromkeys(FLOW, d * e),
        **dict.fromkeys(RESISTANCE, 1 / (d * e)),
        **dict.fromkeys(DISPLACEMENT, d),
        **dict.fromkeys(TORQUE, p / e),
        **dict.fromkeys(SPEED, e),
        **dict.fromkeys(HEAT, p),
        "engine_viscous_friction": p / e**2,
    }
    found = dict(_times(SHIPPED, factors))
    given = {"main_pump_displacement": "displacement", "margin": "margin", "pressure_cut_off": "cut_off"}
    found |= {n: crane.numbers["pump"][key] for n, key in given.items() if pump[key]}
    if pump["flow"]:
        note = "pump.flow over engine.speed"
        found["main_pump_displacement"] = Number(displacement, "m3/rad", "derived", note)
    if pump["power"]:
        found["torque_limit"] = Number(
            pump["power"] / speed, "N.m", "derived", "pump.power over engine.speed"
        )
    if engine["rated_power"]:
        note = "engine.power over engine.speed"
        found["engine_rated_torque"] = Number(engine["rated_power"] / speed, "N.m", "derived", note)
    return found
