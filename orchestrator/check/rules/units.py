"""Rules on units (defined, correct in SI) and on terminals (existing members, unique names)."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping

from orchestrator.base.text import words
from orchestrator.base.units import BASES, parse_unit
from orchestrator.base.xml import Element, children
from orchestrator.check.finding import Finding, error, join_variables, note, warning
from orchestrator.check.rules.identity import violations
from orchestrator.check.subject import Subject, read_xml
from orchestrator.fmi.description import UnitDefinition, parse_float, parse_int

DIMENSIONS = [b for b in BASES if b != "rad"]  # tools differ in the treatment of the radian
WELL_KNOWN = words(  # names with one meaning
    """m mm cm m/s km/h m3 L l m3/s L/min l/min kg s ms min h N kN N.m J kJ W kW Pa kPa MPa bar rad deg rad/s
    deg/s rpm K degC A mA V %"""
)


def _at(unit: UnitDefinition) -> str:
    return f"modelDescription.xml line {unit.line}: unit {unit.name}"


def unit_undefined(subject: Subject) -> Iterator[str]:
    """Every unit that a variable uses is defined."""
    defined = {u.name for u in subject.model.units}
    for v in subject.model.variables:
        if v.unit_name is not None and v.unit_name not in defined:
            yield f"{v}: unit {v.unit_name!r} is not in UnitDefinitions"


def unit_display(subject: Subject) -> Iterator[Finding]:
    """Every display unit is defined in its unit."""
    displays = {u.name: u.display_units for u in subject.model.units}
    for v in subject.model.variables:
        display_unit = v.attributes.get("displayUnit") if v.is_real else None
        if display_unit is None:
            continue
        if v.unit_name is None:
            yield error(f"{v}: displayUnit {display_unit!r} without unit")
        elif v.unit_name in displays and display_unit not in displays[v.unit_name]:
            make = error if subject.major == 3 else note  # FMI 2.0: "then displayUnit is ignored"
            yield make(f"{v}: displayUnit {display_unit!r} is not defined in unit {v.unit_name}")
    for unit in subject.model.units:
        for name, attributes in unit.display_units.items():
            if parse_float(attributes.get("factor")) == 0:
                yield warning(f"{_at(unit)}: DisplayUnit {name} has factor 0")


def unit_twice(subject: Subject) -> Iterator[str]:
    """Each unit is defined once."""
    for name, count in Counter(u.name for u in subject.model.units).items():
        if count > 1:
            yield f"modelDescription.xml: unit {name} is defined {count} times"


def unit_base(subject: Subject) -> Iterator[str]:
    """Every used unit has a BaseUnit."""
    used = {v.unit_name for v in subject.model.variables}
    for unit in subject.model.units:
        if unit.base_unit is None and unit.name in used:
            yield f"{_at(unit)}: has no BaseUnit; tools can neither convert it nor detect a wrong connection"


def unit_wrong(subject: Subject) -> Iterator[str]:
    """Units with well-known names are defined with their usual meaning."""
    for unit in subject.model.units:
        if unit.base_unit is None or unit.name not in WELL_KNOWN:
            continue
        usual = parse_unit(unit.name)
        exponents = {b: str(usual.base().get(b, 0)) for b in DIMENSIONS}
        declared = {b: unit.base_unit.get(b, "0") for b in DIMENSIONS}
        factor, offset = unit.declared.factor, unit.declared.offset
        if {b: parse_int(e) for b, e in declared.items()} != {b: int(e) for b, e in exponents.items()}:
            yield f"{_at(unit)}: expected exponents {_text(exponents)}, got {_text(declared)}"
        elif not (  # factors have five digits or more
            math.isclose(factor, usual.factor, rel_tol=1e-4)
            and math.isclose(offset, usual.offset, abs_tol=1e-2)
        ):
            expected = f"expected factor {usual.factor:.6g} and offset {usual.offset:g}"
            yield f"{_at(unit)}: {expected}, got {factor:g} and {offset:g}"


def _text(exponents: Mapping[str, str]) -> str:
    return " ".join(f"{b}^{e}" for b, e in exponents.items() if e != "0") or "none"


def unit_factor(subject: Subject) -> Iterator[str]:
    """Inputs and outputs are in SI units: factor 1, offset 0."""
    declared = [u.declared for u in subject.model.units if u.base_unit]
    scaled = {u.name for u in declared if (u.factor, u.offset) != (1, 0)}
    if ports := [v for v in subject.model.of("input", "output") if v.unit_name in scaled]:
        names = ", ".join(sorted({str(v.unit_name) for v in ports}))
        yield f"{join_variables(ports)}: in {names}, not SI; most tools do not convert values"


FILE = "terminalsAndIcons/terminalsAndIcons.xml"
NAMES = {
    "TerminalMemberVariable": ("variableName",),
    "TerminalStreamMemberVariable": ("inStreamVariableName", "outStreamVariableName"),
}
EXCHANGED = ("signal", "inflow", "outflow")  # variableKind of members that are connected
CONNECTABLE = ("input", "output", "parameter", "calculatedParameter")


def _elements(subject: Subject, *names: str) -> Iterator[Element]:
    """The elements of terminalsAndIcons.xml with these names; none without that file or without variables."""
    root = read_xml(subject.folder, FILE)[0] if subject.model.variables else None
    return iter(()) if root is None else root.iter(*names)


def terminal_schema(subject: Subject) -> Iterator[str]:
    """terminalsAndIcons.xml is valid against its schema."""
    root, fault = read_xml(subject.folder, FILE)
    if fault:
        yield fault
    if root is None:
        return
    for line, message in violations(root, "fmi3/fmi3TerminalsAndIcons.xsd"):
        yield f"{FILE} line {line}: {message}"
    if subject.major == 3 and root.get("fmiVersion") != subject.version:
        yield f"{FILE}: fmiVersion: expected {subject.version}, got {root.get('fmiVersion')}"


def terminal_members(subject: Subject) -> Iterator[str]:
    """Members of terminals are connectable variables of the FMU."""
    variables = {n: v for v in subject.model.variables for n in v.names}
    for element in _elements(subject, *NAMES):
        for attribute in NAMES[element.tag]:
            name = element.get(attribute, "")
            where = f"{FILE} line {element.sourceline}: {element.getparent().get('name')}"
            if name not in variables:
                yield f"{where}: member {name!r} is not a variable of the FMU"
            elif variables[name].causality not in CONNECTABLE and element.get("variableKind") in EXCHANGED:
                yield f"{where}: member {name}: expected an input or output, got {variables[name].causality}"


def terminal_names(subject: Subject) -> Iterator[Finding]:
    """Terminals and their members have unique names."""
    for level in _elements(subject, "Terminals", "Terminal"):
        for name, count in Counter(t.get("name") for t in children(level, "Terminal")).items():
            if count > 1:
                yield error(f"{FILE}: expected unique names on each level, got {count} terminals {name}")
        if level.tag == "Terminal":
            yield from _member_names(level)


def _member_names(terminal: Element) -> Iterator[Finding]:
    where = f"{FILE} line {terminal.sourceline}: {terminal.get('name')}"
    members_ = [m.get("memberName") for m in children(terminal, "TerminalMemberVariable")]
    rule = terminal.get("matchingRule")
    if rule in ("plug", "bus") and None in members_:
        yield error(f"{where}: a member has no memberName, which matching by {rule} needs")
    for name, count in Counter(n for n in members_ if n is not None).items():
        if count > 1:
            yield error(f"{where}: expected unique names, got {count} members {name}")


def terminal_rule(subject: Subject) -> Iterator[str]:
    """Matching rules are those of the standard, or have a reverse domain name."""
    for terminal in _elements(subject, "Terminal"):
        matching = terminal.get("matchingRule", "")
        if matching not in ("plug", "bus", "sequence") and "." not in matching:
            where = f"{FILE} line {terminal.sourceline}: {terminal.get('name')}: matchingRule"
            yield f"{where}: expected plug, bus, sequence or a reverse domain name, got {matching!r}"


def terminal_icons(subject: Subject) -> Iterator[str]:
    """Referenced icons exist, also as PNG."""
    for element in _elements(subject, "TerminalGraphicalRepresentation"):
        base = element.get("iconBaseName", "")
        if base and f"terminalsAndIcons/{base}.png" not in subject.files:
            yield f"{FILE} line {element.sourceline}: terminalsAndIcons/{base}.png is missing"
    if "terminalsAndIcons/icon.svg" in subject.files and "terminalsAndIcons/icon.png" not in subject.files:
        yield "terminalsAndIcons/icon.svg without icon.png, which the standard requires next to it"
