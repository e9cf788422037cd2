"""What supplies with pumps have in common: outlet lines, check valves, supply line with relief valve, engine.

    C_p p' = x - k (p - P_t) - q           outlet line of a pump
    q      = r(p - P) / R_c                its check valve: no flow back into the pump
    C_s P' = sum q - Q - Q_r - Q_l         supply line: flow Q into the drives, main relief valve, leakage
    J w'   = T - T_f(w) - sum T_i          engine and pumps on one shaft

with x, T, T_i from `fmus.components.engine_and_pump`, Q_r from `fmus.components.orifice`, r the `ramp` of
`fmus.components.smooth`. Cavities in the lines as in `fmus.components.chamber`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from fmus.components import chamber, engine_and_pump, orifice
from fmus.components.engine_and_pump import DieselEngine, Pump
from fmus.components.orifice import PressureValve
from fmus.contract import Group, Quantity, Scalar
from fmus.supply.variables import CommonParameters


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
    """Parameters of a tank whose oil is counted."""

    reservoir_volume_start: Scalar = Quantity("m3", "Initial volume of oil in the tank", 0.1, minimum=0.0)


class ShaftState(Group):
    """Engine, and oil in the tank."""

    engine_speed: Scalar = Quantity("rad/s", "Speed of engine and pumps", 100.0)
    engine_torque: Scalar = Quantity("N.m", "Torque of the combustion", 100.0)
    reservoir_volume: Scalar = Quantity("m3", "Volume of oil in the tank", 0.1)


@dataclass(frozen=True)
class Outlet:
    """A pump at work on its outlet line: pressure and its rise [Pa], flows [m3/s], torque [N.m].

    resistance, capacitance   of check valve [Pa.s/m3] and outlet line [m3/Pa]
    """

    pump: Pump
    resistance: Scalar
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
    return Outlet(
        pump,
        *(resistance, capacitance, pressure, rise),
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
    outlets: Sequence[Outlet], returned: Scalar, x: ShaftState, p: RailParameters
) -> dict[str, Scalar]:
    """Time derivatives of `ShaftState`; returned: flow [m3/s] into the tank from drives and leakage."""
    engine, load = DieselEngine.of(p, "engine"), sum(o.torque for o in outlets)
    drained = sum(o.leakage - o.suction for o in outlets) + relief_flow(x, p)
    return {
        "engine_speed": engine_and_pump.speed_rate(engine, x.engine_speed, x.engine_torque, load),
        "engine_torque": engine_and_pump.torque_rate(engine, x.engine_speed, x.engine_torque),
        "reservoir_volume": returned + drained,
    }


def stored_energy(outlets: Sequence[Outlet], x: ShaftState, p: RailParameters) -> Scalar:
    """Energy [J] of compression in all lines, of rotation, and of the oil in the tank."""
    lines = chamber.stored_energy(x.supply_pressure, p.rail_capacitance) + sum(
        chamber.stored_energy(o.pressure, o.capacitance) for o in outlets
    )
    return lines + p.engine_inertia * x.engine_speed**2 / 2 + p.reservoir_pressure * x.reservoir_volume


def dissipated_power(outlets: Sequence[Outlet], leakage: Scalar, x: ShaftState, p: RailParameters) -> Scalar:
    """Heat [W] of pumps, check valves, relief valve, engine friction and rail leakage [m3/s]."""
    line, engine = x.supply_pressure - p.reservoir_pressure, DieselEngine.of(p, "engine")
    pumps = sum(
        engine_and_pump.loss(o.pump, x.engine_speed, o.rise) + o.delivered * (o.rise - line) for o in outlets
    )
    friction = engine_and_pump.engine_friction(engine, x.engine_speed) * x.engine_speed
    return pumps + (relief_flow(x, p) + leakage) * line + friction


def engine_requirements(p: RailParameters, idle_load: Scalar, pumps: str) -> dict[str, Scalar]:
    """Order of the speeds, an engine that can turn the pumps; idle_load [N.m] at rated speed."""
    return {
        "engine_no_load_speed exceeds engine_rated_speed": p.engine_no_load_speed - p.engine_rated_speed,
        "engine_rated_speed exceeds engine_peak_speed": p.engine_rated_speed - p.engine_peak_speed,
        f"engine_rated_torque exceeds what turns {pumps} without flow": p.engine_rated_torque - idle_load,
    }
