"""Our own orchestrator stepping as other tools do: what the tests of those tools compare with."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from work_cycle import SIGNALS

from orchestrator import load, run
from orchestrator.coupling.masters import MASTERS
from orchestrator.coupling.network import Link, Network

# the same algorithm on the same FMUs: only the times of the steps differ, by rounding, and with them the
# inner steps of the solvers; measured 5e-12 over 10 s, and 4e-10 where the run itself is unstable
SAME = 1e-8


def _plain(network: Network) -> Callable[[float, float], None]:
    """Step all, read all outputs once, carry them over.

    Our own `jacobi` reads outputs with feed-through (the accelerations) again, with the new inputs.
    """
    bank, fed = network.real, {c.target for c in network.connections}
    steps = [slave.step for slave in network.slaves.values()]
    reads = [network.reader(bank, b) for b in bank.blocks if not set(b.ports) & fed]
    writes = [network.writer(bank, b) for b in bank.blocks if set(b.ports) & fed]
    link = Link(bank, network.connections)

    def step(t: float, h: float) -> None:
        for advance in steps:
            advance(t, h)
        for read in reads:
            read()
        link.carry()
        for write in writes:
            write()

    return step


@cache
def ours(
    folder: Path, step: float, stop: float, rates: bool = True, master: str = "plain"
) -> dict[str, np.ndarray]:
    """The work cycle with harvester.ssp of `folder`, or without its rate wires: SIGNALS every 20 ms."""
    system = load(folder / "harvester.ssp")
    if not rates:
        system = system.without("*_rate", "*_acceleration")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(MASTERS, "plain", _plain)
        trace = run(system, master=master, step=step, stop=stop, record=SIGNALS, record_step=0.02).trace
    return {name: trace[name][1:] for name in SIGNALS}
