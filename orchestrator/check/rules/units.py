"""Units: defined, with a meaning in SI that is right.

Terminals and icons: members that exist, names that match.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping

from orchestrator.base.units import BASES
from orchestrator.base.xml import children
from orchestrator.check.finding import Finding, Table, error, listed, note, warning
from orchestrator.check.rules.description import violations
from orchestrator.check.subject import Element, Subject, read_xml
from orchestrator.fmi.model_description import UnitDefinition, whole

UNITS = Table()
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


@UNITS.rule("unit.undefined", "Every unit that a variable uses is defined", "FMPy#511")
def undefined(subject: Subject) -> Iterator[Finding]:
    known = {u.name for u in subject.model.units}
    for v in subject.model.variables:
        if v.unit is not None and v.unit not in known:
            yield error(f"{v}: unit {v.unit!r} is not in UnitDefinitions")


@UNITS.rule("unit.display", "Every display unit is defined at its unit", "FMPy#511")
def display(subject: Subject) -> Iterator[Finding]:
    displays = {u.name: u.displays for u in subject.model.units}
    for v in subject.model.variables:
        shown = v.attributes.get("displayUnit") if v.is_float else None
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


@UNITS.rule("unit.twice", "Each unit is defined once")
def twice(subject: Subject) -> Iterator[Finding]:
    for name, count in Counter(u.name for u in subject.model.units).items():
        if count > 1:
            yield warning(f"modelDescription.xml: unit {name} is defined {count} times")


@UNITS.rule("unit.base", "Every unit that is used has a BaseUnit", "libcosim#519 OMSimulator#942")
def base(subject: Subject) -> Iterator[Finding]:
    used = {v.unit for v in subject.model.variables}
    for unit in subject.model.units:
        if unit.base is None and unit.name in used:
            yield warning(f"{_at(unit)}: has no BaseUnit; no tool can convert it or see a wrong connection")


@UNITS.rule("unit.wrong", "Units with well-known names mean what the name says")
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


@UNITS.rule(
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


@UNITS.rule("unit.missing", "Inputs, outputs and parameters that are real numbers have a unit")
def missing(subject: Subject) -> Iterator[Finding]:
    without = [v for v in subject.model.of("input", "output", "parameter") if v.is_float and v.unit is None]
    if without:
        yield note(f"{listed(without)}: real numbers without unit")


TERMINALS = Table()
FILE = "terminalsAndIcons/terminalsAndIcons.xml"
NAMES = {
    "TerminalMemberVariable": ("variableName",),
    "TerminalStreamMemberVariable": ("inStreamVariableName", "outStreamVariableName"),
}
CONNECTED = ("input", "output", "parameter", "calculatedParameter")


def _root(subject: Subject) -> Element | None:
    return read_xml(subject.folder, FILE)[0] if FILE in subject.files and subject.model.variables else None


@TERMINALS.rule("terminal.schema", "terminalsAndIcons.xml keeps its schema")
def schema(subject: Subject) -> Iterator[Finding]:
    if FILE not in subject.files:
        return
    root, wrong = read_xml(subject.folder, FILE)
    if root is None:
        yield error(wrong)
        return
    for line, message in violations(root, "fmi3/fmi3TerminalsAndIcons.xsd"):
        yield error(f"{FILE} line {line}: {message}")
    if subject.major == 3 and root.get("fmiVersion") != subject.version:
        yield error(f"{FILE}: fmiVersion is {root.get('fmiVersion')}, expected {subject.version}")


@TERMINALS.rule("terminal.members", "Members of terminals are variables of the FMU that can be connected")
def members(subject: Subject) -> Iterator[Finding]:
    root = _root(subject)
    known = {n: v for v in subject.model.variables for n in v.names}
    for element in () if root is None else root.iter(*NAMES):
        for attribute in NAMES[element.tag]:
            name = element.get(attribute, "")
            where = f"{FILE} line {element.sourceline}: {element.getparent().get('name')}"
            if name not in known:
                yield error(f"{where}: member {name!r} is no variable of the FMU")
            elif known[name].causality not in CONNECTED and element.get("variableKind") in (
                "signal",
                "inflow",
                "outflow",
            ):
                yield error(f"{where}: member {name} is {known[name].causality}, expected an input or output")


@TERMINALS.rule("terminal.names", "Terminals and their members have names of their own")
def names(subject: Subject) -> Iterator[Finding]:
    root = _root(subject)
    for level in () if root is None else root.iter("Terminals", "Terminal"):
        for name, count in Counter(t.get("name") for t in children(level, "Terminal")).items():
            if count > 1:
                yield error(f"{FILE}: {count} terminals {name} on one level, expected unique names")
        if level.tag == "Terminal":
            yield from _member_names(level)


def _member_names(terminal: Element) -> Iterator[Finding]:
    where = f"{FILE} line {terminal.sourceline}: {terminal.get('name')}"
    found = [m.get("memberName") for m in children(terminal, "TerminalMemberVariable")]
    if terminal.get("matchingRule") in ("plug", "bus") and None in found:
        yield error(
            f"{where}: a member has no memberName, which matching by {terminal.get('matchingRule')} needs"
        )
    for name, count in Counter(n for n in found if n is not None).items():
        if count > 1:
            yield error(f"{where}: {count} members {name}, expected unique names")


@TERMINALS.rule("terminal.rule", "Matching rules are those of the standard, or have a domain name")
def rule(subject: Subject) -> Iterator[Finding]:
    root = _root(subject)
    for terminal in () if root is None else root.iter("Terminal"):
        said = terminal.get("matchingRule", "")
        if said not in ("plug", "bus", "sequence") and "." not in said:
            yield error(
                f"{FILE} line {terminal.sourceline}: {terminal.get('name')}: matchingRule {said!r},"
                " expected plug, bus, sequence or a reverse domain name"
            )


@TERMINALS.rule("terminal.icons", "Icons that are named are there, as PNG too")
def icons(subject: Subject) -> Iterator[Finding]:
    root = _root(subject)
    for element in () if root is None else root.iter("TerminalGraphicalRepresentation"):
        base = element.get("iconBaseName", "")
        if base and f"terminalsAndIcons/{base}.png" not in subject.files:
            yield error(f"{FILE} line {element.sourceline}: terminalsAndIcons/{base}.png is missing")
    if "terminalsAndIcons/icon.svg" in subject.files and "terminalsAndIcons/icon.png" not in subject.files:
        yield error("terminalsAndIcons/icon.svg without icon.png, which the standard requires beside it")


@TERMINALS.rule("terminal.there", "Ports that belong together form terminals (FMI 3)")
def there(subject: Subject) -> Iterator[Finding]:
    ports = len(subject.model.of("input", "output"))
    if subject.major == 3 and FILE not in subject.files and ports > 8:
        yield note(f"{FILE} is missing; {ports} inputs and outputs have to be connected one by one")
