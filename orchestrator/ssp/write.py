"""Writes a system as an .ssp file: SSP 1.0, or 2.0 for FMUs of FMI 3.0.

The archive contains the system structure, the FMUs, parameter sets, and the other resources of the SSP that
the system was loaded from.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.base.files import write_zip
from orchestrator.base.text import grouped
from orchestrator.base.units import IDENTITY, DeclaredUnit
from orchestrator.base.xml import generation_tool, rendered_xml
from orchestrator.fmi.description import FmuVariable, Value
from orchestrator.ssp.annotations import COMMON, SHARED, coupling_attributes
from orchestrator.ssp.common_elements import NAMESPACES, TYPES, defined_units
from orchestrator.ssp.system import RESOURCES, Inlet, Outlet, Port, System
from orchestrator.ssp.system_structure import DEFINITION, FMU

Values = Mapping[str, tuple[FmuVariable, Value]]  # name of a parameter -> the variable it sets, and its value
DESCRIPTION = "modelDescription.xml"
# files of components: FMUs are written anew, nested systems are flattened
NOT_COPIED = (".fmu", ".ssp", ".ssd")
SIGNALS = "signals.ssb"  # a dictionary of the components' signals, which earlier versions wrote
WIDTH, GAP, PITCH = 70.0, 50.0, 5.0  # [mm] of a drawn component, between two, between connectors
# name, kind, variable, unit, and place in a box with the corners (0, 0) and (1, 1)
Connector = tuple[str, str, FmuVariable, DeclaredUnit | None, tuple[float, float]]
Places = Mapping[Port, tuple[Port, str]]  # element of an array -> connector of the array, indices in it


def write_ssp(
    system: System,
    path: str | Path,
    sets: Mapping[str, Mapping[str, float]] | None = None,
    bound: Sequence[str] = (),
    resources: Mapping[str, bytes] | None = None,
    version: str | None = None,
) -> Path:
    """Write a system to `path` and return `path`; `load` reads the same system from there.

    sets         name of a parameter set -> its values by "component.variable"
    bound        names of the sets that are bound to the system, so that they are its default values
    resources    name under resources/ -> content of a further file; resources of the SSP that the system was
                 loaded from, such as view.toml and parameter sets, are written too
    version      version of SSP, 1.0 or 2.0; default: 2.0 for FMUs of FMI 3.0, else 1.0
    """
    if version is None:
        version = "2.0" if any(c.interface.model.major == 3 for c in system.components.values()) else "1.0"
    if version not in TYPES:
        raise Problem(f"{system.name}: SSP version: expected one of {', '.join(TYPES)}, got {version!r}")
    _check_types(system, version)
    sets = sets or {}
    for name in bound:
        if name not in sets:
            raise Problem(f"{system.name}: bound set {name}: expected one of the sets {', '.join(sets)}")
    files = _other_resources(system) | dict(resources or {})
    for name, c in system.components.items():
        if c.source is None:
            expected = f"expected an FMU file to write into {path}"
            raise Problem(f"{system.name}: component {name}: {expected}, got none")
        files[f"{name}.fmu"] = c.source.read()
    for name, values in sets.items():
        try:
            ports = [(port, system.port(port), value) for port, value in values.items()]
        except Problem as problem:
            raise Problem(f"{system.name}: set {name}: {problem}") from None
        parameters = {port: (system.variable(of), value) for port, of, value in ports}
        files[f"{name}.ssv"] = parameter_set(name, parameters, version, generation_tool())
    content = {DEFINITION: _structure(system, version, bound)}
    write_zip(Path(path), content | {f"{RESOURCES}/{name}": data for name, data in files.items()})
    return Path(path)


def _check_types(system: System, version: str) -> None:
    """Refuse connections and start values of clocks and binaries in SSP 1.0."""
    starts = [Port(c.name, v) for c in system.components.values() for v in c.start]
    for port in (*(c.source for c in system.connections), *starts):
        if (variable := system.variable(port)).value_type not in TYPES[version]:
            expected = f"expected a number or a text in SSP {version}, got a {variable.kind}"
            raise Problem(f"{system.name}: {port}: {expected}; version 2.0 has it")


def _other_resources(system: System) -> dict[str, bytes]:
    """Resources of the system's SSP that are not files of components."""
    unpacked = [n.removesuffix(DESCRIPTION) for n in system.resources if n.endswith(f"/{DESCRIPTION}")]
    return {
        name: file.read()
        for name, file in system.resources.items()
        if name != SIGNALS and not name.endswith(NOT_COPIED) and not name.startswith(tuple(unpacked))
    }


