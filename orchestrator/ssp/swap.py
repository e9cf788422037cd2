"""Which ports of a component a system uses, for what, and which of them an FMU may lack.

A rate port carries the time derivative of another port, and no power. Without its wire inputs that moved
inside a step are held: less accurate, nothing worse.

Does an FMU fit into the place of a component? Every port that the system uses is checked.

A port fits if the new FMU has it with the same type, a causality that does the same work, and a unit of the
same dimension. Wires to and from rate ports that it lacks are left out.

Start values of a component that go over to the FMU in its place.

What was known of the FMUs before the swaps, and is not any more.

Which file a swap names: a variant lies beside the system, in variants/<component>_<name>.fmu.

Another FMU in the place of a component: a variant of it, or any file, checked port by port.

What was connected stays connected, with the units of the new FMU converted; values that are given for a port
from outside (scenarios, parameter sets, --set) stay in the units of the FMU that is replaced.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.units import IDENTITY, DeclaredUnit, Linear, conversion
from orchestrator.fmi.description import Interface, Value, Variable
from orchestrator.ssp.assembly import family, open_component
from orchestrator.ssp.power_bonds import find_bonds
from orchestrator.ssp.system import FEW, Component, Connection, Inlet, Outlet, Port, System, coerce

STEMS = {"_rate": ("",), "_acceleration": ("_velocity", "_speed")}  # of names: a derivative, and of what


@dataclass(frozen=True)
class Use:
    """A port in use.

    unit      of the numbers that pass through it
    wires     to or from it
    outside   it is one of the system's own inputs or outputs
    optional  an FMU may lack it
    """

    declared: Variable
    unit: DeclaredUnit | None
    wires: tuple[Connection, ...]
    outside: bool
    optional: bool

    def __str__(self) -> str:
        return f"{self.declared.causality} {self.declared.name}{f' {self.unit}' if self.unit else ''}"


def uses(system: System, component: Component) -> dict[str, Use]:
    """The ports of a component that the system uses, by name."""
    ports = [end for c in system.connections for end in (c.source, c.target)]
    own = [port for inlet in system.inputs.values() for port, _ in inlet.targets]
    own += [outlet.source for outlet in system.outputs.values()]
    power = carrying(system)
    mine = dict.fromkeys(port for port in ports + own if port.component == component.name)
    return {port.variable: _use(system, port, port in own, power) for port in mine}


def carrying(system: System) -> set[Port]:
    """The inputs that carry power."""
    return {port for bond in find_bonds(system) for port in (bond.effort, bond.flow)}


def _use(system: System, port: Port, outside: bool, power: set[Port]) -> Use:
    wires = tuple(c for c in system.connections if port in (c.source, c.target))
    targets = {c.target for c in wires}
    # without a unit, the number has been that of the other end
    ends = [c.target if c.source == port else c.source for c in wires if c.map == IDENTITY]
    units = [system.variable(p).unit for p in (port, *ends)]
    return Use(
        declared=system.variable(port),
        unit=next((u for u in units if u), None),
        wires=wires,
        outside=outside,
        optional=not outside and not targets & power and all(_is_rate(system, p) for p in targets),
    )


def _is_rate(system: System, port: Port) -> bool:
    """Is an input the time derivative of another one, by declaration or by name?"""
    face, name = system.components[port.component].interface, port.variable
    if name in face.rates.values():
        return name not in face.rates  # else more than a slope: it has a slope itself
    for ending, stems in STEMS.items():
        if name.endswith(ending):
            return any(name.removesuffix(ending) + stem in face.variables for stem in stems)
    return False


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

    expected   port -> the unit that the system gives or takes
    found      port -> the unit of the new FMU
    dropped    ports whose wires are left out
    assumed    ports for which the new FMU states no unit, with the expected one
    """

    expected: Mapping[str, DeclaredUnit | None]
    found: Mapping[str, DeclaredUnit | None]
    dropped: frozenset[str]
    assumed: Mapping[str, Variable]
    notes: tuple[str, ...]

    def inward(self, port: str) -> Linear:
        """From the expected unit to that of the new FMU."""
        return conversion(self.expected.get(port), self.found.get(port), port)[0]

    def outward(self, port: str) -> Linear:
        """From the unit of the new FMU to the expected one."""
        return conversion(self.found.get(port), self.expected.get(port), port)[0]


def fit(system: System, old: Component, new: Component) -> Fit:
    """How the new component takes the place of the old one; a Problem tells all that does not fit."""
    used = uses(system, old)
    dropped = [n for n, use in used.items() if use.optional and n not in new.interface.variables]
    needed = {name: use for name, use in used.items() if name not in dropped}
    free = {n: v for n, v in new.interface.variables.items() if n not in used}
    faults = {name: fault for name, use in needed.items() if (fault := _fault(use, new.interface, free))}
    if faults:
        told = "; ".join(faults.values())
        raise Problem(f"swap {new.name}: {new.source} does not fit: {told}{_way_out(system, new, faults)}")
    found = {name: new.interface.variables[name] for name in needed}
    bare = [name for name, v in found.items() if v.unit is None and needed[name].unit]
    expected, units = {n: use.unit for n, use in needed.items()}, {n: v.unit for n, v in found.items()}
    remarks = (conversion(units[n], expected[n], f"{new.name}.{n} in {new.source}")[1] for n in needed)
    return Fit(
        expected=expected,
        found=units,
        dropped=frozenset(dropped),
        assumed={name: replace(found[name], unit=expected[name]) for name in bare},
        notes=(*_notes(old, new, dropped, bare), *filter(None, remarks)),
    )


