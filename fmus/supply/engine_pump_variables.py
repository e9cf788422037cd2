"""Variables of the supply with engine and pumps; signs as in engine_pump.py."""

from __future__ import annotations

from fmus.components.engine_and_pump import Engine, Pump
from fmus.components.orifice import PressureValve
from fmus.contract import Group, Quantity, Scalar
from fmus.supply.variables import ReservoirParameters, SupplyOutputs


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


class EngineParameters(Group):
    """The diesel."""

    engine_rated_speed: Scalar = Quantity("rad/s", "Speed at rated power", 100.0, minimum=1.0, group="Engine")
    engine_rated_torque: Scalar = Quantity("N.m", "Torque at the shaft at rated power", 100.0, minimum=1.0)
    engine_peak_speed: Scalar = Quantity("rad/s", "Speed of the largest torque", 100.0, minimum=1.0)
    engine_torque_rise: Scalar = Quantity("1", "Largest torque over rated torque, less 1", minimum=0.0)
    engine_no_load_speed: Scalar = Quantity(
        "rad/s", "Speed at which the governor leaves no torque", 100.0, minimum=1.0
    )
    engine_friction: Scalar = Quantity(
        "N.m", "Friction of the engine that does not depend on speed", 10.0, minimum=0.0
    )
    engine_viscous_friction: Scalar = Quantity(
        "N.m.s/rad", "Friction of the engine in proportion to speed", minimum=0.0
    )
    engine_inertia: Scalar = Quantity("kg.m2", "Inertia of engine, flywheel and pumps", minimum=1e-3)
    engine_lag: Scalar = Quantity("s", "Time constant from governor to torque", 0.1, minimum=1e-6)


class EnginePumpParameters(EngineParameters, LineParameters, PumpParameters, ReservoirParameters):
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

    @property
    def relief(self) -> PressureValve:
        """The main relief valve these numbers describe."""
        return PressureValve(self.relief_pressure, self.relief_gain, self.relief_rounding)

    @property
    def engine(self) -> Engine:
        """The engine these numbers describe."""
        return Engine(
            self.engine_rated_speed,
            self.engine_rated_torque,
            self.engine_peak_speed,
            self.engine_torque_rise,
            self.engine_no_load_speed,
            self.engine_friction,
            self.engine_viscous_friction,
            self.engine_inertia,
            self.engine_lag,
        )


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
