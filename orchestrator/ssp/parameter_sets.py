"""Start values of a system: parameter bindings, parameter sets (SSV) and parameter mappings (SSM).

A user can select further parameter sets, such as poses: by name from the SSP, or as .ssv files.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.text import first_names
from orchestrator.base.units import IDENTITY, DeclaredUnit, LinearTransformation, conversion, with_definition
from orchestrator.base.xml import XmlElement, read_xml
from orchestrator.fmi.description import KINDS, TYPES, Value
from orchestrator.ssp.common_elements import read_transformation, read_units
from orchestrator.ssp.swap import missing_after_swap
from orchestrator.ssp.system import Port, System, coerce
from orchestrator.ssp.system_structure import ParameterBinding, SignalPaths

SET, MAPPING = "application/x-ssp-parameter-set", "application/x-ssp-parameter-mapping"
TEXTS = ("String", "Enumeration", "Binary")  # of an array there is a Value each; of others a list


class ParameterValue(NamedTuple):
    """A value for a variable; its unit is converted (unless suppressed), then `map` is applied.

    texts   one, or those of all elements of an array
    where   begins a message
    fault   why no scalar variable can have it
    """

    name: str
    texts: tuple[str, ...]
    unit: DeclaredUnit | None
    map: LinearTransformation = IDENTITY
    suppressed: bool = False
    where: str = ""
    fault: str = ""

    @property
    def text(self) -> str:
        return self.texts[0]

    def of_elements(self, array: Sequence[Port]) -> Iterator[tuple[Port, "ParameterValue"]]:
        """The value of each element of an array."""
        if len(self.texts) != len(array):
            raise Problem(f"{self.where}: expected {len(array)} values, got {len(self.texts)}")
        for port, text in zip(array, self.texts, strict=True):
            yield port, self._replace(name=str(port), texts=(text,), fault="")

    def map_to(self, target: DeclaredUnit | None, context: str, notes: list[str]) -> LinearTransformation:
        """The map to a value in the unit `target`; `notes` get one if a unit is unknown."""
        return self.map if self.suppressed else conversion(self.unit, target, context, notes).then(self.map)


def read_parameter_set(root: XmlElement, outer_units: Mapping[str, DeclaredUnit]) -> list[ParameterValue]:
    """The values of a parameter set, whose units are defined there or in the file around it."""
    units, values = {**outer_units, **read_units(root)}, dict[str, ParameterValue]()
    for parameter in root.children("Parameters", "Parameter"):
        name = parameter.required("name")
        where = f"{parameter.location}: parameter {name!r}"
        if name in values:
            raise Problem(f"{where}: expected a unique name, got it twice")
        value = next((e for e in parameter.children() if e.name in TYPES), None)
        texts = [e.required("value") for e in value.children("Value")] if value is not None else []
        texts += [text] if value is not None and (text := value.get("value")) is not None else []
        if value is None or not texts:
            raise Problem(f"{where}: expected a value, got none")
        texts = texts if value.name in TEXTS else texts[0].split() or texts
        count = len(texts)
        got = f"{count} values" if count > 1 else "" if value.name in KINDS else f"a {value.name}"
        fault = got and f"{where}: expected a scalar number or text, got {got}, not supported"
        unit = value.get("unit")
        # a unit that no file defines is that of its symbol
        declared = units.get(unit, with_definition(DeclaredUnit(unit))) if unit else None
        values[name] = ParameterValue(name, tuple(texts), declared, where=where, fault=fault)
    return [*values.values()]


# ---- bindings of the SSP -----------------------------------------------------------------------------------


def bound_values(signals: SignalPaths) -> dict[str, dict[str, Value]]:
    """Start values by component, see `System.started`; outer and later bindings override others."""
    flat, system = signals.flat, signals.system
    start: dict[str, dict[str, Value]] = {name: {} for name in ["", *system.components]}
    for binding in flat.bindings:
        file = binding.element.file
        for value in _values(signals, binding):
            unmatched = not signals.sizes
            for port, linear, text in _targets(signals, binding, value):
                variable, unmatched = system.variable(port), False
                if value.fault and variable.array is None:
                    raise Problem(value.fault)
                if signals.sizes and variable.causality != "structuralParameter":
                    continue
                if variable.settable:
                    start[port.component][port.variable] = coerce(str(port), variable, text, linear)
                else:
                    signals.notes.append(f"{file}: {port} is not set: the FMU computes this variable itself")
            if unmatched:
                owner = binding.owner or flat.name
                signals.notes.append(f"{file}: parameter {value.name!r} of {owner} does not match a variable")
    return start


def _targets(
    signals: SignalPaths, binding: ParameterBinding, value: ParameterValue
) -> Iterator[tuple[Port, LinearTransformation, str]]:
    """The variable that a value sets, or all that a connector feeds, with the map from the value, and it."""
    flat, system = signals.flat, signals.system
    full = str(Port(binding.owner, value.name))
    for owner in sorted([*flat.sources, *flat.systems], key=len, reverse=True):
        name = full.removeprefix(f"{owner}.") if owner else full
        if owner and name == full:
            continue
        if owner in flat.sources:
            interface, port = system.components[owner].interface, Port(owner, name)
            interface.check_supported(name, f"parameter {full}")
            if name in interface.arrays and not signals.sizes:
                elements = [Port(owner, element) for element in interface.arrays[name].elements]
                for port, of in value.of_elements(elements):
                    unit = system.variable(port).unit
                    yield port, of.map_to(unit, f"parameter {port}", signals.notes), of.text
                return
            if name in interface.variables:
                unit = system.variable(port).unit
                yield port, value.map_to(unit, f"parameter {port}", signals.notes), value.text
                return
        connector = Port(owner, name)
        if owner in flat.systems and connector in flat.connectors:
            number = str(flat.declared(connector).items.get(value.text.strip(), value.text))
            for path in (p for p in signals.paths if connector in p.connectors):
                unit = signals.unit(path, connector)
                first = value.map_to(unit, f"parameter {connector}", signals.notes)
                from_connector = replace(signals, notes=[]).map_from(path, connector, unit or value.unit)
                if path.target.component:
                    linear = first.then(from_connector)
                    yield path.target, linear, value.text if linear == IDENTITY else number
                elif connector == path.source:  # an input that is passed on
                    yield connector, first, number
            return


def _values(signals: SignalPaths, binding: ParameterBinding) -> list[ParameterValue]:
    """The values of a binding after prefix and mapping; a mapping leaves out what it does not name."""
    content = _content(signals, binding, binding.element, SET, "ParameterValues", "ParameterSet")
    prefix = binding.element.get("prefix") or ""
    values = {prefix + v.name: v for v in read_parameter_set(content, binding.units)}
    mapping = binding.element.child("ParameterMapping")
    if mapping is None:
        return [value._replace(name=name) for name, value in values.items()]
    mapped, used = dict[str, ParameterValue](), set[str]()
    for e in _content(signals, binding, mapping, MAPPING, "ParameterMapping").children("MappingEntry"):
        source, target, (linear, names) = e.required("source"), e.required("target"), read_transformation(e)
        if target in mapped:
            raise e.problem(f"expected each target once, got {target!r} twice")
        if source not in values:
            signals.notes.append(f"{e.location}: the parameter set has no {source!r}")
            continue
        suppressed, used = e.boolean("suppressUnitConversion"), used | {source}
        texts = tuple(names.get(text.strip(), text) for text in values[source].texts)
        mapped[target] = values[source]._replace(name=target, texts=texts, map=linear, suppressed=suppressed)
    if left := values.keys() - used:
        signals.notes.append(f"{content.file}: left out, not in the mapping: {first_names(sorted(left))}")
    return [*mapped.values()]


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
        values = {value.name: value for value in read_parameter_set(read_xml(file, "ParameterSet"), {})}
        for part in system.sizes({n: v for n, v in values.items() if n not in missing}):
            start: dict[str, dict[str, Value]] = {name: {} for name in ["", *system.components]}
            for value in part.values():
                array = system.array(value.name)
                try:
                    for each in [v for _, v in value.of_elements(array[1])] if array else [value]:
                        read = partial(_read, each, f"{file}: parameter {each.name}", notes)
                        for port, converted in system.assigned(each.name, each.text, read):
                            start[port.component][port.variable] = converted
                except Problem as problem:
                    raise Problem(f"{file}: {str(problem).removeprefix(f'{file}: ')}") from None
            system = system.started(start, str(chosen))
        left = [f"{file}: {name} is left out: {missing[name]}" for name in values if name in missing]
        system = system.noted(*notes, *left)
    return system


def _read(
    value: ParameterValue,
    context: str,
    notes: list[str],
    given: Value | str,
    _: Port,
    unit: DeclaredUnit | None,
) -> tuple[Value | str, LinearTransformation]:
    """A value of a set, and the map to a unit."""
    if value.fault:
        raise Problem(value.fault)
    return given, value.map_to(unit, context, notes)


def _file(system: System, chosen: str | Path) -> Location:
    """The file of a set: a path that ends in .ssv, or a name in the SSP."""
    if str(chosen).endswith(SUFFIX):
        return Location(Path(chosen))
    sets = parameter_sets(system)
    if str(chosen) not in sets:
        home = system.source.parent if system.source and system.source.members else system.source
        contents = f"{home or system.name} contains {', '.join(sets) or 'none'}"
        unknown = f"parameter set {str(chosen)!r} is unknown{suggest(str(chosen), sets)}"
        raise Problem(f"{unknown}; {contents}; a file name ends in {SUFFIX}")
    return sets[str(chosen)]


def parameter_sets(system: System) -> Mapping[str, Location]:
    """The parameter sets in the resources of an SSP, by name."""
    files = system.resources.items()
    return {PurePosixPath(n).stem: f for n, f in files if n.endswith(SUFFIX) and "/" not in n}
