"""The block of one FMU in Modelica: its variables, and equations that call the library of the FMU."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from orchestrator.base.errors import Problem
from orchestrator.base.text import grouped
from orchestrator.fmi.description import FmuVariable, Value
from orchestrator.fmi.interface import FmuInterface
from orchestrator.modelica.syntax import Scope, number, quoted
from orchestrator.ssp.system import Component

T = TypeVar("T")
Equation = tuple[list[str], str]  # unknowns, and the call that computes them
EMPTY_FILL = {"Real": "0.0", "Integer": "0", "Boolean": "0", "String": '""'}  # elements of arrays of length 0
DISPLAY_UNITS = {"Pa": "bar", "rad": "deg", "rad/s": "deg/s", "m3/s": "l/min"}
# Tools use tolerance * nominal as absolute tolerance of a state, which is too large for a pressure near zero.
# The FMUs of this project give the same fraction of nominal to a solver (fmus/export/native/exchange.c).
NOMINAL_FRACTION = 1e-3
ICON_EDGE = 100.0  # coordinate of the edges of an icon, whose origin is in the centre


@dataclass(frozen=True)
class BlockParameter:
    """A parameter of the block: its name in Modelica, the variable of the FMU and its value in the FMU."""

    name: str
    variable: FmuVariable
    value: Value

    @property
    def argument(self) -> str:
        """The expression whose value the FMU gets; 1 and 0 for booleans."""
        return f"if {self.name} then 1 else 0" if self.variable.kind == "Boolean" else self.name


@dataclass(frozen=True)
class OptionalInput:
    """An input that has a constant value if it is not connected.

    use        name of the parameter that enables the connector
    constant   name of the parameter with the value
    internal   name of the variable with the input in the equations
    """

    variable: FmuVariable
    value: float
    use: str
    constant: str
    internal: str


@dataclass(frozen=True)
class FmuBlock:
    """The block of one FMU.

    name              of the Modelica class
    folder            with the unpacked FMU in the resources of the package
    inputs, outputs   variables of the FMU, except those that are only for rates of inputs
    names             identifiers of inputs and outputs in Modelica
    optional          inputs that need not be connected, by name
    levers            variable with the start value of an input to which nothing is connected, by its name
    scope             all identifiers of the block
    """

    name: str
    folder: str
    component: Component
    inputs: Sequence[FmuVariable]
    outputs: Sequence[FmuVariable]
    names: Mapping[str, str]
    parameters: Sequence[BlockParameter]
    optional: Mapping[str, OptionalInput]
    levers: Mapping[str, str]
    scope: Scope

    @property
    def interface(self) -> FmuInterface:
        """The FMU's interface."""
        return self.component.interface

    @property
    def states(self) -> list[FmuVariable]:
        """The continuous states."""
        return [self.interface.variables[name] for name in self.interface.states]

    @property
    def has_picture(self) -> bool:
        """Whether the FMU has an icon."""
        return "model.png" in self.component.source.names()  # type: ignore[union-attr]  # see fmu_block

    def nominal(self) -> str:
        """Nominal values of the states."""
        return _vector(number(NOMINAL_FRACTION * (v.nominal or 1.0)) for v in self.states)

    def values(self) -> Iterator[str]:
        """References and values of the parameters of each type."""
        for kind, fill in EMPTY_FILL.items():
            parameters = [p for p in self.parameters if p.variable.value_type == kind]
            values = _vector((p.argument for p in parameters), fill)
            yield f"{_references(p.variable for p in parameters)}, {values}"

    def initial_equations(self) -> Iterator[Equation]:
        """Initial equations of the states, one for each group with the same dependencies on inputs."""
        states = self.states

        def inputs_of(k: int) -> frozenset[str]:
            declared = self.interface.initial_dependencies.get(states[k].name)
            return self._inputs_among([frozenset() if states[k].initial == "exact" else declared])

        for needed, rows in grouped(range(len(states)), inputs_of).items():
            started = f", {_references(states[k] for k in rows)}"
            yield [f"fmu_states[{k + 1}]" for k in rows], self._call("start", "", needed, started)

    def equations(self) -> Iterator[Equation]:
        """Equations of the derivatives, and of each group of outputs with the same dependencies on inputs."""
        dependencies = self.interface.dependencies
        if self.states:
            needed = self._inputs_among(dependencies.get(dx) for dx in self.interface.states.values())
            names = [f"der(fmu_states[{k + 1}])" for k in range(len(self.states))]
            yield names, self._call("derivatives", "fmu_states, ", needed)
        groups = grouped(self.outputs, lambda y: self._inputs_among([dependencies.get(y.name)]))
        for needed, outputs in groups.items():
            call = self._call("outputs", f"{self._states}, ", needed, f", {_references(outputs)}")
            yield [self.names[y.name] for y in outputs], call

    def event(self) -> str:
        """The call that handles an event, and returns the time of the next one."""
        call = self._call("event", f"{self._states}, ", [v.name for v in self.inputs])
        return call.replace("\n", "\n  ")

    def _call(self, function: str, states: str, needed: Collection[str], unknowns: str = "") -> str:
        """A call of a function of the FMU with the needed inputs."""
        inputs = [v for v in self.inputs if v.name in needed]
        values = _vector(self._expression(v) for v in inputs)
        arguments = f"fmu_instance, time, {states}{_references(inputs)},\n    {values}{unknowns}"
        return f"Internal.{function}({arguments})"

    def _inputs_among(self, dependencies: Iterable[frozenset[str] | None]) -> frozenset[str]:
        """The inputs among the dependencies of some unknowns; all inputs if dependencies are not declared."""
        inputs = frozenset(v.name for v in self.inputs)
        return frozenset().union(*(inputs if names is None else names & inputs for names in dependencies))

    def _expression(self, v: FmuVariable) -> str:
        """An input in the equations."""
        return self.optional[v.name].internal if v.name in self.optional else self.names[v.name]

    @property
    def _states(self) -> str:
        return "fmu_states" if self.states else "fill(0.0, 0)"


