"""A co-simulation system as data: components, connections, and inputs and outputs of the system."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import islice
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.numerals import integer, real
from orchestrator.base.signals import selected
from orchestrator.base.text import brief, first_names, grouped
from orchestrator.base.units import (
    IDENTITY,
    DeclaredUnit,
    LinearTransformation,
    conversion,
    from_user_unit,
    number_and_unit,
)
from orchestrator.fmi.description import FmuVariable, Value
from orchestrator.fmi.interface import FmuInterface, read_interface
from orchestrator.ssp.coupling import Coupling, CouplingOptions, Suggestion

TYPED = 12  # characters of a number below which somebody has typed it
MAX_NAMES = 4  # in a message
ROUNDING = 1e-12  # relative difference of equal values after a conversion of units; messages show 13 digits
WRITTEN = 1e-6  # relative difference of equal values that tools have written with 6 to 9 digits
RESOURCES = "resources"  # folder of an SSP
SOURCES = ("output", "calculatedParameter")  # causalities at the first end of a connection
TARGETS = ("input", "parameter")  # at its second end
# a given value, the port it sets, the unit of user values -> the value without its unit, and the map to that
ReadValue: TypeAlias = (
    "Callable[[Value | str, Port, DeclaredUnit | None], tuple[Value | str, LinearTransformation]]"
)


class Port(NamedTuple):
    """One variable of one component, or a connector of a system, whose path is the component."""

    component: str
    variable: str

    def __str__(self) -> str:
        return f"{self.component}.{self.variable}" if self.component else self.variable


class Chosen(NamedTuple):
    """Where a start value that a user chose comes from, such as --set, and the value of the system."""

    origin: str
    before: Value


@dataclass(frozen=True)
class Component:
    """One FMU in the system.

    start      start values that the system sets before initialisation
    replaced   interface of the FMU that was replaced by a swap
    origins    variable -> origin of its start value, for those that a user chose
    """

    name: str
    interface: FmuInterface
    source: Location | None = None
    start: Mapping[str, Value] = field(default_factory=dict)
    replaced: FmuInterface | None = None
    origins: Mapping[str, Chosen] = field(default_factory=dict)

    __repr__ = brief

    def __post_init__(self) -> None:
        """Arrays have the sizes that structural parameters give them; elements may vanish."""
        resized = self.interface.resized(self.start)
        if resized is not self.interface:
            object.__setattr__(self, "interface", resized)
            for name in ("start", "origins"):
                left = {n: v for n, v in getattr(self, name).items() if n in resized.variables}
                object.__setattr__(self, name, left)

    @cached_property
    def whole_start(self) -> Mapping[str, Value]:
        """The start values of the system; of an array with some of them those of the FMU, too.

        Elements without any, which are fed, begin with 0 or an empty text.
        """
        variables = self.interface.variables
        arrays = dict.fromkeys(a for name in self.start if (a := variables[name].array))
        blank = {e: 0 if a.is_number else "" for a in arrays for e in a.elements if not self.has_start(e)}
        values = {e: self.value(e) for array in arrays for e in array.elements if e not in blank}
        return {**self.start, **blank, **values}

    def with_start(self, values: Mapping[str, Value], origin: str) -> Component:
        """The component with other start values; origin: where they come from, if a user chose them."""
        if not origin:
            return replace(self, start={**self.start, **values})
        before = {n: self.origins[n].before if n in self.origins else self.value(n) for n in values}
        origins = {name: Chosen(origin, value) for name, value in before.items()}
        return replace(self, start={**self.start, **values}, origins={**self.origins, **origins})

    def value(self, variable: str) -> Value:
        """The start value of a variable: that of the system, else that of the FMU; NaN without one."""
        declared = self.interface.variables[variable]
        if variable in self.start:
            return self.start[variable]
        if declared.start is None:
            return float("nan") if declared.is_number else ""
        return coerce(f"{self.name}.{variable}", declared, declared.start)

    def has_start(self, variable: str) -> bool:
        """Has a variable a start value, from the system or the FMU?"""
        return variable in self.start or self.interface.variables[variable].start is not None

    def real_parameters(self) -> dict[str, float]:
        """Values of the Real parameters that have one, by name."""
        real = [v for v in self.interface.variables.values() if v.is_real and v.causality == "parameter"]
        return {v.name: float(self.value(v.name)) for v in real if self.has_start(v.name)}


@dataclass(frozen=True)
class Connection:
    """Sets `target` to the value of `source`, mapped by `map` (unit conversion and transformation)."""

    source: Port
    target: Port
    map: LinearTransformation = IDENTITY

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"

    def carried(self, value: Value, to: FmuVariable) -> Value:
        """The value of the target if that of the source is `value`."""
        if self.map == IDENTITY:
            return to.typed(value) if to.is_number else value
        if to.is_real:
            return self.map(float(value))
        whole, table = int(value), dict(self.map.table)  # 64 bits, which a float64 does not have
        return to.typed(table.get(whole, int(self.map.factor) * whole + int(self.map.offset)))


@dataclass(frozen=True)
class Inlet:
    """An input of the system and the component inputs that it feeds.

    type    of its connector
    items   of the enumeration of its connector, if it is not that of all targets
    start   value without a scenario, if an output of the system passes it on
    """

    name: str
    unit: DeclaredUnit | None
    targets: tuple[tuple[Port, LinearTransformation], ...]
    type: str = "Real"
    items: Mapping[str, int] = field(default_factory=dict)
    start: Value | None = None

    def number(self, given: Value | str) -> Value | str:
        """The number of an item of the enumeration; any other value as it is."""
        return self.items.get(str(given).strip(), given)


@dataclass(frozen=True)
class Outlet:
    """An output of the system and its source: an output of a component, or an input of the system."""

    name: str
    unit: DeclaredUnit | None
    source: Port
    map: LinearTransformation = IDENTITY


@dataclass(frozen=True)
class System:
    """A system before a run. Times in [s].

    notes        remarks for the user, shown after a run
    warnings     the same, where the result may be wrong for its purpose
    suggestion   suggested master and step, from the file of the system
    shared       parameter -> components in which a parameter of this name is the same physical quantity
    common       the same, if different values get a note and are not refused
    driven_instead   components without inputs that a scenario replaces
    """

    name: str
    components: Mapping[str, Component]
    connections: tuple[Connection, ...] = ()
    inputs: Mapping[str, Inlet] = field(default_factory=dict)
    outputs: Mapping[str, Outlet] = field(default_factory=dict)
    start: float | None = None
    stop: float | None = None
    source: Location | None = None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    suggestion: Suggestion = Suggestion()  # noqa: RUF009  frozen
    shared: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    common: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    driven_instead: tuple[str, ...] = ()

    def __repr__(self) -> str:
        components = first_names(self.components, 8)
        ports = f"{len(self.connections)} connections, {len(self.inputs)} inputs, {len(self.outputs)} outputs"
        return f"System {self.name}: {components}\n{ports}"

    @property
    def coupling(self) -> Coupling | None:
        """The suggested coupling, with changes by `coupled`."""
        return self.suggestion.coupling

    @property
    def step(self) -> float | None:
        """The suggested communication step [s]."""
        return self.suggestion.step

    @property
    def refusal(self) -> str:
        """The reason why the coupling of the file is not supported; a given step or master replaces it."""
        return self.suggestion.refusal

    @property
    def resources(self) -> Mapping[str, Location]:
        """Files in the resources of the system's SSP, by name under `resources/`; empty without an SSP."""
        if self.source is None or not str(self.source).endswith(".ssd"):
            return {}
        if not self.source.members:
            folder = Location(self.source.path.parent / RESOURCES)
            return {name: folder.member(name) for name in folder.names()} if folder.is_folder else {}
        archive, prefix = self.source.parent, f"{RESOURCES}/"
        names = (name for name in sorted(archive.names()) if name.startswith(prefix))
        return {name.removeprefix(prefix): archive.member(name) for name in names}

    def port(self, name: str, others: Iterable[str] = ()) -> Port:
        """The port that `component.variable` names; both parts may contain dots.

        others   further names that are accepted, for the message
        """
        port = self.find(name)
        if port is None:
            hint = f"; expected one of {', '.join(self.components)}, a dot and a name"
            raise Problem(f"unknown variable {name!r}{suggest(name, [*others, *self.names()]) or hint}")
        return port

    def find(self, name: str) -> Port | None:
        """The port that `component.variable` names, or None."""
        for dot in (i for i in range(len(name) - 1, 0, -1) if name[i] == "."):
            component, variable = name[:dot], name[dot + 1 :]
            if component in self.components:
                interface = self.components[component].interface
                interface.check_supported(variable, name)
                if variable in interface.variables:
                    return Port(component, variable)
        return None

    def targets(self, name: str) -> tuple[tuple[Port, LinearTransformation], ...]:
        """The component inputs that a name refers to, with the conversion to their units.

        A name is an input of the system, a `component.variable`, a parameter that components share, or the
        name of component inputs, which refers to all inputs of that name.
        """
        if name in self.inputs:
            return self.inputs[name].targets
        inputs = [] if self.find(name) else self.sharing(name) or self._inputs(name)
        units = {self.unit(p) for p in inputs}
        if len(units) > 1:
            with_units = ", ".join(f"{p} {self.unit(p) or '[-]'}" for p in inputs)
            raise Problem(f"{name}: expected inputs with one unit, got {with_units}")
        common = filter(self.sharing, (*self.shared, *self.common))
        others = dict.fromkeys([*self.inputs, *common, *(p.variable for p in self.ports("input"))])
        return tuple((port, self._conversion(port)) for port in inputs or [self.port(name, others)])

    def array(self, name: str) -> tuple[tuple[int | None, ...], list[Port]] | None:
        """Shape and elements of the array that a name means, `component.array`; None if it is none."""
        dots = (i for i, letter in enumerate(name) if letter == ".")
        for component, variable in ((name[:i], name[i + 1 :]) for i in dots):
            if component in self.components:
                found = self.components[component].interface.arrays.get(variable)
                if found:
                    return found.shape, [Port(component, element) for element in found.elements]
        for alone, one in self.components.items() if len(self.components) == 1 else ():
            return self.array(f"{alone}.{name}") if name in one.interface.arrays else None
        return None

    def pairs(self, source: str, target: str) -> list[tuple[Port, Port]] | None:
        """The elements that a connection of two arrays connects; None if neither end is one."""
        ends = self.array(source), self.array(target)
        if ends == (None, None):
            return None
        (one, sources), (other, targets) = (end or ((), []) for end in ends)
        if one != other:
            got = " and ".join(f"({', '.join(map(str, s))})" if s else "a scalar" for s in (one, other))
            raise Problem(f"{source} -> {target}: expected equal shapes, got {got}")
        return [*zip(sources, targets, strict=True)]

    def by_element(self, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        """Values by name, those of arrays by element; an array has a list, or a text of one."""
        for name, given in values.items():
            if not (array := self.array(name)):
                yield name, given
                continue
            each = given.split() if isinstance(given, str) else [*np.ravel(given).tolist()]
            if len(each) != len(array[1]):
                raise Problem(f"{name}: expected {len(array[1])} values, got {len(each)}")
            yield from zip(map(str, array[1]), each, strict=True)

    def _rewired(self, before: System) -> System:
        """The system with connections of arrays whose sizes have changed."""
        arrays = {(n, a) for n, c in before.components.items() for a in c.interface.arrays}
        was, now = ({n: c.interface.arrays for n, c in s.components.items()} for s in (before, self))
        changed = {(n, a) for n, a in arrays if a not in now[n] or was[n][a].shape != now[n][a].shape}
        if not changed:
            return self

        def end(port: Port) -> tuple[str, str]:
            array = before.variable(port).array
            return port.component, array.name if array else port.variable

        kept = list[Connection]()
        groups = grouped(self.connections, lambda c: (end(c.source), end(c.target)))
        for (source, target), wires in groups.items():
            if source not in changed and target not in changed:
                kept += wires
                continue
            names = Port(*source), Port(*target)
            shapes = [was[n][a].shape for n, a in (source, target) if (n, a) in arrays]
            alike = len(shapes) == 2 and shapes[0] == shapes[1]
            whole = before.pairs(*map(str, names)) if alike else None
            if whole != [(c.source, c.target) for c in wires]:
                gone = [p for c in wires for p in (c.source, c.target) if not self.find(str(p))]
                if gone:
                    raise Problem(f"{wires[0]}: {gone[0]} is not an element since the size has changed")
                kept += wires
                continue
            kept += [Connection(*pair, wires[0].map) for pair in self.pairs(*map(str, names)) or ()]
        inlets = {n: i for n, i in self.inputs.items() if all(self.find(str(p)) for p, _ in i.targets)}
        read = {n: o.source for n, o in self.outputs.items()}
        outlets = {n: self.outputs[n] for n, p in read.items() if not p.component or self.find(str(p))}
        return replace(self, connections=tuple(kept), inputs=inlets, outputs=outlets)

    def check_sizes(self, driven: Iterable[Port]) -> None:
        """Raise Problem if an array of another size than that of the FMU lacks start values."""
        fed = {c.target for c in self.connections} | {*driven}
        for c in self.components.values():
            for array in c.interface.arrays.values():
                if array.starts is None and any(array.sizes) and array.settable and array.initial != "approx":
                    lacking = [e for e in array.elements if e not in c.start and Port(c.name, e) not in fed]
                    if lacking:
                        shape = f"({', '.join(map(str, array.shape))})"
                        expected = f"expected start values of all its elements, got none of {lacking[0]}"
                        raise Problem(f"{c.name}.{array.name} has the shape {shape} now: {expected}")

    def _inputs(self, name: str) -> list[Port]:
        """The component inputs of one name."""
        return [port for port in self.ports("input") if port.variable == name]

    def sharing(self, name: str) -> list[Port]:
        """The parameters that have the value of a shared parameter.

        A swapped FMU can lack it, or can have something else under its name.
        """
        sharing = self.shared.get(name, self.common.get(name, ()))
        components = [self.components[c] for c in sharing if c in self.components]
        before = [(c.replaced or c.interface).variables.get(name) for c in components]
        dimension = next((v.unit.dimension for v in before if v and v.unit), None)
        ports = [Port(c.name, name) for c in components if name in c.interface.variables]
        numbers = [p for p in ports if _is_number_to_set(self.variable(p), dimension)]
        return [p for p in numbers if self.components[p.component].has_start(name)]

    def check_sets_all(self, name: str, where: str) -> None:
        """Refuse a name that sets one of several variables that are the same physical quantity."""
        ports = {port for port, _ in self.targets(name)}
        for common in self.shared:
            shared = {*self.sharing(common)}
            if ports & shared and not ports >= shared:
                parts = " and ".join(port.component for port in self.sharing(common))
                raise Problem(f"{where}: expected {common}, one value for {parts}, got {name}")

    def check_sharing(self) -> None:
        """Raise Problem if a component lacks a parameter that it shares."""
        for name, components in self.shared.items():
            for component in components:
                if Port(component, name) not in self.sharing(name):
                    expected = f"expected a numeric parameter with a start value in {component}"
                    got = self._instead(component, name)
                    raise Problem(f"shared parameter {name}: {expected}, got {got}")

    def _instead(self, component: str, name: str) -> str:
        """What a component has under a name, in words."""
        if component not in self.components:
            return f"no such component{suggest(component, self.components)}"
        variables = self.components[component].interface.variables
        if name not in variables:
            return f"none of this name{suggest(name, variables)}"
        variable = variables[name]
        unit = f" in {variable.unit.name}" if variable.unit else ""
        without = "" if self.components[component].has_start(name) else " without a start value"
        return f"causality {variable.causality} and type {variable.kind}{unit}{without}"

    def passed(self, name: str) -> list[Outlet]:
        """The outputs of the system that pass an input of the system on."""
        return [outlet for outlet in self.outputs.values() if outlet.source == Port("", name)]

    def passed_starts(self, driven: Iterable[Port]) -> dict[Port, float]:
        """Start values of inputs that are passed on; driven: those that a scenario drives."""
        ports = {o.source for o in self.outputs.values() if not o.source.component}
        starts = {p: self.start_of(self.inputs[p.variable]) for p in ports if self.variable(p).is_number}
        return {p: float(start or 0.0) for p, start in starts.items() if start is not None or p in driven}

    def without_effect(self, names: Iterable[str]) -> tuple[str, ...]:
        """Notes on inputs of the system that feed nothing."""
        idle = [n for n in names if n in self.inputs and not self.inputs[n].targets and not self.passed(n)]
        return tuple(f"{name} has no effect: this input of the system feeds nothing" for name in idle)

    def without_ticks(self) -> Iterator[str]:
        """Notes on connected variables whose clocks are all triggered ones that nothing is connected to."""
        fed = self.fed
        for port in dict.fromkeys([*fed, *(c.source for c in self.connections)]):
            clocks = [
                Port(port.component, v.name)
                for v in self.components[port.component].interface.variables.values()
                if v.kind == "Clock" and v.reference in self.variable(port).clocks
            ]
            idle = [c for c in clocks if c not in fed and self.variable(c).is_triggered_input]
            if clocks and idle == clocks:
                never = f"its clock {clocks[0]} never ticks, because nothing is connected to it"
                yield f"{port} keeps its start value: {never}"

    def start_of(self, inlet: Inlet) -> Value | None:
        """The start value of an input of the system, if need be from the first input that it feeds."""
        for port, linear in inlet.targets[:1] if inlet.start is None else ():
            value = self.components[port.component].value(port.variable)
            if linear == IDENTITY and value == value:  # not NaN: there is a start value
                return value
            if linear.factor and not linear.table and value == value:
                return (float(value) - linear.offset) / linear.factor
        return inlet.start

    def has(self, name: str) -> bool:
        """Does `targets` accept this name? Faster than `targets`, which searches for similar names."""
        return bool(name in self.inputs or self.find(name) or self.sharing(name) or self._inputs(name))

    def names(self) -> list[str]:
        """All `component.variable` names."""
        return [f"{c.name}.{v}" for c in self.components.values() for v in c.interface.variables]

    @property
    def fmus(self) -> str:
        """The components with their files, for a message about a process that runs them."""
        return first_names(f"{c.name} ({c.source})" for c in self.components.values())

    def ports(self, causality: str) -> list[Port]:
        """All variables of one causality."""
        return [Port(c.name, v.name) for c in self.components.values() for v in c.interface.of(causality)]

    @property
    def rate_ports(self) -> Mapping[Port, Port]:
        """The declared rate input of each input that has one."""
        rates = {name: component.interface.rate_inputs for name, component in self.components.items()}
        return {Port(name, u): Port(name, rate) for name, of in rates.items() for u, rate in of.items()}

    @property
    def nominals(self) -> Mapping[str, float | None]:
        """The nominal value of each output, by its name."""
        return {str(port): self.variable(port).nominal for port in self.ports("output")}

    @property
    def fed(self) -> Set[Port]:
        """The ports that have a source: an output of a component, or an input of the system."""
        return {c.target for c in self.connections} | {p for i in self.inputs.values() for p, _ in i.targets}

    @property
    def open(self) -> Mapping[str, Inlet]:
        """Component inputs that have no source, by variable name."""
        fed = self.fed
        unfed = [p for p in self.ports("input") if p not in fed and self.variable(p).is_number]
        return {
            name: Inlet(name, self.unit(ports[0]), tuple((p, self._conversion(p)) for p in ports))
            for name, ports in grouped(unfed, lambda port: port.variable).items()
        }

    @property
    def exposed(self) -> list[Port]:
        """Component inputs that are fed by an input of the system, or have no source."""
        inlets = [*self.inputs.values(), *self.open.values()]
        ports = [port for inlet in inlets for port, _ in inlet.targets]
        return [p for p in ports if (v := self.variable(p)).causality == "input" and v.is_number]

    def variable(self, port: Port) -> FmuVariable:
        """The declaration of a port, or of an input of the system."""
        if not port.component and port.variable in self.inputs:
            inlet = self.inputs[port.variable]
            return FmuVariable(inlet.name, type=inlet.type, causality="input", unit=inlet.unit)
        return self.components[port.component].interface.variables[port.variable]

    def is_continuous(self, connection: Connection) -> bool:
        """Are both ends of a connection continuous?"""
        return all(self.variable(port).is_continuous for port in (connection.source, connection.target))

    def unit(self, port: Port) -> DeclaredUnit | None:
        """The unit of values that a user gives for a port; after a swap that of the replaced FMU."""
        replaced, unit = self.components[port.component].replaced, self.variable(port).unit
        before = replaced.variables.get(port.variable) if replaced else None
        if before and before.unit and (unit is None or before.unit.dimension == unit.dimension):
            return before.unit
        return unit

    def _conversion(self, port: Port) -> LinearTransformation:
        """From the unit of values that a user gives to the unit of the FMU."""
        return conversion(self.unit(port), self.variable(port).unit, str(port))

    def with_start(self, values: Mapping[str, Value | str], origin: str = "--set") -> System:
        """The system with other start values; names are those that `targets` accepts.

        A text may contain a unit: "180bar". Otherwise a value is in the unit of the variable. A connected
        input cannot be set; but a value of one that its FMU declares as held replaces the connection.

        origin   where the values come from, for `Component.origins`
        """
        sizes, others = self.sizes(values)
        if sizes and others:  # first, as they change the names of elements
            return self.with_start(sizes, origin).with_start(others, origin)
        connected = {c.target: c for c in self.connections}
        start: dict[str, dict[str, Value]] = {name: {} for name in ("", *self.components)}
        replaced: list[Connection] = []
        for name, given in self.by_element(values):
            for port, value in self.assigned(name, given, partial(self._without_unit, name, connected)):
                start[port.component][port.variable] = value
                if port in connected:
                    replaced.append(connected[port])
        notes = tuple(f"{c.target} is set, which replaces its connection from {c.source}" for c in replaced)
        system = self.started(start, origin).noted(*notes)  # where sizes change, with other connections
        system = replace(system, connections=tuple(c for c in system.connections if c not in replaced))
        for component in system.components.values():
            for name, value in component.start.items():
                where = f"{self.source or self.name}: {component.name}.{name}"
                check_bounds(where, component.interface.variables[name], value)
        system.check_shared()
        return system

    def started(self, start: Mapping[str, Mapping[str, Value]], origin: str) -> System:
        """The system with start values by component; the component "" has inputs that are passed on."""
        components = {n: c.with_start(start[n], origin) for n, c in self.components.items()}
        inputs = {n: replace(i, start=start[""].get(n, i.start)) for n, i in self.inputs.items()}
        return replace(self, components=components, inputs=inputs)._rewired(self)

    def sizes(self, values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Those of some values that set structural parameters, and the others."""
        ports = {name: self.find(name) for name in values}
        sizes = {n for n, p in ports.items() if p and self.variable(p).causality == "structuralParameter"}
        return {n: values[n] for n in values if n in sizes}, {n: values[n] for n in values if n not in sizes}

    def assigned(self, name: str, given: Value | str, read: ReadValue) -> Iterator[tuple[Port, Value]]:
        """The ports that a name sets, see `targets`, each with a value in its unit and type.

        read   gives the value for a port without its unit, and the map to the unit of a user's values
        """
        inlet = self.inputs.get(name)
        given = inlet.number(given) if inlet else given
        if inlet and self.passed(name):
            port = Port("", name)
            yield port, coerce(name, self.variable(port), *read(given, port, inlet.unit))
        for port, linear in self.targets(name):
            variable = self.variable(port)
            check_settable(port, self.components[port.component].interface)
            value, to_unit = read(given, port, inlet.unit if inlet else self.unit(port))
            value = coerce(name, variable, value, to_unit.then(linear))
            check_bounds(str(port), variable, value)
            yield port, value

    def _without_unit(
        self,
        name: str,
        connected: Mapping[Port, Connection],
        given: Value | str,
        port: Port,
        target: DeclaredUnit | None,
    ) -> tuple[Value | str, LinearTransformation]:
        """A value without its unit, and the map to the unit of values that a user gives for a port.

        Raises Problem if the port is connected, unless its FMU declares it as held.
        """
        connection = connected.get(port)
        if connection and port.variable not in self.components[port.component].interface.model.held_inputs:
            reason = f"the input is connected ({connection})"
            raise Problem(f"{name} cannot be set: {reason}; --cut {port} removes the connection")
        number, unit = number_and_unit(str(given)) if self.variable(port).is_real else ("", "")
        return (number, from_user_unit(unit, target, f"{name}={given}")) if unit else (given, IDENTITY)

    def check_shared(self) -> None:
        """Raise Problem if a parameter that components share has two values."""
        for problem in self.differences(self.shared):
            raise Problem(problem)

    def differences(self, names: Iterable[str]) -> Iterator[str]:
        """One line for each of these shared or common parameters that has two values."""
        for name in names:
            ports = self.sharing(name)
            unit = self.variable(ports[0]).unit if ports else None
            maps = (conversion(self.variable(port).unit, unit, str(port)) for port in ports)
            starts = (float(self.components[port.component].value(name)) for port in ports)
            values = [linear(start) for linear, start in zip(maps, starts, strict=True)]
            others = (k for k, v in enumerate(values) if not math.isclose(v, values[0], rel_tol=WRITTEN))
            for k in islice(others, 1):
                in_unit = f" {unit.name}" if unit else ""
                got = f"{ports[0]} is {values[0]:.9g} and {ports[k]} is {values[k]:.9g}{in_unit}"
                hint = f"set {'both' if len(ports) == 2 else 'all'} at once by the name {name}"
                yield f"{got}: expected one value of one physical quantity; {hint}"

    def in_kind(self, kind: str, *names: str) -> System:
        """The system with components, default: all, in another kind, "CoSimulation" or "ModelExchange"."""
        changed = dict(self.components)
        for name, c in self.components.items():
            if c.source is not None and (name in names or not names):
                interface = replace(read_interface(c.source, kind), variables=c.interface.variables)
                changed[name] = replace(c, interface=interface)
        return replace(self, components=changed)

    def coupled(self, choices: CouplingOptions | Mapping[str, Any]) -> System:
        """The system with other choices about the coupling: a master replaces those of the system's file.

        A mapping has the names of the fields of `Coupling`.
        """
        choices = choices if isinstance(choices, CouplingOptions) else CouplingOptions(**choices)
        return replace(self, suggestion=self.suggestion.with_choices(choices)) if choices.names else self

    def noted(self, *notes: str) -> System:
        """The system with further notes."""
        return replace(self, notes=(*self.notes, *notes))

    def without(self, *patterns: str) -> System:
        """The system without the connections whose target, such as `b.force_rate`, matches a pattern.

        patterns   names and patterns: "*_rate" matches every input whose name ends in _rate, see `matching`
        """
        targets = [str(c.target) for c in self.connections]

        def missing(pattern: str) -> str:
            hint = suggest(pattern, targets) or f"; connected are {', '.join(targets[:8]) or 'none'}"
            return f"cut {pattern}: no connected input matches{hint}"

        cut = selected(targets, patterns, missing)
        kept = tuple(c for c in self.connections if str(c.target) not in cut)
        note = f"connections removed by --cut; these inputs keep their start values: {', '.join(cut)}"
        return replace(self, connections=kept).noted(note) if cut else self


def _is_number_to_set(variable: FmuVariable, dimension: object) -> bool:
    """Is this a parameter that is a number of this dimension? Without a defined unit it is of any."""
    same = dimension is None or variable.unit is None or variable.unit.dimension in (None, dimension)
    is_parameter = variable.causality == "parameter" and variable.settable
    return is_parameter and same and variable.kind != "Boolean" and variable.is_number


def check_settable(port: Port, interface: FmuInterface) -> None:
    """Raise Problem if the FMU computes a variable itself."""
    variable = interface.variables[port.variable]
    if not variable.settable:
        category = f"{variable.variability} {variable.causality}"
        sources = sorted((interface.initial_dependencies.get(port.variable) or frozenset()) - {port.variable})
        at_start = f", at the start from {', '.join(sources)}" if 0 < len(sources) <= MAX_NAMES else ""
        raise Problem(f"{port} cannot be set: it is a {category} that the FMU computes itself{at_start}")


def check_bounds(context: str, variable: FmuVariable, value: Value, remark: str = "") -> None:
    """Raise Problem if a value is outside of the limits that the FMU declares; a remark follows it."""
    if isinstance(value, (str, bool)):
        return
    unit = f" {variable.unit.name}" if variable.unit and variable.unit.name != "1" else ""
    for word, bound, sign in zip(("least", "most"), variable.bounds, (1.0, -1.0), strict=True):
        if math.isfinite(bound) and sign * (value - bound) < -ROUNDING * abs(bound):
            raise Problem(f"{context}: expected at {word} {bound:.13g}{unit}, got {value:.13g}{unit}{remark}")


def coerce(
    context: str, variable: FmuVariable, value: Value | str, linear: LinearTransformation = IDENTITY
) -> Value:
    """A value, also as text from a command line or an XML file, in the type of a variable."""
    check_map(context, variable, linear)
    text = str(value).strip()
    try:
        if variable.kind == "Real":
            value = linear(real(text))
            typed = len(text) < TYPED  # -30 degC is 243.15 K; what was computed keeps its last digit
            return float(f"{value:.15g}") if linear.offset and typed else value
        if variable.kind == "String":
            return str(value)
        if variable.kind == "Binary":
            return bytes.fromhex(text).hex()
        if variable.kind == "Boolean":
            return bool(linear({"true": 1.0, "1": 1.0, "false": 0.0, "0": 0.0}[text.lower()]))
        number = variable.items[text] if text in variable.items else integer(text)
        return number if linear == IDENTITY else int(linear(float(number)))
    except (ValueError, KeyError):
        choice = f" (one of {', '.join(variable.items)})" if variable.items else ""
        if re.match(r"[-+]?\d+,\d", text):
            choice = " with a decimal point"
        raise Problem(f"{context}: expected a value of type {variable.kind}{choice}, got {text!r}") from None


def open_component(name: str, fmu: Location, kind: str = "") -> Component:
    """A component from its FMU; kind: as for `read_interface`."""
    return Component(name, read_interface(fmu, kind), fmu)


# type of an output -> types of the inputs that take it
WIDER = {
    **{kind: (kind,) for kind in ("Real", "String", "Binary", "Clock")},
    **{"Integer": ("Integer", "Real"), "Boolean": ("Boolean", "Integer", "Real")},
}


def check_connection(system: System, source: Port, target: Port, linear: LinearTransformation) -> Connection:
    """A connection; raises Problem if causalities or types do not fit.

    A clock that ticks by time may be the source of another one, though an input (FMI-LS-BUS).
    """
    connection, y, u = Connection(source, target, linear), system.variable(source), system.variable(target)
    transmits = y.kind == u.kind == "Clock" and y.get("intervalVariability") != "triggered"
    if not (y.causality in SOURCES or (transmits and y.causality == "input")) or u.causality not in TARGETS:
        raise Problem(f"{connection}: expected an output and an input, got {y.causality} and {u.causality}")
    items = u.kind == "Enumeration" and y.value_type == "Boolean"
    if items or u.value_type not in WIDER.get(y.value_type, ()):
        raise Problem(f"{connection}: variables of type {y.kind} and {u.kind} cannot be connected")
    if u.kind == "Clock" and not u.is_triggered_input:
        got = f"{u.get('intervalVariability')} {target}, which ticks by time"
        raise Problem(f"{connection}: expected a triggered clock at the end, got the {got}")
    check_map(str(connection), u, linear)
    return connection


def check_map(where: str, variable: FmuVariable, linear: LinearTransformation) -> None:
    """Raise Problem if values of a variable cannot be transformed so."""
    no_line = variable.kind in ("String", "Binary", "Clock")
    if linear != IDENTITY and (no_line or (variable.is_real and linear.table)):
        expected = "a LinearTransformation" if variable.is_real else "no transformation"
        got = "a mapping of values" if linear.table else f"{linear.factor:g} x + {linear.offset:g}"
        raise Problem(f"{where}: expected {expected} of a {variable.kind}, got {got}")
    if not (variable.is_real or (linear.factor.is_integer() and linear.offset.is_integer())):
        got = f"{linear.factor:g} and {linear.offset:g}"
        raise Problem(f"{where}: expected integer factor and offset, got {got}")
