"""Power bonds: pairs of opposite connections whose product is power, found from the units."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import prod

from orchestrator.base.errors import Problem
from orchestrator.ssp.system import Connection, Port, System

# effort and flow in (kg, m, s, A, K, mol, cd); their products are watts
FORCE, VELOCITY = (1, 1, -2, 0, 0, 0, 0), (0, 1, -1, 0, 0, 0, 0)
TORQUE, SPEED = (1, 2, -2, 0, 0, 0, 0), (0, 0, -1, 0, 0, 0, 0)
PRESSURE, FLOW = (1, -1, -2, 0, 0, 0, 0), (0, 3, -1, 0, 0, 0, 0)
VOLTAGE, CURRENT = (1, 2, -3, -1, 0, 0, 0), (0, 0, 0, 1, 0, 0, 0)
PAIRS = ((FORCE, VELOCITY), (TORQUE, SPEED), (PRESSURE, FLOW), (VOLTAGE, CURRENT))


@dataclass(frozen=True)
class Bond:
    """effort, flow: the two component inputs; their product times `scale` is power [W]."""

    name: str
    effort: Port
    flow: Port
    scale: float = 1.0


def find_bonds(system: System) -> list[Bond]:
    """The bonds that follow from units; among several pairs the common stem of the names decides."""
    candidates = []
    for effort, flow in product(system.connections, repeat=2):
        if _opposite(effort, flow) and _is_power(system, effort, flow):
            candidates.append((_stem(effort, flow), effort, flow))
    bonds, taken = [], set[Port]()
    for stem, effort, flow in sorted(candidates, key=lambda c: -len(c[0])):
        rivals = [c for c in candidates if (c[1] is effort) != (c[2] is flow) and len(c[0]) >= len(stem)]
        if effort.target in taken or flow.target in taken or any(_free(c, taken) for c in rivals):
            continue
        taken |= {effort.target, flow.target}
        bonds.append(_bond(system, effort, flow, stem))
    return bonds


def _free(candidate: tuple[tuple[str, ...], Connection, Connection], taken: set[Port]) -> bool:
    return candidate[1].target not in taken and candidate[2].target not in taken


def bond_of(system: System, effort: str, flow: str) -> Bond:
    """A bond given by the names of its two inputs."""
    fed = {c.target: c for c in system.connections}
    ports = system.port(effort), system.port(flow)
    for port in ports:
        if port not in fed:
            raise Problem(f"power bond {effort}, {flow}: {port} is not a connected input")
    a, b = (fed[p] for p in ports)
    if not _opposite(a, b):
        raise Problem(f"power bond {effort}, {flow}: expected opposite connections, got {a} and {b}")
    return _bond(system, a, b, _stem(a, b))


def _bond(system: System, effort: Connection, flow: Connection, stem: tuple[str, ...]) -> Bond:
    units = system.variable(effort.target).unit, system.variable(flow.target).unit
    scale = prod((u.factor for u in units if u is not None), start=1.0)
    a, b = sorted((effort.target.component, flow.target.component))
    name = f"{a} - {b}" + (f": {'_'.join(stem)}" if stem else "")
    return Bond(name, effort.target, flow.target, scale)


def _opposite(effort: Connection, flow: Connection) -> bool:
    return (
        effort.source.component == flow.target.component != effort.target.component
        and flow.source.component == effort.target.component
    )


def _is_power(system: System, effort: Connection, flow: Connection) -> bool:
    e, f = (system.variable(c.target).unit for c in (effort, flow))
    return e is not None and f is not None and (e.dimension, f.dimension) in PAIRS


def _stem(effort: Connection, flow: Connection) -> tuple[str, ...]:
    """Common leading words of the two inputs' names."""
    words = [c.target.variable.replace(".", "_").split("_") for c in (effort, flow)]
    stem = []
    for a, b in zip(*words, strict=False):
        if a != b:
            break
        stem.append(a)
    return tuple(stem)
