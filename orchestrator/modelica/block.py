"""One FMU as a Modelica block: states and derivatives in the equations, values from the FMU's library."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.fmi.description import Interface, Value, Variable
from orchestrator.modelica.text import Scope, literal, number, quoted
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
class Parameter:
    """A parameter of the block, its name in Modelica, the FMU's variable and its value in the FMU."""

    name: str
    variable: Variable
    value: Value


@dataclass(frozen=True)
class Held:
    """An input that has a value where nothing is connected, and the names that this takes."""

    value: float
    use: str
    constant: str
    internal: str


@dataclass(frozen=True)
class Model:
    """What a block needs of one FMU.

    name     of the Modelica class
    folder   of the unpacked FMU in the package's resources
    moving, outputs   its inputs and outputs, without those that are for rates
    names    of inputs and outputs in Modelica
    held     inputs that have a value where nothing is connected
    scope    of the names in the block
    """

    name: str
    folder: str
    component: Component
    moving: Sequence[Variable]
    outputs: Sequence[Variable]
    names: Mapping[str, str]
    parameters: Sequence[Parameter]
    held: Mapping[str, Held]
    scope: Scope

    @property
    def face(self) -> Interface:
        """The FMU's interface."""
        return self.component.interface

    @property
    def states(self) -> list[Variable]:
        """Its continuous states."""
        return [self.face.variables[name] for name in self.face.states]


def model(name: str, folder: str, component: Component, held: Collection[str]) -> Model:
    """What a block needs; a Problem for an FMU that cannot be one.

    component   the FMU, read for Model Exchange, with its own values
    held        inputs that are their start value where nothing is connected
    """
    face, scope = component.interface, Scope()
    _check(f"{component.source}", face)
    outputs, moving = _used(face)
    names = {v.name: scope.add(v.name) for v in [*moving, *outputs]}
    parameters = [
        Parameter(scope.add(v.name), v, component.value(v.name))
        for v in face.of("parameter")
        if v.start is not None
    ]
    free = [v for x in face.states if (v := face.variables[x]).initial == "exact" and v.start is not None]
    parameters += [Parameter(scope.add(f"{v.name}_start"), v, component.value(v.name)) for v in free]
    for p in parameters:
        if isinstance(p.value, float) and math.isnan(p.value):
            raise Problem(f"{component.source}: {p.variable.name}: expected a number to start with, got nan")
    wanted = [v for v in moving if v.name in held]
    kept = {v.name: _held(v.name, float(component.value(v.name)), scope) for v in wanted}
    return Model(name, folder, component, moving, outputs, names, parameters, kept, scope)


def _held(name: str, value: float, scope: Scope) -> Held:
    return Held(
        value, scope.add(f"use_{name}_in"), scope.add(f"{name}_constant"), scope.add(f"{name}_internal")
    )


def _check(where: str, face: Interface) -> None:
    """Refuse FMUs that the functions of the package cannot run."""
    if face.fmi != 2:
        raise Problem(f"{where}: expected an FMU 2.0 for Model Exchange, got FMI {face.fmi}.0")
    if face.indicators:
        raise Problem(f"{where}: expected an FMU without event indicators, state events are not supported")
    if face.only_one:
        raise Problem(f"{where}: expected an FMU that can be instantiated twice in a process")
    if face.needs_tool:
        raise Problem(f"{where}: expected an FMU that runs by itself, this one needs the tool that made it")
    if not face.states and not face.stateless:
        raise Problem(f"{where}: expected continuous states with all their derivatives among the variables")
    for v in (v for v in face.variables.values() if v.causality in ("input", "output")):
        if not v.is_real:
            raise Problem(f"{where}: {v.name}: expected real inputs and outputs, got {v.kind}")
        if v.causality == "input" and not v.is_continuous:
            raise Problem(f"{where}: {v.name}: expected a continuous input, got a {v.variability} one")


def _used(face: Interface) -> tuple[list[Variable], list[Variable]]:
    """Outputs and inputs of the block.

    In Model Exchange inputs move by themselves: what an input's rate alone is for, and outputs that only give
    such rates on, have no use.
    """
    inputs = {v.name for v in face.of("input")}
    starts = [face.initially.get(x) for x in face.states if face.variables[x].initial != "exact"]
    needed = [*(face.knowns.get(dx) for dx in face.states.values()), *starts]
    matter = inputs if None in needed else inputs & {name for known in needed for name in known or ()}
    rates = set(face.rates.values()) - matter
    outputs = [y for y in face.of("output") if not rates & (face.knowns.get(y.name) or frozenset())]
    direct = [face.knowns.get(y.name) for y in outputs]
    used = matter.union(*(inputs if known is None else known for known in direct)) - rates
    return outputs, [v for v in face.of("input") if v.name in used]