def parameter_set(name: str, values: Values, version: str = "1.0", tool: str | None = None) -> bytes:
    """The content of an .ssv file; tool: for the attribute generationTool."""
    units = defined_units(variable.unit for variable, _ in values.values())
    return _file("ParameterSet.ssv", version, name=name, tool=tool, values=_typed(values), units=units)


def _file(template: str, version: str, **content: object) -> bytes:
    """A file from a template; types: of values -> name in a version of SSP."""
    path = Path(__file__).with_name("templates") / f"{template}.j2"
    return rendered_xml(path, version=version, namespaces=NAMESPACES, types=TYPES[version], **content)


def _typed(values: Values) -> Values:
    """The values, those of real variables as floats."""
    return {name: (v, float(value) if v.is_real else value) for name, (v, value) in values.items()}


def _structure(s: System, version: str, bound: Sequence[str]) -> bytes:
    """The content of SystemStructure.ssd."""
    places = {} if version == "1.0" else _places(s)
    connectors = dict(_connectors(s, places, TYPES[version]))
    variables = {name: {**c.interface.variables, **c.interface.arrays} for name, c in s.components.items()}
    units = [v.unit for of_component in variables.values() for v in of_component.values()]
    units += [i.unit for i in s.inputs.values()] + [o.unit for o in s.outputs.values()]
    starts = {name: start for name, inlet in s.inputs.items() if (start := _start(s, inlet))}
    shared = [(SHARED, name, [port.component for port in s.sharing(name)]) for name in s.shared]
    shared += [(COMMON, name, [c for c in names if c in s.components]) for name, names in s.common.items()]
    step = s.suggestion.step
    return _file(
        DEFINITION,
        version,
        tool=generation_tool(),
        system=s,
        fmu_type=FMU,
        identity=IDENTITY,
        connectors=connectors,
        start=_typed(starts),
        bound=bound,
        boxes={name: _box(k, connectors[name]) for k, name in enumerate(s.components)},
        component_start={
            name: _with_lists(
                _typed({v: (variables[name][v], value) for v, value in c.start.items()}), version
            )
            for name, c in s.components.items()
        },
        connections=list(_connections(s, places)),
        units=defined_units(units),
        decimal=None if step is None else f"{step:.12f}".rstrip("0"),  # OMSimulator allows no exponent
        coupling=coupling_attributes(s.suggestion),
        factors=s.coupling.factors if s.coupling else {},
        shared=[row for row in shared if row[-1]],
    )


def _with_lists(values: Values, version: str) -> Values:
    """The values, in SSP 2.0 those of whole arrays of numbers as lists."""
    result, whole = dict[str, tuple[FmuVariable, Value]](), dict[str, bool]()
    for name, (variable, value) in values.items():
        array = variable.array if version != "1.0" and variable.kind in ("Real", "Integer") else None
        if array and array.name not in whole:
            whole[array.name] = all(e in values for e in array.elements)
            if whole[array.name]:
                result[array.name] = array, " ".join(repr(values[e][1]) for e in array.elements)
        if not (array and whole[array.name]):
            result[name] = variable, value
    return result


def _variable(s: System, port: Port) -> FmuVariable:
    """The variable of a port; that of a port of the system is the first one that it is connected with."""
    if port.component or port.variable not in (*s.inputs, *s.outputs):
        return s.variable(port)
    inlet = s.inputs.get(port.variable)
    if inlet is None:
        return s.variable(s.outputs[port.variable].source)
    return s.variable(inlet.targets[0][0] if inlet.targets else port)


def _places(s: System) -> Places:
    """The elements that are written as a part of an array, in SSP 2.0.

    Those of the system are if none is missing, each has the indices of its variable, and all have one unit.
    """
    found = {
        Port(component.name, name): (Port(component.name, v.array.name), _indices(name))
        for component in s.components.values()
        for name, v in component.interface.variables.items()
        if v.array
    }
    every: tuple[Mapping[str, Inlet | Outlet], ...] = s.inputs, s.outputs
    for ends in every:
        for name, elements in grouped(ends.values(), lambda e: e.name.rpartition("[")[0]).items():
            pairs = [(e, _variable(s, Port("", e.name))) for e in elements]
            own = [
                (v.array and v.array.shape, _indices(v.name) == _indices(e.name), e.unit) for e, v in pairs
            ]
            array = pairs[0][1].array
            if array and name not in ends and own == [(array.shape, True, own[0][2])] * array.size:
                found |= {Port("", e.name): (Port("", name), _indices(e.name)) for e in elements}
    return found


