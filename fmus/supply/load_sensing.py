"""Supply by a load-sensing pump: on a diesel engine, it holds a margin over the highest load.

    tau_L P_L' = min(P_load, P_max) - P_L     load-sensing line: the highest load of the drives, limited
    C_p p'     = x - k (p - P_t) - q          outlet line of the pump
    q          = r(p - P) / R_c               its check valve
    C_s P'     = q - Q - Q_r - k_l (P - P_t)  supply line: drives, main relief valve, pilot oil and spools
    J w'       = b T - T_f(w) - T_1           engine and pump on one shaft
    V'         = Q_b + leakage + relief - x          oil in the tank, at constant pressure

    s' : lag and speed limits of the swash plate towards
         lim(min((P_L + margin - p) / band,  (P_off - p) / band_off,  T_max / (D dp)))

Return line (Q_b) and temperature of the oil, from which k and k_l follow, are those of `rail`. P_load is the
highest load pressure (`fmus.components.load_sensing`). The orifice of the line and its relief
valve, P_max = P_off - difference, take no flow from the drives; in practice it is at most a few L/min. A
stalled stroke raises P_L to P_max; with a difference below the margin the pump then runs at its cut-off.

The lowest of margin, cut-off and power limit determines the stroke (`fmus.components.engine_and_pump`), so at
rest of all states the supply pressure is

    P = P_L + margin - band s - drop of the check valve          s = (q + k (p - P_t)) / (D w)

while the pump has stroke and the engine power to spare. An engine that cannot carry T_max and the friction of
the pump, 35 N.m at 3000 psi, stalls under load. Without flow the check valve stays closed until pilot oil
and leaking spools, k_l, have lowered P after a stroke.

    engine_power + P_t return_flow = P supply_flow + dE/dt + heat

as in `fmus.supply.engine_pump`; the heat includes k_l (P - P_t)^2.

References: Ivantysyn and Ivantysynova, Hydrostatic Pumps and Motors, 2001, ch. 9; Merritt, Hydraulic Control
Systems, 1967; data sheets of open-circuit pumps with pressure, flow and power control.

Signs: supply flows are positive out of the supply line, return flows into the tank.
"""

from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import casadi as ca

from fmus.components import engine_and_pump, load_sensing, oil
from fmus.components.circuit import Branch, Kind
from fmus.components.engine_and_pump import DieselEngine, Pump
from fmus.components.load_sensing import LoadPressure
from fmus.contract import Group, Quantity, Scalar, nested
from fmus.smooth import ramp_inverse
from fmus.supply import rail
from fmus.supply.rail import RESERVOIR, Outlet, RailParameters, Supply, TankParameters
from fmus.supply.variables import limited, line_pressure, variant

_LEAST_DROP = 1e-60  # Pa, for the inverse of `ramp`, which is not defined at 0
_ITERATIONS = 20  # of check valve and engine at standby; each gains about a digit


class MainPump(Group):
    """Parameters of the pump, its servo and its outlet line."""

    displacement: Scalar = Quantity(
        "m3/rad", "Displacement of the pump on full stroke", 1e-5, minimum=1e-9, group="Pump"
    )
    leakage: Scalar = Quantity("m3/(s.Pa)", "Leakage of the pump to its case", 1e-12, minimum=1e-17)
    pressure_friction: Scalar = Quantity(
        "1", "Friction of the pump under pressure, share of the full torque", minimum=0.0
    )
    viscous_friction: Scalar = Quantity("N.m.s/rad", "Viscous friction of the pump", minimum=0.0)
    rounding: Scalar = Quantity(
        "1",
        "Share of the stroke over which its ends and the change of regulators are rounded",
        minimum=1e-6,
        maximum=0.5,
    )
    lag: Scalar = Quantity("s", "Time constant of the swash plate for small changes", minimum=1e-6)
    stroke_time: Scalar = Quantity("s", "Shortest time from no stroke to full", minimum=1e-6)
    destroke_time: Scalar = Quantity("s", "Shortest time from full stroke to none", minimum=1e-6)
    line_capacitance: Scalar = Quantity(
        "m3/Pa", "Capacitance of the line from the pump to its check valve", 1e-12, minimum=1e-16
    )
    check_resistance: Scalar = Quantity(
        "Pa.s/m3", "Resistance of the check valve with its line", 1e8, minimum=1e3
    )


