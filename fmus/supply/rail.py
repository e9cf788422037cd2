"""What supplies with pumps have in common: lines with their valves, engine, and the heat of the oil.

    C_p p' = x - k (p - P_t) - q           outlet line of a pump
    q      = r(p - P) / R_c                its check valve: no flow back into the pump
    C_s P' = sum q - Q - Q_r - Q_l         supply line: flow Q into the drives, main relief valve, leakage
    J w'   = b T - T_f(w) - sum T_i        engine and pumps on one shaft
    C_b P_b' = Q_return - Q_b              return line of the drives, preloaded by a check valve
    Q_b    = (r(P_b - P_t - p_b) - a r(P_t - P_b)) / R_b + Q_f       into the tank; a second one draws there
    C th'  = heat - (G + G_c lim((th - th_c)/band)) (th - th_a)        temperature of the oil, with a cooler

with x, b T, T_i from `fmus.components.engine_and_pump`, Q_r and the bypass valve of the filter, Q_f at P_b -
P_t - p_b, from `fmus.components.orifice`, r the `ramp` of `fmus.smooth`. Cavities in the lines as in
`fmus.components.chamber`. Leakage and drag of the pumps follow from the temperature of the oil
(`fmus.components.oil`); the resistances of check valves, filter and cooler are constants.

**Suction.** Pumps have the share a = s(2 V/V_s - 1) of their displacement, with the oil V in the tank and s
the `s_curve` of `smooth`: below V_s they draw air too, at V_s/2 and below only air, so V stays positive.

The heat is that of all losses but those of the engine, and the power that the drives take: over a cycle it
ends in the oil, because the arm comes back to its height. In between, the error is the potential energy of
the arm, 0.1 K. Friction outside the oil is counted too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import casadi as ca

from fmus.components import engine_and_pump, oil
from fmus.components.additions import Addition, Place
from fmus.components.circuit import GROUND, HEATS, Branch, Circuit, Kind, Node
from fmus.components.engine_and_pump import Pump
from fmus.components.orifice import PressureValve
from fmus.contract import Group, Quantity, Scalar, Subsystem, flat, make_group, nested, quantities, unknown
from fmus.smooth import s_curve, unit_limited
from fmus.supply.variables import CommonParameters, SupplyOutputs, consumers

RESERVOIR = "reservoir_pressure"  # node of the tank
# Longest communication step [s]: a third of the time constant of the supply line with three compensated
# sections fully open, 0.8 ms. At 1 ms the rate of its pressure leads to a steady and wrong motion.
STEP = 2.5e-4
_FAN_ROUNDING = 0.02  # share of the cooler's band over which its ends are rounded


class MainRelief(PressureValve):
    """The main relief valve."""

    pressure: Scalar = Quantity(
        "Pa", "Pressure above the tank at which the main relief valve opens", 1e7, minimum=1e5, group="Lines"
    )
    gain: Scalar = Quantity(
        "m3/(s.Pa)",
        "Flow of the main relief valve per pressure above the opening pressure",
        1e-9,
        minimum=0.0,
    )
    rounding: Scalar = Quantity(
        "Pa", "Pressure range over which the main relief valve begins to open", 1e5, minimum=1.0
    )


class RailParameters(Group, relief=MainRelief):
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


class TankParameters(CommonParameters, return_bypass=(PressureValve, "return filter bypass")):
    """Parameters of return line, tank and cooler."""

    suction_volume: Scalar = Quantity(
        "m3",
        "Volume of oil in the tank below which pumps draw air too; at half of it only air",
        0.1,
        minimum=1e-6,
        group="Tank",
    )
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
    ambient_temperature: Scalar = Quantity("K", "Temperature of the air", 300.0, minimum=223.15, group="Heat")
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
    oil_temperature: Scalar = quantities(SupplyOutputs)["oil_temperature"]
    reservoir_volume: Scalar = Quantity("m3", "Volume of oil in the tank", 0.1)


class ShaftOutputs(SupplyOutputs):
    """Outputs of every variant, viscosity, and three that are zero while engine and tank are in range."""

    oil_viscosity: Scalar = Quantity(
        "m2/s",
        "Kinematic viscosity of the oil in the tank",
        1e-5,
        warn_above=1e-3,
        meaning="cold oil: pumps of the class start at up to 1600 mm2/s, without load and for a short time; "
        "lags of valves and load sensing, check valves, filter and friction of pistons are those of warm oil",
    )
    reservoir_volume_below_suction: Scalar = Quantity(
        "m3",
        "Oil that the tank lacks to its suction_volume, else zero",
        0.01,
        warn_above=0.0,
        meaning="the pumps draw air and lose their flow",
    )
    engine_speed_below_idle: Scalar = Quantity(
        "rad/s",
        "Speed that the engine lacks to its idle speed, else zero",
        100.0,
        warn_above=0.0,
        meaning="the engine is overloaded: it falls below its idle speed",
    )
    engine_speed_below_stall: Scalar = Quantity(
        "rad/s",
        "Speed that the engine lacks to its stall speed, else zero",
        100.0,
        warn_above=0.0,
        meaning="the engine has stalled and does not start again",
    )


class PumpOutputs(Group):
    """Of a pump; pressure and stroke are states."""

    pressure: Scalar = Quantity("Pa", "Pressure at the outlet of {}", 1e7)
    stroke: Scalar = Quantity("1", "Stroke of {} relative to its full stroke")
    flow: Scalar = Quantity("m3/s", "Flow from {} through its check valve", 1e-3)


class EngineOutputs(Group):
    """Of engine and tank."""

    engine_speed: Scalar = quantities(ShaftState)["engine_speed"]
    engine_torque: Scalar = Quantity("N.m", "Torque of the combustion", 100.0)
    engine_load: Scalar = Quantity("N.m", "Torque of {} on the engine", 100.0)
    cooling_power: Scalar = Quantity("W", "Heat from tank and cooler to the air", 1e4)
    reservoir_volume: Scalar = quantities(ShaftState)["reservoir_volume"]


def variables(
    pumps: Mapping[str, str], load: str, lines: Sequence[str], **others: Quantity
) -> tuple[type[Any], type[Any]]:
    """States and outputs of a supply with pumps.

    pumps    begin of the names of each one -> the pump in texts
    load     all of them in a text
    lines    pressures that are states beside those of the pumps
    others   further outputs
    """
    line, of = quantities(SupplyOutputs), dict[str, Quantity]()
    for n, q in quantities(PumpOutputs).items():
        of |= {f"{pump}_{n}": q.of(text, str) for pump, text in pumps.items()}
    states = {n: line[n] for n in lines} | {n: q for n, q in of.items() if not n.endswith("flow")}
    outputs = make_group("Outputs", of | others, ShaftOutputs)
    of_engine = {n: q.of(load, str) for n, q in quantities(EngineOutputs).items()}
    return make_group("State", states | dict(quantities(ShaftState))), make_group(
        "Outputs", of_engine, outputs
    )


RELIEF_FLOW = Quantity("m3/s", "Flow through the main relief valve", 1e-3)


@dataclass(frozen=True)
class Outlet:
    """A pump at work on the line to its check valve.

    name                      of the pump, in the names of its variables
    pump                      with the oil at its temperature
    resistance, capacitance   of check valve [Pa.s/m3] and line [m3/Pa]
    pressure, stroke          states [Pa, 1]
    """

    name: str
    pump: Pump
    resistance: Scalar
    capacitance: Scalar
    pressure: Scalar
    stroke: Scalar

    @classmethod
    def of(cls, name: str, pump: Pump, line: tuple[Scalar, Scalar], x: Any, p: TankParameters) -> Outlet:
        """A pump with the oil at its temperature, as far as it is in the tank."""
        drawn = replace(pump, displacement=pump.displacement * oil_share(x, p))
        warm = engine_and_pump.at_viscosity(drawn, oil.viscosity_ratio(x.oil_temperature, p))
        return cls(name, warm, *line, getattr(x, f"{name}_pressure"), getattr(x, f"{name}_stroke"))

    def circuit(self, speed: Scalar, p: RailParameters) -> Circuit:
        """From the tank to the supply line, at a speed of the engine."""
        node, check = f"{self.name}_pressure", (self.resistance, p.check_opening)
        suction = engine_and_pump.suction_flow(self.pump, self.stroke, speed)
        return Circuit(
            {node: Node(self.pressure, "C_p", self.capacitance)},
            {
                self.name: Branch(RESERVOIR, node, Kind.PUMP, suction, "D_p"),
                f"{self.name}_leakage": Branch(
                    node, RESERVOIR, Kind.LEAKAGE, lambda rise: self.pump.leakage * rise, "k"
                ),
                f"{self.name}_flow": Branch(
                    node, "supply_pressure", Kind.CHECK, partial(engine_and_pump.check_flow, *check), "R_c"
                ),
            },
        )


def oil_share(x: ShaftState, p: TankParameters) -> Scalar:
    """Share a of oil in what is drawn from the tank."""
    return s_curve(2 * x.reservoir_volume / p.suction_volume - 1)


@dataclass(frozen=True)
class Supply:
    """A supply with pumps at one instant: pumps, inputs, state, parameters, branches of the variant."""

    pumps: Sequence[Outlet]
    u: Any
    x: ShaftState
    p: Any
    branches: Mapping[str, Branch] = field(default_factory=dict)

    @cached_property
    def circuit(self) -> Circuit:
        """From the tank over pumps and drives back to the tank."""
        x, p = self.x, self.p
        whole = Circuit(
            {
                RESERVOIR: Node(p.reservoir_pressure, "P_t"),
                GROUND: Node(0),
                "supply_pressure": Node(x.supply_pressure, "C_s", p.rail_capacitance),
                "tank_pressure": Node(x.tank_pressure, "C_b", p.return_capacitance),
            },
            {
                **consumers(self.u),
                "relief_flow": Branch("supply_pressure", RESERVOIR, Kind.RELIEF, p.relief.flow, "Q_relief"),
                "return_check": Branch("tank_pressure", RESERVOIR, Kind.RETURN, self._into_tank, "R_b"),
                **self.branches,
            },
        )
        for pump in self.pumps:
            whole |= pump.circuit(x.engine_speed, p)
        for name, added in additions(p):
            whole |= added.added(Place(name, whole, getattr(x, name, None), self.u, p, p))
        return whole

    def _into_tank(self, drop: Scalar) -> Scalar:
        """Flow Q_b [m3/s] from the return line into the tank."""
        p, back = self.p, drop - self.p.return_preload
        valve = partial(engine_and_pump.check_flow, p.return_resistance, p.check_opening)
        return valve(back) + p.return_bypass.flow(back) - oil_share(self.x, p) * valve(-drop)

    def _rise(self, pump: Outlet) -> Scalar:
        return pump.pressure - self.p.reservoir_pressure

    @property
    def load(self) -> Scalar:
        """Torque [N.m] of all pumps."""
        return sum(
            engine_and_pump.torque(o.pump, o.stroke, self.x.engine_speed, self._rise(o)) for o in self.pumps
        )

    @property
    def engine_torque(self) -> Scalar:
        """Torque [N.m] of the combustion."""
        burning = engine_and_pump.burning_share(self.p.engine, self.x.engine_speed)
        return burning * self.x.engine_fuel_torque

    @cached_property
    def heats(self) -> dict[str, Scalar]:
        """Heat [W] by cause."""
        w = self.x.engine_speed
        pumps = sum(engine_and_pump.pump_friction(o.pump, w, self._rise(o)) * w for o in self.pumps)
        engine = engine_and_pump.engine_friction(self.p.engine, w) * w
        return {**self.circuit.heats, "pump_friction_heat": pumps, "engine_friction_heat": engine}

    @property
    def oil_heat(self) -> Scalar:
        """Heat [W] of all losses but those of the engine."""
        return sum(heat for cause, heat in self.heats.items() if cause != "engine_friction_heat")

    @property
    def cooling_power(self) -> Scalar:
        """Heat [W] from the oil to the air."""
        p, temperature = self.p, self.x.oil_temperature
        fan = unit_limited((temperature - p.cooler_setting) / p.cooler_band, _FAN_ROUNDING)
        return (p.tank_conductance + p.cooler_conductance * fan) * (temperature - p.ambient_temperature)

    def rates(self) -> dict[str, Scalar]:
        """Time derivatives of all pressures and of `ShaftState`, by name."""
        x, p, engine = self.x, self.p, self.p.engine
        heat = self.circuit.work(Kind.CONSUMER) + self.oil_heat
        return {
            **self.circuit.rates,
            "engine_speed": engine_and_pump.speed_rate(engine, x.engine_speed, self.engine_torque, self.load),
            "engine_fuel_torque": engine_and_pump.torque_rate(engine, x.engine_speed, x.engine_fuel_torque),
            "oil_temperature": (heat - self.cooling_power) / p.heat_capacity,
            "reservoir_volume": self.circuit.into(RESERVOIR),
        }

    def outputs(self) -> dict[str, Scalar]:
        """States and outputs by name."""
        x, p, w = self.x, self.p, self.x.engine_speed
        rotation = p.engine.inertia * w**2 / 2
        return {
            **flat(x),
            **self.circuit.flows,
            "oil_viscosity": oil.kinematic_viscosity(x.oil_temperature, p),
            "supply_pressure_rate": self.circuit.rates["supply_pressure"],
            "tank_pressure_rate": self.circuit.rates["tank_pressure"],
            "hydraulic_power": self.circuit.work(Kind.CONSUMER),
            "reservoir_volume_below_suction": ca.fmax(p.suction_volume - x.reservoir_volume, 0),
            "engine_speed_below_idle": ca.fmax(p.engine.idle_speed - w, 0),
            "engine_speed_below_stall": ca.fmax(p.engine.stall_speed - w, 0),
            "engine_torque": self.engine_torque,
            "engine_power": self.engine_torque * w,
            "engine_load": self.load,
            "stored_energy": self.circuit.stored_energy
            + rotation
            + p.reservoir_pressure * x.reservoir_volume,
            **self.heats,
            "dissipated_power": sum(self.heats.values()),
            "cooling_power": self.cooling_power,
        }


def with_heats(sub: Subsystem) -> Subsystem:
    """The subsystem with an output for each heat that it has; its `observe` gives all by name."""
    known = sub.observe(*map(unknown, (sub.states, sub.inputs, sub.parameters)))
    heats = {n: q.of("supply", str) for n, q in HEATS.items() if n in known}
    outputs = make_group("Outputs", heats, sub.outputs)
    return replace(sub, outputs=outputs, observe=lambda x, u, p: nested(outputs, sub.observe(x, u, p)))


def additions(p: Any) -> list[tuple[str, Addition]]:
    """Components beside those of the variant, by name."""
    return [(name, part) for name, part in vars(p).items() if isinstance(part, Addition)]


def start(p: Any, speed: Scalar) -> dict[str, Scalar]:
    """Initial engine at a governed speed, return line, temperature and volume of the oil, without flow."""
    return {
        "engine_speed": speed,
        "engine_fuel_torque": engine_and_pump.governor_torque(p.engine, speed),
        **{f"{name}_{n}": value for name, added in additions(p) for n, value in added.start().items()},
        "tank_pressure": return_pressure(p),
        "oil_temperature": p.oil_temperature_start,
        "reservoir_volume": p.reservoir_volume_start,
    }


def return_pressure(p: Any) -> Scalar:
    """Pressure [Pa] of the return line without flow."""
    return p.reservoir_pressure + p.return_preload


def at_start(pump: Pump, p: TankParameters) -> Pump:
    """A pump at the initial temperature of the oil."""
    return engine_and_pump.at_viscosity(pump, oil.viscosity_ratio(p.oil_temperature_start, p))


def engine_requirements(p: Any, idle_load: Scalar, pumps: str) -> dict[str, Scalar]:
    """Order of the speeds, an engine that can turn the pumps; idle_load [N.m] at rated speed."""
    return {
        "engine_no_load_speed exceeds engine_rated_speed": p.engine.no_load_speed - p.engine.rated_speed,
        "engine_rated_speed exceeds engine_peak_speed": p.engine.rated_speed - p.engine.peak_speed,
        "engine_peak_speed exceeds engine_idle_speed": p.engine.peak_speed - p.engine.idle_speed,
        "engine_idle_speed exceeds engine_stall_speed": p.engine.idle_speed - p.engine.stall_speed,
        f"engine_rated_torque exceeds what turns {pumps} without flow": p.engine.rated_torque - idle_load,
    }
