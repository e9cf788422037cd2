"""What may be broken (unknowns.toml); limits and time constants of the diagnosis (settings.toml)."""

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


def _read(name: str) -> dict[str, Any]:
    return tomllib.loads((Path(__file__).parent / name).read_text(encoding="utf-8"))


_ROWS = {n: (group, row) for group, rows in _read("settings.toml").items() for n, row in rows.items()}
NUMBERS = {n: Number(row["value"], row["unit"], "assumed", row["note"]) for n, (_, row) in _ROWS.items()}
Settings: type[Group] = make_group(
    "Settings", {n: Quantity(r["unit"], r["text"], abs(r["value"]), group=g) for n, (g, r) in _ROWS.items()}
)


@dataclass(frozen=True)
class Unknown:
    """A size that is estimated: an output, one of its deviation, one of its state. See unknowns.toml."""

    unit: str
    text: str
    nominal: float
    repair: str
    prior: float = 0.0
    healthy: float | None = None
    of: str = ""
    words: str = ""

    def named(self, name: str, prior: float = 0.0, healthy: float | None = None) -> Unknown:
        """Of an axis, a reading, a mass."""
        text, repair, words = (t.replace("{}", name) for t in (self.text, self.repair, self.words))
        known = self.healthy if healthy is None else healthy
        return replace(self, text=text, repair=repair, words=words, prior=prior or self.prior, healthy=known)


TABLE = {k: {n: Unknown(**row) for n, row in rows.items()} for k, rows in _read("unknowns.toml").items()}
MAP, EDGES, FRICTION = (tuple(TABLE[k]) for k in ("map", "edges", "cylinder"))
OF_AXIS = TABLE["axis"] | TABLE["map"] | TABLE["edges"]


def chambers_of(axis: ControlledAxis) -> tuple[str, str]:
    """How the names of findings of both chambers are made."""
    return ("{}_a", "{}_b") if axis.turns else ("head_{}", "rod_{}")


def signals_of(axis: ControlledAxis) -> dict[str, str]:
    """Readings of an axis with their units: coordinate, speed, both pressures."""
    names = axis.coordinate[0], axis.speed[0], axis.sides[0][0], axis.sides[1][0]
    return dict(zip(names, (*axis.units, "Pa", "Pa"), strict=True))


def _of_sensors(names: Any) -> dict[str, Unknown]:
    return {f"{n}_sensor": TABLE["sensor"]["sensor"].named(n) for n in names}


def of_axis(axis: ControlledAxis) -> dict[str, Unknown]:
    """Of one function, by the full names."""
    other = "cylinder" if axis.turns else "motor"
    own = {f"{axis.name}_{n}": u.named(axis.name) for n, u in OF_AXIS.items() if u.of != other}
    return own | _of_sensors(signals_of(axis))


def tare_of(arm: Arm, manipulator: Subsystem) -> dict[str, Unknown]:
    """Masses beyond the known ones, by a tenth, and friction of cylinders, viscous as in the mechanics."""
    known, found = values(manipulator).p, dict[str, Unknown]()
    for n in masses_of(manipulator):
        prior = max(0.1 * float(known[n]), TABLE["mass"]["off"].prior)
        found[f"{n}_off"] = TABLE["mass"]["off"].named(n.replace("_", " ").capitalize(), prior)
    for a, n in ((a.name, n) for a in arm.axes for n in FRICTION if not a.turns):
        healthy = float(known.get(f"{a}_piston_damping", 0.0)) if n == "damping" else None
        found[f"{a}_{n}"] = TABLE["cylinder"][n].named(a, healthy=healthy)
    return found


def masses_of(manipulator: Subsystem) -> list[str]:
    """Masses of the arm."""
    return [n for n, q in quantities(manipulator.parameters).items() if q.unit == "kg"]


def findings(arm: Arm, manipulator: Subsystem) -> dict[str, Unknown]:
    """All unknowns, in the order of the outputs."""
    own = {n: u for a in arm.axes for n, u in of_axis(a).items()}
    return own | _of_sensors(LINES) | TABLE["machine"] | tare_of(arm, manipulator)


def reference(name: str, p: Any) -> Scalar:
    """Size of the healthy machine, from the parameters; 0 if it is not learned."""
    return getattr(p, f"{name}_reference", 0)