# ---- text ------------------------------------------------------------------------------------------


def attributes(v: Variable, **more: str) -> str:
    """(unit="Pa", displayUnit="bar", ...) or nothing."""
    if not v.is_real:
        return ""
    found = dict(more)
    if v.unit:
        found = {"unit": quoted(v.unit.name)} | found
        if v.unit.name in SHOWN_IN:
            found["displayUnit"] = quoted(SHOWN_IN[v.unit.name])
    for word, bound in (("min", v.minimum), ("max", v.maximum)):
        if bound is not None and math.isfinite(bound) and v.causality == "parameter":
            found[word] = number(bound)
    return f"({', '.join(f'{k} = {x}' for k, x in found.items())})" if found else ""


def connector(name: str, v: Variable, kind: str, side: float, place: float, condition: str = "") -> str:
    """One line: an input or output at a place of the icon, -100 to 100 from below."""
    extent = f"{{{{{side - 10:g}, {place - 10:g}}}, {{{side + 10:g}, {place + 10:g}}}}}"
    declared = f"{name}{attributes(v)}{condition}"
    return (
        f"  Modelica.Blocks.Interfaces.{kind} {declared} {quoted(v.text)}\n"
        f"    annotation(Placement(transformation(extent = {extent})));\n"
    )


def places(count: int) -> list[float]:
    """Where `count` connectors lie on a side, from above."""
    return [SIDE - 2 * SIDE * (k + 0.5) / count for k in range(count)]


def _references(variables: Iterable[Variable]) -> str:
    return _vector((str(v.reference) for v in variables), "0")


def _vector(elements: Iterable[str], nothing: str = "0.0") -> str:
    text = ", ".join(elements)
    return f"{{{text}}}" if text else f"fill({nothing}, 0)"


def declaration(p: Parameter) -> str:
    """One line: a parameter."""
    v = p.variable
    return f"  parameter {TYPES[v.kind]} {p.name}{attributes(v)} = {literal(p.value)} {quoted(v.text)};\n"


def choice(name: str, held: Held, v: Variable) -> str:
    """Two parameters: has an input a connector, and its value if it has none."""
    return (
        f'  parameter Boolean {held.use} = false "= true, if {name} comes from its connector"\n'
        "    annotation(Evaluate = true, choices(checkBox = true));\n"
        f"  parameter Real {held.constant}{attributes(v)} = {number(held.value)} {quoted(v.text)}\n"
        f"    annotation(Dialog(enable = not {held.use}));\n"
    )


def block(m: Model, package: str) -> str:
    """The text of the block."""
    states = m.states
    inputs = {v.name: m.held[v.name].internal if v.name in m.held else m.names[v.name] for v in m.moving}
    text = [f"block {m.name} {quoted(m.face.text)}\n  extends Modelica.Blocks.Icons.Block;\n"]
    text += [declaration(p) for p in m.parameters]
    text += [choice(name, held, m.face.variables[name]) for name, held in m.held.items()]
    text += _connectors(m)
    text.append("protected\n")
    text += [
        f"  Modelica.Blocks.Interfaces.RealInput {held.internal}{attributes(m.face.variables[name])};\n"
        for name, held in m.held.items()
    ]
    text.append(_instance(m, package))
    if states:
        nominal = ", ".join(number(FOR_TOLERANCES * (v.nominal or 1.0)) for v in states)
        always = f"nominal = {{{nominal}}}, each stateSelect = StateSelect.always"
        text.append(f"  Real fmu_states[{len(states)}]({always});\n")
    text.append('  discrete Real fmu_next(start = -1e60, fixed = true) "Time of the next event";\n')
    text += _initial(m, states, inputs) if states else []
    text.append("equation\n")
    for name, held in m.held.items():
        text.append(f"  connect({m.names[name]}, {held.internal});\n")
        text.append(f"  if not {held.use} then\n    {held.internal} = {held.constant};\n  end if;\n")
    text += _equations(m, states, inputs)
    text.append(
        "  when {initial(), time >= pre(fmu_next)} then\n"
        f"    fmu_next = Internal.event(fmu_instance, time, {_states(m)}, {_references(m.moving)},\n"
        f"      {_vector(inputs[v.name] for v in m.moving)});\n  end when;\n"
    )
    if "model.png" in m.component.source.names():  # type: ignore[union-attr]  # see model
        picture = f'fileName = "modelica://{package}/Resources/FMUs/{m.folder}/model.png"'
        extent = "extent = {{-80, -80}, {80, 80}}"
        text.append(f"  annotation(Icon(graphics = {{Bitmap({extent}, {picture})}}));\n")
    text.append(f"end {m.name};\n")
    return "".join(text)