def _fault(use: Use, face: Interface, free: Mapping[str, Variable]) -> str:
    """What is wrong with one port, as 'expected ..., got ...'; empty if it fits.

    free   the variables that may be meant by a name that is not there
    """
    name = use.declared.name
    if name in face.refused:
        return f"expected {use}, got {face.refused[name]}"
    if name in face.variables:
        return _mismatch(use, face.variables[name])
    meant = [other for other, v in free.items() if not _mismatch(use, v)]
    near = get_close_matches(name, meant, n=1, cutoff=0.8)
    return f"expected {use}, got none{f' (it has {near[0]})' if near else ''}"


def _mismatch(use: Use, found: Variable) -> str:
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
    fed = {c.target for c in system.connections} - carrying(system)
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


def carried(old: Component, new: Component) -> tuple[dict[str, Value], tuple[str, ...]]:
    """The start values in the units of the new FMU, and what to say about those that it cannot take."""
    start: dict[str, Value] = {}
    lacking, fixed = list[str](), list[str]()
    for name, value in old.start.items():
        variable = new.interface.variables.get(name)
        if variable is None:
            lacking.append(name)
        elif not variable.settable:
            fixed.append(name)
        else:
            where = f"{new.name}: {new.source}: start value of {name}"
            linear, _ = conversion(old.interface.variables[name].unit, variable.unit, where)
            start[name] = coerce(where, variable, value, linear)
    notes = (
        [f"{new.source} has no {listed(lacking)}: what the system sets there is left out"] if lacking else []
    )
    notes += (
        [f"{new.source} determines {listed(fixed)} itself: what the system sets is left out"] if fixed else []
    )
    return start, tuple(notes)


def listed(names: list[str]) -> str:
    """The first few names."""
    more = f" and {len(names) - FEW} more" if len(names) > FEW else ""
    return f"{', '.join(names[:FEW])}{more}"


def lost(system: System) -> Mapping[str, str]:
    """Names that a swapped FMU lacks, or does not let be set as the one before it did -> why."""
    swapped = ((c, c.replaced) for c in system.components.values() if c.replaced)
    return {f"{c.name}.{name}": why for c, before in swapped for name, why in _lost(c, before).items()}


def _lost(component: Component, before: Interface) -> dict[str, str]:
    now = component.interface.variables
    fixed = (n for n, v in before.variables.items() if n in now and v.settable and not now[n].settable)
    return {
        name: f"{component.source} has no such variable" for name in before.variables if name not in now
    } | {name: f"{component.source} determines it itself" for name in fixed}


FOLDER, SUFFIX, MAKE = "variants", ".fmu", "harvester build"


def find(system_file: Location | None, component: str, chosen: str | Path) -> Location:
    """The FMU that is chosen for a component: a path ending in .fmu, an unpacked FMU, or a variant's name."""
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
    there = f"there are {', '.join(names)}" if names else f"there is no variant of {component}"
    raise Problem(f"{where}: no file {file}; {there}; {MAKE} makes the variants, a path ends in {SUFFIX}")


def swapped(system: System, swaps: Mapping[str, str | Path]) -> System:
    """The system with other FMUs.

    swaps   component -> the name of a variant, or the path of an .fmu file
    """
    for name, chosen in swaps.items():
        if name not in system.components:
            near = suggest(name, system.components)
            there = ", ".join(system.components)
            raise Problem(f"swap {name}={chosen}: no component {name!r}{near}; there are {there}")
        system = _swap(system, name, find(system.source, name, chosen))
    return system


def _swap(system: System, name: str, file: Location) -> System:
    old, new = system.components[name], _opened(name, file)
    fitting = fit(system, old, new)
    start, notes = carried(old, new)
    face = replace(new.interface, variables={**new.interface.variables, **fitting.assumed})
    component = replace(new, interface=face, start=start, replaced=old.replaced or old.interface)
    told = f"{name} is swapped: {face.identifier} ({file})"
    return replace(
        system,
        components={**system.components, name: component},
        connections=tuple(
            _connection(c, name, fitting) for c in system.connections if _kept(c, name, fitting)
        ),
        inputs={i.name: _inlet(i, name, fitting) for i in system.inputs.values()},
        outputs={o.name: _outlet(o, name, fitting) for o in system.outputs.values()},
        notes=(*system.notes, told, *fitting.notes, *notes),
    )


def _opened(name: str, file: Location) -> Component:
    try:
        return open_component(name, file)
    except Problem as problem:
        raise Problem(f"swap {name}: {problem}") from None


def _kept(c: Connection, name: str, fitting: Fit) -> bool:
    ends = [end.variable for end in (c.source, c.target) if end.component == name]
    return not fitting.dropped.intersection(ends)


def _connection(c: Connection, name: str, fitting: Fit) -> Connection:
    linear = c.map
    if c.source.component == name:
        linear = fitting.outward(c.source.variable).then(linear)
    if c.target.component == name:
        linear = linear.then(fitting.inward(c.target.variable))
    return replace(c, map=linear)


def _inlet(inlet: Inlet, name: str, fitting: Fit) -> Inlet:
    targets = tuple(
        (port, linear.then(fitting.inward(port.variable)) if port.component == name else linear)
        for port, linear in inlet.targets
    )
    return replace(inlet, targets=targets)


def _outlet(outlet: Outlet, name: str, fitting: Fit) -> Outlet:
    if outlet.source.component != name:
        return outlet
    return replace(outlet, map=fitting.outward(outlet.source.variable).then(outlet.map))
