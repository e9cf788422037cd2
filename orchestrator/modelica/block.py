"""One FMU as a Modelica block: states and derivatives in the equations, values from the FMU's library."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lxml import etree

from orchestrator.errors import Problem
from orchestrator.system.interface import Interface, Variable
from orchestrator.system.system import Component

KEYWORDS = frozenset(
    re.findall(
        r"\w+",
        """algorithm and annotation block break class connect connector constant constrainedby der discrete
        each else elseif elsewhen encapsulated end enumeration equation expandable extends external false
        final flow for function if import impure in initial inner input loop model not operator or outer
        output package parameter partial protected public pure record redeclare replaceable return stream then
        true type when while within time fmu_folder fmu_instance fmu_states fmu_next""",
    )
)
SHOWN_IN = {"Pa": "bar", "rad": "deg", "rad/s": "deg/s", "m3/s": "l/min"}  # units that Modelica tools know
# tools take tolerance * nominal as absolute tolerance of a state: too loose for a pressure near zero; this is
# the same share as an FMU of ours gives to a solver (fmus/export/native/exchange.c)
FOR_TOLERANCES = 1e-3
SIDE = 100.0  # of an icon, from its middle


@dataclass(frozen=True)
class Model:
    """What a block needs of one FMU.

    name     of the Modelica class
    folder   of the unpacked FMU in the package's resources
    moving, outputs   its inputs and outputs, without those that are for rates
    held     inputs that are a number where nothing is connected, -> that number
    """

    name: str
    folder: str
    component: Component
    identifier: str
    moving: Sequence[Variable]
    outputs: Sequence[Variable]
    held: Mapping[str, float]

    @property
    def face(self) -> Interface:
        """The FMU's interface."""
        return self.component.interface

    @property
    def states(self) -> list[Variable]:
        """Its continuous states."""
        return [self.face.variables[name] for name in self.face.states]


def model(name: str, component: Component, held: Collection[str]) -> Model:
    """What a block needs; a Problem for an FMU that cannot be one.

    held   inputs that are their start value where nothing is connected
    """
    assert component.source is not None  # components come from files
    where, face = str(component.source), component.interface
    root = etree.fromstring(component.source.member("modelDescription.xml").read())
    exchange = root.find("ModelExchange")
    if face.fmi != 2 or exchange is None:
        raise Problem(f"{where}: expected an FMU 2.0 for Model Exchange")
    if int(root.get("numberOfEventIndicators") or 0):
        raise Problem(f"{where}: expected an FMU without event indicators, state events are not supported")
    if root.findall("ModelStructure/Derivatives/Unknown") and not face.states:
        raise Problem(f"{where}: expected continuous states with all their derivatives among the variables")
    other = [v.name for v in face.variables.values() if not v.is_real and v.causality in ("input", "output")]
    if other:
        raise Problem(f"{where}: expected inputs and outputs that are real numbers, {other[0]} is none")
    for v in face.variables.values():
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", v.name):
            raise Problem(f"{where}: {v.name!r} is no identifier in Modelica, expected letters, digits and _")
    outputs, moving = _used(face)
    numbers = {v.name: float(component.value(v.name)) for v in moving if v.name in held}
    return Model(name, component.name, component, exchange.get("modelIdentifier"), moving, outputs, numbers)


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


def identifier(name: str) -> str:
    """A name that Modelica takes."""
    return f"{name}_" if name in KEYWORDS else name


def class_name(name: str) -> str:
    """boom_stick -> BoomStick."""
    return "".join(part[:1].upper() + part[1:] for part in re.split(r"[^A-Za-z0-9]+", name))


