"""Swaps: a component gets another FMU, a variant or any file, whose ports are checked.

Connections are kept, with units converted to those of the new FMU. Values that a user gives for a port
(scenarios, parameter sets, --set) keep the units of the replaced FMU.

A port fits if the new FMU has it with the same type, a causality that serves the same purpose, and a unit of
the same dimension. The new FMU may lack ports without power of three kinds; their connections are left out:

- Rate ports, the time derivative of another port. Without them inputs are held that would vary inside a step,
  which only reduces the accuracy.
- Ports of connections to inputs that an FMU declares as optional. They keep their start values. A note has
  the declared meaning. It is a warning if a state of the system depends on the input.
- Inputs that it does not use, with a note. If it has another free input of the same type and dimension, the
  swap is refused, because that input may be the same port under another name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import FMUS, VARIANTS, Location, require
from orchestrator.base.text import first_names
from orchestrator.base.units import IDENTITY, DeclaredUnit, LinearTransformation, conversion
from orchestrator.fmi.description import FmuVariable, Value
from orchestrator.ssp.power_bonds import find_bonds
from orchestrator.ssp.system import Component, Connection, Port, System, coerce, open_component

SUFFIX, MAKE = ".fmu", "harvester build"


def with_swaps(system: System, swaps: Mapping[str, str | Path]) -> System:
    """The system with other FMUs, which must have the ports that are used.

    swaps   component -> name of a variant, or path of an .fmu file; variants are in the folder `variants/`
            next to the system's file
    """
    lost = list[LostSignal]()
    for name, chosen in swaps.items():
        if name not in system.components:
            names = ", ".join(system.components)
            hint = f"{suggest(name, system.components)}; there are {names}"
            raise Problem(f"swap {name}={chosen}: no component {name!r}{hint}")
        system, signals = _swap(system, name, find_fmu(system.source, name, chosen))
        lost += signals
    told = [(signal, signal.users(system)) for signal in lost]
    warnings = (f"{signal}; {' and '.join(users)} could use this signal" for signal, users in told if users)
    system = system.noted(*(str(signal) for signal, users in told if not users))
    return replace(system, warnings=(*system.warnings, *warnings))


def find_fmu(system_file: Location | None, component: str, chosen: str | Path) -> Location:
    """The FMU of a swap: a path that ends in .fmu, an unpacked FMU, or the name of a variant.

    A variant is the file variants/<component>_<name>.fmu next to the system's file.
    """
    context, path = f"swap {component}={chosen}", Path(chosen)
    if path.suffix.lower() == SUFFIX or (path / "modelDescription.xml").is_file():
        return Location(require(path, FMUS, context))
    if path.suffix.lower() == ".py":
        raise Problem(f"{context}: expected an {SUFFIX} file, got a Python file; {MAKE} {chosen} makes one")
    if any(mark in str(chosen) for mark in "/\\,"):
        raise Problem(f"{context}: expected the name of a variant or a path that ends in {SUFFIX}")
    if system_file is None:
        got = "the system has no file and no folder of variants"
        raise Problem(f"{context}: expected a path to an .fmu: {got}")
    folder, prefix = system_file.path.parent / VARIANTS, f"{component.rpartition('.')[2]}_"
    file = folder / f"{prefix}{chosen}{SUFFIX}"
    if file.is_file():
        return Location(file)
    names = sorted(p.stem.removeprefix(prefix) for p in folder.glob(f"{prefix}*{SUFFIX}"))
    variants = (
        f"variants of {component}: {', '.join(names)}" if names else f"there is no variant of {component}"
    )
    hint = f"{MAKE} builds all variants; the path of another FMU ends in {SUFFIX}"
    raise Problem(f"{context}: no file {file}; {variants}; {hint}")


def _swap(system: System, name: str, file: Location) -> tuple[System, list[LostSignal]]:
    """The system with another FMU in a component, and the signals to optional inputs that are lost."""
    old = system.components[name]
    try:
        new = open_component(name, file)
    except Problem as problem:
        raise Problem(f"swap {name}: {problem}") from None
    used, variables, notes = used_ports(system, old), new.interface.variables, list[str]()
    unused, dropped = _missing(new, used)
    back, forth = dict[Port, LinearTransformation](), dict[Port, LinearTransformation]()  # to the new unit
    needed = {Port(name, n): use for n, use in used.items() if n not in dropped}
    for port, use in needed.items():
        unit = variables[port.variable].unit
        back[port] = conversion(unit, use.unit, f"{port} in {new.source}", notes)
        forth[port] = conversion(use.unit, unit, port.variable)
    units = {p.variable: use.unit for p, use in needed.items() if use.unit}
    without_unit = [n for n in units if not variables[n].unit]
    assumed = {n: replace(variables[n], unit=units[n]) for n in without_unit}
    interface = replace(new.interface, variables={**variables, **assumed})
    start, missing, fixed = _start_values(old, new)
    origins = {n: origin for n, origin in old.origins.items() if n in start}
    replaced = old.replaced or old.interface
    component = replace(new, interface=interface, start=start, replaced=replaced, origins=origins)
    without = {Port(name, n) for n in dropped}
    connections = (
        replace(c, map=back.get(c.source, IDENTITY).then(c.map).then(forth.get(c.target, IDENTITY)))
        for c in system.connections
        if not without & {c.source, c.target}
    )
    inlets = (
        replace(i, targets=tuple((p, linear.then(forth.get(p, IDENTITY))) for p, linear in i.targets))
        for i in system.inputs.values()
    )
    outlets = (replace(o, map=back.get(o.source, IDENTITY).then(o.map)) for o in system.outputs.values())
    rates = _lost_rates(system, used, dropped)
    told = _notes(old, new, unused, rates, without_unit, missing, fixed)
    swapped = replace(
        system,
        components={**system.components, name: component},
        connections=tuple(connections),
        inputs={i.name: i for i in inlets},
        outputs={o.name: o for o in outlets},
    ).noted(f"{name} is swapped: {interface.identifier} ({file})", *told, *notes)
    return swapped, [
        LostSignal(new, n, tuple(port for port, t in used[n].meanings.items() if t == text), text)
        for n in dropped
        for text in dict.fromkeys(used[n].meanings.values())
    ]


# ---- which ports the system uses ---------------------------------------------------------------------------


@dataclass(frozen=True)
class UsedPort:
    """A port of a component that the system uses.

    unit          of the values that are exchanged
    connections   to or from it
    ignorable     an input without power: an FMU that does not use it may lack it
    optional      another FMU may lack it
    meanings      connected inputs that are declared as optional -> what it means that nothing feeds them
    """

    declared: FmuVariable
    unit: DeclaredUnit | None
    connections: tuple[Connection, ...]
    ignorable: bool
    optional: bool
    meanings: Mapping[Port, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.declared.causality} {self.declared.name}{f' {self.unit}' if self.unit else ''}"


def used_ports(system: System, component: Component) -> dict[str, UsedPort]:
    """The ports of a component that the system uses, by name."""
    connected = [end for c in system.connections for end in (c.source, c.target)]
    exposed = [port for inlet in system.inputs.values() for port, _ in inlet.targets]
    exposed += [outlet.source for outlet in system.outputs.values()]
    power = {port for bond in find_bonds(system) for port in (bond.effort, bond.flow)}
    ports = dict.fromkeys(port for port in connected + exposed if port.component == component.name)
    return {port.variable: _used_port(system, port, port in exposed, power) for port in ports}


def _used_port(system: System, port: Port, exposed: bool, power: set[Port]) -> UsedPort:
    connections = tuple(c for c in system.connections if port in (c.source, c.target))
    targets = {c.target for c in connections}
    # a port without a unit has the unit of the port at the other end
    other_ends = [c.target if c.source == port else c.source for c in connections if c.map == IDENTITY]
    units = [system.variable(p).unit for p in (port, *other_ends)]
    meanings = {p: text for p in sorted(targets) if (text := _optional_input(system, p))}
    dispensable = all(p in meanings or _is_rate(system, p) for p in targets)
    powerless = not exposed and not targets & power
    return UsedPort(
        declared=system.variable(port),
        unit=next((u for u in units if u), None),
        connections=connections,
        ignorable=powerless and system.variable(port).causality == "input" and not dispensable,
        optional=powerless and dispensable,
        meanings=meanings,
    )


def _optional_input(system: System, port: Port) -> str:
    """The declared meaning of an optional input without source; empty for another port.

    The declaration of an FMU that was replaced counts, too: it holds for the place in the system.
    """
    component = system.components[port.component]
    before = component.replaced.model.optional_inputs if component.replaced else {}
    return {**before, **component.interface.model.optional_inputs}.get(port.variable, "")


def _is_rate(system: System, port: Port) -> bool:
    """Is an input declared as the time derivative of another one?"""
    rates, name = system.components[port.component].interface.rate_inputs, port.variable
    return name in rates.values() and name not in rates  # a rate with a rate of its own is needed for more


# ---- does the new FMU fit? ---------------------------------------------------------------------------------

# causality of a port -> causalities in a new FMU that serve the same purpose
REPLACEMENTS = {
    "input": ("input",),
    "parameter": ("parameter", "input"),
    "structuralParameter": ("structuralParameter", "parameter", "input"),
    "output": ("output",),
    "calculatedParameter": ("calculatedParameter", "output"),
    "local": ("local", "output"),
}


def _missing(new: Component, used: Mapping[str, UsedPort]) -> tuple[list[str], list[str]]:
    """The ports that a new FMU does not use, and all that it lacks; raises Problem if others do not fit."""
    others = {n: v for n, v in new.interface.variables.items() if n not in used}
    missing = {n: use for n, use in used.items() if n not in new.interface.variables}
    unused = [n for n, use in missing.items() if use.ignorable and not _fault(use, new, others)]
    dropped = [n for n, use in missing.items() if use.optional or n in unused]
    needed = (use for n, use in used.items() if n not in dropped)
    if faults := list(filter(None, (_fault(use, new, others) for use in needed))):
        raise Problem(f"swap {new.name}: {new.source} does not fit: {'; '.join(faults)}")
    return unused, dropped


def _fault(use: UsedPort, new: Component, others: Mapping[str, FmuVariable]) -> str:
    """Why a port does not fit, as 'expected ..., got ...'; empty if it fits.

    others   variables of the new FMU that may have another name for the port
    """
    name, interface = use.declared.name, new.interface
    if name in interface.unsupported:
        return f"expected {use}, got {interface.unsupported[name]}"
    if name in interface.variables:
        return _mismatch(use, interface.variables[name])
    # a similar name, or any input that fits one which the FMU might leave out
    fitting = [other for other, v in others.items() if not _mismatch(use, v)]
    similar = get_close_matches(name, fitting, n=1, cutoff=0.8)
    other = next(iter(similar or (fitting if use.ignorable else ())), "")
    if use.ignorable and not other:
        return ""
    cut = f"; to do without: --cut {new.name}.{name}" if use.ignorable else ""
    return f"expected {use}, got none{f' (it has {other}{cut})' if other else ''}"


def _mismatch(use: UsedPort, new: FmuVariable) -> str:
    """How a variable differs from the port in use; empty if it fits."""
    old = use.declared
    if new.causality not in REPLACEMENTS[old.causality]:
        noun = "local variable" if new.causality == "local" else new.causality
        return f"expected {use}, got {'an' if noun[0] in 'aeiou' else 'a'} {noun}"
    if new.value_type != old.value_type:
        return f"expected {old.causality} {old.name} of type {old.kind}, got type {new.kind}"
    if new.unit and use.unit and new.unit.exponents is None and new.unit.name != use.unit.name:
        return f"expected {use}, got {new.unit}, a unit without definition"
    try:
        conversion(new.unit, use.unit, "")
    except Problem:
        return f"expected {use}, got {new.unit}"
    return ""


def _lost_rates(system: System, used: Mapping[str, UsedPort], dropped: Iterable[str]) -> list[str]:
    """The dropped rates, without those of signals that are dropped, too."""
    rates = {n for n in dropped if used[n].optional and not used[n].meanings}
    lost = {c.target for n in dropped if n not in rates for c in used[n].connections}
    of_lost = {rate for port, rate in system.rate_ports.items() if port in lost}
    return [n for n in dropped if n in rates and any(c.target not in of_lost for c in used[n].connections)]


@dataclass(frozen=True)
class LostSignal:
    """A signal to optional inputs whose port a new FMU lacks.

    targets   the inputs; the port itself if it is one
    meaning   what it means if nothing feeds them
    """

    new: Component
    port: str
    targets: tuple[Port, ...]
    meaning: str

    def users(self, system: System) -> list[str]:
        """The other components that would use the signal."""
        names = dict.fromkeys(_users(system, self.targets))
        return [f"{n} ({system.components[n].interface.identifier})" for n in names if n != self.new.name]

    def __str__(self) -> str:
        return f"{self.new.source} has no {self.port}: {self.meaning}"


def _users(system: System, inputs: Iterable[Port]) -> Iterator[str]:
    """Components with a state that may depend on some inputs, directly or through outputs of others."""
    reached, todo = set[Port](), list(inputs)
    while todo:
        port = todo.pop()
        interface, name = system.components[port.component].interface, port.variable
        if port in reached or name not in interface.variables or name in interface.unused_inputs:
            continue
        reached.add(port)
        rates = [interface.dependencies.get(dx) for dx in interface.states.values()]
        declared = interface.stateless or (rates and None not in rates)
        if not declared or any(name in known for known in rates if known):
            yield port.component
        outgoing = (c for c in system.connections if c.source.component == port.component)
        todo += (c.target for c in outgoing if name in interface.direct_inputs(c.source.variable))


def _notes(
    old: Component,
    new: Component,
    unused: list[str],
    rates: list[str],
    without_unit: list[str],
    missing: list[str],
    fixed: list[str],
) -> Iterator[str]:
    """Notes on inputs, and on start values that the new FMU lacks, or computes itself."""
    variables = old.interface.variables
    additional = [v.name for v in new.interface.of("input") if v.name not in variables]
    converted = [
        f"{v.name} in {v.unit}, not {before.unit}"
        for v in new.interface.variables.values()
        if (before := variables.get(v.name)) and v.unit and before.unit
        if v.causality == before.causality and (v.settable or v.causality == "output")
        if _differ(before.unit, v.unit)
    ]
    held = "without these rates inputs are held during a step, which reduces the accuracy"
    without = "the start values in the system are not used"
    keep = "values that you set keep the unit of the replaced FMU"
    for names, text in (
        (unused, "has no {}: it does not use what the system would send there"),
        (rates, f"has no {{}}: {held}"),
        (without_unit, "declares no unit for {}: that of the replaced FMU is used"),
        (missing, f"has no {{}}: {without}"),
        (fixed, f"computes {{}} itself: {without}"),
        (additional, "has additional inputs, which are not connected: {}"),
        (converted, f"has other units, which are converted: {{}}; {keep}"),
    ):
        if names:
            yield f"{new.source} {text.format(first_names(names))}"


def _differ(old: DeclaredUnit, new: DeclaredUnit) -> bool:
    """Do two units of one dimension differ by more than their name?"""
    return old.dimension == new.dimension is not None and conversion(old, new, "") != IDENTITY


def _start_values(old: Component, new: Component) -> tuple[dict[str, Value], list[str], list[str]]:
    """Start values in the units of the new FMU; those that it lacks, and those that it computes itself."""
    start, missing, fixed = dict[str, Value](), list[str](), list[str]()
    for name, value in old.start.items():
        variable = new.interface.variables.get(name)
        if variable is None:
            missing.append(name)
        elif not variable.settable:
            fixed.append(name)
        else:
            context = f"{new.name}: {new.source}: start value of {name}"
            linear = conversion(old.interface.variables[name].unit, variable.unit, context)
            start[name] = coerce(context, variable, value, linear)
    return start, missing, fixed


def missing_after_swap(system: System) -> Mapping[str, str]:
    """Variables that a swapped FMU lacks, or does not let a user set any more -> the reason."""
    reasons = dict[str, str]()
    for c in system.components.values():
        now = c.interface.variables
        for name, before in c.replaced.variables.items() if c.replaced else ():
            if name not in now:
                reasons[f"{c.name}.{name}"] = f"{c.source} has no such variable"
            elif before.settable and not now[name].settable:
                reasons[f"{c.name}.{name}"] = f"{c.source} computes it itself"
    return reasons
