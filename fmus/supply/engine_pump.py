"""Two pressure-compensated pumps side by side on a diesel engine, feeding one supply line.

    C_p p_i' = x_i - k (p_i - P_t) - q_i         outlet line of pump i = 1, 2
    q_i      = r(p_i - P) / R_c                  its check valve: pumps never take oil back
    C_s P'   = q_1 + q_2 - Q - Q_r               supply line: what the drives take, main relief valve
    J w'     = T - T_f(w) - T_1 - T_2            engine and pumps on one shaft
    V'       = return flow + leakage + relief - x_1 - x_2          oil in the tank, at constant pressure

with x, T, T_i and the strokes from `fmus.components.engine_and_pump`, Q_r from `fmus.components.orifice`, r
the `ramp` of `fmus.components.smooth`. Cavities in the lines as in `fmus.components.chamber`.

    engine_power + P_t return_flow = P supply_flow + dE/dt + heat

engine_power is the work of the combustion, T w; the heat is that of the engine's own friction, friction and
leakage of the pumps, check valves and relief valve; E is compression, rotation, and P_t V of the tank.

Signs: supply flows are positive out of the supply line, return flows into the tank.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from fmus.components import chamber, engine_and_pump, orifice
from fmus.components.engine_and_pump import DieselEngine, Pump
from fmus.components.orifice import PressureValve
from fmus.contract import Group, Quantity, Scalar, Subsystem
from fmus.supply.variables import (
    TERMINALS,
    ReservoirParameters,
    SupplyInputs,
    SupplyOutputs,
    return_flow,
    supply_flow,
)

_SWEEPS = 12  # of the search for the speed at rest; each gains two digits


class PumpParameters(Group):
    """Two pumps of one size; each has its own setting."""

    pump_1_pressure_setting: Scalar = Quantity(
        "Pa", "Pressure at which pump 1 has no stroke left", 1e7, minimum=1e5, group="Pumps"
    )
    pump_2_pressure_setting: Scalar = Quantity(
        "Pa", "Pressure at which pump 2 has no stroke left", 1e7, minimum=1e5
    )
    pump_displacement: Scalar = Quantity(
        "m3/rad", "Displacement of each pump on full stroke", 1e-5, minimum=1e-9
    )
    pump_leakage: Scalar = Quantity("m3/(s.Pa)", "Leakage of each pump to its case", 1e-12, minimum=1e-17)
    pump_pressure_friction: Scalar = Quantity(
        "1", "Friction of each pump under pressure, share of the full torque", minimum=0.0
    )
    pump_viscous_friction: Scalar = Quantity("N.m.s/rad", "Viscous friction of each pump", minimum=0.0)
    compensator_band: Scalar = Quantity(
        "Pa", "Pressure by which a pump falls from no stroke to full stroke", 1e6, minimum=1.0
    )
    compensator_rounding: Scalar = Quantity(
        "1", "Share of the stroke over which its ends are rounded", minimum=1e-6, maximum=0.5
    )
    compensator_lag: Scalar = Quantity(
        "s", "Time constant of the compensator for small changes", minimum=1e-6
    )
    pump_stroke_time: Scalar = Quantity("s", "Shortest time from no stroke to full", minimum=1e-6)
    pump_destroke_time: Scalar = Quantity("s", "Shortest time from full stroke to none", minimum=1e-6)


class LineParameters(Group):
    """Lines between pumps and drives, with their valves."""

    pump_line_capacitance: Scalar = Quantity(
        "m3/Pa",
        "Capacitance of the line from each pump to its check valve",
        1e-12,
        minimum=1e-16,
        group="Lines",
    )
    rail_capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance of the line from the check valves to the drives", 1e-12, minimum=1e-13
    )
    check_resistance: Scalar = Quantity(
        "Pa.s/m3", "Resistance of each check valve with its line", 1e8, minimum=1e3
    )
    check_opening: Scalar = Quantity("Pa", "Pressure within which each check valve opens", 1e4, minimum=1.0)
    relief_pressure: Scalar = Quantity(
        "Pa", "Pressure over the tank at which the main relief valve opens", 1e7, minimum=1e5
    )
    relief_gain: Scalar = Quantity(
        "m3/(s.Pa)", "Flow of the open relief valve per pressure above", 1e-9, minimum=0.0
    )
    relief_rounding: Scalar = Quantity("Pa", "Pressure within which the relief valve opens", 1e5, minimum=1.0)


class EnginePumpParameters(LineParameters, PumpParameters, ReservoirParameters, engine=DieselEngine):
    """Constants; their numbers and sources are in parameters.toml."""

    reservoir_volume_start: Scalar = Quantity(
        "m3", "Oil in the tank at the start", 0.1, minimum=0.0, group="Tank"
    )

    @property
    def pumps(self) -> tuple[Pump, Pump]:
        """The pumps these numbers describe."""
        alike = (
            *(self.compensator_band, self.compensator_rounding, self.compensator_lag),
            *(self.pump_stroke_time, self.pump_destroke_time),
        )
        losses = (self.pump_leakage, self.pump_pressure_friction, self.pump_viscous_friction)
        first, second = (
            Pump(self.pump_displacement, *losses, setting, *alike)
            for setting in (self.pump_1_pressure_setting, self.pump_2_pressure_setting)
        )
        return first, second


class EnginePumpState(Group):
    """Pressures, strokes, the engine, and the oil in the tank."""

    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7)
    pump_1_pressure: Scalar = Quantity("Pa", "Pressure at the outlet of pump 1", 1e7)
    pump_2_pressure: Scalar = Quantity("Pa", "Pressure at the outlet of pump 2", 1e7)
    pump_1_stroke: Scalar = Quantity("1", "Share of the stroke of pump 1")
    pump_2_stroke: Scalar = Quantity("1", "Share of the stroke of pump 2")
    engine_speed: Scalar = Quantity("rad/s", "Speed of engine and pumps", 100.0)
    engine_torque: Scalar = Quantity("N.m", "Torque of the combustion", 100.0)
    reservoir_volume: Scalar = Quantity("m3", "Oil in the tank", 0.1)


class EnginePumpOutputs(SupplyOutputs):
    """What every variant shows, the state, and flows and torques in between."""

    pump_1_pressure: Scalar = Quantity("Pa", "Pressure at the outlet of pump 1", 1e7)
    pump_2_pressure: Scalar = Quantity("Pa", "Pressure at the outlet of pump 2", 1e7)
    pump_1_stroke: Scalar = Quantity("1", "Share of the stroke of pump 1")
    pump_2_stroke: Scalar = Quantity("1", "Share of the stroke of pump 2")
    pump_1_flow: Scalar = Quantity("m3/s", "Flow from pump 1 through its check valve", 1e-3)
    pump_2_flow: Scalar = Quantity("m3/s", "Flow from pump 2 through its check valve", 1e-3)
    relief_flow: Scalar = Quantity("m3/s", "Flow through the main relief valve", 1e-3)
    engine_speed: Scalar = Quantity("rad/s", "Speed of engine and pumps", 100.0)
    engine_torque: Scalar = Quantity("N.m", "Torque of the combustion", 100.0)
    engine_load: Scalar = Quantity("N.m", "Torque of both pumps on the engine", 100.0)
    reservoir_volume: Scalar = Quantity("m3", "Oil in the tank", 0.1)


@dataclass(frozen=True)
class _Working:
    """One pump at work: outlet pressure over the tank [Pa], its flows [m3/s] and torque [N.m]."""

    pump: Pump
    rise: Scalar
    drawn: Scalar
    leakage: Scalar
    delivered: Scalar
    torque: Scalar


def _pumps(x: EnginePumpState, p: EnginePumpParameters) -> tuple[_Working, _Working]:
    def work(d: Pump, pressure: Scalar, stroke: Scalar) -> _Working:
        rise = pressure - p.reservoir_pressure
        return _Working(
            d,
            rise,
            engine_and_pump.suction_flow(d, stroke, x.engine_speed),
            d.leakage * rise,
            engine_and_pump.check_flow(pressure, x.supply_pressure, p.check_resistance, p.check_opening),
            engine_and_pump.torque(d, stroke, x.engine_speed, rise),
        )

    first, second = p.pumps
    return work(first, x.pump_1_pressure, x.pump_1_stroke), work(second, x.pump_2_pressure, x.pump_2_stroke)


def _relief_flow(x: EnginePumpState, p: EnginePumpParameters) -> Scalar:
    return orifice.relief_flow(PressureValve.of(p, "relief"), x.supply_pressure - p.reservoir_pressure)


def dynamics(x: EnginePumpState, u: SupplyInputs, p: EnginePumpParameters) -> EnginePumpState:
    """Time derivative of the state, field by field."""
    a, b = _pumps(x, p)
    spilled, motor = _relief_flow(x, p), DieselEngine.of(p, "engine")
    accelerating = (
        x.engine_torque - engine_and_pump.engine_friction(motor, x.engine_speed) - a.torque - b.torque
    )
    net = a.delivered + b.delivered - supply_flow(u) - spilled
    return EnginePumpState(
        supply_pressure=chamber.pressure_rate(x.supply_pressure, net, p.rail_capacitance),
        pump_1_pressure=_outlet_rate(a, x.pump_1_pressure, p),
        pump_2_pressure=_outlet_rate(b, x.pump_2_pressure, p),
        pump_1_stroke=engine_and_pump.stroke_rate(a.pump, x.pump_1_stroke, x.pump_1_pressure),
        pump_2_stroke=engine_and_pump.stroke_rate(b.pump, x.pump_2_stroke, x.pump_2_pressure),
        engine_speed=accelerating / motor.inertia,
        engine_torque=(engine_and_pump.governor_torque(motor, x.engine_speed) - x.engine_torque) / motor.lag,
        reservoir_volume=return_flow(u) + a.leakage + b.leakage + spilled - a.drawn - b.drawn,
    )


def _outlet_rate(w: _Working, pressure: Scalar, p: EnginePumpParameters) -> Scalar:
    return chamber.pressure_rate(pressure, w.drawn - w.leakage - w.delivered, p.pump_line_capacitance)


def observe(x: EnginePumpState, u: SupplyInputs, p: EnginePumpParameters) -> EnginePumpOutputs:
    """Outputs."""
    a, b = _pumps(x, p)
    taken, given = supply_flow(u), return_flow(u)
    return EnginePumpOutputs(
        **vars(x),
        supply_pressure_rate=dynamics(x, u, p).supply_pressure,
        tank_pressure=p.reservoir_pressure,
        supply_flow=taken,
        return_flow=given,
        hydraulic_power=x.supply_pressure * taken - p.reservoir_pressure * given,
        engine_power=x.engine_torque * x.engine_speed,
        stored_energy=_stored_energy(x, p),
        dissipated_power=_dissipated_power(x, p),
        pump_1_flow=a.delivered,
        pump_2_flow=b.delivered,
        relief_flow=_relief_flow(x, p),
        engine_load=a.torque + b.torque,
    )


def _stored_energy(x: EnginePumpState, p: EnginePumpParameters) -> Scalar:
    lines = chamber.stored_energy(x.supply_pressure, p.rail_capacitance) + sum(
        chamber.stored_energy(pressure, p.pump_line_capacitance)
        for pressure in (x.pump_1_pressure, x.pump_2_pressure)
    )
    return lines + p.engine_inertia * x.engine_speed**2 / 2 + p.reservoir_pressure * x.reservoir_volume


def _dissipated_power(x: EnginePumpState, p: EnginePumpParameters) -> Scalar:
    rail = x.supply_pressure - p.reservoir_pressure
    pumps = sum(
        engine_and_pump.loss(w.pump, x.engine_speed, w.rise) + w.delivered * (w.rise - rail)
        for w in _pumps(x, p)
    )
    return (
        pumps
        + _relief_flow(x, p) * rail
        + engine_and_pump.engine_friction(DieselEngine.of(p, "engine"), x.engine_speed) * x.engine_speed
    )


def initial(x: EnginePumpState, u: SupplyInputs, p: EnginePumpParameters) -> dict[str, Scalar]:
    """Nothing is taken: the pumps cover their leakage, the governor holds the speed under that load."""
    tank, motor, speed = p.reservoir_pressure, DieselEngine.of(p, "engine"), p.engine_no_load_speed
    for _ in range(_SWEEPS):
        found = engine_and_pump.governed_speed(motor, _idle_load(p, speed), speed)
        speed = ca.fmax(p.engine_peak_speed, ca.fmin(found, p.engine_no_load_speed))  # some engine may not do
    (stroke_1, pressure_1), (stroke_2, pressure_2) = (
        engine_and_pump.dead_head(d, speed, tank) for d in p.pumps
    )
    return {
        "supply_pressure": ca.fmax(pressure_1, pressure_2),
        "pump_1_pressure": pressure_1,
        "pump_2_pressure": pressure_2,
        "pump_1_stroke": stroke_1,
        "pump_2_stroke": stroke_2,
        "engine_speed": speed,
        "engine_torque": engine_and_pump.governor_torque(motor, speed),
        "reservoir_volume": p.reservoir_volume_start,
    }


def _idle_load(p: EnginePumpParameters, speed: Scalar) -> Scalar:
    """Torque [N.m] of both pumps that deliver nothing."""
    load: Scalar = 0
    for d in p.pumps:
        stroke, pressure = engine_and_pump.dead_head(d, speed, p.reservoir_pressure)
        load = load + engine_and_pump.torque(d, stroke, speed, pressure - p.reservoir_pressure)
    return load


def require(x: EnginePumpState, u: SupplyInputs, p: EnginePumpParameters) -> dict[str, Scalar]:
    """What must hold beyond the bounds of single parameters."""
    return {
        "relief_pressure exceeds pump_1_pressure_setting": p.relief_pressure - p.pump_1_pressure_setting,
        "relief_pressure exceeds pump_2_pressure_setting": p.relief_pressure - p.pump_2_pressure_setting,
        "engine_no_load_speed exceeds engine_rated_speed": p.engine_no_load_speed - p.engine_rated_speed,
        "engine_rated_speed exceeds engine_peak_speed": p.engine_rated_speed - p.engine_peak_speed,
        "engine_rated_torque exceeds what turns both pumps without flow": p.engine_rated_torque
        - _idle_load(p, p.engine_rated_speed),
    }


ENGINE_PUMP = Subsystem(
    name="supply",
    text="Hydraulic supply: two pressure-compensated pumps on a diesel engine",
    parameters=EnginePumpParameters,
    states=EnginePumpState,
    inputs=SupplyInputs,
    outputs=EnginePumpOutputs,
    dynamics=dynamics,
    observe=observe,
    initial=initial,
    require=require,
    values=Path(__file__).with_name("parameters.toml"),
    terminals=TERMINALS,
    validity="engine above 800 rpm; mean flows: no ripple of the pistons, no waves in the supply line",
)
