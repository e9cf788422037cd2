"""A co-simulation system: components, connections between them, and inputs and outputs of the whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from orchestrator.base.coupling import Coupling, Suggestion
from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.units import IDENTITY, DeclaredUnit, LinearTransformation, conversion
from orchestrator.base.xml import integer, real
from orchestrator.fmi.description import FmuInterface, FmuVariable, Value

FEW = 4  # names that fit into a message


class Port(NamedTuple):
    """One variable of one component."""

    component: str
    variable: str

    def __str__(self) -> str:
        return f"{self.component}.{self.variable}"


@dataclass(frozen=True)
class Component:
    """One FMU in the system.

    start      values set before initialisation
    replaced   the FMU that was here before a swap
    """

    name: str
    interface: FmuInterface
    source: Location | None = None
    start: Mapping[str, Value] = field(default_factory=dict)
    replaced: FmuInterface | None = None

    def value(self, variable: str) -> Value:
        """The start value of a variable: the system's, else the FMU's own; NaN where neither tells one."""
        declared = self.interface.variables[variable]
        if variable in self.start:
            return self.start[variable]
        if declared.start is None:
            return "" if declared.kind == "String" else float("nan")
        return coerce(f"{self.name}.{variable}", declared, declared.start)

    def numbers(self) -> dict[str, float]:
        """Parameters that are real numbers and have a value, by name."""
        real = [v for v in self.interface.variables.values() if v.is_real and v.causality == "parameter"]
        return {
            v.name: float(self.value(v.name)) for v in real if v.name in self.start or v.start is not None
        }


@dataclass(frozen=True)
class Connection:
    """The value of `source`, mapped by `map` (unit conversion and transformation), goes to `target`."""

    source: Port
    target: Port
    map: LinearTransformation = IDENTITY

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


@dataclass(frozen=True)
class Inlet:
    """An input of the whole system and the component inputs it feeds."""

    name: str
    unit: DeclaredUnit | None
    targets: tuple[tuple[Port, LinearTransformation], ...]


@dataclass(frozen=True)
class Outlet:
    """An output of the whole system and the component output behind it."""

    name: str
    unit: DeclaredUnit | None
    source: Port
    map: LinearTransformation = IDENTITY


@dataclass(frozen=True)
class System:
    """Everything that is known before a run. Times in [s].

    notes        remarks to show after a run
    suggestion   how to couple the components, from its file
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
    suggestion: Suggestion = Suggestion()  # noqa: RUF009  frozen

    @property
    def coupling(self) -> Coupling | None:
        """How its file suggests to couple the components, with what was changed since."""
        return self.suggestion.coupling

    @property
    def step(self) -> float | None:
        """The communication step [s] that goes with it."""
        return self.suggestion.step

    @property
    def refusal(self) -> str:
        """Why the coupling that its file wants is not possible here; a given step or master puts it aside."""
        return self.suggestion.refusal

    def port(self, name: str) -> Port:
        """The port that `component.variable` names; both parts may contain dots."""
        port = self._find(name)
        if port is None:
            near = (
                suggest(name, self.names())
                or f"; expected one of {', '.join(self.components)}, a dot and a name"
            )
            raise Problem(f"unknown variable {name!r}{near}")
        return port

    def _find(self, name: str) -> Port | None:
        for component in sorted(self.components, key=len, reverse=True):
            rest, interface = name.removeprefix(component + "."), self.components[component].interface
            if rest != name:
                interface.check_supported(rest, name)
                if rest in interface.variables:
                    return Port(component, rest)
        return None

    def targets(self, name: str) -> tuple[tuple[Port, LinearTransformation], ...]:
        """What a name stands for: an input of the system, one `component.variable`, or, as a bare name, every
        component input of that name."""
        if name in self.inputs:
            return self.inputs[name].targets
        same = [] if self._find(name) else [p for p in self.ports("input") if p.variable == name]
        units = {self.unit(p) for p in same}
        if len(units) > 1:
            each = ", ".join(f"{p} {self.unit(p) or '[-]'}" for p in same)
            raise Problem(f"{name} names inputs in different units: {each}")
        return tuple((port, self._given(port)) for port in same or [self.port(name)])

    def has(self, name: str) -> bool:
        """Does `targets` know this name? Tells it without the search for names that are like it."""
        return (
            name in self.inputs
            or self._find(name) is not None
            or any(port.variable == name for port in self.ports("input"))
        )

    def names(self) -> list[str]:
        """All `component.variable` names."""
        return [f"{c.name}.{v}" for c in self.components.values() for v in c.interface.variables]

    def ports(self, causality: str) -> list[Port]:
        """All variables of one causality."""
        return [Port(c.name, v.name) for c in self.components.values() for v in c.interface.of(causality)]

    @property
    def open(self) -> Mapping[str, Inlet]:
        """Component inputs that nothing feeds, by their bare names."""
        taken = {c.target for c in self.connections} | {p for i in self.inputs.values() for p, _ in i.targets}
        found: dict[str, list[Port]] = {}
        for port in self.ports("input"):
            if port not in taken and self.variable(port).kind != "String":
                found.setdefault(port.variable, []).append(port)
        return {
            name: Inlet(name, self.unit(ports[0]), tuple((p, self._given(p)) for p in ports))
            for name, ports in found.items()
        }

    @property
    def exposed(self) -> list[Port]:
        """Component inputs that are inputs of the whole system or that no connection feeds."""
        inlets = [*self.inputs.values(), *self.open.values()]
        ports = [port for inlet in inlets for port, _ in inlet.targets]
        return [p for p in ports if (v := self.variable(p)).causality == "input" and v.kind != "String"]

    def variable(self, port: Port) -> FmuVariable:
        """The declaration of a port."""
        return self.components[port.component].interface.variables[port.variable]

    def unit(self, port: Port) -> DeclaredUnit | None:
        """The unit of values that are given for a port: of a swapped FMU, that of the one before it."""
        before = self.components[port.component].replaced
        known, own = before.variables.get(port.variable) if before else None, self.variable(port).unit
        same = known and known.unit and (own is None or known.unit.dimension == own.dimension)
        return known.unit if known and same else own

    def _given(self, port: Port) -> LinearTransformation:
        """From the unit of given values to that of the FMU."""
        return conversion(self.unit(port), self.variable(port).unit, str(port))[0]

    def with_start(self, values: Mapping[str, Value | str]) -> System:
        """The same system with other start values, given by names as `targets` knows them."""
        connected = {c.target: c for c in self.connections}
        fresh = {name: dict(c.start) for name, c in self.components.items()}
        for name, value in values.items():
            for port, linear in self.targets(name):
                if port in connected:
                    fed = f"it is fed by {connected[port]}"
                    raise Problem(f"{name} cannot be set: {fed}; to set it, cut that wire: --cut {port}")
                settable(port, self.components[port.component].interface)
                fresh[port.component][port.variable] = coerce(str(port), self.variable(port), value, linear)
        components = {n: replace(c, start=fresh[n]) for n, c in self.components.items()}
        return replace(self, components=components)

    def coupled(self, given: Coupling | Mapping[str, Any]) -> System:
        """The same system, coupled so, or with other settings, named like the fields of `Coupling`.

        A master among them puts aside all that the system's file suggests, else the rest of that stays.
        """
        return replace(self, suggestion=self.suggestion.with_choices(given))

    def without(self, *patterns: str) -> System:
        """The same system without the connections whose target, such as `b.force_rate`, fits a pattern.

        patterns   with * and ? as in file names: "*_rate" is every input whose name ends so
        """
        targets = [str(c.target) for c in self.connections]
        for pattern in patterns:
            if not any(fnmatchcase(target, pattern) for target in targets):
                near = suggest(pattern, targets) or f"; connected are {', '.join(targets[:8]) or 'none'}"
                raise Problem(f"cut {pattern}: no connected input fits{near}")
        cut = [t for t in targets if any(fnmatchcase(t, pattern) for pattern in patterns)]
        kept = tuple(c for c in self.connections if str(c.target) not in cut)
        notes = (f"cut, so these inputs keep their start values: {', '.join(cut)}",) if cut else ()
        return replace(self, connections=kept, notes=self.notes + notes)


