"""Inputs and outputs of a linear model, and the system without the connections to these inputs."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.signals import selected
from orchestrator.engine.plant import Plant
from orchestrator.fmi.interface import FmuInterface
from orchestrator.ssp.system import Inlet, Port, System

MAX_LISTED = 8  # names in a message


@dataclass(frozen=True)
class CutSystem:
    """The system that is linearised, and its inputs.

    system            without the connections to the inputs, and without the components whose outputs are
                      connected only to these inputs
    inputs            external inputs, each with its targets, the connected inputs of components
    requested_count   number of inputs of the linear model, the first ones; the others only hold joints
    notes             remarks for the user
    """

    system: System
    inputs: tuple[Inlet, ...]
    requested_count: int
    notes: tuple[str, ...]


class CutPlant(Plant):
    """The running components of a cut system."""

    def __init__(self, cut: CutSystem) -> None:
        super().__init__(cut.system, cut.inputs)
        self.cut = cut


def cut_at_inputs(
    system: System, names: Sequence[str] = (), steady: bool = False, released: System | None = None
) -> CutSystem:
    """Make inputs of the linear model and remove the connections to them.

    names    inputs, in the notation of `System.targets`; default: all inputs of the system, and the inputs
             connected to components without inputs, such as an operator
    steady   add the default inputs, which a steady state needs to hold the joints
    released the system without the connections that a scenario replaces
    """
    requested = tuple(_inlet(system, name) for name in dict.fromkeys(names)) or _default_inputs(system)
    targets = {port for inlet in requested for port, _ in inlet.targets}
    others = (i for i in _default_inputs(system) if not targets & {port for port, _ in i.targets})
    inlets = (*requested, *others) if steady else requested
    ports = [port for inlet in inlets for port, _ in inlet.targets]
    for port in ports:
        if ports.count(port) > 1:
            both = " and ".join(i.name for i in inlets if port in dict(i.targets))
            raise Problem(
                f"--input {both}: expected inputs with different targets, both are connected to {port}"
            )
    cut_targets = {*ports}
    for port, rate in system.rate_ports.items():
        if port in ports and rate_only(system.components[rate.component].interface, rate.variable):
            cut_targets.add(rate)
    connections = tuple(c for c in (released or system).connections if c.target not in cut_targets)
    cut_sources = {c.source.component for c in system.connections if c not in connections}
    unused = sorted(cut_sources - {c.source.component for c in connections})
    components = {name: c for name, c in system.components.items() if name not in unused}
    connections = tuple(c for c in connections if c.target.component in components)
    reason = "because they are connected only to inputs of the linear model or of the scenario"
    notes = (f"components left out, {reason}: {', '.join(unused)}",) if unused else ()
    system = replace(system, components=components, connections=connections)
    return CutSystem(system, inlets, len(requested), notes)


def rate_only(interface: FmuInterface, name: str) -> str:
    """The input of which `name` is only the time derivative; empty if `name` is another input.

    Such a rate input makes the value of the input a ramp inside a communication step, and rate outputs exact.
    No time derivative of a state depends on it, so it is not an input of a linear model.
    """
    value_input = next((u for u, rate in interface.rate_inputs.items() if rate == name), "")
    dependencies = [interface.dependencies.get(rate) for rate in interface.states.values()]
    affects_state = any(known is None or name in known for known in dependencies)
    return "" if affects_state else value_input


def matching_outputs(system: System, patterns: Sequence[str] = ()) -> list[Port]:
    """The continuous outputs that match one of the patterns; all without patterns."""
    ports = [p for p in system.ports("output") if system.variable(p).is_continuous]
    names = [str(p) for p in ports]

    def missing(pattern: str) -> str:
        return f"--output {pattern}: no output matches{suggest(pattern, names) or _name_list(names)}"

    chosen = selected(names, patterns, missing)
    return [p for p in ports if not patterns or str(p) in chosen]


def _name_list(names: Sequence[str], kind: str = "outputs") -> str:
    """A list of names, or of the first of many, for a message."""
    if len(names) <= MAX_LISTED:
        return f"; there are {', '.join(names) or 'none'}"
    return f"; there are {len(names)} {kind}, such as {', '.join(names[:MAX_LISTED])}"


def _inlet(system: System, name: str) -> Inlet:
    """The input with a name, which must be a continuous input."""
    if not system.has(name):
        ports = [*_effective(system, system.ports("input"))]
        names = [*dict.fromkeys([*system.inputs, *(p.variable for p in ports), *map(str, ports)])]
        raise Problem(
            f"--input: unknown variable {name!r}{suggest(name, names) or _name_list(names, 'inputs')}"
        )
    targets = system.targets(name)
    for port, _ in targets:
        variable, interface = system.variable(port), system.components[port.component].interface
        if variable.causality != "input" or not variable.is_continuous:
            kind = f"{variable.variability} {variable.causality} of type {variable.kind}"
            raise Problem(f"--input {name}: expected a continuous input, got a {kind}")
        if value_input := rate_only(interface, port.variable):
            got = f"its time derivative {port.variable}, on which no state depends"
            raise Problem(f"--input {name}: expected {value_input}, got {got}")
    unit = system.inputs[name].unit if name in system.inputs else system.unit(targets[0][0])
    return Inlet(name, unit, targets)


def _default_inputs(system: System) -> tuple[Inlet, ...]:
    """Inputs of the system, unconnected inputs, and inputs connected to components without inputs."""
    sources = {n for n, c in system.components.items() if not c.interface.of("input")}
    targets = [c.target for c in system.connections if c.source.component in sources]
    inlets = [*system.inputs.values(), *(i for joint in system.open.values() for i in _apart(system, joint))]
    inlets += [_inlet(system, name) for name in _names(system, _effective(system, targets))]
    return tuple(i for i in inlets if list(_effective(system, (p for p, _ in i.targets))))


def _apart(system: System, inlet: Inlet) -> list[Inlet]:
    """An unconnected input, or one for each component where these start at different values."""
    starts = set()
    for port, linear in inlet.targets:
        start = system.components[port.component].start.get(port.variable, system.variable(port).start)
        starts.add((float(start or 0.0) - linear.offset) / linear.factor)
    if len(starts) == 1:
        return [inlet]
    return [Inlet(str(p), system.unit(p), ((p, linear),)) for p, linear in inlet.targets]


def _effective(system: System, ports: Iterable[Port]) -> Iterable[Port]:
    """The inputs that can have an effect in a linear model."""
    for port in ports:
        interface = system.components[port.component].interface
        used = system.variable(port).is_continuous and port.variable not in interface.unused_inputs
        if used and not rate_only(interface, port.variable):
            yield port


def _names(system: System, ports: Iterable[Port]) -> list[str]:
    """Names of variables if they are unique to these ports, else component.variable."""
    selected = list(ports)
    names = dict[str, None]()
    for port in selected:
        same = [p for p in system.ports("input") if p.variable == port.variable]
        names[port.variable if set(same) <= set(selected) else str(port)] = None
    return list(names)
