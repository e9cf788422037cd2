"""Start values from an SSP: parameter bindings, parameter sets (SSV) and parameter mappings (SSM)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.files.xml import (
    Element,
    child,
    children,
    local,
    parse,
    required,
    transformation,
    truth,
    units,
)
from orchestrator.system.interface import KINDS, Value
from orchestrator.system.ssd import Binding, Flat, Node
from orchestrator.system.system import Port, System, coerce
from orchestrator.system.wires import Wire
from orchestrator.units import IDENTITY, Linear, Unit, conversion

SET, MAPPING = "application/x-ssp-parameter-set", "application/x-ssp-parameter-mapping"


class Entry(NamedTuple):
    """One value on its way to a variable: convert its unit (unless suppressed), then apply `map`."""

    name: str
    text: str
    unit: Unit | None
    map: Linear = IDENTITY
    suppressed: bool = False


def apply(flat: Flat, system: System, wires: list[Wire], notes: list[str]) -> dict[str, dict[str, Value]]:
    """Start values by component; bindings of outer systems win over inner ones, later over earlier."""
    fresh: dict[str, dict[str, Value]] = {name: {} for name in system.components}
    for binding in flat.bindings:
        for entry in _entries(flat, binding):
            targets = list(_targets(flat, system, wires, binding, entry))
            if not targets:
                owner = binding.owner or flat.name
                notes.append(f"{binding.file}: parameter {entry.name!r} of {owner} fits no variable")
            for port, linear, note in targets:
                variable = system.variable(port)
                notes.extend([note] if note else [])
                if variable.settable:
                    fresh[port.component][port.variable] = coerce(str(port), variable, entry.text, linear)
                else:
                    notes.append(f"{binding.file}: {port} keeps its value: the FMU determines it itself")
    return fresh


def _targets(
    flat: Flat, system: System, wires: list[Wire], binding: Binding, entry: Entry
) -> Iterator[tuple[Port, Linear, str | None]]:
    """The variables that an entry sets, with the map from the entry's value."""
    full = f"{binding.owner}.{entry.name}" if binding.owner else entry.name
    for owner in sorted([*flat.sources, *flat.systems], key=len, reverse=True):
        name = full.removeprefix(f"{owner}.") if owner else full
        if owner and name == full:
            continue
        if owner in flat.sources:
            system.components[owner].interface.allow(name, f"parameter {full}")
        if owner in flat.sources and name in system.components[owner].interface.variables:
            port = Port(owner, name)
            target = system.variable(port).unit
            yield (port, *_value_map(entry, target, str(port)))
            return
        node = Node(owner, name)
        if owner in flat.systems and node in flat.kinds:
            for wire in wires:
                if node in wire.nodes:
                    first, note = _value_map(entry, flat.units.get(node), str(node))
                    start = flat.units.get(node) or entry.unit
                    yield wire.target, first.then(wire.map_from(flat, system, node, start, [])), note
            return


def _value_map(entry: Entry, target: Unit | None, where: str) -> tuple[Linear, str | None]:
    if entry.suppressed:
        return entry.map, None
    linear, note = conversion(entry.unit, target, f"parameter {where}")
    return linear.then(entry.map), note


def _entries(flat: Flat, binding: Binding) -> list[Entry]:
    """The values of a binding after prefix and mapping. Names without mapping stay as they are."""
    values = _parameter_set(flat, binding)
    prefix = binding.element.get("prefix") or ""
    mapped: dict[str, list[tuple[str, Linear, Mapping[str, str], bool]]] = {}
    for entry in _mapping(flat, binding):
        mapped.setdefault(entry[0], []).append(entry[1:])
    found = []
    for value in values:
        name = prefix + value.name
        for target, linear, table, suppressed in mapped.get(name, [(name, IDENTITY, {}, False)]):
            text = table.get(value.text, value.text)
            found.append(Entry(target, text, value.unit, linear, suppressed))
    return found


def _parameter_set(flat: Flat, binding: Binding) -> list[Entry]:
    _check_type(binding, binding.element, SET)
    inline = child(binding.element, "ParameterValues", "ParameterSet")
    file, root = _content(flat, binding, binding.element, inline, "ParameterSet")
    return entries(file, root, flat.known_units)


def entries(file: Location, root: Element, known: Mapping[str, Unit]) -> list[Entry]:
    """The values of a parameter set, whose units are its own or, else, those known around it."""
    there = {**known, **units(file, root)}
    return [_entry(file, p, there) for p in children(root, "Parameters", "Parameter")]


def _entry(file: Location, parameter: Element, known: Mapping[str, Unit]) -> Entry:
    value = next((e for e in parameter if local(e) in KINDS), None)
    if value is None or value.get("value") is None:
        raise Problem(
            f"{file}: line {parameter.sourceline}: parameter {parameter.get('name')!r}: "
            "expected a value, got none"
        )
    unit = value.get("unit")
    return Entry(
        required(file, parameter, "name"), value.get("value"), known.get(unit, Unit(unit)) if unit else None
    )


def _mapping(flat: Flat, binding: Binding) -> Iterator[tuple[str, str, Linear, Mapping[str, str], bool]]:
    """Source name, target name, transformation and table of the entries of a parameter mapping."""
    element = child(binding.element, "ParameterMapping")
    if element is None:
        return
    _check_type(binding, element, MAPPING)
    inline = child(element, "ParameterMapping")
    file, root = _content(flat, binding, element, inline, "ParameterMapping")
    for e in children(root, "MappingEntry"):
        linear, table = transformation(file, e)
        names = required(file, e, "source"), required(file, e, "target")
        yield *names, linear, table, truth(file, e, "suppressUnitConversion")


def _check_type(binding: Binding, element: Element, expected: str) -> None:
    kind = element.get("type") or expected
    if kind != expected:
        raise _problem(binding, element, f"expected the type {expected}, got {kind}")


def _content(
    flat: Flat, binding: Binding, element: Element, inline: Element | None, name: str
) -> tuple[Location, Element]:
    """What a binding or its mapping consists of, with its file: it stands inside, or in a file of its own."""
    source = element.get("source")
    if source and inline is not None:
        raise _problem(binding, element, f"expected a source or a {name} inside, got both")
    if inline is not None:
        return binding.file, inline
    if not source:
        raise _problem(binding, element, f"expected a source or a {name} inside, got neither")
    file = _source(flat, binding, element, source)
    return file, parse(file, name)


def _source(flat: Flat, binding: Binding, element: Element, source: str) -> Location:
    """The file that a binding refers to: beside the SSD, or inside the component."""
    base = element.get("sourceBase") or "SSD"
    if base == "component" and binding.owner in flat.sources:
        return flat.sources[binding.owner].member(source)
    if base != "SSD":
        there = "SSD or component" if binding.owner in flat.sources else "SSD"
        raise _problem(binding, element, f"expected {there} for sourceBase, got {base!r}")
    return binding.file.beside(source)


def _problem(binding: Binding, element: Element, text: str) -> Problem:
    return Problem(f"{binding.file}: line {element.sourceline}: {local(element)}: {text}")