def settable(port: Port, interface: FmuInterface) -> None:
    """Refuse to set what the FMU computes itself."""
    variable = interface.variables[port.variable]
    if not variable.settable:
        kind = f"{variable.variability} {variable.causality}"
        sources = sorted((interface.initial_dependencies.get(port.variable) or frozenset()) - {port.variable})
        at_start = f", at the start from {', '.join(sources)}" if 0 < len(sources) <= FEW else ""
        raise Problem(f"{port} cannot be set: it is a {kind} that the FMU determines itself{at_start}")


def coerce(
    where: str, variable: FmuVariable, value: Value | str, linear: LinearTransformation = IDENTITY
) -> Value:
    """`value` (perhaps text from a command line or an XML file) in the type of `variable`."""
    text = str(value).strip()
    try:
        if variable.kind == "Real":
            return linear(real(text))
        if variable.kind == "String":
            return str(value)
        if variable.kind == "Boolean":
            return {"true": True, "1": True, "false": False, "0": False}[text.lower()]
        if text in variable.items:
            return variable.items[text]
        return integer(text)
    except (ValueError, KeyError):
        choice = f" (one of {', '.join(variable.items)})" if variable.items else ""
        raise Problem(f"{where}: expected a value of type {variable.kind}{choice}, got {text!r}") from None
