"""The valve of a bench, as it is in the machine: a spool that is where it is told, or one that moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from fmus.components import spool_dynamics, spool_valve
from fmus.components.spool_dynamics import SpoolState
from fmus.components.spool_valve import PortFlow
from fmus.contract import Scalar
from fmus.rig.benches.bench import SUPPLY, Named, detailed, lumped

Flows: TypeAlias = tuple[Scalar, Scalar]  # out of A and B [m3/s]
Ports: TypeAlias = tuple[PortFlow, PortFlow]


@dataclass(frozen=True)
class BenchValve:
    """States of the spool, (start, nominal); rates (x, command); ports (x, command, flows, tank)."""

    states: dict[str, tuple[Scalar, float]]
    rates: Callable[[Named, Scalar], Named]
    ports: Callable[[Named, Scalar, Flows, float], Ports]


def bench_valve(machine: str) -> BenchValve:
    """The valve of the lumped or of the detailed machine between bench supply and return line."""
    return _moving() if machine == "detailed" else _still()


def _still() -> BenchValve:
    p = lumped()

    def ports(_: Named, command: Scalar, flows: Flows, tank: float) -> Ports:
        return spool_valve.ports(p.valve, command, *flows, SUPPLY, tank, p.density)

    return BenchValve({}, lambda _, __: {}, ports)


def _moving() -> BenchValve:
    p = detailed()

    def rates(x: Named, command: Scalar) -> Named:
        wanted = spool_dynamics.share(command, p.valve_full_command)
        rate = spool_dynamics.rates(p.spool, SpoolState(x["position"], x["speed"]), wanted)
        return {"position": rate.position, "speed": rate.speed}

    def ports(x: Named, _: Scalar, flows: Flows, tank: float) -> Ports:
        return spool_dynamics.ports(p.edges, x["position"], *flows, SUPPLY, tank, p.density)

    return BenchValve({"position": (0.0, 1.0), "speed": (0.0, 10.0)}, rates, ports)