class Regulators(Group, main_pump=MainPump):
    """Parameters of the regulators and of the load-sensing line."""

    margin: Scalar = Quantity(
        "Pa",
        "Pressure above the load-sensing line at which the stroke is zero",
        1e6,
        minimum=1e4,
        group="Regulators",
    )
    margin_band: Scalar = Quantity(
        "Pa", "Pressure by which the margin falls from no stroke to full stroke", 1e6, minimum=1.0
    )
    pressure_cut_off: Scalar = Quantity(
        "Pa", "Pressure at which the cut-off makes the stroke zero", 1e7, minimum=1e5
    )
    cut_off_band: Scalar = Quantity(
        "Pa",
        "Pressure by which the pump falls from no stroke to full stroke at the cut-off",
        1e6,
        minimum=1.0,
    )
    torque_limit: Scalar = Quantity(
        "N.m", "Torque of the swash plate, without friction, that the power limit allows", 100.0, minimum=1.0
    )
    load_sensing_lag: Scalar = Quantity("s", "Time constant of the load-sensing line", minimum=1e-6)
    rail_leakage: Scalar = Quantity(
        "m3/(s.Pa)", "Pilot oil and leakage of spools from the supply line to the tank", 1e-12, minimum=1e-17
    )


class LoadSensingParameters(RailParameters, Regulators, TankParameters, engine=DieselEngine):
    """Parameters; values and sources are in parameters.toml."""

    def pump(self, load_sensing_pressure: Scalar) -> Pump:
        """Parameters of the pump; its setting is the load-sensing pressure plus the margin."""
        d = self.main_pump
        return Pump(
            *(d.displacement, d.leakage, d.pressure_friction, d.viscous_friction),
            *(load_sensing_pressure + self.margin, self.margin_band),
            *(d.rounding, d.lag, d.stroke_time, d.destroke_time),
        )


STATES, OUTPUTS = rail.variables(
    {"pump": "the pump"},
    "the pump",
    ("supply_pressure", "load_sensing_pressure"),
    pressure_margin=Quantity("Pa", "Supply pressure above the load-sensing pressure", 1e6),
    relief_flow=rail.RELIEF_FLOW,
    rail_leakage_flow=Quantity("m3/s", "Pilot oil and leakage of spools", 1e-5),
)


def _supply(x: Any, u: Any, p: LoadSensingParameters) -> Supply:
    line = (p.main_pump.check_resistance, p.main_pump.line_capacitance)
    bleed = p.rail_leakage / oil.viscosity_ratio(x.oil_temperature, p)
    leakage = Branch("supply_pressure", RESERVOIR, Kind.LEAKAGE, lambda drop: bleed * drop, "k_l")
    pumps = [Outlet.of("pump", p.pump(x.load_sensing_pressure), line, x, p)]
    return Supply(pumps, u, x, p, {"rail_leakage_flow": leakage})


def dynamics(x: Any, u: Any, p: LoadSensingParameters) -> Any:
    """Time derivative of the state, field by field."""
    pump = p.pump(x.load_sensing_pressure)
    target = engine_and_pump.limited_stroke(
        *(pump, p.pressure_cut_off, p.cut_off_band, p.torque_limit, x.pump_pressure),
        x.pump_pressure - p.reservoir_pressure,
    )
    load = line_pressure(u, p, p.pressure_cut_off).value
    rates = dict(
        **_supply(x, u, p).rates(),
        load_sensing_pressure=(load - x.load_sensing_pressure) / p.load_sensing_lag,
        pump_stroke=engine_and_pump.servo_rate(pump, x.pump_stroke, target),
    )
    return nested(type(x), rates)


def observe(x: Any, u: Any, p: LoadSensingParameters) -> dict[str, Scalar]:
    """States, outputs and heats by name."""
    return _supply(x, u, p).outputs() | {
        "load_sensing_pressure_rate": dynamics(x, u, p).load_sensing_pressure,
        "pressure_margin": x.supply_pressure - x.load_sensing_pressure,
    }


