"""One FMU as a Modelica block: states and derivatives in the equations, values from the FMU's library."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from orchestrator.base.errors import Problem
from orchestrator.fmi.description import FmuInterface, FmuVariable, Value
from orchestrator.modelica.syntax import Scope, literal, number, quoted
from orchestrator.ssp.system import Component

TYPES = {
    "Real": "Real",
    "Integer": "Integer",
    "Enumeration": "Integer",
    "Boolean": "Boolean",
    "String": "String",
}
NOTHING = {"Real": "0.0", "Integer": "0", "Boolean": "0", "String": '""'}  # elements of empty arrays
SHOWN_IN = {"Pa": "bar", "rad": "deg", "rad/s": "deg/s", "m3/s": "l/min"}  # units that Modelica tools know
# tools take tolerance * nominal as absolute tolerance of a state: too loose for a pressure near zero; this is
# the same share as an FMU of ours gives to a solver (fmus/export/native/exchange.c)
FOR_TOLERANCES = 1e-3
SIDE = 100.0  # of an icon, from its middle


@dataclass(frozen=True)
class BlockParameter:
    """A parameter of the block: its name in Modelica, the FMU's variable and its value in the FMU."""

    name: str
    variable: FmuVariable
    value: Value

    @property
    def text(self) -> str:
        """Its declaration."""
        v = self.variable
        kind = TYPES[v.kind]
        start = literal(self.value)
        return f"  parameter {kind} {self.name}{attributes(v)} = {start} {quoted(v.description)};\n"

    @property
    def passed(self) -> str:
        """What the FMU gets."""
        return f"if {self.name} then 1 else 0" if self.variable.kind == "Boolean" else self.name


@dataclass(frozen=True)
class OptionalInput:
    """An input that has a value where nothing is connected, and the names that this takes."""

    variable: FmuVariable
    value: float
    use: str
    constant: str
    internal: str

    @property
    def text(self) -> str:
        """Two parameters: has the input a connector, and its value if it has none."""
        v = self.variable
        return (
            f'  parameter Boolean {self.use} = false "= true, if {v.name} comes from its connector"\n'
            "    annotation(Evaluate = true, choices(checkBox = true));\n"
            f"  parameter Real {self.constant}{attributes(v)} = {number(self.value)}"
            f" {quoted(v.description)}\n"
            f"    annotation(Dialog(enable = not {self.use}));\n"
        )


