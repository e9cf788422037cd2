"""Initialisation: start values, then consistent outputs and inputs in initialisation mode."""

from __future__ import annotations

import math
from collections.abc import Mapping

from orchestrator.base.errors import Problem
from orchestrator.engine.algebraic_loop import solver
from orchestrator.fmi.calls import Slave
from orchestrator.fmi.description import FmuInterface, Value
from orchestrator.ssp.dependencies import DependencyCycle, Feedthrough, strongly_connected
from orchestrator.ssp.system import Connection, Port, System


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
        slave.setup(span[0], _end(slave.interface, span[1]), tolerance)
        for variable, value in system.components[name].start.items():
            slave.set(variable, value)
    _set(slaves, driven)  # for FMUs that compute their start when they enter initialisation
    for slave in slaves.values():
        slave.enter()
    _set(slaves, driven)
    propagate(system, slaves)
    for slave in slaves.values():
        slave.exit()


def _end(interface: FmuInterface, stop: float) -> float:
    """The stop time to announce [s]: the sum of equal steps may be past the true one by its rounding."""
    return stop if interface.variable_step else stop + 4.0 * math.ulp(stop)


def _set(slaves: Mapping[str, Slave], values: Mapping[Port, Value]) -> None:
    for port, value in values.items():
        slaves[port.component].set(port.variable, value)


def propagate(system: System, slaves: Mapping[str, Slave]) -> None:
    """Carry outputs to the inputs they feed, in the order of the dependencies in initialisation mode.

    Algebraic loops are solved as in the run, see `AlgebraicLoop`.
    """
    flow = Feedthrough(system, initially=True)
    fed: dict[Port, list[Connection]] = {}
    for c in system.connections:
        fed.setdefault(c.source, []).append(c)
    for group in strongly_connected(flow.graph):
        known, cycle = [y for y in group if y in fed], flow.cycle(group)
        if cycle:
            _solve(slaves, cycle, {y: [c for c in fed[y] if c not in cycle.connections] for y in known})
        else:
            for y in known:
                _carry(slaves, y, fed[y])


def _solve(slaves: Mapping[str, Slave], cycle: DependencyCycle, fed: Mapping[Port, list[Connection]]) -> None:
    """Solve for the Real signals of a cycle; where it has others, again and again until nothing changes."""
    solve = solver(slaves, cycle) if cycle.connections else None
    previous: dict[Port, Value] = {}
    for _ in range(1 if cycle.rounds == 1 else len(fed) + 1):
        if solve:
            solve()
        current = {y: _carry(slaves, y, connections) for y, connections in fed.items()}
        if previous and all(_same(previous[y], value) for y, value in current.items()):
            return
        previous = current
    if cycle.rounds > 1 and cycle.declared:
        raise Problem(f"initialisation does not settle: {cycle.text}")


def _same(old: Value, new: Value) -> bool:
    """Equal up to the rounding of an FMU that iterates inside."""
    return old == new or (isinstance(new, float) and math.isclose(float(old), new, rel_tol=1e-10))


def _carry(slaves: Mapping[str, Slave], source: Port, connections: list[Connection]) -> Value:
    """Read one output and set the inputs it feeds; returns the output's value."""
    value = slaves[source.component].get(source.variable)
    if isinstance(value, str) or math.isnan(value):
        raise Problem(f"{source}: expected a number in initialisation mode, got {value!r}")
    for c in connections:
        slaves[c.target.component].set(c.target.variable, type(value)(c.map(value)))
    return value
