"""What may be broken: the table of the unknowns of a machine; limits and time constants (settings.toml)."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fmus.contract import Group, Quantity, Scalar, Subsystem, make_group, quantities
from fmus.controller.arm import Arm, ControlledAxis
from fmus.parameters import Number, values

LITRE = 1 / 6e4  # L/min in m3/s
LINES = {"supply_pressure": "Pressure of the supply line", "tank_pressure": "Pressure of the return line"}
FRICTION = ("dry_friction", "damping", "zero_force")  # of a cylinder
_TABLES = tomllib.loads((Path(__file__).parent / "settings.toml").read_text(encoding="utf-8"))
_ROWS = {n: (heading, row) for heading, rows in _TABLES.items() for n, row in rows.items()}
NUMBERS = {n: Number(row["value"], row["unit"], "assumed", row["note"]) for n, (_, row) in _ROWS.items()}
Settings: type[Group] = make_group(
    "Settings", {n: Quantity(r["unit"], r["text"], abs(r["value"]), group=g) for n, (g, r) in _ROWS.items()}
)


@dataclass(frozen=True)
class Unknown:
    """A size that is estimated: an output, one of its deviation, one of its state.

    unit, text, nominal   of the size
    repair                what a mechanic looks at
    prior                 standard deviation before any data; 0: a cumulative sum tells it, without deviation
    healthy               size of a healthy machine as long as none was measured; None: it is not learned
    """

    unit: str
    text: str
    nominal: float
    repair: str
    prior: float = 0.0
    healthy: float | None = None


Finding = Unknown
_VALVE, _HOSE = "{axis} valve", "{axis} hose"
_OF_MAP = {  # a valve that is another one
    "gain_up": Unknown("1", "Gain of the positive {axis} command", 0.1, _VALVE, 0.5, 1.0),
    "dead_band_up": Unknown(
        "V", "Dead band of the positive {axis} command, more than known", 0.1, _VALVE, 0.5, 0.0
    ),
    "gain_down": Unknown("1", "Gain of the negative {axis} command", 0.1, _VALVE, 0.5, 1.0),
    "dead_band_down": Unknown(
        "V", "Dead band of the negative {axis} command, more than known", 0.1, _VALVE, 0.5, 0.0
    ),
    "half_hysteresis": Unknown("V", "Half of the hysteresis of the {axis} valve", 0.1, _VALVE, 1.0, 0.2),
    "valve_delay": Unknown("s", "Lag of the {axis} valve with that of the readings", 0.1, _VALVE, 0.1, 0.02),
}
MAP = tuple(_OF_MAP)
EDGES = ("return_edge_up", "return_edge_down")
SEAL = Unknown("m3/(s.Pa)", "Leakage past the seals of the {axis}", 1e-12, "{axis} seals", 10.0)
AIR = Unknown("1", "Share of undissolved air in the oil of the {axis}", 0.01, "air", 0.02, 0.0)


def chambers_of(axis: ControlledAxis) -> dict[str, str]:
    """Both chambers: how the names of their findings are made, and words for them."""
    if axis.turns:
        return {"{}_a": "line A", "{}_b": "line B"}
    return {"head_{}": "the head side", "rod_{}": "the rod side"}


def signals_of(axis: ControlledAxis) -> dict[str, str]:
    """Readings of an axis with their units: coordinate, speed, both pressures."""
    names = axis.coordinate[0], axis.speed[0], axis.sides[0][0], axis.sides[1][0]
    return dict(zip(names, (*axis.units, "Pa", "Pa"), strict=True))


def _of_sensors(names: Any) -> dict[str, Unknown]:
    return {f"{n}_sensor": Unknown("1", f"1: the reading of {n} is wrong", 1.0, f"{n} sensor") for n in names}


def of_axis(axis: ControlledAxis) -> dict[str, Unknown]:
    """Of one function, by the full names.

    Without the seals of a motor, whose lines have one pressure on level ground, and without its air.
    """
    ends, leak, burst = chambers_of(axis), "Opening to the outside at {} of the {{axis}}", 1e-3
    loss, edge = "Loss beyond that of the valve at {} of the {{axis}}", "Opening of the return edge over that"
    own = {} if axis.turns else {"seal_leakage": SEAL}
    for mark, end in ends.items():
        own[mark.format("leak")] = Unknown("m2", leak.format(end), 1e-6, _HOSE, 10.0)
    own["valve_opening"] = Unknown("m2", "Opening of the {axis} valve at rest", 1e-6, _VALVE, 10.0)
    own |= {} if axis.turns else {"air": AIR}
    for mark, end in ends.items():
        own[mark.format("burst")] = Unknown("m3/s", loss.format(end), burst, _HOSE)
    own["spool"] = Unknown("1", "1: the {axis} spool does not follow its command", 1.0, _VALVE)
    own |= _OF_MAP
    for n, way in zip(EDGES, ("positive", "negative"), strict=True):
        own[n] = Unknown("1", f"{edge} of the other one, {way} {{axis}} command", 1.0, _VALVE, 0.5, 1.5)
    texts = {n: (u.text.format(axis=axis.name), u.repair.format(axis=axis.name)) for n, u in own.items()}
    named = {f"{axis.name}_{n}": replace(u, text=texts[n][0], repair=texts[n][1]) for n, u in own.items()}
    return named | _of_sensors(signals_of(axis))


OF_MACHINE = {
    "return_resistance": Unknown("Pa.s/m3", "Resistance of the return line", 1e7, "return filter", 0.0, 4e7),
    "pump_pressure": Unknown(
        "Pa", "Supply pressure at 60 L/min, unless it follows the load", 1e6, "pump", 0.0, 0.0
    ),
    "valve_delay": Unknown(
        "s", "Lag of all valves more than that of the healthy machine", 0.01, "pilot filter"
    ),
    "oil_air": Unknown("1", "Undissolved air in the oil more than that of the healthy machine", 0.01, "air"),
    "oil_temperature_high": Unknown("1", "1: the oil is hotter than its limit", 1.0, "cooler"),
    "weighing": Unknown("N", "Mean horizontal force at the tip", 100.0, "pressure sensors"),
}


def tare_of(arm: Arm, manipulator: Subsystem) -> dict[str, Unknown]:
    """Masses beyond the known ones, friction of cylinders: learned without payload, no size is a fault."""
    known, found = values(manipulator).p, dict[str, Unknown]()
    for n in masses_of(manipulator):
        text = f"{n.replace('_', ' ').capitalize()} beyond the known one"
        found[f"{n}_off"] = Unknown("kg", text, 1.0, "tare", max(0.1 * float(known[n]), 1.0), 0.0)
    for a in (a.name for a in arm.axes if not a.turns):
        damping = float(known.get(f"{a}_piston_damping", 0.0))  # of the mechanics
        for n, unit, text, nominal, prior, healthy in (
            (FRICTION[0], "N", "Dry friction of the {} cylinder", 30.0, 2e3, 0.0),
            (FRICTION[1], "N.s/m", "Viscous friction of the {} cylinder", 1e4, 3e4, damping),
            (FRICTION[2], "N", "Force by zeros of the {} pressures", 1e3, 3e3, 0.0),
        ):
            found[f"{a}_{n}"] = Unknown(unit, text.format(a), nominal, "tare", prior, healthy)
    return found


def masses_of(manipulator: Subsystem) -> list[str]:
    """Masses of the arm."""
    return [n for n, q in quantities(manipulator.parameters).items() if q.unit == "kg"]


def findings(arm: Arm, manipulator: Subsystem) -> dict[str, Unknown]:
    """All unknowns, in the order of the outputs."""
    own = {n: u for a in arm.axes for n, u in of_axis(a).items()}
    return own | _of_sensors(LINES) | OF_MACHINE | tare_of(arm, manipulator)


def reference(name: str, p: Any) -> Scalar:
    """Size of the healthy machine, from the parameters; 0 if it is not learned."""
    return getattr(p, f"{name}_reference", 0)
