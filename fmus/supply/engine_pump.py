"""Supply by two pressure-compensated pumps on one shaft with a diesel engine.

    C_p p_i' = x_i - k (p_i - P_t) - q_i         outlet line of pump i = 1, 2
    q_i      = r(p_i - P) / R_c                  its check valve: no flow back into the pump
    C_s P'   = q_1 + q_2 - Q - Q_r               supply line: flow Q into the drives, main relief valve
    J w'     = T - T_f(w) - T_1 - T_2            engine and pumps on one shaft
    V'       = return flow + leakage + relief - x_1 - x_2          oil in the tank, at constant pressure

with x, T, T_i and the strokes from `fmus.components.engine_and_pump`, Q_r from `fmus.components.orifice`, r
the `ramp` of `fmus.components.smooth`. Cavities in the lines as in `fmus.components.chamber`.

    engine_power + P_t return_flow = P supply_flow + dE/dt + heat

engine_power is the power of the combustion, T w. The heat is that of engine friction, friction and leakage of
the pumps, check valves and relief valve. E is the energy of compression and rotation, and P_t V of the tank.

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
    highest_load,
    return_flow,
    supply_flow,
)

_ITERATIONS = 12  # iterations of the search for the idle speed; each gains two digits


class PumpParameters(Group):
    """Parameters of two pumps of equal size with separate pressure settings."""

    pump_1_pressure_setting: Scalar = Quantity(
        "Pa", "Pressure at which the stroke of pump 1 is zero (dead head)", 1e7, minimum=1e5, group="Pumps"
    )
    pump_2_pressure_setting: Scalar = Quantity(
        "Pa", "Pressure at which the stroke of pump 2 is zero (dead head)", 1e7, minimum=1e5
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
    """Parameters of lines and valves between pumps and drives."""

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
    check_opening: Scalar = Quantity(
        "Pa", "Pressure range over which each check valve opens", 1e4, minimum=1.0
    )
    relief_pressure: Scalar = Quantity(
        "Pa", "Pressure above the tank at which the main relief valve opens", 1e7, minimum=1e5
    )
    relief_gain: Scalar = Quantity(
        "m3/(s.Pa)",
        "Flow of the main relief valve per pressure above the opening pressure",
        1e-9,
        minimum=0.0,
    )
    relief_rounding: Scalar = Quantity(
        "Pa", "Pressure range over which the main relief valve begins to open", 1e5, minimum=1.0
    )


class EnginePumpParameters(LineParameters, PumpParameters, ReservoirParameters, engine=DieselEngine):
    """Parameters; values and sources are in parameters.toml."""

    reservoir_volume_start: Scalar = Quantity(
        "m3", "Initial volume of oil in the tank", 0.1, minimum=0.0, group="Tank"
    )

    @property
    def pumps(self) -> tuple[Pump, Pump]:
        """Parameters of both pumps."""
        compensator = (
            *(self.compensator_band, self.compensator_rounding, self.compensator_lag),
            *(self.pump_stroke_time, self.pump_destroke_time),
        )
        losses = (self.pump_leakage, self.pump_pressure_friction, self.pump_viscous_friction)
        first, second = (
            Pump(self.pump_displacement, *losses, setting, *compensator)
            for setting in (self.pump_1_pressure_setting, self.pump_2_pressure_setting)
        )
        return first, second


class EnginePumpState(Group):
    """Pressures, strokes, engine, and oil in the tank."""

    supply_pressure: Scalar = Quantity("Pa", "Pressure of the supply line", 1e7)
    pump_1_pressure: Scalar = Quantity("Pa", "Pressure at the outlet of pump 1", 1e7)
    pump_2_pressure: Scalar = Quantity("Pa", "Pressure at the outlet of pump 2", 1e7)
    pump_1_stroke: Scalar = Quantity("1", "Stroke of pump 1 relative to its full stroke")
    pump_2_stroke: Scalar = Quantity("1", "Stroke of pump 2 relative to its full stroke")
    engine_speed: Scalar = Quantity("rad/s", "Speed of engine and pumps", 100.0)
    engine_torque: Scalar = Quantity("N.m", "Torque of the combustion", 100.0)
    reservoir_volume: Scalar = Quantity("m3", "Volume of oil in the tank", 0.1)


class EnginePumpOutputs(SupplyOutputs):
    """Outputs of every variant, states, and flows and torques of pumps and valves."""

    pump_1_pressure: Scalar = Quantity("Pa", "Pressure at the outlet of pump 1", 1e7)
    pump_2_pressure: Scalar = Quantity("Pa", "Pressure at the outlet of pump 2", 1e7)
    pump_1_stroke: Scalar = Quantity("1", "Stroke of pump 1 relative to its full stroke")
    pump_2_stroke: Scalar = Quantity("1", "Stroke of pump 2 relative to its full stroke")
    pump_1_flow: Scalar = Quantity("m3/s", "Flow from pump 1 through its check valve", 1e-3)
    pump_2_flow: Scalar = Quantity("m3/s", "Flow from pump 2 through its check valve", 1e-3)
    relief_flow: Scalar = Quantity("m3/s", "Flow through the main relief valve", 1e-3)
    engine_speed: Scalar = Quantity("rad/s", "Speed of engine and pumps", 100.0)
    engine_torque: Scalar = Quantity("N.m", "Torque of the combustion", 100.0)
    engine_load: Scalar = Quantity("N.m", "Torque of both pumps on the engine", 100.0)
    reservoir_volume: Scalar = Quantity("m3", "Volume of oil in the tank", 0.1)


@dataclass(frozen=True)
class _OperatingPoint:
    """Operating point of a pump: pressure rise [Pa], flows [m3/s] and torque [N.m]."""

    pump: Pump
    rise: Scalar
    suction: Scalar
    leakage: Scalar
    delivered: Scalar
    torque: Scalar


def _pumps(x: EnginePumpState, p: EnginePumpParameters) -> tuple[_OperatingPoint, _OperatingPoint]:
    def operating_point(d: Pump, pressure: Scalar, stroke: Scalar) -> _OperatingPoint:
        rise = pressure - p.reservoir_pressure
        return _OperatingPoint(
            d,
            rise,
            engine_and_pump.suction_flow(d, stroke, x.engine_speed),
            d.leakage * rise,
            engine_and_pump.check_flow(pressure, x.supply_pressure, p.check_resistance, p.check_opening),
            engine_and_pump.torque(d, stroke, x.engine_speed, rise),
        )

    first, second = p.pumps
    return (
        operating_point(first, x.pump_1_pressure, x.pump_1_stroke),
        operating_point(second, x.pump_2_pressure, x.pump_2_stroke),
    )


def _relief_flow(x: EnginePumpState, p: EnginePumpParameters) -> Scalar:
    return orifice.relief_flow(PressureValve.of(p, "relief"), x.supply_pressure - p.reservoir_pressure)


def dynamics(x: EnginePumpState, u: SupplyInputs, p: EnginePumpParameters) -> EnginePumpState:
    """Time derivative of the state, field by field."""
    a, b = _pumps(x, p)
    relief, engine = _relief_flow(x, p), DieselEngine.of(p, "engine")
    torque = x.engine_torque - engine_and_pump.engine_friction(engine, x.engine_speed) - a.torque - b.torque
    net = a.delivered + b.delivered - supply_flow(u) - relief
    return EnginePumpState(
        supply_pressure=chamber.pressure_rate(x.supply_pressure, net, p.rail_capacitance),
        pump_1_pressure=_outlet_rate(a, x.pump_1_pressure, p),
        pump_2_pressure=_outlet_rate(b, x.pump_2_pressure, p),
        pump_1_stroke=engine_and_pump.stroke_rate(a.pump, x.pump_1_stroke, x.pump_1_pressure),
        pump_2_stroke=engine_and_pump.stroke_rate(b.pump, x.pump_2_stroke, x.pump_2_pressure),
        engine_speed=torque / engine.inertia,
        engine_torque=(engine_and_pump.governor_torque(engine, x.engine_speed) - x.engine_torque)
        / engine.lag,
        reservoir_volume=return_flow(u) + a.leakage + b.leakage + relief - a.suction - b.suction,
    )


def _outlet_rate(w: _OperatingPoint, pressure: Scalar, p: EnginePumpParameters) -> Scalar:
    return chamber.pressure_rate(pressure, w.suction - w.leakage - w.delivered, p.pump_line_capacitance)


def observe(x: EnginePumpState, u: SupplyInputs, p: EnginePumpParameters) -> EnginePumpOutputs:
    """Outputs."""
    a, b = _pumps(x, p)
    supplied, returned, load = supply_flow(u), return_flow(u), highest_load(u)
    return EnginePumpOutputs(
        **vars(x),
        supply_pressure_rate=dynamics(x, u, p).supply_pressure,
        tank_pressure=p.reservoir_pressure,
        load_sensing_pressure=load.value,
        load_sensing_pressure_rate=load.rate,
        supply_flow=supplied,
        return_flow=returned,
        hydraulic_power=x.supply_pressure * supplied - p.reservoir_pressure * returned,
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
    """Initial state without flow into the drives: pumps at dead head, engine at idle speed."""
    tank, engine, speed = p.reservoir_pressure, DieselEngine.of(p, "engine"), p.engine_no_load_speed
    for _ in range(_ITERATIONS):
        speed = engine_and_pump.governed_speed(engine, _idle_load(p, speed), speed)
        # within the range of the governor, also for an engine that is too weak
        speed = ca.fmax(p.engine_peak_speed, ca.fmin(speed, p.engine_no_load_speed))
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
        "engine_torque": engine_and_pump.governor_torque(engine, speed),
        "reservoir_volume": p.reservoir_volume_start,
    }


def _idle_load(p: EnginePumpParameters, speed: Scalar) -> Scalar:
    """Torque [N.m] of both pumps at dead head."""
    load: Scalar = 0
    for d in p.pumps:
        stroke, pressure = engine_and_pump.dead_head(d, speed, p.reservoir_pressure)
        load = load + engine_and_pump.torque(d, stroke, speed, pressure - p.reservoir_pressure)
    return load


def require(x: EnginePumpState, u: SupplyInputs, p: EnginePumpParameters) -> dict[str, Scalar]:
    """Requirements: order of pressure settings and of speeds, an engine that can turn the pumps."""
    return {
        "pump_1_pressure_setting exceeds reservoir_pressure": p.pump_1_pressure_setting
        - p.reservoir_pressure,
        "pump_2_pressure_setting exceeds reservoir_pressure": p.pump_2_pressure_setting
        - p.reservoir_pressure,
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
