"""What supplies with pumps have in common: lines with their valves, engine, and the heat of the oil.

    C_p p' = x - k (p - P_t) - q           outlet line of a pump
    q      = r(p - P) / R_c                its check valve: no flow back into the pump
    C_s P' = sum q - Q - Q_r - Q_l         supply line: flow Q into the drives, main relief valve, leakage
    J w'   = b T - T_f(w) - sum T_i        engine and pumps on one shaft
    C_b P_b' = Q_return - Q_b              return line of the drives, preloaded by a check valve
    Q_b    = (r(P_b - P_t - p_b) - r(P_t - P_b)) / R_b       into the tank; a second one draws from there
    C th'  = heat - (G + G_c lim((th - th_c)/band)) (th - th_a)        temperature of the oil, with a cooler

with x, b T, T_i from `fmus.components.engine_and_pump`, Q_r from `fmus.components.orifice`, r the `ramp` of
`fmus.smooth`. Cavities in the lines as in `fmus.components.chamber`. Leakage and drag of the pumps
follow from the temperature of the oil (`fmus.components.oil`).

The heat is that of all losses but those of the engine, and the power that the drives take: over a cycle it
ends in the oil, because the arm comes back to its height. In between, the error is the potential energy of
the arm, 0.1 K. Friction outside the oil is counted too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from fmus.components import chamber, engine_and_pump, oil, orifice
from fmus.components.engine_and_pump import DieselEngine, Pump
from fmus.components.orifice import PressureValve
from fmus.contract import Group, Quantity, Scalar, quantities
from fmus.smooth import unit_limited
from fmus.supply.variables import CommonParameters, SupplyInputs, SupplyOutputs, return_flow, supply_flow

# Longest communication step [s]: a third of the time constant of the supply line with three compensated
# sections fully open, 0.8 ms. At 1 ms the rate of its pressure leads to a steady and wrong motion.
STEP = 2.5e-4
_FAN_ROUNDING = 0.02  # share of the cooler's band over which its ends are rounded


class RailParameters(Group):
    """Parameters of the supply line and its valves."""

    rail_capacitance: Scalar = Quantity(
        "m3/Pa",
        "Capacitance of the line from the check valves to the drives",
        1e-12,
        minimum=1e-13,
        group="Lines",
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


class TankParameters(CommonParameters):
    """Parameters of return line, tank and cooler."""

    reservoir_volume_start: Scalar = Quantity("m3", "Initial volume of oil in the tank", 0.1, minimum=0.0)
    return_preload: Scalar = Quantity(
        "Pa",
        "Pressure above the tank at which the check valve of the return line opens",
        1e5,
        minimum=0.0,
        group="Return line",
    )
    return_resistance: Scalar = Quantity(
        "Pa.s/m3", "Resistance of that check valve with filter and cooler", 1e7, minimum=1e3
    )
    return_capacitance: Scalar = Quantity("m3/Pa", "Capacitance of the return line", 1e-10, minimum=1e-13)
    oil_temperature_start: Scalar = Quantity(
        "K", "Initial temperature of the oil", 300.0, minimum=243.15, maximum=373.15, group="Heat"
    )
    ambient_temperature: Scalar = Quantity("K", "Temperature of the air", 300.0, minimum=223.15)
    heat_capacity: Scalar = Quantity("J/K", "Heat capacity of oil, tank and lines", 1e5, minimum=1e3)
    tank_conductance: Scalar = Quantity(
        "W/K", "Heat to the air per kelvin, from tank, lines and cylinders", 100.0, minimum=0.0
    )
    cooler_conductance: Scalar = Quantity(
        "W/K", "Heat to the air per kelvin from the cooler at full speed of its fan", 1e3, minimum=0.0
    )
    cooler_setting: Scalar = Quantity("K", "Oil temperature at which the fan starts", 300.0, minimum=223.15)
    cooler_band: Scalar = Quantity(
        "K", "Rise of the oil temperature from the start of the fan to its full speed", 10.0, minimum=0.1
    )


class ShaftState(Group):
    """Engine, return line, and oil in the tank."""

    engine_speed: Scalar = Quantity("rad/s", "Speed of engine and pumps", 100.0)
    engine_fuel_torque: Scalar = Quantity("N.m", "Torque of the injected fuel if all of it burns", 100.0)
    tank_pressure: Scalar = replace(quantities(SupplyOutputs)["tank_pressure"], absolute=1e6)
    oil_temperature: Scalar = Quantity("K", "Temperature of the oil in the tank", 300.0)
    reservoir_volume: Scalar = Quantity("m3", "Volume of oil in the tank", 0.1)


class ShaftOutputs(SupplyOutputs):
    """Outputs of every variant, and two that are zero while the engine is in its range."""

    engine_speed_below_idle: Scalar = Quantity(
        "rad/s", "Speed that the engine lacks to its idle speed, else zero", 100.0, warn_above=0.0
    )
    engine_speed_below_stall: Scalar = Quantity(
        "rad/s",
        "Speed that the engine lacks to its stall speed, else zero",
        100.0,
        warn_above=0.0,
        meaning="the engine has stalled and does not start again",
    )


@dataclass(frozen=True)
class Outlet:
    """A pump at work on its outlet line: pressure and its rise [Pa], flows [m3/s], torque [N.m].

    capacitance   of the outlet line [m3/Pa]
    """

    pump: Pump
    capacitance: Scalar
    pressure: Scalar
    rise: Scalar
    suction: Scalar
    leakage: Scalar
    delivered: Scalar
    torque: Scalar

    @property
    def pressure_rate(self) -> Scalar:
        """Time derivative [Pa/s] of the pressure."""
        return chamber.pressure_rate(
            self.pressure, self.suction - self.leakage - self.delivered, self.capacitance
        )


def outlet(
    pump: Pump,
    line: tuple[Scalar, Scalar],
    pressure: Scalar,
    stroke: Scalar,
    x: ShaftState,
    p: RailParameters,
) -> Outlet:
    """The pump on a line of (resistance, capacitance), at an outlet pressure and a stroke."""
    rise, (resistance, capacitance) = pressure - p.reservoir_pressure, line
    pump = engine_and_pump.at_viscosity(pump, oil.viscosity_ratio(x.oil_temperature))
    return Outlet(
        pump,
        *(capacitance, pressure, rise),
        suction=engine_and_pump.suction_flow(pump, stroke, x.engine_speed),
        leakage=pump.leakage * rise,
        delivered=engine_and_pump.check_flow(pressure, x.supply_pressure, resistance, p.check_opening),
        torque=engine_and_pump.torque(pump, stroke, x.engine_speed, rise),
    )


def relief_flow(x: ShaftState, p: RailParameters) -> Scalar:
    """Flow [m3/s] of the main relief valve."""
    return orifice.relief_flow(PressureValve.of(p, "relief"), x.supply_pressure - p.reservoir_pressure)


def pressure_rate(outlets: Sequence[Outlet], taken: Scalar, x: ShaftState, p: RailParameters) -> Scalar:
    """Time derivative [Pa/s] of the supply pressure; taken: all flow [m3/s] out of the line but relief."""
    net = sum(o.delivered for o in outlets) - taken - relief_flow(x, p)
    return chamber.pressure_rate(x.supply_pressure, net, p.rail_capacitance)


def shaft_rate(
    outlets: Sequence[Outlet], leakage: Scalar, u: SupplyInputs, x: ShaftState, p: RailParameters
) -> dict[str, Scalar]:
    """Time derivatives of `ShaftState`; leakage: flow [m3/s] from the supply line into the tank."""
    engine, load, speed = DieselEngine.of(p, "engine"), sum(o.torque for o in outlets), x.engine_speed
    drained = sum(o.leakage - o.suction for o in outlets) + relief_flow(x, p) + leakage
    net = return_flow(u) - _into_tank(x, p)
    # heat [W] into the oil: power that the drives take, and the losses without those of the engine
    taken = x.supply_pressure * supply_flow(u) - x.tank_pressure * return_flow(u)
    heat = taken + dissipated_power(outlets, leakage, x, p) - _engine_heat(x, p)
    return {
        "engine_speed": engine_and_pump.speed_rate(engine, speed, _engine_torque(x, p), load),
        "engine_fuel_torque": engine_and_pump.torque_rate(engine, speed, x.engine_fuel_torque),
        "tank_pressure": chamber.pressure_rate(x.tank_pressure, net, p.return_capacitance),
        "oil_temperature": (heat - cooling_power(x, p)) / p.heat_capacity,
        "reservoir_volume": _into_tank(x, p) + drained,
    }


def start(p: TankParameters) -> dict[str, Scalar]:
    """Initial return line, temperature and volume of the oil, without flow."""
    return {
        "tank_pressure": return_pressure(p),
        "oil_temperature": p.oil_temperature_start,
        "reservoir_volume": p.reservoir_volume_start,
    }


def return_pressure(p: Any) -> Scalar:
    """Pressure [Pa] of the return line without flow."""
    return p.reservoir_pressure + p.return_preload


def at_start(pump: Pump, p: TankParameters) -> Pump:
    """A pump at the initial temperature of the oil."""
    return engine_and_pump.at_viscosity(pump, oil.viscosity_ratio(p.oil_temperature_start))


def _into_tank(x: ShaftState, p: RailParameters) -> Scalar:
    """Flow Q_b [m3/s] from the return line into the tank."""
    valve = (p.return_resistance, p.check_opening)
    return engine_and_pump.check_flow(
        x.tank_pressure, return_pressure(p), *valve
    ) - engine_and_pump.check_flow(p.reservoir_pressure, x.tank_pressure, *valve)


def cooling_power(x: ShaftState, p: Any) -> Scalar:
    """Heat [W] from the oil to the air."""
    fan = unit_limited((x.oil_temperature - p.cooler_setting) / p.cooler_band, _FAN_ROUNDING)
    conductance = p.tank_conductance + p.cooler_conductance * fan
    return conductance * (x.oil_temperature - p.ambient_temperature)


def _engine_torque(x: ShaftState, p: RailParameters) -> Scalar:
    """Torque [N.m] of the combustion."""
    share = engine_and_pump.burning_share(DieselEngine.of(p, "engine"), x.engine_speed)
    return share * x.engine_fuel_torque


def _engine_heat(x: ShaftState, p: RailParameters) -> Scalar:
    """Power [W] of the engine's friction."""
    return engine_and_pump.engine_friction(DieselEngine.of(p, "engine"), x.engine_speed) * x.engine_speed


