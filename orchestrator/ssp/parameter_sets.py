"""Start values of a system: parameter bindings, parameter sets (SSV) and parameter mappings (SSM).

A user can select further parameter sets, such as poses: by name from the SSP, or as .ssv files.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.units import IDENTITY, DeclaredUnit, LinearTransformation, conversion
from orchestrator.base.xml import XmlElement, read_xml
from orchestrator.fmi.description import KINDS, Value
from orchestrator.ssp.common_elements import read_transformation, read_units
from orchestrator.ssp.swap import missing_after_swap
from orchestrator.ssp.system import Port, System, check_bounds, check_settable, coerce
from orchestrator.ssp.system_structure import ParameterBinding, SignalPaths

# target, transformation, table source -> target, suppression of the unit conversion
MappingEntry = tuple[str, LinearTransformation, Mapping[str, str], bool]
SET, MAPPING = "application/x-ssp-parameter-set", "application/x-ssp-parameter-mapping"


class ParameterValue(NamedTuple):
    """A value for a variable; its unit is converted (unless suppressed), then `map` is applied."""

    name: str
    text: str
    unit: DeclaredUnit | None
    map: LinearTransformation = IDENTITY
    suppressed: bool = False

    def map_to(self, target: DeclaredUnit | None, context: str, notes: list[str]) -> LinearTransformation:
        """The map to a value in the unit `target`; `notes` get one if a unit is unknown."""
        return self.map if self.suppressed else conversion(self.unit, target, context, notes).then(self.map)


def read_parameter_set(root: XmlElement, outer_units: Mapping[str, DeclaredUnit]) -> list[ParameterValue]:
    """The values of a parameter set, whose units are defined there or in the file around it."""
    units, values = {**outer_units, **read_units(root)}, list[ParameterValue]()
    for parameter in root.children("Parameters", "Parameter"):
        value = next((e for e in parameter.children() if e.name in KINDS), None)
        text = value.get("value") if value is not None else None
        if value is None or text is None:
            message = f"parameter {parameter.get('name')!r}: expected a value, got none"
            raise Problem(f"{parameter.location}: {message}")
        unit = value.get("unit")
        declared = units.get(unit, DeclaredUnit(unit)) if unit else None
        values.append(ParameterValue(parameter.required("name"), text, declared))
    return values


# ---- bindings of the SSP -----------------------------------------------------------------------------------


def bound_values(signals: SignalPaths) -> dict[str, dict[str, Value]]:
    """Start values by component; outer bindings override inner ones, later ones override earlier ones."""
    flat, system = signals.flat, signals.system
    start: dict[str, dict[str, Value]] = {name: {} for name in system.components}
    for binding in flat.bindings:
        file = binding.element.file
        for value in _values(signals, binding):
            unmatched = True
            for port, linear in _targets(signals, binding, value):
                variable, unmatched = system.variable(port), False
                if variable.settable:
                    start[port.component][port.variable] = coerce(str(port), variable, value.text, linear)
                else:
                    signals.notes.append(f"{file}: {port} is not set: the FMU computes this variable itself")
            if unmatched:
                owner = binding.owner or flat.name
                signals.notes.append(f"{file}: parameter {value.name!r} of {owner} does not match a variable")
    return start


def _targets(
    signals: SignalPaths, binding: ParameterBinding, value: ParameterValue
) -> Iterator[tuple[Port, LinearTransformation]]:
    """The variable that a value sets, or all that a connector feeds, with the map from the value."""
    flat, system = signals.flat, signals.system
    full = str(Port(binding.owner, value.name))
    for owner in sorted([*flat.sources, *flat.systems], key=len, reverse=True):
        name = full.removeprefix(f"{owner}.") if owner else full
        if owner and name == full:
            continue
        if owner in flat.sources:
            interface, port = system.components[owner].interface, Port(owner, name)
            interface.check_supported(name, f"parameter {full}")
            if name in interface.variables:
                yield port, value.map_to(system.variable(port).unit, f"parameter {port}", signals.notes)
                return
        connector = Port(owner, name)
        if owner in flat.systems and connector in flat.connectors:
            unit = flat.unit(connector)
            for path in (p for p in signals.paths if connector in p.connectors):
                first = value.map_to(unit, f"parameter {connector}", signals.notes)
                from_connector = replace(signals, notes=[]).map_from(path, connector, unit or value.unit)
                yield path.target, first.then(from_connector)
            return


def _values(signals: SignalPaths, binding: ParameterBinding) -> list[ParameterValue]:
    """The values of a binding after prefix and mapping; without a mapping entry a name is unchanged."""
    content = _content(signals, binding, binding.element, SET, "ParameterValues", "ParameterSet")
    prefix, entries = binding.element.get("prefix") or "", dict[str, list[MappingEntry]]()
    mapping = binding.element.child("ParameterMapping")
    if mapping is not None:
        root = _content(signals, binding, mapping, MAPPING, "ParameterMapping")
        for e in root.children("MappingEntry"):
            entry = e.required("target"), *read_transformation(e), e.boolean("suppressUnitConversion")
            entries.setdefault(e.required("source"), []).append(entry)
    values = []
    for value in read_parameter_set(content, binding.units):
        name = prefix + value.name
        for target, linear, table, suppressed in entries.get(name, [(name, IDENTITY, {}, False)]):
            text = table.get(value.text, value.text)
            values.append(ParameterValue(target, text, value.unit, linear, suppressed))
    return values


def _content(
    signals: SignalPaths, binding: ParameterBinding, element: XmlElement, expected: str, *path: str
) -> XmlElement:
    """The content of a binding or its mapping: the element at `path` inside, or the root of another file."""
    mime_type, name = element.get("type") or expected, path[-1]
    if mime_type != expected:
        raise element.problem(f"expected the type {expected}, got {mime_type}")
    source, inside = element.get("source"), element.child(*path)
    if bool(source) == (inside is not None):
        raise element.problem(f"expected a source or a {name} inside, got {'both' if source else 'neither'}")
    if inside is not None:
        return inside
    base, fmu = element.get("sourceBase") or "SSD", signals.flat.sources.get(binding.owner)
    if base == "component" and fmu is not None:
        return read_xml(fmu.member(source or ""), name)
    if base != "SSD":
        choice = "SSD or component" if fmu is not None else "SSD"
        raise element.problem(f"expected {choice} for sourceBase, got {base!r}")
    return read_xml(element.file.resolve(source or ""), name)


# ---- selected by the user ----------------------------------------------------------------------------------

SUFFIX = ".ssv"


def with_sets(system: System, sets: Sequence[str | Path]) -> System:
    """The system with start values from parameter sets; later ones override earlier ones.

    A set may contain connected inputs: these values are used until the end of the initialisation. Values are
    left out if a swapped FMU lacks the variable, or determines it itself.
    """
    for chosen in sets:
        file, notes = _file(system, chosen), list[str]()
        missing = missing_after_swap(system)
        start: dict[str, dict[str, Value]] = {name: {} for name in system.components}
        for value in read_parameter_set(read_xml(file, "ParameterSet"), {}):
            if value.name in missing:
                notes.append(f"{file}: {value.name} is left out: {missing[value.name]}")
                continue
            for port, converted in _converted(system, file, value, notes):
                start[port.component][port.variable] = converted
        components = {n: c.chosen(start[n], str(chosen)) for n, c in system.components.items()}
        system = replace(system, components=components, notes=(*system.notes, *notes))
    return system


def _converted(
    system: System, file: Location, value: ParameterValue, notes: list[str]
) -> Iterator[tuple[Port, Value]]:
    """The variables that a value of a set refers to, each with the value in its unit."""
    context = f"{file}: parameter {value.name}"
    try:
        targets = system.targets(value.name)
    except Problem as problem:
        raise Problem(f"{file}: {problem}") from None
    for port, linear in targets:
        check_settable(port, system.components[port.component].interface)
        unit = system.inputs[value.name].unit if value.name in system.inputs else system.unit(port)
        first = value.map_to(unit, context, notes)
        converted = coerce(context, system.variable(port), value.text, first.then(linear))
        check_bounds(f"{file}: {port}", system.variable(port), converted)
        yield port, converted


def _file(system: System, chosen: str | Path) -> Location:
    """The file of a set: a path that ends in .ssv, or a name in the SSP."""
    if str(chosen).endswith(SUFFIX):
        return Location(Path(chosen))
    sets = parameter_sets(system)
    if str(chosen) not in sets:
        home = system.source.parent if system.source and system.source.members else system.source
        contents = f"{home or system.name} contains {', '.join(sets) or 'none'}"
        raise Problem(
            f"parameter set {str(chosen)!r} is unknown{suggest(str(chosen), sets)}; {contents};"
            f" a file name ends in {SUFFIX}"
        )
    return sets[str(chosen)]


def parameter_sets(system: System) -> Mapping[str, Location]:
    """The parameter sets in the resources of an SSP, by name."""
    files = system.resources.items()
    return {PurePosixPath(n).stem: f for n, f in files if n.endswith(SUFFIX) and "/" not in n}