def _indices(element: str) -> str:
    """The indices of an element of an array, as connections have them."""
    return element.rpartition("[")[2].rstrip("]").replace(",", " ")


def _sides(s: System, types: Collection[str]) -> dict[str, tuple[list[Port], list[Port]]]:
    """Ports at the left and at the right of the system, "", and of its components, in the order of the FMU.

    Of a component these are the connected inputs and all outputs of some types. A clock that is the source of
    a connection is at the right.
    """
    fed, read = s.fed, {c.source for c in s.connections} | {o.source for o in s.outputs.values()}
    sides = {"": ([Port("", name) for name in s.inputs], [Port("", name) for name in s.outputs])}
    for name, component in s.components.items():
        ports = [(Port(name, v.name), v) for v in component.interface.variables.values()]
        outputs = [p for p, v in ports if (v.causality == "output" or p in read) and v.value_type in types]
        sides[name] = [p for p, _ in ports if p in fed], outputs
    return sides


def _connectors(s: System, places: Places, types: Collection[str]) -> Iterator[tuple[str, list[Connector]]]:
    """The connectors of the system, "", and of its components, from top to bottom on either side."""
    for owner, sides in _sides(s, types).items():
        connectors = list[Connector]()
        for x, (kind, side) in enumerate(zip(("input", "output"), sides, strict=True)):
            groups = grouped(side, lambda port: places.get(port, (port, ""))[0])
            for n, (connector, ports) in enumerate(groups.items(), 1):
                variable, at = _variable(s, ports[0]), (float(x), 1 - n / (len(groups) + 1))
                whole = variable if connector == ports[0] else variable.array or variable
                kind = whole.causality if owner else kind
                connectors.append((connector.variable, kind, whole, _unit(s, ports[0]), at))
        yield owner, connectors


def _box(place: int, connectors: Sequence[Connector]) -> tuple[float, float, float, float]:
    """Corners x1, y1, x2, y2 [mm] of a component in the row of all, with room for its connectors."""
    inputs = sum(at[0] == 0.0 for *_, at in connectors)
    left = place * (WIDTH + GAP)
    return left, 0.0, left + WIDTH, PITCH * (1 + max(inputs, len(connectors) - inputs))


def _unit(s: System, port: Port) -> DeclaredUnit | None:
    """The unit of a port; that of a port of the system may be another one than that of its variable."""
    end = None if port.component else s.inputs.get(port.variable) or s.outputs[port.variable]
    return end.unit if end else s.variable(port).unit


def _start(s: System, inlet: Inlet) -> tuple[FmuVariable, Value] | None:
    """The start value of an input of the system, from the first component input that it feeds.

    Without it some tools set zero.
    """
    value = s.start_of(inlet)
    if value is None:
        return None
    variable = s.variable(inlet.targets[0][0] if inlet.targets else Port("", inlet.name))
    return replace(variable, unit=inlet.unit), value


def _connections(s: System, places: Places) -> Iterator[tuple[Any, ...]]:
    """Connections between components, then those of inputs and outputs of the system.

    Each with the indices at both ends, its map, the type of values in its table, and whether the reader must
    suppress its own unit conversion, which the map contains. Arrays are connected whole if all their
    elements are.
    """
    ends = [(c.source, c.target, c.map) for c in s.connections]
    ends += [(Port("", i.name), p, linear) for i in s.inputs.values() for p, linear in i.targets]
    ends += [(o.source, Port("", o.name), o.map) for o in s.outputs.values()]
    placed = [(*places.get(a, (a, "")), *places.get(b, (b, ""))) for a, b, _ in ends]
    together = Counter(
        (*place[::2], linear)
        for place, (*_, linear) in zip(placed, ends, strict=True)
        if place[1] == place[3]
    )
    done = set[Any]()
    for (start, of_start, end, of_end), (source, target, linear) in zip(placed, ends, strict=True):
        units = _unit(s, source), _unit(s, target)
        converted = linear != IDENTITY or (units[0] != units[1] and None not in units)
        if linear.table and (linear.factor, linear.offset) != (1.0, 0.0):
            raise Problem(f"{source} -> {target}: expected a line or a mapping of values to write, got both")
        kind = "Boolean" if s.variable(source).kind == "Boolean" else "Integer"
        arrays = [v.array for p in (source, target) if (v := _variable(s, p)).array]
        if of_start and all(together[start, end, linear] == a.size for a in arrays if a):
            if (start, end) in done:
                continue
            done.add((start, end))
            of_start = of_end = ""
        yield start, end, of_start, of_end, linear, kind, converted
