"""Another FMU in the place of a component: a variant of it, or any file, checked port by port.

Connections stay, with units converted to those of the new FMU. Values that are given for a port from outside
(scenarios, parameter sets, --set) stay in the units of the FMU that is replaced.

A port fits if the new FMU has it with the same type, a causality that serves the same purpose, and a unit of
the same dimension. The new FMU may lack rate ports, which carry the time derivative of another port and no
power: without them inputs that moved inside a step are held, which costs accuracy only.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.units import IDENTITY, DeclaredUnit, LinearTransformation, conversion
from orchestrator.fmi.description import FmuInterface, FmuVariable, Value
from orchestrator.ssp.assembly import family, open_component
from orchestrator.ssp.power_bonds import find_bonds
from orchestrator.ssp.system import FEW, Component, Connection, Port, System, coerce

STEMS = {"_rate": ("",), "_acceleration": ("_velocity", "_speed")}  # ends of names: a derivative, and of what
FOLDER, SUFFIX, MAKE = "variants", ".fmu", "harvester build"


def with_swaps(system: System, swaps: Mapping[str, str | Path]) -> System:
    """The same system with other FMUs, which must have the ports that are used.

    swaps   component -> the name of a variant, or the path of an .fmu file; variants lie in `variants/`, next
            to the system's file
    """
    for name, chosen in swaps.items():
        if name not in system.components:
            close, known = suggest(name, system.components), ", ".join(system.components)
            raise Problem(f"swap {name}={chosen}: no component {name!r}{close}; there are {known}")
        system = _swap(system, name, find(system.source, name, chosen))
    return system


def find(system_file: Location | None, component: str, chosen: str | Path) -> Location:
    """The FMU that is chosen: a path ending in .fmu, an unpacked FMU, or the name of a variant.

    Variants lie in variants/<component>_<name>.fmu beside the system.
    """
    where, path = f"swap {component}={chosen}", Path(chosen)
    if path.suffix.lower() == SUFFIX or (path / "modelDescription.xml").is_file():
        if not path.exists():
            raise Problem(f"{where}: no such file")
        return Location(path)
    if path.suffix.lower() == ".py":
        makes = f"{MAKE} {chosen} makes one"
        raise Problem(f"{where}: {chosen} is a Python file, expected an {SUFFIX} file: {makes}")
    if any(mark in str(chosen) for mark in "/\\,"):
        raise Problem(f"{where}: expected the name of a variant or a path that ends in {SUFFIX}")
    if system_file is None:
        raise Problem(
            f"{where}: the system has no file to look for variants beside, expected a path to an .fmu"
        )
    home, stem = system_file.path.parent / FOLDER, f"{component.rpartition('.')[2]}_"
    file = home / f"{stem}{chosen}{SUFFIX}"
    if file.is_file():
        return Location(file)
    names = sorted(p.stem.removeprefix(stem) for p in home.glob(f"{stem}*{SUFFIX}"))
    known = f"there are {', '.join(names)}" if names else f"there is no variant of {component}"
    raise Problem(f"{where}: no file {file}; {known}; {MAKE} makes the variants, a path ends in {SUFFIX}")


def _swap(system: System, name: str, file: Location) -> System:
    old = system.components[name]
    try:
        new = open_component(name, file)
    except Problem as problem:
        raise Problem(f"swap {name}: {problem}") from None
    fit = _fit(system, old, new)
    start, notes = _start_values(old, new)
    interface = replace(new.interface, variables={**new.interface.variables, **fit.assumed})
    component = replace(new, interface=interface, start=start, replaced=old.replaced or old.interface)
    connections = (
        replace(c, map=fit.source(c.source).then(c.map).then(fit.target(c.target)))
        for c in system.connections
        if not fit.dropped & {c.source, c.target}
    )
    inlets = (
        replace(i, targets=tuple((port, linear.then(fit.target(port))) for port, linear in i.targets))
        for i in system.inputs.values()
    )
    outlets = (replace(o, map=fit.source(o.source).then(o.map)) for o in system.outputs.values())
    return replace(
        system,
        components={**system.components, name: component},
        connections=tuple(connections),
        inputs={i.name: i for i in inlets},
        outputs={o.name: o for o in outlets},
        notes=(
            *system.notes,
            f"{name} is swapped: {interface.identifier} ({file})",
            *fit.notes,
            *notes,
        ),
    )


# ---- which ports the system uses ---------------------------------------------------------------------------


@dataclass(frozen=True)
class UsedPort:
    """A port in use.

    unit          of the numbers that pass through it
    connections   to or from it
    outside       it is one of the system's own inputs or outputs
    optional      an FMU may lack it
    """

    declared: FmuVariable
    unit: DeclaredUnit | None
    connections: tuple[Connection, ...]
    outside: bool
    optional: bool

    def __str__(self) -> str:
        return f"{self.declared.causality} {self.declared.name}{f' {self.unit}' if self.unit else ''}"


def used_ports(system: System, component: Component) -> dict[str, UsedPort]:
    """The ports of a component that the system uses, by name."""
    ports = [end for c in system.connections for end in (c.source, c.target)]
    own = [port for inlet in system.inputs.values() for port, _ in inlet.targets]
    own += [outlet.source for outlet in system.outputs.values()]
    power = _power_inputs(system)
    mine = dict.fromkeys(port for port in ports + own if port.component == component.name)
    return {port.variable: _used(system, port, port in own, power) for port in mine}


def _power_inputs(system: System) -> set[Port]:
    return {port for bond in find_bonds(system) for port in (bond.effort, bond.flow)}


def _used(system: System, port: Port, outside: bool, power: set[Port]) -> UsedPort:
    connections = tuple(c for c in system.connections if port in (c.source, c.target))
    targets = {c.target for c in connections}
    # without a unit, the number has been that of the other end
    ends = [c.target if c.source == port else c.source for c in connections if c.map == IDENTITY]
    units = [system.variable(p).unit for p in (port, *ends)]
    return UsedPort(
        declared=system.variable(port),
        unit=next((u for u in units if u), None),
        connections=connections,
        outside=outside,
        optional=not outside and not targets & power and all(_is_rate(system, p) for p in targets),
    )


def _is_rate(system: System, port: Port) -> bool:
    """Is an input the time derivative of another one, by declaration or by name?"""
    interface, name = system.components[port.component].interface, port.variable
    if name in interface.rate_inputs.values():
        return name not in interface.rate_inputs  # else more than a slope: it has a slope itself
    for ending, stems in STEMS.items():
        if name.endswith(ending):
            return any(name.removesuffix(ending) + stem in interface.variables for stem in stems)
    return False


# ---- does the new FMU fit? ---------------------------------------------------------------------------------

# what a port may be in the new FMU to do the work of the old one: more may change than before, not less
SERVES = {
    "input": ("input",),
    "parameter": ("parameter", "input"),
    "structuralParameter": ("structuralParameter", "parameter", "input"),
    "output": ("output",),
    "calculatedParameter": ("calculatedParameter", "output"),
    "local": ("local", "output"),
}


@dataclass(frozen=True)
class Fit:
    """How a new FMU takes the place of an old one.

    maps      port -> from the unit that the system gives to that of the new FMU, and back
    dropped   ports whose connections are left out
    assumed   ports for which the new FMU states no unit, with the expected one
    """

    maps: Mapping[Port, tuple[LinearTransformation, LinearTransformation]]
    dropped: frozenset[Port]
    assumed: Mapping[str, FmuVariable]
    notes: tuple[str, ...]

    def target(self, port: Port) -> LinearTransformation:
        """The conversion of values that go to a port."""
        return self.maps.get(port, (IDENTITY, IDENTITY))[0]

    def source(self, port: Port) -> LinearTransformation:
        """The conversion of values that come from a port."""
        return self.maps.get(port, (IDENTITY, IDENTITY))[1]


def _fit(system: System, old: Component, new: Component) -> Fit:
    """How the new component takes the place of the old one; a Problem names all that does not fit."""
    used, variables = used_ports(system, old), new.interface.variables
    dropped = [n for n, use in used.items() if use.optional and n not in variables]
    needed = {n: use for n, use in used.items() if n not in dropped}
    free = {n: v for n, v in variables.items() if n not in used}
    faults = {n: fault for n, use in needed.items() if (fault := _fault(use, new.interface, free))}
    if faults:
        advice = _way_out(system, new, faults)
        raise Problem(f"swap {new.name}: {new.source} does not fit: {'; '.join(faults.values())}{advice}")
    bare = [n for n, use in needed.items() if variables[n].unit is None and use.unit]
    maps, remarks = dict[Port, tuple[LinearTransformation, LinearTransformation]](), list[str | None]()
    for n, use in needed.items():
        back, remark = conversion(variables[n].unit, use.unit, f"{new.name}.{n} in {new.source}")
        maps[Port(new.name, n)] = conversion(use.unit, variables[n].unit, n)[0], back
        remarks.append(remark)
    return Fit(
        maps,
        dropped=frozenset(Port(new.name, n) for n in dropped),
        assumed={n: replace(variables[n], unit=needed[n].unit) for n in bare},
        notes=(*_notes(old, new, dropped, bare), *filter(None, remarks)),
    )


def _fault(use: UsedPort, interface: FmuInterface, free: Mapping[str, FmuVariable]) -> str:
    """What is wrong with one port, as 'expected ..., got ...'; empty if it fits.

    free   the variables that may be meant by a name that is not there
    """
    name = use.declared.name
    if name in interface.unsupported:
        return f"expected {use}, got {interface.unsupported[name]}"
    if name in interface.variables:
        return _mismatch(use, interface.variables[name])
    meant = [other for other, v in free.items() if not _mismatch(use, v)]
    near = get_close_matches(name, meant, n=1, cutoff=0.8)
    return f"expected {use}, got none{f' (it has {near[0]})' if near else ''}"


def _mismatch(use: UsedPort, found: FmuVariable) -> str:
    """Where a variable differs from what is used."""
    old = use.declared
    if found.causality not in SERVES[old.causality]:
        return f"expected {use}, got {_article(found.causality)}"
    if family(found) != family(old):
        return f"expected {old.causality} {old.name} of type {old.kind}, got type {found.kind}"
    if found.unit and use.unit and found.unit.exponents is None and found.unit.name != use.unit.name:
        return f"expected {use}, got {found.unit}, a unit without definition"
    try:
        conversion(found.unit, use.unit, "")
    except Problem:
        return f"expected {use}, got {found.unit}"
    return ""


def _article(causality: str) -> str:
    kind = "local variable" if causality == "local" else causality
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def _way_out(system: System, new: Component, faults: Iterable[str]) -> str:
    """How to do without inputs, where that is all that is wrong."""
    ports = [Port(new.name, name) for name in faults]
    fed = {c.target for c in system.connections} - _power_inputs(system)
    lacking = [p for p in ports if p in fed and p.variable not in new.interface.variables]
    if len(lacking) < len(ports):
        return ""
    return f"; to do without: {' '.join(f'--cut {port}' for port in lacking)}"


def _notes(old: Component, new: Component, dropped: list[str], bare: list[str]) -> Iterator[str]:
    if dropped:
        yield (
            f"{new.source} has no {listed(dropped)}: without these rates inputs are held during a step,"
            " which costs accuracy"
        )
    if bare:
        yield f"{new.source} states no unit of {listed(bare)}: taken as that of the FMU it replaces"
    converted = [
        f"{v.name} in {v.unit}, not {before.unit}"
        for v in new.interface.variables.values()
        if (before := old.interface.variables.get(v.name)) and v.unit and before.unit
        if v.causality == before.causality and (v.settable or v.causality == "output")
        if _differ(before.unit, v.unit)
    ]
    idle = [v.name for v in new.interface.of("input") if v.name not in old.interface.variables]
    if idle:
        yield f"{new.source} has inputs of its own, {listed(idle)}: no wire feeds them"
    if converted:
        yield f"{new.source} has {listed(converted)}: converted; given values stay in the latter"


def _differ(old: DeclaredUnit, new: DeclaredUnit) -> bool:
    """Do two units of one dimension differ by more than their name?"""
    return old.dimension == new.dimension is not None and conversion(old, new, "")[0] != IDENTITY


def _start_values(old: Component, new: Component) -> tuple[dict[str, Value], list[str]]:
    """The start values in the units of the new FMU, and notes on those that it cannot take."""
    start: dict[str, Value] = {}
    missing, fixed = list[str](), list[str]()
    for name, value in old.start.items():
        variable = new.interface.variables.get(name)
        if variable is None:
            missing.append(name)
        elif not variable.settable:
            fixed.append(name)
        else:
            where = f"{new.name}: {new.source}: start value of {name}"
            linear, _ = conversion(old.interface.variables[name].unit, variable.unit, where)
            start[name] = coerce(where, variable, value, linear)
    notes = []
    if missing:
        notes.append(f"{new.source} has no {listed(missing)}: what the system sets there is left out")
    if fixed:
        notes.append(f"{new.source} determines {listed(fixed)} itself: what the system sets is left out")
    return start, notes


def listed(names: list[str]) -> str:
    """The first few names."""
    more = f" and {len(names) - FEW} more" if len(names) > FEW else ""
    return f"{', '.join(names[:FEW])}{more}"


def lost(system: System) -> Mapping[str, str]:
    """Names that a swapped FMU lacks, or does not let be set as the one before it did -> why."""
    swapped = ((c, c.replaced) for c in system.components.values() if c.replaced)
    return {f"{c.name}.{name}": why for c, before in swapped for name, why in _lost(c, before).items()}


def _lost(component: Component, before: FmuInterface) -> dict[str, str]:
    now = component.interface.variables
    fixed = (n for n, v in before.variables.items() if n in now and v.settable and not now[n].settable)
    return {
        name: f"{component.source} has no such variable" for name in before.variables if name not in now
    } | {name: f"{component.source} determines it itself" for name in fixed}
