"""A system of FMUs as a Modelica model: its components, connections and open inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from orchestrator.base.errors import Problem
from orchestrator.base.units import IDENTITY, Linear
from orchestrator.fmi.description import Variable
from orchestrator.modelica.block import Model, attributes
from orchestrator.modelica.text import Scope, literal, number, quoted
from orchestrator.ssp.system import Component, Port, System


@dataclass(frozen=True)
class Wiring:
    """A system, the block of each component by name, and the names of the components in Modelica."""

    system: System
    blocks: Mapping[str, Model]
    names: Mapping[str, str]

    def moves(self, port: Port) -> bool:
        """False for an input that has no use in Model Exchange: the rate of another one."""
        return port.variable in self.blocks[port.component].names

    def at(self, port: Port) -> str:
        """A port as Modelica names it."""
        return f"{self.names[port.component]}.{self.blocks[port.component].names[port.variable]}"


def connected(system: System, blocks: Mapping[str, Model], name: str) -> str:
    """The text of the model.

    An input that nothing feeds is a variable of the model with its start value, which a user may bind to
    something else: extends Harvester(controller_speed = sin(time)).
    """
    scope = Scope()
    wiring = Wiring(system, blocks, {component: scope.add(component) for component in system.components})
    fed = [c.target for c in system.connections]
    fed += [port for inlet in system.inputs.values() for port, _ in inlet.targets]
    text = [f"model {name} {quoted(system.name)}\n  extends Modelica.Icons.Example;\n"]
    text += [_component(c, blocks[n], wiring.names[n], set(fed)) for n, c in system.components.items()]
    declared, equations = _open(wiring, set(fed), scope)
    text += [*declared, "equation\n", *_connections(wiring), *equations]
    stop = f"StopTime = {number(system.stop)}, " if system.stop else ""
    text.append(f"  annotation(experiment({stop}Interval = 0.02, Tolerance = 1e-8));\n")
    return "".join([*text, f"end {name};\n"])


def _component(component: Component, m: Model, name: str, fed: set[Port]) -> str:
    """A component, with the values that differ from those of its FMU."""
    changed = [
        f"{p.name} = {literal(value)}"
        for p in m.parameters
        if (value := component.value(p.variable.name)) != p.value
    ]
    for variable, held in m.held.items():
        value = float(component.value(variable))
        if Port(component.name, variable) in fed:
            changed.append(f"{held.use} = true")
        elif value != held.value:
            changed.append(f"{held.constant} = {number(value)}")
    modified = f"({', '.join(changed)})" if changed else ""
    return f"  FMUs.{m.name} {name}{modified};\n"


def _connections(wiring: Wiring) -> list[str]:
    text = []
    for c in wiring.system.connections:
        target = wiring.system.variable(c.target)
        if target.causality != "input":
            raise Problem(
                f"{c}: {c.target} is a {target.causality}, expected an input: nothing else is connected"
            )
        if not wiring.moves(c.target):
            continue
        if not wiring.moves(c.source):
            raise Problem(f"{c}: {c.source} is no output in Model Exchange")
        text.append(
            f"  connect({wiring.at(c.source)}, {wiring.at(c.target)});\n"
            if c.map == IDENTITY
            else _equation(wiring.at(c.target), wiring.at(c.source), c.map)
        )
    return text


def _equation(target: str, source: str, linear: Linear) -> str:
    if linear == IDENTITY:
        return f"  {target} = {source};\n"
    return f"  {target} = {number(linear.factor)} * {source} + {number(linear.offset)};\n"


def _open(wiring: Wiring, fed: set[Port], scope: Scope) -> tuple[list[str], list[str]]:
    """Inputs of the system, and inputs of components that nothing feeds: declarations and equations."""
    declared, equations = [], []
    for inlet in wiring.system.inputs.values():
        targets = [(port, linear) for port, linear in inlet.targets if wiring.moves(port)]
        if targets:
            port, linear = targets[0]
            start = (_start(wiring, port) - linear.offset) / linear.factor
            name = scope.add(inlet.name)
            unit = f"(unit = {quoted(inlet.unit.name)})" if inlet.unit else ""
            declared.append(_variable(name, unit, start, wiring.system.variable(port)))
            equations += [_equation(wiring.at(port), name, linear) for port, linear in targets]
    for component, m in wiring.blocks.items():
        for v in m.moving:
            port = Port(component, v.name)
            if port not in fed and v.name not in m.held:
                name = scope.add(f"{component}_{v.name}")
                declared.append(_variable(name, attributes(v), _start(wiring, port), v))
                equations.append(_equation(wiring.at(port), name, IDENTITY))
    return declared, equations


def _variable(name: str, unit: str, value: float, of: Variable) -> str:
    return f"  Real {name}{unit} = {number(value)} {quoted(of.text)} annotation(Dialog);\n"


def _start(wiring: Wiring, port: Port) -> float:
    return float(wiring.system.components[port.component].value(port.variable))