def fmu_block(
    name: str, folder: str, component: Component, constant_inputs: Collection[str], levers: Collection[str]
) -> FmuBlock:
    """The block of an FMU; raises Problem if the FMU cannot be a block.

    component                 the FMU, read for Model Exchange, with its own values
    constant_inputs, levers   as of `write_package`
    """
    interface, scope = component.interface, Scope()
    _check(f"{component.source}", interface)
    outputs, inputs = _needed_signals(interface)
    names = {v.name: scope.add(v.name) for v in [*inputs, *outputs]}
    named = [(v.name, v) for v in interface.of("parameter") if v.start is not None]
    states = [interface.variables[x] for x in interface.states]
    named += [(f"{v.name}_start", v) for v in states if v.initial == "exact" and v.start is not None]
    parameters = [BlockParameter(scope.add(n), v, component.value(v.name)) for n, v in named]
    for p in parameters:
        if isinstance(p.value, float) and math.isnan(p.value):
            raise Problem(f"{component.source}: {p.variable.name}: start value: expected a number, got nan")
    optional = {}
    for v in (v for v in inputs if v.name in constant_inputs):
        identifiers = [scope.add(n) for n in (f"use_{v.name}_in", f"{v.name}_constant", f"{v.name}_internal")]
        optional[v.name] = OptionalInput(v, float(component.value(v.name)), *identifiers)
    free = {v.name: scope.add(f"{v.name}_default") for v in inputs if v.name in levers}
    return FmuBlock(name, folder, component, inputs, outputs, names, parameters, optional, free, scope)


def _check(where: str, interface: FmuInterface) -> None:
    """Raise Problem for an FMU that the functions of the package cannot run."""
    version, complete = interface.model.major, interface.states or interface.stateless
    needs_tool = interface.needs_execution_tool
    faults = {
        f"an FMU for Model Exchange in FMI 2.0, got FMI {version}.0": version != 2,
        "an FMU without event indicators, because state events are not supported": interface.event_indicators,
        "an FMU that can be instantiated twice per process": interface.one_per_process,
        "an FMU that runs without the tool that made it, got needsExecutionTool": needs_tool,
        "a variable for each continuous state and derivative, some are missing": not complete,
    }
    for expected in (text for text, found in faults.items() if found):
        raise Problem(f"{where}: expected {expected}")
    for v in (v for v in interface.variables.values() if v.causality in ("input", "output")):
        if not v.is_real:
            raise Problem(f"{where}: {v.name}: expected real inputs and outputs, got {v.kind}")
        if v.causality == "input" and not v.is_continuous:
            raise Problem(f"{where}: {v.name}: expected a continuous input, got a {v.variability} one")


def _needed_signals(interface: FmuInterface) -> tuple[list[FmuVariable], list[FmuVariable]]:
    """Outputs and inputs of the block.

    In Model Exchange inputs change continuously. Inputs that are only the rate of another input are not
    needed, and neither are outputs that depend on such rates.
    """
    inputs, declared = {v.name for v in interface.of("input")}, interface.dependencies
    started = [x for x in interface.states if interface.variables[x].initial != "exact"]
    dependencies = [declared.get(dx) for dx in interface.states.values()]
    dependencies += map(interface.initial_dependencies.get, started)
    needed = {n for names in dependencies for n in names or ()}
    for_states = inputs if None in dependencies else inputs & needed
    rates = set(interface.rate_inputs.values()) - for_states
    outputs = [y for y in interface.of("output") if not rates & (declared.get(y.name) or frozenset())]
    direct = [declared.get(y.name) for y in outputs]
    used = for_states.union(*(inputs if names is None else names for names in direct)) - rates
    return outputs, [v for v in interface.of("input") if v.name in used]


# ---- code --------------------------------------------------------------------------------------------------


def attributes(v: FmuVariable) -> str:
    """Attributes of a variable, (unit="Pa", displayUnit="bar", ...), or an empty string."""
    if not v.is_real:
        return ""
    result = {}
    if v.unit:
        result["unit"] = quoted(v.unit.name)
        if v.unit.name in DISPLAY_UNITS:
            result["displayUnit"] = quoted(DISPLAY_UNITS[v.unit.name])
    for name, bound in zip(("min", "max"), v.bounds, strict=True):
        if math.isfinite(bound) and v.causality == "parameter":
            result[name] = number(bound)
    return f"({', '.join(f'{name} = {value}' for name, value in result.items())})" if result else ""


def connectors(
    inputs: Sequence[FmuVariable], outputs: Sequence[FmuVariable]
) -> Iterator[tuple[str, FmuVariable, float, float]]:
    """Kind, variable and position of the connectors at the left and right edge of the icon."""
    for kind, variables, edge in (("RealInput", inputs, -1), ("RealOutput", outputs, 1)):
        for v, along in positions(variables):
            yield kind, v, edge * (ICON_EDGE + 10), along


def positions(items: Sequence[T]) -> list[tuple[T, float]]:
    """Connectors with their coordinates along an edge of the icon, from above."""
    return [(x, ICON_EDGE - 2 * ICON_EDGE * (k + 0.5) / len(items)) for k, x in enumerate(items)]


def _references(variables: Iterable[FmuVariable]) -> str:
    return _vector((str(v.reference) for v in variables), "0")


def _vector(elements: Iterable[str], fill: str = "0.0") -> str:
    text = ", ".join(elements)
    return f"{{{text}}}" if text else f"fill({fill}, 0)"
