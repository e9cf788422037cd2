"""Supply by two pressure-compensated pumps on one shaft with a diesel engine.

    C_p p_i' = x_i - k (p_i - P_t) - q_i         outlet line of pump i = 1, 2
    q_i      = r(p_i - P) / R_c                  its check valve: no flow back into the pump
    C_s P'   = q_1 + q_2 - Q - Q_r               supply line: flow Q into the drives, main relief valve
    J w'     = b T - T_f(w) - T_1 - T_2          engine and pumps on one shaft
    V'       = Q_b + leakage + relief - x_1 - x_2        oil in the tank, at constant pressure

with x, b T, T_i and the strokes from `fmus.components.engine_and_pump`, Q_r from `fmus.components.orifice`, r
the `ramp` of `fmus.smooth`; return line (P_b, Q_b) and temperature of the oil from `rail`.
Cavities in the lines as in `fmus.components.chamber`.

    engine_power + P_b return_flow = P supply_flow + dE/dt + heat

engine_power is the power of the combustion, b T w. The heat is that of engine friction, friction and leakage
of the pumps, check valves and relief valve. E is the energy of compression and rotation, P_t V of the tank.

Signs: supply flows are positive out of the supply line, return flows into the tank.
"""

from typing import Any

import casadi as ca

from fmus.components import engine_and_pump
from fmus.components.engine_and_pump import DieselEngine, Pump
from fmus.contract import Group, Quantity, Scalar, nested
from fmus.supply import rail
from fmus.supply.rail import Outlet, RailParameters, Supply, TankParameters
from fmus.supply.variables import line_pressure, variant


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


class LineParameters(RailParameters):
    """Parameters of lines and valves between pumps and drives."""

    pump_line_capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance of the line from each pump to its check valve", 1e-12, minimum=1e-16
    )
    check_resistance: Scalar = Quantity(
        "Pa.s/m3", "Resistance of each check valve with its line", 1e8, minimum=1e3
    )


class EnginePumpParameters(LineParameters, PumpParameters, TankParameters, engine=DieselEngine):
    """Parameters; values and sources are in parameters.toml."""

    @property
    def pumps(self) -> dict[str, Pump]:
        """Parameters of both pumps."""
        settings = {"pump_1": self.pump_1_pressure_setting, "pump_2": self.pump_2_pressure_setting}
        return {
            name: Pump(
                displacement=self.pump_displacement,
                leakage=self.pump_leakage,
                pressure_friction=self.pump_pressure_friction,
                viscous_friction=self.pump_viscous_friction,
                setting=setting,
                band=self.compensator_band,
                rounding=self.compensator_rounding,
                lag=self.compensator_lag,
                stroke_time=self.pump_stroke_time,
                destroke_time=self.pump_destroke_time,
            )
            for name, setting in settings.items()
        }


STATES, OUTPUTS = rail.variables(
    {"pump_1": "pump 1", "pump_2": "pump 2"},
    "both pumps",
    ("supply_pressure",),
    relief_flow=rail.RELIEF_FLOW,
)


def _supply(x: Any, u: Any, p: EnginePumpParameters) -> Supply:
    line = (p.check_resistance, p.pump_line_capacitance)
    return Supply([Outlet.of(name, pump, line, x, p) for name, pump in p.pumps.items()], u, x, p)


def dynamics(x: Any, u: Any, p: EnginePumpParameters) -> Any:
    """Time derivative of the state, field by field."""
    whole = _supply(x, u, p)
    strokes = {
        f"{o.name}_stroke": engine_and_pump.stroke_rate(o.pump, o.stroke, o.pressure) for o in whole.pumps
    }
    return nested(type(x), whole.rates() | strokes)


def observe(x: Any, u: Any, p: EnginePumpParameters) -> dict[str, Scalar]:
    """States, outputs and heats by name."""
    known = _supply(x, u, p).outputs()
    load = line_pressure(u, p, ca.fmax(p.pump_1_pressure_setting, p.pump_2_pressure_setting))
    return known | {"load_sensing_pressure": load.value, "load_sensing_pressure_rate": load.rate}


def initial(x: Any, u: Any, p: EnginePumpParameters) -> dict[str, Scalar]:
    """Initial state without flow into the drives: pumps at dead head, governed engine."""
    speed = p.engine.no_load_speed
    for _ in range(engine_and_pump.ITERATIONS):
        speed = engine_and_pump.governed_speed(p.engine, _idle_load(p, speed), speed)
    tank, pumps = p.reservoir_pressure, {n: rail.at_start(pump, p) for n, pump in p.pumps.items()}
    found = {n: engine_and_pump.dead_head(pump, speed, tank) for n, pump in pumps.items()}
    return {
        "supply_pressure": ca.fmax(*(pressure for _, pressure in found.values())),
        **{f"{n}_pressure": pressure for n, (_, pressure) in found.items()},
        **{f"{n}_stroke": stroke for n, (stroke, _) in found.items()},
        **rail.start(p, speed),
    }


def _idle_load(p: EnginePumpParameters, speed: Scalar) -> Scalar:
    """Torque [N.m] of both pumps at dead head."""
    load: Scalar = 0
    for d in (rail.at_start(pump, p) for pump in p.pumps.values()):
        stroke, pressure = engine_and_pump.dead_head(d, speed, p.reservoir_pressure)
        load = load + engine_and_pump.torque(d, stroke, speed, pressure - p.reservoir_pressure)
    return load


def require(x: Any, u: Any, p: EnginePumpParameters) -> dict[str, Scalar]:
    """Requirements: order of pressure settings and of speeds, an engine that can turn the pumps."""
    settings = {f"{name}_pressure_setting": pump.setting for name, pump in p.pumps.items()}
    return {
        **{f"{n} exceeds reservoir_pressure": x - p.reservoir_pressure for n, x in settings.items()},
        **{f"relief_pressure exceeds {n}": p.relief.pressure - x for n, x in settings.items()},
        **rail.engine_requirements(p, _idle_load(p, p.engine.rated_speed), "both pumps"),
    }


ENGINE_PUMP = variant(
    text="Hydraulic supply: two pressure-compensated pumps on a diesel engine",
    parameters=EnginePumpParameters,
    states=STATES,
    outputs=OUTPUTS,
    dynamics=dynamics,
    observe=observe,
    circuits=lambda x, u, p: {"supply": _supply(x, u, p).circuit},
    initial=initial,
    require=require,
    step=rail.STEP,
    validity="engine above 800 rpm; mean flows: no ripple of the pistons, no waves in the supply line",
)
