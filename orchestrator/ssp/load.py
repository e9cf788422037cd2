"""`load` reads a system from SSP 1.0 or 2.0 (.ssp archive, unpacked archive, .ssd file) or a single .fmu.

`assemble` makes one from FMU files and connections.

Nested systems, also those in other .ssd and .ssp files, are flattened: the name of a component is its path,
and each component input is traced back through the connectors of systems to the output that feeds it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, archive_kept_open, require_system
from orchestrator.base.options import Time, seconds
from orchestrator.base.text import grouped
from orchestrator.base.units import IDENTITY, LinearTransformation
from orchestrator.fmi.description import Value
from orchestrator.ssp.annotations import COMMON, SHARED, read_annotations
from orchestrator.ssp.common_elements import Transformation
from orchestrator.ssp.coupling import Coupling, Suggestion
from orchestrator.ssp.parameter_sets import bound_values, with_sets
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import Connection, Inlet, Outlet, Port, System, check_connection, open_component
from orchestrator.ssp.system_structure import (
    DEFINITION,
    SINKS,
    ConnectorType,
    FlatStructure,
    IncomingConnection,
    read_structure,
    signal_paths,
    whole_of,
)
from orchestrator.ssp.terminals import Terminals


def load(path: str | Path) -> System:
    """The system in an .ssp, .ssd or .fmu file, or in a folder with an unpacked SSP or FMU.

    path   or the name of a system or FMU in the folder build or in the package, such as harvester

    An FMU is used in Co-Simulation if it has that, else in Model Exchange, unless the file says which.
    """
    with archive_kept_open():
        return _load(Location(require_system(path)))


def configured(
    system: System | str | Path,
    *,
    cut: Iterable[str] = (),
    swap: Mapping[str, str | Path] | None = None,
    parameters: Sequence[str | Path] = (),
    set: Mapping[str, Value | str] | None = None,
) -> System:
    """The system with the choices of `SystemArguments`: connections, then FMUs, sets and start values."""
    system = system if isinstance(system, System) else load(system)
    return with_sets(with_swaps(system.without(*cut), swap or {}), parameters).with_start(set or {})


def _load(file: Location) -> System:
    suffix = file.path.suffix.lower()
    if suffix == ".fmu" or (file.path / "modelDescription.xml").is_file():
        return _single_fmu(file)
    if suffix == ".ssp" or file.is_folder:
        return _load_ssd(file.member(DEFINITION))
    return _load_ssd(file)


def _single_fmu(fmu: Location) -> System:
    """A system of one FMU; the inputs of the FMU are inputs of the system."""
    component = open_component(fmu.path.stem, fmu)
    inputs = [v for v in component.interface.of("input") if v.is_number]
    inlets = {v.name: Inlet(v.name, v.unit, ((Port(component.name, v.name), IDENTITY),)) for v in inputs}
    start = component.interface.start
    return System(component.name, {component.name: component}, inputs=inlets, start=start, source=fmu)


def _load_ssd(ssd: Location) -> System:
    flat = read_structure(ssd)
    suggestion, sharing, notes = read_annotations(flat.roots, flat.sources)
    flat.notes += notes
    components = {name: open_component(name, fmu, flat.kinds[name]) for name, fmu in flat.sources.items()}
    try:
        system = System(flat.name, components, (), {}, {}, flat.start, flat.stop, ssd, suggestion=suggestion)
        system = _connected(flat, replace(system, shared=sharing[SHARED], common=sharing[COMMON]))
        system.check_sharing()
    except Problem as problem:
        raise Problem(f"{ssd}: {str(problem).removeprefix(f'{ssd}: ')}") from None
    if not components:
        raise Problem(f"{ssd}: the system has no components: expected at least one FMU")
    return system


def _connected(flat: FlatStructure, system: System) -> System:
    """The system with its connections, inputs, outputs and start values."""
    notes = list(flat.notes)
    sizes = bound_values(signal_paths(flat, system, [], sizes=True))
    system = system.started(sizes, "")
    signals = signal_paths(flat, system, notes)
    maps = [(path, signals.map(path)) for path in signals.paths]
    fed: dict[Port, list[tuple[Port, LinearTransformation]]] = {}
    for path, linear in maps:
        if path.target.component in flat.sources:
            fed.setdefault(path.source, []).append((path.target, linear))
    elements = grouped(fed, lambda c: c if c in flat.connectors else whole_of(c))
    inlets = [
        e for c in flat.of_kind("", *SINKS) for e in elements.get(c, () if flat.declared(c).shape else [c])
    ]
    inputs = {c.variable: _inlet(flat, system, c, fed.get(c, ()), notes) for c in inlets}
    for name in [name for name, inlet in inputs.items() if inlet.type == "Clock"]:
        notes.append(f"{name}: left out, a clock at an input of the system, where nothing ticks")
        del inputs[name]
    system = replace(system, inputs=inputs)
    start = bound_values(replace(signals, system=system))
    connections, outputs = list[Connection](), dict[str, Outlet]()
    for path, linear in maps:
        source, target = path.source, path.target
        if source.component in flat.sources and target.component in flat.sources:
            connections.append(check_connection(system, source, target, linear))
        elif target.component in flat.sources:
            if (causality := system.variable(target).causality) not in SINKS:
                raise Problem(f"{source} -> {target}: expected one of {', '.join(SINKS)}, got {causality}")
        elif source.component and source.component not in flat.sources:
            notes.append(f"{target} is not recorded: nothing feeds {source}")
        elif not source.component and source.variable not in inputs:
            expected = "expected a scalar, or an element of an array that feeds an FMU"
            raise Problem(f"{source} -> {target}: {expected}, got {source}")
        else:
            unit = flat.declared(target).unit or system.variable(source).unit
            outputs[target.variable] = Outlet(target.variable, unit, source, linear)
    told = tuple(dict.fromkeys([*notes, *_driven_parameters(system, connections)]))
    wired = replace(system, connections=tuple(connections), outputs=outputs, notes=told)
    return wired.started(start, origin="")


def _driven_parameters(system: System, connections: Iterable[Connection]) -> Iterator[str]:
    """A note on each connection of an output to a parameter, which the standard allows."""
    for c in connections:
        variable = system.variable(c.target)
        if variable.causality == "parameter" and system.variable(c.source).causality == "output":
            yield f"{c}: expected an input, got a {variable.variability} parameter, which is set like one"


def _inlet(
    flat: FlatStructure,
    system: System,
    connector: Port,
    targets: Sequence[tuple[Port, LinearTransformation]],
    notes: list[str],
) -> Inlet:
    """An input of the outermost system; without a declared unit it has that of the inputs that it feeds."""
    variables, declared = [system.variable(port) for port, _ in targets], flat.declared(connector)
    units = {v.unit for v in variables}
    unit = declared.unit or (units.pop() if len(units) == 1 else None)
    if unit is None and len(units) > 1:
        ends = zip(targets, variables, strict=True)
        fed = ", ".join(f"{p} {f'in {v.unit}' if v.unit else 'without one'}" for (p, _), v in ends)
        notes.append(f"input {connector.variable} has no unit: the same number goes to {fed}")
    if unit and any(v.unit and v.unit.relative for v in variables):
        unit = replace(unit, relative=True)
    kind = declared.type or next((v.type for v in variables), "Real")
    items = {} if targets and all(linear == IDENTITY for _, linear in targets) else declared.items
    return Inlet(connector.variable, unit, tuple(targets), kind, items)


# ---- from FMU files


def assemble(
    fmus: Mapping[str, str | Path],
    connections: Iterable[str | Sequence[str | float]] = (),
    start: Mapping[str, Value | str] | None = None,
    name: str = "system",
    inputs: Mapping[str, Sequence[str]] | None = None,
    stop: Time = None,
    step: Time = None,
    shared: Mapping[str, Sequence[str]] | None = None,
    common: Mapping[str, Sequence[str]] | None = None,
) -> System:
    """A system from FMU files and connections.

    fmus          component name -> path of the .fmu file
    connections   "a.y -> b.u", or (source, target), or (source, target, factor, offset) with
                  target = factor * source + offset after the unit conversion; or of two terminals,
                  "drive.shaft -> arm.shaft", whose members are connected
    start         component.variable -> value
    inputs        input of the system -> component inputs that it feeds; the first one gives the unit
    stop          default stop time of a run [s], or with a unit, such as "2 s"
    step          default communication step of a run [s], or with a unit, with Gauss-Seidel
    shared        parameter -> components in which a parameter of this name is the same physical quantity
    common        the same, if different values get a note and are not refused
    """
    flat = FlatStructure(name, {n: Location(Path(p)) for n, p in fmus.items()})
    system = System(name, {n: open_component(n, file) for n, file in flat.sources.items()})
    start = start or {}
    system = system.with_start(system.sizes(start)[0], origin="")  # first, as they give arrays their elements
    terminals = Terminals(system)
    for entry in connections:
        parts = [e.strip() for e in entry.split("->")] if isinstance(entry, str) else list(entry)
        if len(parts) not in (2, 3, 4):
            raise Problem(f"connection {entry!r}: expected 'a.y -> b.u' or (source, target, factor, offset)")
        linear = LinearTransformation(*(float(x) for x in parts[2:]))
        for source, target in terminals.pairs(str(parts[0]), str(parts[1])):
            check_connection(system, source, target, linear)
            flat.connect(target, IncomingConnection(source, Transformation(linear)))
    for inlet, targets in (inputs or {}).items():
        ports = [system.port(target) for target in targets]
        flat.connectors[Port("", inlet)] = ConnectorType("input", system.variable(ports[0]).unit)
        for port in ports:
            if (causality := system.variable(port).causality) != "input":
                raise Problem(f"{inlet} -> {port}: expected an input, got {causality}")
            flat.connect(port, IncomingConnection(Port("", inlet)))
    length = seconds(step, "step")
    system = replace(
        _connected(flat, system),
        stop=seconds(stop, "stop"),
        suggestion=Suggestion() if length is None else Suggestion(Coupling("gauss-seidel"), length),
        shared={parameter: tuple(names) for parameter, names in (shared or {}).items()},
        common={parameter: tuple(names) for parameter, names in (common or {}).items()},
    ).with_start(start, origin="")
    system.check_sharing()
    return system