def quoted(text: str) -> str:
    """A Modelica string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def number(value: float) -> str:
    """A Modelica literal."""
    return repr(float(value))


def _attributes(v: Variable, **more: str) -> str:
    """(unit="Pa", displayUnit="bar", ...) or nothing."""
    found = dict(more)
    if v.unit:
        found = {"unit": quoted(v.unit.name)} | found
        if v.unit.name in SHOWN_IN:
            found["displayUnit"] = quoted(SHOWN_IN[v.unit.name])
    for word, bound in (("min", v.minimum), ("max", v.maximum)):
        if bound is not None and v.causality == "parameter":
            found[word] = number(bound)
    return f"({', '.join(f'{k} = {x}' for k, x in found.items())})" if found else ""


def connector(v: Variable, kind: str, side: float, place: float, condition: str = "") -> str:
    """One line: an input or output at a place of the icon, -100 to 100 from below."""
    extent = f"{{{{{side - 10:g}, {place - 10:g}}}, {{{side + 10:g}, {place + 10:g}}}}}"
    declared = f"{identifier(v.name)}{_attributes(v)}{condition}"
    return (
        f"  Modelica.Blocks.Interfaces.{kind} {declared} {quoted(v.text)}\n"
        f"    annotation(Placement(transformation(extent = {extent})));\n"
    )


def places(count: int) -> list[float]:
    """Where `count` connectors lie on a side, from above."""
    return [SIDE - 2 * SIDE * (k + 0.5) / count for k in range(count)]


def _references(variables: Iterable[Variable]) -> str:
    refs = ", ".join(str(v.reference) for v in variables)
    return f"{{{refs}}}" if refs else "fill(0, 0)"


def _vector(names: Iterable[str]) -> str:
    text = ", ".join(names)
    return f"{{{text}}}" if text else "fill(0.0, 0)"


def parameters(m: Model) -> dict[str, tuple[Variable, float]]:
    """What a user may set, by its name in Modelica: parameters, and start values of states as NAME_start."""
    numbers = m.component.numbers()
    free = {f"{v.name}_start": v for v in m.states if v.initial == "exact" and v.start is not None}
    return {identifier(v.name): (v, numbers[v.name]) for v in m.face.of("parameter") if v.name in numbers} | {
        name: (v, float(m.component.value(v.name))) for name, v in free.items()
    }


def choice(name: str) -> str:
    """The parameter that says whether an input has a connector."""
    return (
        f'  parameter Boolean use_{name}_in = false "= true, if {name} comes from its connector"\n'
        "    annotation(Evaluate = true, choices(checkBox = true));\n"
    )


def block(m: Model, package: str) -> str:
    """The text of the block."""
    given, states = parameters(m), m.states
    text = [f"block {m.name} {quoted(m.face.text)}\n  extends Modelica.Blocks.Icons.Block;\n"]
    text += [
        f"  parameter Real {name}{_attributes(v)} = {number(value)} {quoted(v.text)};\n"
        for name, (v, value) in given.items()
    ]
    for name, value in m.held.items():
        v = m.face.variables[name]
        text.append(
            f'  parameter Boolean use_{name}_in = false "= true, if {name} comes from its connector"\n'
            f"    annotation(Evaluate = true, choices(checkBox = true));\n"
            f"  parameter Real {name}_constant{_attributes(v)} = {number(value)} {quoted(v.text)}\n"
            f"    annotation(Dialog(enable = not use_{name}_in));\n"
        )
    for v, place in zip(m.moving, places(max(len(m.moving), 1)), strict=False):
        condition = f" if use_{v.name}_in" if v.name in m.held else ""
        text.append(connector(v, "RealInput", -SIDE - 10, place, condition))
    for v, place in zip(m.outputs, places(max(len(m.outputs), 1)), strict=False):
        text.append(connector(v, "RealOutput", SIDE + 10, place))
    text.append("protected\n")
    text += [
        f"  Modelica.Blocks.Interfaces.RealInput {name}_internal{_attributes(m.face.variables[name])};\n"
        for name in m.held
    ]
    text.append(
        "  parameter String fmu_folder =\n"
        f'    ModelicaServices.ExternalReferences.loadResource("modelica://{package}/Resources/FMUs/{m.folder}");\n'
        "  Internal.Instance fmu_instance = Internal.Instance(\n    fmu_folder,\n"
        f"    {quoted(m.identifier)}, {quoted(m.face.guid)},\n"
        f"    {_references(v for v, _ in given.values())},\n    {_vector(given)});\n"
    )
    if states:
        nominal = ", ".join(number(FOR_TOLERANCES * (v.nominal or 1.0)) for v in states)
        always = f"nominal = {{{nominal}}}, each stateSelect = StateSelect.always"
        text.append(f"  Real fmu_states[{len(states)}]({always});\n")
    text.append('  discrete Real fmu_next(start = -1e60, fixed = true) "Time of the next event";\n')
    inputs = {v.name: f"{v.name}_internal" if v.name in m.held else identifier(v.name) for v in m.moving}
    if states:
        text += _initial(m, states, inputs)
    text.append("equation\n")
    for name in m.held:
        text.append(f"  connect({identifier(name)}, {name}_internal);\n")
        text.append(f"  if not use_{name}_in then\n    {name}_internal = {name}_constant;\n  end if;\n")
    text += _equations(m, states, inputs)
    text.append(
        "  when {initial(), time >= pre(fmu_next)} then\n"
        f"    fmu_next = Internal.event(fmu_instance, time, {_states(m)});\n  end when;\n"
    )
    if "model.png" in m.component.source.names():  # type: ignore[union-attr]  # see model
        picture = f'fileName = "modelica://{package}/Resources/FMUs/{m.folder}/model.png"'
        extent = "extent = {{-80, -80}, {80, 80}}"
        text.append(f"  annotation(Icon(graphics = {{Bitmap({extent}, {picture})}}));\n")
    text.append(f"end {m.name};\n")
    return "".join(text)


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
        text.append(_assigned([identifier(y.name) for y in ys], call))
    return text


def _needed(m: Model, unknowns: Iterable[str]) -> frozenset[str]:
    """The inputs that matter to some derivatives or outputs."""
    moving = {v.name for v in m.moving}
    found: set[str] = set()
    for name in unknowns:
        known: Any = m.face.knowns.get(name)
        found |= moving if known is None else known & moving
    return frozenset(found)
