"""Initialisation of a system: start values, then consistent outputs and inputs in initialisation mode."""

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
    """Initialise all FMUs, which are instantiated.

    driven   input -> value at the start time, for inputs that a scenario drives
    span     start and stop time [s]
    """
    for name, slave in slaves.items():
        slave.setup(span[0], _announced_stop(slave.interface, span[1]), tolerance)
        for variable, value in system.components[name].start.items():
            slave.set(variable, value)
    _set(slaves, driven)  # some FMUs compute start values when they enter initialisation mode
    for slave in slaves.values():
        slave.enter()
    _set(slaves, driven)
    propagate(system, slaves)
    for slave in slaves.values():
        slave.exit()


def _announced_stop(interface: FmuInterface, stop: float) -> float:
    """The stop time for the FMU [s]: rounding may carry the sum of equal steps beyond the true one."""
    return stop if interface.variable_step else stop + 4.0 * math.ulp(stop)


def _set(slaves: Mapping[str, Slave], values: Mapping[Port, Value]) -> None:
    for port, value in values.items():
        slaves[port.component].set(port.variable, value)


def propagate(system: System, slaves: Mapping[str, Slave]) -> None:
    """Copy outputs to the inputs that they feed, in the order of the dependencies in initialisation mode.

    Algebraic loops are solved as in the run, see `AlgebraicLoop`.
    """
    feedthrough = Feedthrough(system, initially=True)
    connections: dict[Port, list[Connection]] = {}
    for c in system.connections:
        connections.setdefault(c.source, []).append(c)
    for group in strongly_connected(feedthrough.graph):
        outputs, cycle = [y for y in group if y in connections], feedthrough.cycle(group)
        if cycle:
            others = {y: [c for c in connections[y] if c not in cycle.connections] for y in outputs}
            _solve(slaves, cycle, others)
        else:
            for y in outputs:
                _copy(slaves, y, connections[y])


def _solve(
    slaves: Mapping[str, Slave], cycle: DependencyCycle, others: Mapping[Port, list[Connection]]
) -> None:
    """Solve for the Real signals of a cycle; repeat until its other signals do not change any more.

    others   output of the cycle -> its connections that are not solved for
    """
    solve = solver(slaves, cycle) if cycle.connections else None
    previous: dict[Port, Value] = {}
    for _ in range(1 if cycle.rounds == 1 else len(others) + 1):
        if solve:
            solve()
        current = {y: _copy(slaves, y, connections) for y, connections in others.items()}
        if previous and all(_equal(previous[y], value) for y, value in current.items()):
            return
        previous = current
    if cycle.rounds > 1 and cycle.declared:
        raise Problem(f"initialisation does not settle: {cycle.text}")


def _equal(old: Value, new: Value) -> bool:
    """Whether two values are equal, except for the tolerance of an FMU that iterates inside."""
    return old == new or (isinstance(new, float) and math.isclose(float(old), new, rel_tol=1e-10))


def _copy(slaves: Mapping[str, Slave], source: Port, connections: list[Connection]) -> Value:
    """Read one output and set the inputs that it feeds; returns the value of the output."""
    value = slaves[source.component].get(source.variable)
    if isinstance(value, str) or math.isnan(value):
        raise Problem(f"{source}: expected a number in initialisation mode, got {value!r}")
    for c in connections:
        slaves[c.target.component].set(c.target.variable, type(value)(c.map(value)))
    return value
