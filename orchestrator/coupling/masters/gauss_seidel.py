"""Gauss-Seidel: components step one after the other, later ones with the new outputs of earlier ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orchestrator.coupling.network import Link, Network
from orchestrator.slaves.slave import Call
from orchestrator.system.dependencies import sequence
from orchestrator.system.interface import Interface
from orchestrator.system.system import Connection

Receive = Callable[[float], None]


def gauss_seidel(network: Network) -> Callable[[float, float], None]:
    """Later components interpolate linearly between old and new value where they can, else hold the new one.

    The order of the components follows from the dependencies; order of convergence 1.
    """
    names = sequence(network.system)
    moves = [
        (_receive(network, name, names[:i]), network.slaves[name].step, network.read_again(name))
        for i, name in enumerate(names)
    ]

    def step(t: float, h: float) -> None:
        network.tilt(t, h)
        for receive, advance, reads in moves:
            for take in receive:
                take(h)
            advance(t, h)
            for read in reads:
                read()
        network.settle(t, h)

    return step


def _receive(network: Network, name: str, earlier: list[str]) -> list[Receive]:
    """What gives component `name` the new outputs of the components before it."""
    mine = [c for c in network.connections if c.target.component == name]
    links = [c for c in mine if c.source.component in earlier]
    face = network.slaves[name].interface
    sloped = [c for c in links if c.target.variable in face.sloped]
    moving = _moving(face, {c.target.variable for c in mine}, {c.target.variable for c in sloped})
    held = [c for c in links if c not in sloped and c.target.variable not in moving]
    banks = [[c for c in held if network.system.variable(c.target).is_real is real] for real in (True, False)]
    taken = [call for part in banks if part for call in _hold(network, part)]
    return taken + ([_interpolate(network, sloped)] if sloped else [])


def _moving(face: Interface, fed: set[str], sloped: set[str]) -> set[str]:
    """Inputs that must not get their new value before a step, because a rate input moves them, or is one.

    A rate input of a sloped input carries the slope that the master gives it.
    """
    if face.interpolates:
        return set()
    carried = {u for u, rate in face.rates.items() if rate in fed and u not in sloped}
    return carried | {face.rates[u] for u in sloped}


def _interpolate(network: Network, links: list[Connection]) -> Receive:
    """Keep the old value and give the slope towards the new one."""
    link = Link(network.real, links)
    buffer = np.zeros(len(links))
    slave = network.slaves[links[0].target.component]
    write = slave.slope_writer([c.target.variable for c in links], buffer)
    values, slopes = network.real.values, network.slopes

    def take(h: float) -> None:
        buffer[:] = (link.arriving() - values[link.target]) / h
        slopes[link.target] = buffer
        write()

    return take


def _hold(network: Network, links: list[Connection]) -> list[Receive]:
    """Set the new value before the step."""
    bank = network.bank(links[0].target)
    link = Link(bank, links)
    blocks = [b for b in bank.blocks if set(b.ports) & {c.target for c in links}]
    writes: list[Call] = [network.writer(bank, b) for b in blocks]

    def take(_: float) -> None:
        link.carry()
        for write in writes:
            write()

    return [take]
