"""Which inputs and outputs a linear model has, and the system that is left when its wires to them are cut."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

from orchestrator.base.errors import Problem, suggest
from orchestrator.fmi.description import FmuInterface
from orchestrator.ssp.system import Inlet, Port, System

MAX_LISTED = 8  # names in a message


@dataclass(frozen=True)
class CutSystem:
    """What is linearised.

    system   without the wires to the inputs, and without components that fed nothing but them
    inputs   from outside, each with the component inputs that it feeds
    asked    how many of them, the first ones, are inputs of the linear model; others only hold joints
    notes    remarks for the user
    """

    system: System
    inputs: tuple[Inlet, ...]
    requested_count: int
    notes: tuple[str, ...]


def cut_at_inputs(system: System, names: Sequence[str] = (), steady: bool = False) -> CutSystem:
    """The inputs of these names, as `System.targets` knows them; a wire to one of them is cut.

    Default: what components without inputs feed, such as levers, and all inputs of the system. A steady state
    needs these in any case: whoever asks for the supply pressure only still wants the joints held.
    """
    asked = tuple(_inlet(system, name) for name in dict.fromkeys(names)) or _default_inputs(system)
    taken = {port for inlet in asked for port, _ in inlet.targets}
    free = (i for i in _default_inputs(system) if not taken & {port for port, _ in i.targets})
    inlets = (*asked, *free) if steady else asked
    ports = [port for inlet in inlets for port, _ in inlet.targets]
    for port in ports:
        if ports.count(port) > 1:
            both = " and ".join(i.name for i in inlets if port in dict(i.targets))
            raise Problem(f"--input {both}: expected inputs apart from each other, both feed {port}")
    gone = {*ports, *_rate_inputs(system, ports)}
    cut = {c.source.component for c in system.connections if c.target in gone}
    kept = tuple(c for c in system.connections if c.target not in gone)
    fed = {c.source.component for c in kept}
    idle = sorted(cut - fed)
    rest = {name: c for name, c in system.components.items() if name not in idle}
    wires = tuple(c for c in kept if c.target.component in rest)
    notes = (f"left out, because it feeds only what is an input here: {', '.join(idle)}",) if idle else ()
    return CutSystem(replace(system, components=rest, connections=wires), inlets, len(asked), notes)


def rate_only(face: FmuInterface, name: str) -> str:
    """The input whose time derivative this one carries and does nothing else with; empty for the others.

    Such a rate input moves the value inside a communication step, and it makes rate outputs exact. No time
    derivative of a state depends on it, so to a linear model it is no input.
    """
    of = next((u for u, rate in face.rate_inputs.items() if rate == name), "")
    known = [face.dependencies.get(rate) for rate in face.states.values()]
    moves = any(inputs is None or name in inputs for inputs in known)
    return "" if moves else of


def _rate_inputs(system: System, ports: Iterable[Port]) -> Iterable[Port]:
    """The rate inputs that go with inputs."""
    for port in ports:
        face = system.components[port.component].interface
        rate = face.rate_inputs.get(port.variable, "")
        if rate and rate_only(face, rate):
            yield Port(port.component, rate)


def matching_outputs(system: System, patterns: Sequence[str] = ()) -> list[Port]:
    """The outputs that fit the patterns, or all of them; those that are no numbers never do."""
    ports = [p for p in system.ports("output") if system.variable(p).is_continuous]
    names = [str(p) for p in ports]
    for pattern in patterns:
        if not any(map(_fits(pattern), names)):
            raise Problem(f"--output {pattern}: no output fits{suggest(pattern, names) or _name_list(names)}")
    return [p for p in ports if not patterns or any(_fits(x)(str(p)) for x in patterns)]


def _name_list(names: Sequence[str]) -> str:
    """All names, or the first of many."""
    if len(names) <= MAX_LISTED:
        return f"; there are {', '.join(names) or 'none'}"
    return f"; there are {len(names)} outputs, such as {', '.join(names[:MAX_LISTED])}"


def _fits(pattern: str) -> Callable[[str], bool]:
    return lambda name: fnmatchcase(name, pattern) or fnmatchcase(name.rpartition(".")[2], pattern)


def _inlet(system: System, name: str) -> Inlet:
    """The input that a user names."""
    targets = system.targets(name)
    for port, _ in targets:
        variable, face = system.variable(port), system.components[port.component].interface
        if variable.causality != "input" or not variable.is_continuous:
            kind = f"{variable.variability} {variable.causality} of type {variable.kind}"
            raise Problem(f"--input {name}: expected a continuous input, got a {kind}")
        if of := rate_only(face, port.variable):
            only = f"it only carries the time derivative of {of}, which no state depends on"
            raise Problem(f"--input {name}: {only}; expected {of}")
    unit = system.inputs[name].unit if name in system.inputs else system.unit(targets[0][0])
    return Inlet(name, unit, targets)


def _default_inputs(system: System) -> tuple[Inlet, ...]:
    """Inputs of the system, inputs that nothing feeds, and those fed by components without inputs."""
    sources = {n for n, c in system.components.items() if not c.interface.of("input")}
    fed = [c.target for c in system.connections if c.source.component in sources]
    found = [*system.inputs.values(), *system.open.values()]
    found += [_inlet(system, name) for name in _names(system, _effective(system, fed))]
    return tuple(i for i in found if list(_effective(system, (p for p, _ in i.targets))))


def _effective(system: System, ports: Iterable[Port]) -> Iterable[Port]:
    """Inputs that something can depend on in a linear model."""
    for port in ports:
        face = system.components[port.component].interface
        free = system.variable(port).is_continuous and port.variable not in face.unused_inputs
        if free and not rate_only(face, port.variable):
            yield port


def _names(system: System, ports: Iterable[Port]) -> list[str]:
    """Bare names where they stand for these ports only, else component.variable."""
    there = list(ports)
    found = dict[str, None]()
    for port in there:
        same = [p for p in system.ports("input") if p.variable == port.variable]
        found[port.variable if set(same) <= set(there) else str(port)] = None
    return list(found)