def _connectors(m: Model) -> list[str]:
    text = []
    for v, place in zip(m.moving, places(max(len(m.moving), 1)), strict=False):
        condition = f" if {m.held[v.name].use}" if v.name in m.held else ""
        text.append(connector(m.names[v.name], v, "RealInput", -SIDE - 10, place, condition))
    for v, place in zip(m.outputs, places(max(len(m.outputs), 1)), strict=False):
        text.append(connector(m.names[v.name], v, "RealOutput", SIDE + 10, place))
    return text


def _instance(m: Model, package: str) -> str:
    """The FMU, with the parameters that it gets."""
    lists = []
    for kind, nothing in NOTHING.items():
        same = [p for p in m.parameters if TYPES[p.variable.kind] == kind]
        lists.append(
            f"    {_references(p.variable for p in same)}, {_vector((_passed(p) for p in same), nothing)}"
        )
    return (
        "  parameter String fmu_folder =\n"
        f'    ModelicaServices.ExternalReferences.loadResource("modelica://{package}/Resources/FMUs/{m.folder}");\n'
        "  Internal.Instance fmu_instance = Internal.Instance(getInstanceName(), fmu_folder,\n"
        f"    {quoted(m.face.identifier)}, {quoted(m.face.guid)},\n" + ",\n".join(lists) + ");\n"
    )


def _passed(p: Parameter) -> str:
    return f"if {p.name} then 1 else 0" if p.variable.kind == "Boolean" else p.name


def _states(m: Model) -> str:
    return "fmu_states" if m.states else "fill(0.0, 0)"


def _assigned(names: Sequence[str], call: str) -> str:
    """An equation for the result of a call; OpenModelica takes no array of one element there."""
    if len(names) == 1:
        return f"  {names[0]} = sum({call});\n"
    return f"  {{{', '.join(names)}}} =\n  {call};\n"


def _initial(m: Model, states: Sequence[Variable], inputs: Mapping[str, str]) -> list[str]:
    """States at the start, in groups that depend on the same inputs."""
    text = ["initial equation\n"]
    groups: dict[frozenset[str], list[int]] = {}
    for k, v in enumerate(states):
        known = frozenset() if v.initial == "exact" else m.face.initially.get(v.name)
        needed = frozenset(inputs) if known is None else known & set(inputs)
        groups.setdefault(frozenset(needed), []).append(k)
    for needed, rows in groups.items():
        u = [w for w in m.moving if w.name in needed]
        call = (
            f"Internal.start(fmu_instance, time, {_references(u)},\n"
            f"    {_vector(inputs[w.name] for w in u)}, {_references(states[k] for k in rows)})"
        )
        text.append(_assigned([f"fmu_states[{k + 1}]" for k in rows], call))
    return text


def _equations(m: Model, states: Sequence[Variable], inputs: Mapping[str, str]) -> list[str]:
    text, x = [], _states(m)
    if states:
        needed = _needed(m, m.face.states.values())
        u = [w for w in m.moving if w.name in needed]
        call = (
            f"Internal.derivatives(fmu_instance, time, fmu_states, {_references(u)},\n"
            f"    {_vector(inputs[w.name] for w in u)})"
        )
        text.append(_assigned([f"der(fmu_states[{k + 1}])" for k in range(len(states))], call))
    groups: dict[frozenset[str], list[Variable]] = {}
    for y in m.outputs:
        groups.setdefault(_needed(m, [y.name]), []).append(y)
    for needed, ys in groups.items():
        u = [w for w in m.moving if w.name in needed]
        call = (
            f"Internal.outputs(fmu_instance, time, {x}, {_references(u)},\n"
            f"    {_vector(inputs[w.name] for w in u)}, {_references(ys)})"
        )
        text.append(_assigned([m.names[y.name] for y in ys], call))
    return text


def _needed(m: Model, unknowns: Iterable[str]) -> frozenset[str]:
    """The inputs that matter to some derivatives or outputs."""
    moving = {v.name for v in m.moving}
    found: set[str] = set()
    for name in unknowns:
        known: Any = m.face.knowns.get(name)
        found |= moving if known is None else known & moving
    return frozenset(found)