@dataclass(frozen=True)
class FmuBlock:
    """What the block of one FMU consists of.

    name     of the Modelica class
    folder   of the unpacked FMU in the package's resources
    inputs, outputs   of the FMU, without those that are for rates
    names    of inputs and outputs in Modelica
    optional   inputs that have a value where nothing is connected, by name
    scope    of the names in the block
    """

    name: str
    folder: str
    component: Component
    inputs: Sequence[FmuVariable]
    outputs: Sequence[FmuVariable]
    names: Mapping[str, str]
    parameters: Sequence[BlockParameter]
    optional: Mapping[str, OptionalInput]
    scope: Scope

    @property
    def interface(self) -> FmuInterface:
        """The FMU's interface."""
        return self.component.interface

    @property
    def states(self) -> list[FmuVariable]:
        """The continuous states."""
        return [self.interface.variables[name] for name in self.interface.states]

    def text(self, package: str) -> str:
        """The block in Modelica."""
        states = self.states
        text = [
            f"block {self.name} {quoted(self.interface.description)}\n"
            "  extends Modelica.Blocks.Icons.Block;\n"
        ]
        text += [p.text for p in self.parameters]
        text += [optional.text for optional in self.optional.values()]
        text += signals(self, self.inputs, self.outputs)
        text.append("protected\n")
        text += [
            f"  Modelica.Blocks.Interfaces.RealInput {o.internal}{attributes(o.variable)};\n"
            for o in self.optional.values()
        ]
        text.append(self._instance(package))
        if states:
            nominal = ", ".join(number(FOR_TOLERANCES * (v.nominal or 1.0)) for v in states)
            always = f"nominal = {{{nominal}}}, each stateSelect = StateSelect.always"
            text.append(f"  Real fmu_states[{len(states)}]({always});\n")
        text.append('  discrete Real fmu_next(start = -1e60, fixed = true) "Time of the next event";\n')
        text += self._initial_equations()
        text.append("equation\n")
        for name, o in self.optional.items():
            text.append(f"  connect({self.names[name]}, {o.internal});\n")
            text.append(f"  if not {o.use} then\n    {o.internal} = {o.constant};\n  end if;\n")
        text += self._equations()
        references, values = _references(self.inputs), _vector(self._value(v) for v in self.inputs)
        text.append(
            "  when {initial(), time >= pre(fmu_next)} then\n"
            f"    fmu_next = Internal.event(fmu_instance, time, {self._states()}, {references},\n"
            f"      {values});\n  end when;\n"
        )
        if "model.png" in self.component.source.names():  # type: ignore[union-attr]  # see fmu_block
            picture = f'fileName = "modelica://{package}/Resources/FMUs/{self.folder}/model.png"'
            extent = "extent = {{-80, -80}, {80, 80}}"
            text.append(f"  annotation(Icon(graphics = {{Bitmap({extent}, {picture})}}));\n")
        return "".join([*text, f"end {self.name};\n"])

    def _instance(self, package: str) -> str:
        """The FMU, with the parameters that it gets."""
        lists = []
        for kind, nothing in NOTHING.items():
            same = [p for p in self.parameters if TYPES[p.variable.kind] == kind]
            values = _vector((p.passed for p in same), nothing)
            lists.append(f"    {_references(p.variable for p in same)}, {values}")
        address = f"modelica://{package}/Resources/FMUs/{self.folder}"
        return (
            "  parameter String fmu_folder =\n"
            f'    ModelicaServices.ExternalReferences.loadResource("{address}");\n'
            "  Internal.Instance fmu_instance = Internal.Instance(getInstanceName(), fmu_folder,\n"
            f"    {quoted(self.interface.identifier)}, {quoted(self.interface.guid)},\n"
            + ",\n".join(lists)
            + ");\n"
        )

    def _initial_equations(self) -> list[str]:
        """States at the start, in groups that depend on the same inputs."""
        groups: dict[frozenset[str], list[int]] = {}
        for k, v in enumerate(self.states):
            known = frozenset() if v.initial == "exact" else self.interface.initial_dependencies.get(v.name)
            groups.setdefault(self._inputs_among([known]), []).append(k)
        text = ["initial equation\n"] if groups else []
        for needed, rows in groups.items():
            started = f", {_references(self.states[k] for k in rows)}"
            call = self._call("start", "", needed, started)
            text.append(_assigned([f"fmu_states[{k + 1}]" for k in rows], call))
        return text

    def _equations(self) -> list[str]:
        """Derivatives, and outputs in groups that depend on the same inputs."""
        text, known = list[str](), self.interface.dependencies
        if self.states:
            needed = self._inputs_among(known.get(dx) for dx in self.interface.states.values())
            names = [f"der(fmu_states[{k + 1}])" for k in range(len(self.states))]
            text.append(_assigned(names, self._call("derivatives", "fmu_states, ", needed, "")))
        groups: dict[frozenset[str], list[FmuVariable]] = {}
        for y in self.outputs:
            groups.setdefault(self._inputs_among([known.get(y.name)]), []).append(y)
        for needed, outputs in groups.items():
            call = self._call("outputs", f"{self._states()}, ", needed, f", {_references(outputs)}")
            text.append(_assigned([self.names[y.name] for y in outputs], call))
        return text

    def _call(self, function: str, states: str, needed: Collection[str], unknowns: str) -> str:
        """A call of a function of the FMU with the inputs that matter to it."""
        inputs = [v for v in self.inputs if v.name in needed]
        values = _vector(self._value(v) for v in inputs)
        return (
            f"Internal.{function}(fmu_instance, time, {states}{_references(inputs)},\n    {values}{unknowns})"
        )

    def _inputs_among(self, known: Iterable[frozenset[str] | None]) -> frozenset[str]:
        """The inputs among what some unknowns depend on; all inputs where the FMU does not declare that."""
        inputs = frozenset(v.name for v in self.inputs)
        return frozenset().union(*(inputs if names is None else names & inputs for names in known))

    def _value(self, v: FmuVariable) -> str:
        """The value of an input in the equations."""
        return self.optional[v.name].internal if v.name in self.optional else self.names[v.name]

    def _states(self) -> str:
        return "fmu_states" if self.states else "fill(0.0, 0)"


def fmu_block(name: str, folder: str, component: Component, held: Collection[str]) -> FmuBlock:
    """The block of an FMU; a Problem for one that cannot be a block.

    component   the FMU, read for Model Exchange, with its own values
    held        inputs that are their start value where nothing is connected
    """
    interface, scope = component.interface, Scope()
    _check(f"{component.source}", interface)
    outputs, inputs = _useful(interface)
    names = {v.name: scope.add(v.name) for v in [*inputs, *outputs]}
    given = [(v.name, v) for v in interface.of("parameter") if v.start is not None]
    states = [interface.variables[x] for x in interface.states]
    given += [(f"{v.name}_start", v) for v in states if v.initial == "exact" and v.start is not None]
    parameters = [BlockParameter(scope.add(n), v, component.value(v.name)) for n, v in given]
    for p in parameters:
        if isinstance(p.value, float) and math.isnan(p.value):
            raise Problem(f"{component.source}: {p.variable.name}: expected a number to start with, got nan")
    optional = {}
    for v in (v for v in inputs if v.name in held):
        taken = [scope.add(n) for n in (f"use_{v.name}_in", f"{v.name}_constant", f"{v.name}_internal")]
        optional[v.name] = OptionalInput(v, float(component.value(v.name)), *taken)
    return FmuBlock(name, folder, component, inputs, outputs, names, parameters, optional, scope)


