"""Power bonds: two opposite connections between two components whose signals multiply to power.

Bonds are found from the units of the signals; effort and flow are those of bond graphs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from math import prod
from typing import NamedTuple

from orchestrator.base.errors import Problem
from orchestrator.base.text import grouped
from orchestrator.ssp.dependencies import of_structure
from orchestrator.ssp.system import Connection, Port, System

# dimensions of effort and flow: exponents of (kg, m, s, A, K, mol, cd); their product is power
FORCE, VELOCITY = (1, 1, -2, 0, 0, 0, 0), (0, 1, -1, 0, 0, 0, 0)
TORQUE, ANGULAR_VELOCITY = (1, 2, -2, 0, 0, 0, 0), (0, 0, -1, 0, 0, 0, 0)
PRESSURE, VOLUME_FLOW = (1, -1, -2, 0, 0, 0, 0), (0, 3, -1, 0, 0, 0, 0)
VOLTAGE, CURRENT = (1, 2, -3, -1, 0, 0, 0), (0, 0, 0, 1, 0, 0, 0)
PAIRS = ((FORCE, VELOCITY), (TORQUE, ANGULAR_VELOCITY), (PRESSURE, VOLUME_FLOW), (VOLTAGE, CURRENT))

SIGNALS = {"sensing", "sensed", "measured", "setpoint"}  # words of names of ports that carry no power


@dataclass(frozen=True)
class Bond:
    """effort, flow: the two component inputs; the product of their values times `scale` is power [W]."""

    name: str
    effort: Port
    flow: Port
    scale: float = 1.0


class _Candidate(NamedTuple):
    """Two connections that may be a bond; prefix: common leading words of the names of the two inputs."""

    prefix: tuple[str, ...]
    effort: Connection
    flow: Connection

    @property
    def inputs(self) -> set[Port]:
        return {self.effort.target, self.flow.target}


@of_structure
def find_bonds(system: System) -> Sequence[Bond]:
    """The bonds that follow from the units.

    If a connection could belong to several bonds, the longest common prefix of the input names decides. If
    several prefixes are equally long there is no bond. Ports with one of the words `SIGNALS` in their names,
    such as `load_sensing_pressure`, carry no power.
    """
    of = {c: dimension for c in system.connections if (dimension := _dimension(system, c))}
    between = grouped(of, lambda c: (c.source.component, c.target.component))
    candidates = [
        _Candidate(_common_prefix(effort, flow), effort, flow)
        for effort in of
        for flow in between.get((effort.target.component, effort.source.component), ())
        if (of[effort], of[flow]) in PAIRS and _opposite(effort, flow)
    ]
    of_input = grouped(((port, c) for c in candidates for port in c.inputs), lambda pair: pair[0])
    bonds, used = [], set[Port]()
    for candidate in sorted(candidates, key=lambda c: -len(c.prefix)):
        rivals = [
            c
            for port in candidate.inputs
            for _, c in of_input[port]
            if (c.effort is candidate.effort) != (c.flow is candidate.flow)
            and len(c.prefix) >= len(candidate.prefix)
        ]
        if candidate.inputs & used or any(not rival.inputs & used for rival in rivals):
            continue
        used |= candidate.inputs
        bonds.append(_bond(system, candidate))
    return bonds


def bond_of(system: System, effort: str, flow: str) -> Bond:
    """The bond of two inputs, given by their names."""
    sources = {c.target: c for c in system.connections}
    ports = system.port(effort), system.port(flow)
    for port in ports:
        if port not in sources:
            raise Problem(f"power bond {effort}, {flow}: {port} is not a connected input")
    a, b = (sources[p] for p in ports)
    if not _opposite(a, b):
        expected = "two opposite connections between the same two components"
        raise Problem(f"power bond {effort}, {flow}: expected {expected}, got {a} and {b}")
    return _bond(system, _Candidate(_common_prefix(a, b), a, b))


def _bond(system: System, candidate: _Candidate) -> Bond:
    effort, flow = candidate.effort.target, candidate.flow.target
    units = system.variable(effort).unit, system.variable(flow).unit
    scale = prod((u.factor for u in units if u is not None), start=1.0)
    a, b = sorted((effort.component, flow.component))
    name = f"{a} - {b}" + (f": {'_'.join(candidate.prefix)}" if candidate.prefix else "")
    return Bond(name, effort, flow, scale)


def _opposite(effort: Connection, flow: Connection) -> bool:
    one, other = effort.source.component, effort.target.component
    return one != other and (flow.source.component, flow.target.component) == (other, one)


def _dimension(system: System, c: Connection) -> tuple[int, ...] | None:
    """The dimension of a connection that may carry power; None for signals."""
    unit = system.variable(c.target).unit
    signal = any(not SIGNALS.isdisjoint(_words(port)) for port in (c.source, c.target))
    return unit.dimension if unit and not signal else None


def _common_prefix(effort: Connection, flow: Connection) -> tuple[str, ...]:
    words = zip(_words(effort.target), _words(flow.target), strict=False)
    return tuple(word for word, _ in takewhile(lambda pair: pair[0] == pair[1], words))


def _words(port: Port) -> list[str]:
    return port.variable.replace(".", "_").split("_")