def stored_energy(outlets: Sequence[Outlet], x: ShaftState, p: RailParameters) -> Scalar:
    """Energy [J] of compression in all lines, of rotation, and of the oil in the tank."""
    lines = (
        chamber.stored_energy(x.supply_pressure, p.rail_capacitance)
        + chamber.stored_energy(x.tank_pressure, p.return_capacitance)
        + sum(chamber.stored_energy(o.pressure, o.capacitance) for o in outlets)
    )
    return lines + p.engine_inertia * x.engine_speed**2 / 2 + p.reservoir_pressure * x.reservoir_volume


def dissipated_power(outlets: Sequence[Outlet], leakage: Scalar, x: ShaftState, p: RailParameters) -> Scalar:
    """Heat [W] of pumps, check valves, relief valve, engine friction and rail leakage [m3/s]."""
    line = x.supply_pressure - p.reservoir_pressure
    pumps = sum(
        engine_and_pump.loss(o.pump, x.engine_speed, o.rise) + o.delivered * (o.rise - line) for o in outlets
    )
    preload = _into_tank(x, p) * (x.tank_pressure - p.reservoir_pressure)
    return pumps + (relief_flow(x, p) + leakage) * line + preload + _engine_heat(x, p)


def outputs(
    outlets: Sequence[Outlet], leakage: Scalar, rates: ShaftState, u: SupplyInputs, x: ShaftState, p: Any
) -> dict[str, Scalar]:
    """Shown states and the outputs that all supplies with pumps have, by name; rates: of the state."""
    supplied, returned = supply_flow(u), return_flow(u)
    return {
        **{name: value for name, value in vars(x).items() if name != "engine_fuel_torque"},
        "supply_pressure_rate": rates.supply_pressure,
        "tank_pressure_rate": rates.tank_pressure,
        "supply_flow": supplied,
        "return_flow": returned,
        "hydraulic_power": x.supply_pressure * supplied - x.tank_pressure * returned,
        "engine_speed_below_idle": ca.fmax(p.engine_idle_speed - x.engine_speed, 0),
        "engine_speed_below_stall": ca.fmax(p.engine_stall_speed - x.engine_speed, 0),
        "engine_torque": _engine_torque(x, p),
        "engine_power": _engine_torque(x, p) * x.engine_speed,
        "stored_energy": stored_energy(outlets, x, p),
        "dissipated_power": dissipated_power(outlets, leakage, x, p),
        "relief_flow": relief_flow(x, p),
        "engine_load": sum(o.torque for o in outlets),
        "cooling_power": cooling_power(x, p),
    }


def engine_requirements(p: RailParameters, idle_load: Scalar, pumps: str) -> dict[str, Scalar]:
    """Order of the speeds, an engine that can turn the pumps; idle_load [N.m] at rated speed."""
    return {
        "engine_no_load_speed exceeds engine_rated_speed": p.engine_no_load_speed - p.engine_rated_speed,
        "engine_rated_speed exceeds engine_peak_speed": p.engine_rated_speed - p.engine_peak_speed,
        "engine_peak_speed exceeds engine_idle_speed": p.engine_peak_speed - p.engine_idle_speed,
        "engine_idle_speed exceeds engine_stall_speed": p.engine_idle_speed - p.engine_stall_speed,
        f"engine_rated_torque exceeds what turns {pumps} without flow": p.engine_rated_torque - idle_load,
    }
