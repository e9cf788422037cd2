"""A system of FMUs as a Modelica model: its components, connections and open inputs."""

from __future__ import annotations

from collections.abc import Mapping

from orchestrator.base.errors import Problem
from orchestrator.base.units import IDENTITY, LinearTransformation
from orchestrator.fmi.description import FmuVariable
from orchestrator.modelica.block import FmuBlock, attributes
from orchestrator.modelica.syntax import Scope, literal, number, quoted
from orchestrator.ssp.system import Component, Port, System


def connected_system(system: System, blocks: Mapping[str, FmuBlock], name: str) -> str:
    """The text of the model `name`; `blocks` are those of the components.

    An input that nothing feeds is a variable of the model with its start value, which a user may bind to
    something else: extends Harvester(controller_speed = sin(time)).
    """
    return _ConnectedSystem(system, blocks).text(name)


class _ConnectedSystem:
    def __init__(self, system: System, blocks: Mapping[str, FmuBlock]) -> None:
        self._system, self._blocks, self._scope = system, blocks, Scope()
        self._names = {component: self._scope.add(component) for component in system.components}
        inlets = [port for inlet in system.inputs.values() for port, _ in inlet.targets]
        self._fed = {c.target for c in system.connections}.union(inlets)
        self._declared: list[str] = []
        self._equations: list[str] = []

    def text(self, name: str) -> str:
        """The model."""
        stop = f"StopTime = {number(self._system.stop)}, " if self._system.stop else ""
        components = [self._component(c) for c in self._system.components.values()]
        self._connections()
        self._open_inputs()
        return "".join(
            [
                f"model {name} {quoted(self._system.name)}\n  extends Modelica.Icons.Example;\n",
                *components,
                *self._declared,
                "equation\n",
                *self._equations,
                f"  annotation(experiment({stop}Interval = 0.02, Tolerance = 1e-8));\n",
                f"end {name};\n",
            ]
        )

    def _moves(self, port: Port) -> bool:
        """False for an input that has no use in Model Exchange: the rate of another one."""
        return port.variable in self._blocks[port.component].names

    def _at(self, port: Port) -> str:
        """A port as Modelica names it."""
        return f"{self._names[port.component]}.{self._blocks[port.component].names[port.variable]}"

    def _component(self, component: Component) -> str:
        """A component, with the values that differ from those of its FMU."""
        block, changed = self._blocks[component.name], []
        for p in block.parameters:
            if (value := component.value(p.variable.name)) != p.value:
                changed.append(f"{p.name} = {literal(value)}")
        for variable, optional in block.optional.items():
            start = float(component.value(variable))
            if Port(component.name, variable) in self._fed:
                changed.append(f"{optional.use} = true")
            elif start != optional.value:
                changed.append(f"{optional.constant} = {number(start)}")
        modified = f"({', '.join(changed)})" if changed else ""
        return f"  FMUs.{block.name} {self._names[component.name]}{modified};\n"

    def _connections(self) -> None:
        for c in self._system.connections:
            target = self._system.variable(c.target)
            if target.causality != "input":
                got = f"{c.target} is a {target.causality}, expected an input: nothing else is connected"
                raise Problem(f"{c}: {got}")
            if not self._moves(c.target):
                continue
            if not self._moves(c.source):
                raise Problem(f"{c}: {c.source} is no output in Model Exchange")
            if c.map == IDENTITY:
                self._equations.append(f"  connect({self._at(c.source)}, {self._at(c.target)});\n")
            else:
                self._equation(c.target, self._at(c.source), c.map)

    def _equation(self, target: Port, source: str, linear: LinearTransformation) -> None:
        mapped = f"{number(linear.factor)} * {source} + {number(linear.offset)}"
        self._equations.append(f"  {self._at(target)} = {source if linear == IDENTITY else mapped};\n")

    def _open_inputs(self) -> None:
        """Inputs of the system, and inputs of components that nothing feeds."""
        for inlet in self._system.inputs.values():
            targets = [(port, linear) for port, linear in inlet.targets if self._moves(port)]
            if targets:
                port, linear = targets[0]
                start = (self._start(port) - linear.offset) / linear.factor
                unit = f"(unit = {quoted(inlet.unit.name)})" if inlet.unit else ""
                name = self._declare(inlet.name, unit, start, self._system.variable(port))
                for port, linear in targets:
                    self._equation(port, name, linear)
        for component, block in self._blocks.items():
            for v in block.inputs:
                port = Port(component, v.name)
                if port not in self._fed and v.name not in block.optional:
                    name = self._declare(f"{component}_{v.name}", attributes(v), self._start(port), v)
                    self._equation(port, name, IDENTITY)

    def _declare(self, wanted: str, unit: str, value: float, of: FmuVariable) -> str:
        """Declare a variable of the model; its name."""
        name = self._scope.add(wanted)
        declared = f"  Real {name}{unit} = {number(value)} {quoted(of.description)} annotation(Dialog);\n"
        self._declared.append(declared)
        return name

    def _start(self, port: Port) -> float:
        return float(self._system.components[port.component].value(port.variable))
