"""Units: defined, with a meaning in SI that is right."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping

from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.model import UnitDefinition, listed, whole
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject
from orchestrator.units import BASES

RULES = Table()
DEGREE = math.pi / 180
FORCE, PRESSURE = {"kg": 1, "m": 1, "s": -2}, {"kg": 1, "m": -1, "s": -2}
ENERGY, POWER, FLOW = {"kg": 1, "m": 2, "s": -2}, {"kg": 1, "m": 2, "s": -3}, {"m": 3, "s": -1}
# What well-known names mean: exponents (without the radian, which tools treat differently), factor, offset.
WELL_KNOWN: Mapping[str, tuple[Mapping[str, int], float, float]] = {
    "m": ({"m": 1}, 1, 0),
    "mm": ({"m": 1}, 1e-3, 0),
    "cm": ({"m": 1}, 1e-2, 0),
    "m/s": ({"m": 1, "s": -1}, 1, 0),
    "km/h": ({"m": 1, "s": -1}, 1 / 3.6, 0),
    "m3": ({"m": 3}, 1, 0),
    "L": ({"m": 3}, 1e-3, 0),
    "l": ({"m": 3}, 1e-3, 0),
    "m3/s": (FLOW, 1, 0),
    "L/min": (FLOW, 1e-3 / 60, 0),
    "l/min": (FLOW, 1e-3 / 60, 0),
    "kg": ({"kg": 1}, 1, 0),
    "s": ({"s": 1}, 1, 0),
    "ms": ({"s": 1}, 1e-3, 0),
    "min": ({"s": 1}, 60, 0),
    "h": ({"s": 1}, 3600, 0),
    "N": (FORCE, 1, 0),
    "kN": (FORCE, 1e3, 0),
    "N.m": (ENERGY, 1, 0),
    "J": (ENERGY, 1, 0),
    "kJ": (ENERGY, 1e3, 0),
    "W": (POWER, 1, 0),
    "kW": (POWER, 1e3, 0),
    "Pa": (PRESSURE, 1, 0),
    "kPa": (PRESSURE, 1e3, 0),
    "MPa": (PRESSURE, 1e6, 0),
    "bar": (PRESSURE, 1e5, 0),
    "rad": ({}, 1, 0),
    "deg": ({}, DEGREE, 0),
    "rad/s": ({"s": -1}, 1, 0),
    "deg/s": ({"s": -1}, DEGREE, 0),
    "rpm": ({"s": -1}, math.pi / 30, 0),
    "K": ({"K": 1}, 1, 0),
    "degC": ({"K": 1}, 1, 273.15),
    "A": ({"A": 1}, 1, 0),
    "mA": ({"A": 1}, 1e-3, 0),
    "V": ({"kg": 1, "m": 2, "s": -3, "A": -1}, 1, 0),
    "%": ({}, 1e-2, 0),
}


def _at(unit: UnitDefinition) -> str:
    return f"modelDescription.xml line {unit.line}: unit {unit.name}"


@RULES.rule("unit.undefined", "Every unit that a variable uses is defined", "FMPy#511")
def undefined(subject: Subject) -> Iterator[Finding]:
    known = {u.name for u in subject.model.units}
    for v in subject.model.variables:
        if v.unit is not None and v.unit not in known:
            yield error(f"{v}: unit {v.unit!r} is not in UnitDefinitions")


@RULES.rule("unit.display", "Every display unit is defined at its unit", "FMPy#511")
def display(subject: Subject) -> Iterator[Finding]:
    displays = {u.name: u.displays for u in subject.model.units}
    for v in subject.model.variables:
        shown = v.said.get("displayUnit") if v.is_float else None
        if shown is None:
            continue
        if v.unit is None:
            yield error(f"{v}: displayUnit {shown!r} without unit")
        elif v.unit in displays and shown not in displays[v.unit]:
            yield error(f"{v}: displayUnit {shown!r} is not defined at unit {v.unit}")
    for unit in subject.model.units:
        for name, said in unit.displays.items():
            if _float(said.get("factor", "1")) == 0:
                yield error(f"{_at(unit)}: DisplayUnit {name} has factor 0")


@RULES.rule("unit.twice", "Each unit is defined once")
def twice(subject: Subject) -> Iterator[Finding]:
    for name, count in Counter(u.name for u in subject.model.units).items():
        if count > 1:
            yield warning(f"modelDescription.xml: unit {name} is defined {count} times")


@RULES.rule("unit.base", "Every unit that is used has a BaseUnit", "libcosim#519 OMSimulator#942")
def base(subject: Subject) -> Iterator[Finding]:
    used = {v.unit for v in subject.model.variables}
    for unit in subject.model.units:
        if unit.base is None and unit.name in used:
            yield warning(f"{_at(unit)}: has no BaseUnit; no tool can convert it or see a wrong connection")


@RULES.rule("unit.wrong", "Units with well-known names mean what the name says")
def wrong(subject: Subject) -> Iterator[Finding]:
    for unit in subject.model.units:
        if unit.base is None or unit.name not in WELL_KNOWN:
            continue
        exponents, factor, offset = WELL_KNOWN[unit.name]
        said = {b: _exponent(unit.base.get(b, "0")) for b in BASES if b != "rad"}
        if said != {b: exponents.get(b, 0) for b in BASES if b != "rad"}:
            yield error(f"{_at(unit)}: expected exponents {_text(exponents)}, found {_text(said)}")
            continue
        found = _float(unit.base.get("factor", "1")), _float(unit.base.get("offset", "0"))
        # names are written with five digits or more
        if not (
            math.isclose(found[0], factor, rel_tol=1e-4) and math.isclose(found[1], offset, abs_tol=1e-2)
        ):
            yield error(
                f"{_at(unit)}: expected factor {factor:.6g} and offset {offset:g},"
                f" found {found[0]:g} and {found[1]:g}"
            )


def _text(exponents: Mapping[str, int | str]) -> str:
    return " ".join(f"{b}^{e}" for b, e in exponents.items() if e) or "none"


def _exponent(text: str) -> int | str:
    """A whole number; what is none stays as it is written, and so is wrong."""
    number = whole(text)
    return text if number is None else number


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


@RULES.rule(
    "unit.factor", "Inputs and outputs are in SI units: factor 1, offset 0", "libcosim#519 OMSimulator#942"
)
def factor(subject: Subject) -> Iterator[Finding]:
    scaled = {
        u.name
        for u in subject.model.units
        if u.base and (_float(u.base.get("factor", "1")) != 1 or _float(u.base.get("offset", "0")) != 0)
    }
    ports = [v for v in subject.model.of("input", "output") if v.unit in scaled]
    if ports:
        names = ", ".join(sorted({str(v.unit) for v in ports}))
        yield note(f"{listed(ports)}: in {names}, not SI; most tools pass the number on without converting")


@RULES.rule("unit.missing", "Inputs, outputs and parameters that are real numbers have a unit")
def missing(subject: Subject) -> Iterator[Finding]:
    without = [v for v in subject.model.of("input", "output", "parameter") if v.is_float and v.unit is None]
    if without:
        yield note(f"{listed(without)}: real numbers without unit")
