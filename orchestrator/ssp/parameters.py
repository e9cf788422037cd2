"""Start values from an SSP: parameter bindings, parameter sets (SSV) and parameter mappings (SSM).

Parameter sets that a user picks, such as poses and programs: by name from the SSP, or a .ssv file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.units import IDENTITY, DeclaredUnit, Linear, conversion
from orchestrator.base.xml import (
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
from orchestrator.fmi.description import KINDS, Value
from orchestrator.ssp.structure import Binding, Flat, Node, Wire
from orchestrator.ssp.swap import lost
from orchestrator.ssp.system import Port, System, coerce, settable

SET, MAPPING = "application/x-ssp-parameter-set", "application/x-ssp-parameter-mapping"


class Entry(NamedTuple):
    """One value on its way to a variable: convert its unit (unless suppressed), then apply `map`."""

    name: str
    text: str
    unit: DeclaredUnit | None
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


def _value_map(entry: Entry, target: DeclaredUnit | None, where: str) -> tuple[Linear, str | None]:
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


def entries(file: Location, root: Element, known: Mapping[str, DeclaredUnit]) -> list[Entry]:
    """The values of a parameter set, whose units are its own or, else, those known around it."""
    there = {**known, **units(file, root)}
    return [_entry(file, p, there) for p in children(root, "Parameters", "Parameter")]


def _entry(file: Location, parameter: Element, known: Mapping[str, DeclaredUnit]) -> Entry:
    value = next((e for e in parameter if local(e) in KINDS), None)
    if value is None or value.get("value") is None:
        raise Problem(
            f"{file}: line {parameter.sourceline}: parameter {parameter.get('name')!r}: "
            "expected a value, got none"
        )
    unit = value.get("unit")
    return Entry(
        required(file, parameter, "name"),
        value.get("value"),
        known.get(unit, DeclaredUnit(unit)) if unit else None,
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


FOLDER, SUFFIX = "resources", ".ssv"


def with_sets(system: System, sets: Sequence[str | Path]) -> System:
    """The system with start values from parameter sets, later ones over earlier ones.

    A set may name connected inputs: what it says of them holds until the run has initialised. What it says of
    a variable that was lost in a swap, or cannot be set any more, is left out.
    """
    for chosen in sets:
        file = _file(system, chosen)
        gone = lost(system)
        for entry in entries(file, parse(file, "ParameterSet"), {}):
            if entry.name in gone:
                note = f"{file}: {entry.name} is left out: {gone[entry.name]}"
                system = replace(system, notes=(*system.notes, note))
            else:
                system = _with_entry(system, file, entry)
    return system


def _with_entry(system: System, file: Location, entry: Entry) -> System:
    where = f"{file}: parameter {entry.name}"
    try:
        targets = system.targets(entry.name)
    except Problem as problem:
        raise Problem(f"{file}: {problem}") from None
    fresh = {name: dict(c.start) for name, c in system.components.items()}
    notes: list[str] = []
    for port, linear in targets:
        variable = system.variable(port)
        settable(port, system.components[port.component].interface)
        own = system.inputs[entry.name].unit if entry.name in system.inputs else system.unit(port)
        first, note = conversion(entry.unit, own, where)
        notes += [note] if note else []
        fresh[port.component][port.variable] = coerce(where, variable, entry.text, first.then(linear))
    components = {n: replace(c, start=fresh[n]) for n, c in system.components.items()}
    return replace(system, components=components, notes=(*system.notes, *notes))


def _file(system: System, chosen: str | Path) -> Location:
    """The file of a set: one on disk if the name ends in .ssv, else one of the SSP's."""
    if str(chosen).endswith(SUFFIX):
        return Location(Path(chosen))
    known = names(system)
    if str(chosen) not in known:
        home = system.source.parent if system.source and system.source.inside else system.source
        there = f"{home or system.name} holds {', '.join(known) or 'none'}"
        raise Problem(
            f"parameter set {str(chosen)!r} is unknown{suggest(str(chosen), known)}; {there};"
            f" a file name ends in {SUFFIX}"
        )
    return known[str(chosen)]


def names(system: System) -> Mapping[str, Location]:
    """The parameter sets in the resources of an SSP, by name."""
    source = system.source
    if source is None or not str(source).endswith(".ssd"):
        return {}
    home = source.parent if source.inside else Location(source.path.parent / "resources")
    inside = f"{FOLDER}/" if source.inside else ""
    found = [n for n in sorted(home.names()) if n.startswith(inside) and n.endswith(SUFFIX)]
    return {PurePosixPath(n).stem: home.member(n) for n in found if n.count("/") == inside.count("/")}