def _standby_line(u: Any, p: LoadSensingParameters) -> Scalar:
    """Pressure [Pa] of the load-sensing line with all valves closed: that of the return line."""
    closed = [LoadPressure(rail.return_pressure(p), 0) for _ in vars(u)]
    return limited(reduce(load_sensing.highest, closed), p, p.pressure_cut_off).value


@dataclass(frozen=True)
class _Standby:
    """Standby: speed [rad/s], stroke, outlet and supply pressure [Pa], torque [N.m] of the pump."""

    speed: Scalar
    stroke: Scalar
    pump_pressure: Scalar
    supply_pressure: Scalar
    load: Scalar


def _standby(u: Any, p: LoadSensingParameters, speed: Scalar, engine: DieselEngine | None = None) -> _Standby:
    """Standby at a speed, or at the governed speed of an engine, searched from `speed`.

    The flow of the pump only covers leakage. The check valve passes the leakage of the supply line with a
    drop z, so both leakages together are k + k_l (1 - z/dp) per pressure rise dp of the pump.
    """
    tank, pump = p.reservoir_pressure, rail.at_start(p.pump(_standby_line(u, p)), p)
    bleed = p.rail_leakage / oil.viscosity_ratio(p.oil_temperature_start, p)
    passed: Scalar = 0  # leakage of the supply line per pressure rise of the pump
    for iteration in range(_ITERATIONS):
        leaking = replace(pump, leakage=pump.leakage + passed)
        stroke, pressure = engine_and_pump.dead_head(leaking, speed, tank)
        rise = pressure - tank
        pressure_loss = ca.fmax(passed * rise * p.main_pump.check_resistance, _LEAST_DROP)
        drop = ramp_inverse(pressure_loss, p.check_opening)
        passed = bleed * (1 - drop / rise)
        load = engine_and_pump.torque(pump, stroke, speed, rise)
        if engine is not None and iteration < _ITERATIONS - 1:
            speed = engine_and_pump.governed_speed(engine, load, speed)
    return _Standby(speed, stroke, pressure, pressure - drop, load)


def initial(x: Any, u: Any, p: LoadSensingParameters) -> dict[str, Scalar]:
    """Standby: all valves closed, governed engine under the small load of the pump."""
    found = _standby(u, p, p.engine.no_load_speed, p.engine)
    return {
        "supply_pressure": found.supply_pressure,
        "load_sensing_pressure": _standby_line(u, p),
        "pump_pressure": found.pump_pressure,
        "pump_stroke": found.stroke,
        **rail.start(p, found.speed),
    }


def require(x: Any, u: Any, p: LoadSensingParameters) -> dict[str, Scalar]:
    """Requirements: order of pressures and speeds; engine and power limit allow the pump's standby."""
    standby, d = _standby(u, p, p.engine.rated_speed), p.main_pump
    rise = standby.pump_pressure - p.reservoir_pressure
    return {
        "margin exceeds margin_band": p.margin - p.margin_band,
        "load_sensing_relief_difference is not above margin": p.margin - p.load_sensing_relief_difference + 1,
        "pressure_cut_off exceeds return line, margin and load_sensing_relief_difference": (
            p.pressure_cut_off - p.load_sensing_relief_difference - rail.return_pressure(p) - p.margin
        ),
        "relief_pressure exceeds pressure_cut_off": p.relief.pressure - p.pressure_cut_off,
        "torque_limit exceeds what the swash plate takes without flow": (
            p.torque_limit - d.displacement * rise * (standby.stroke + d.rounding)
        ),
        **rail.engine_requirements(p, standby.load, "the pump"),
    }


LOAD_SENSING = variant(
    text="Hydraulic supply: a load-sensing pump on a diesel engine",
    parameters=LoadSensingParameters,
    states=STATES,
    outputs=OUTPUTS,
    dynamics=dynamics,
    observe=observe,
    circuits=lambda x, u, p: {"supply": _supply(x, u, p).circuit},
    initial=initial,
    require=require,
    step=rail.STEP,
    validity="engine above 800 rpm; mean flows: no ripple of the pistons, no waves in the lines",
)
