"""Modelica code of a system of FMUs: components, connections and unconnected inputs."""

from collections.abc import Mapping

from orchestrator.base.errors import Problem
from orchestrator.base.units import IDENTITY, LinearTransformation
from orchestrator.fmi.description import FmuVariable
from orchestrator.modelica.block import FmuBlock, attributes
from orchestrator.modelica.syntax import Scope, literal, number, quoted
from orchestrator.ssp.system import Component, Port, System


def connected_system(system: System, blocks: Mapping[str, FmuBlock], name: str) -> str:
    """The code of the model `name`; `blocks` by name of the component.

    An unconnected input becomes a variable of the model with its start value. A user may replace the value:
    extends Harvester(controller_speed = sin(time)).
    """
    return _ConnectedSystem(system, blocks).to_modelica(name)


class _ConnectedSystem:
    def __init__(self, system: System, blocks: Mapping[str, FmuBlock]) -> None:
        self._system, self._blocks, self._scope = system, blocks, Scope()
        self._names = {component: self._scope.add(component) for component in system.components}
        targets = [port for system_input in system.inputs.values() for port, _ in system_input.targets]
        self._connected = {c.target for c in system.connections}.union(targets)
        self._variables: list[str] = []
        self._equations: list[str] = []

    def to_modelica(self, name: str) -> str:
        stop = f"StopTime = {number(self._system.stop)}, " if self._system.stop else ""
        components = [self._component(c) for c in self._system.components.values()]
        self._connections()
        self._unconnected_inputs()
        return "".join(
            [
                f"model {name} {quoted(self._system.name)}\n  extends Modelica.Icons.Example;\n",
                *components,
                *self._variables,
                "equation\n",
                *self._equations,
                f"  annotation(experiment({stop}Interval = 0.02, Tolerance = 1e-8));\n",
                f"end {name};\n",
            ]
        )

    def _in_block(self, port: Port) -> bool:
        """False for an input that Model Exchange does not need, the rate of another input."""
        return port.variable in self._blocks[port.component].names

    def _port_name(self, port: Port) -> str:
        """A port in the equations."""
        return f"{self._names[port.component]}.{self._blocks[port.component].names[port.variable]}"

    def _component(self, component: Component) -> str:
        """Declaration of a component with the values that differ from those of its FMU."""
        block, changed = self._blocks[component.name], []
        for p in block.parameters:
            if (value := component.value(p.variable.name)) != p.value:
                changed.append(f"{p.name} = {literal(value)}")
        for variable, optional in block.optional.items():
            start = float(component.value(variable))
            if Port(component.name, variable) in self._connected:
                changed.append(f"{optional.use} = true")
            elif start != optional.value:
                changed.append(f"{optional.constant} = {number(start)}")
        modified = f"({', '.join(changed)})" if changed else ""
        return f"  FMUs.{block.name} {self._names[component.name]}{modified};\n"

    def _connections(self) -> None:
        for c in self._system.connections:
            target = self._system.variable(c.target)
            if target.causality != "input":
                raise Problem(f"{c}: {c.target}: expected an input, got a {target.causality}")
            if not self._in_block(c.target):
                continue
            if not self._in_block(c.source):
                raise Problem(f"{c}: {c.source} is not an output in Model Exchange")
            if c.map == IDENTITY:
                self._equations.append(
                    f"  connect({self._port_name(c.source)}, {self._port_name(c.target)});\n"
                )
            else:
                self._equation(c.target, self._port_name(c.source), c.map)

    def _equation(self, target: Port, source: str, linear: LinearTransformation) -> None:
        mapped = f"{number(linear.factor)} * {source} + {number(linear.offset)}"
        self._equations.append(f"  {self._port_name(target)} = {source if linear == IDENTITY else mapped};\n")

    def _unconnected_inputs(self) -> None:
        """Variables for the inputs of the system and for unconnected inputs of components."""
        for system_input in self._system.inputs.values():
            targets = [(port, linear) for port, linear in system_input.targets if self._in_block(port)]
            if targets:
                port, linear = targets[0]
                start = (self._start(port) - linear.offset) / linear.factor
                unit = f"(unit = {quoted(system_input.unit.name)})" if system_input.unit else ""
                name = self._declare(system_input.name, unit, start, self._system.variable(port))
                for port, linear in targets:
                    self._equation(port, name, linear)
        for component, block in self._blocks.items():
            for v in block.inputs:
                port = Port(component, v.name)
                if port not in self._connected and v.name not in block.optional:
                    name = self._declare(f"{component}_{v.name}", attributes(v), self._start(port), v)
                    self._equation(port, name, IDENTITY)

    def _declare(self, name: str, unit: str, value: float, v: FmuVariable) -> str:
        """Declare a variable of the model for the input `v`; returns its identifier."""
        identifier = self._scope.add(name)
        self._variables.append(
            f"  Real {identifier}{unit} = {number(value)} {quoted(v.description)} annotation(Dialog);\n"
        )
        return identifier

    def _start(self, port: Port) -> float:
        return float(self._system.components[port.component].value(port.variable))
