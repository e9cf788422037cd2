"""Jacobi: every component takes the same step with the inputs known at its start."""

from __future__ import annotations

from collections.abc import Callable

from orchestrator.coupling.network import Network


def jacobi(network: Network) -> Callable[[float, float], None]:
    """Inputs are held over the step; order 1.

    An FMU may still move an input inside the step: by a slope it gets (driven inputs), or by a rate input.
    """
    steps = [slave.step for slave in network.slaves.values()]

    def step(t: float, h: float) -> None:
        network.tilt(t, h)
        for advance in steps:
            advance(t, h)
        network.settle(t, h)

    return step