def _check(where: str, interface: FmuInterface) -> None:
    """Refuse FMUs that the functions of the package cannot run."""
    if interface.fmi != 2:
        raise Problem(f"{where}: expected an FMU 2.0 for Model Exchange, got FMI {interface.fmi}.0")
    if interface.event_indicators:
        raise Problem(f"{where}: expected an FMU without event indicators, state events are not supported")
    if interface.one_per_process:
        raise Problem(f"{where}: expected an FMU that can be instantiated twice in a process")
    if interface.needs_execution_tool:
        raise Problem(f"{where}: expected an FMU that runs by itself, this one needs the tool that made it")
    if not interface.states and not interface.stateless:
        raise Problem(f"{where}: expected continuous states with all their derivatives among the variables")
    for v in (v for v in interface.variables.values() if v.causality in ("input", "output")):
        if not v.is_real:
            raise Problem(f"{where}: {v.name}: expected real inputs and outputs, got {v.kind}")
        if v.causality == "input" and not v.is_continuous:
            raise Problem(f"{where}: {v.name}: expected a continuous input, got a {v.variability} one")


def _useful(interface: FmuInterface) -> tuple[list[FmuVariable], list[FmuVariable]]:
    """Outputs and inputs of the block.

    In Model Exchange inputs move by themselves: inputs that only are the rate of another one, and outputs
    that only give such rates on, have no use.
    """
    inputs, known = {v.name for v in interface.of("input")}, interface.dependencies
    starts = [
        interface.initial_dependencies.get(x)
        for x in interface.states
        if interface.variables[x].initial != "exact"
    ]
    needed = [*(known.get(dx) for dx in interface.states.values()), *starts]
    matter = inputs if None in needed else inputs & {name for names in needed for name in names or ()}
    rates = set(interface.rate_inputs.values()) - matter
    outputs = [y for y in interface.of("output") if not rates & (known.get(y.name) or frozenset())]
    direct = [known.get(y.name) for y in outputs]
    used = matter.union(*(inputs if names is None else names for names in direct)) - rates
    return outputs, [v for v in interface.of("input") if v.name in used]


# ---- text --------------------------------------------------------------------------------------------------


def attributes(v: FmuVariable) -> str:
    """(unit="Pa", displayUnit="bar", ...) or nothing."""
    if not v.is_real:
        return ""
    found = {}
    if v.unit:
        found["unit"] = quoted(v.unit.name)
        if v.unit.name in SHOWN_IN:
            found["displayUnit"] = quoted(SHOWN_IN[v.unit.name])
    for word, bound in (("min", v.minimum), ("max", v.maximum)):
        if bound is not None and math.isfinite(bound) and v.causality == "parameter":
            found[word] = number(bound)
    return f"({', '.join(f'{k} = {x}' for k, x in found.items())})" if found else ""


def signals(
    m: FmuBlock, inputs: Sequence[FmuVariable], outputs: Sequence[FmuVariable], at_sides: bool = True
) -> list[str]:
    """Connectors for some inputs and outputs: left and right of the icon, or below and above it."""
    text = []
    for kind, variables, edge in (("RealInput", inputs, -SIDE - 10), ("RealOutput", outputs, SIDE + 10)):
        for v, along in zip(variables, places(len(variables)), strict=True):
            place = placement(edge, along) if at_sides else placement(along, edge)
            condition = f" if {m.optional[v.name].use}" if v.name in m.optional else ""
            declared = f"{m.names[v.name]}{attributes(v)}{condition} {quoted(v.description)}"
            text.append(f"  Modelica.Blocks.Interfaces.{kind} {declared}\n    annotation({place});\n")
    return text


def placement(x: float, y: float) -> str:
    """The place of a connector on the icon, -100 to 100 from below and from the left."""
    extent = f"{{{{{x - 10:g}, {y - 10:g}}}, {{{x + 10:g}, {y + 10:g}}}}}"
    return f"Placement(transformation(extent = {extent}))"


def places(count: int) -> list[float]:
    """Where `count` connectors lie on a side, from above."""
    return [SIDE - 2 * SIDE * (k + 0.5) / count for k in range(count)]


def _references(variables: Iterable[FmuVariable]) -> str:
    return _vector((str(v.reference) for v in variables), "0")


def _vector(elements: Iterable[str], nothing: str = "0.0") -> str:
    text = ", ".join(elements)
    return f"{{{text}}}" if text else f"fill({nothing}, 0)"


def _assigned(names: Sequence[str], call: str) -> str:
    """An equation for the result of a call; OpenModelica takes no array of one element there."""
    if len(names) == 1:
        return f"  {names[0]} = sum({call});\n"
    return f"  {{{', '.join(names)}}} =\n  {call};\n"
