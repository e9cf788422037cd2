"""Initialisation: start values, then consistent outputs and inputs in initialisation mode."""

from __future__ import annotations

import math
from collections.abc import Mapping

from orchestrator.errors import Problem
from orchestrator.slaves.slave import Slave
from orchestrator.system.dependencies import components, describe, feedthrough
from orchestrator.system.interface import Value
from orchestrator.system.system import Connection, Port, System


def initialise(
    system: System,
    slaves: Mapping[str, Slave],
    driven: Mapping[Port, Value],
    span: tuple[float, float],
    tolerance: float | None = None,
) -> None:
    """Bring all slaves from instantiated to ready for the first step.

    driven   input -> value at the start time, for inputs that a scenario drives
    span     start and stop time [s]
    """
    for name, slave in slaves.items():
        slave.setup(*span, tolerance)
        for variable, value in system.components[name].start.items():
            slave.set(variable, value)
    _set(slaves, driven)  # for FMUs that compute their start when they enter initialisation
    for slave in slaves.values():
        slave.enter()
    _set(slaves, driven)
    propagate(system, slaves)
    for slave in slaves.values():
        slave.exit()


def _set(slaves: Mapping[str, Slave], values: Mapping[Port, Value]) -> None:
    for port, value in values.items():
        slaves[port.component].set(port.variable, value)


def propagate(system: System, slaves: Mapping[str, Slave]) -> None:
    """Carry outputs to the inputs they feed, in the order of the dependencies in initialisation mode.

    With a loop in the declared dependencies the sweep is repeated until nothing changes.
    """
    graph = feedthrough(system, lambda c, y: system.components[c].interface.depends_initially(y))
    groups = components(graph)
    ordered = [y for group in groups for y in group]
    fed: dict[Port, list[Connection]] = {}
    for c in system.connections:
        fed.setdefault(c.source, []).append(c)
    previous: dict[Port, Value] = {}
    looped = [g for g in groups if len(g) > 1 or g[0] in graph[g[0]]]
    for _ in range(len(ordered) + 1 if looped else 1):
        current = {y: _carry(slaves, fed[y]) for y in ordered if y in fed}
        if previous and all(_same(previous[y], value) for y, value in current.items()):
            return
        previous = current
    for group in looped:
        if all(system.components[y.component].interface.initially.get(y.variable) is not None for y in group):
            wires = describe(system, graph, group)
            raise Problem(f"initialisation does not settle: algebraic loop {wires}")


def _same(old: Value, new: Value) -> bool:
    """Equal up to the rounding of an FMU that iterates inside."""
    return old == new or (isinstance(new, float) and math.isclose(old, new, rel_tol=1e-10))  # type: ignore[arg-type]


def _carry(slaves: Mapping[str, Slave], connections: list[Connection]) -> Value:
    """Read one output and set the inputs it feeds; returns the output's value."""
    source = connections[0].source
    value = slaves[source.component].get(source.variable)
    if isinstance(value, str) or math.isnan(value):
        raise Problem(f"{source}: expected a number in initialisation mode, got {value!r}")
    for c in connections:
        slaves[c.target.component].set(c.target.variable, type(value)(c.map(value)))
    return value
