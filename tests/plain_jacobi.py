"""Our own orchestrator stepping as other tools do: what the tests of those tools compare with."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from work_cycle import SIGNALS

from orchestrator import load, run
from orchestrator.engine.network import Network
from orchestrator.engine.wiring import Link

# the same algorithm on the same FMUs: only the times of the steps differ, by rounding, and with them the
# inner steps of the solvers; measured 5e-12 over 10 s, and 4e-10 where the run itself is unstable
SAME = 1e-8


def _settle(network: Network, _t: float, _h: float) -> None:
    """Read all outputs once, carry them over.

    Our own `jacobi` reads outputs with feed-through (the accelerations) again, with the new inputs.
    """
    bank, fed = network.real, {c.target for c in network.connections}
    for block in bank.blocks:
        if not set(block.ports) & fed:
            network.reader(bank, block)()
    Link(bank, network.connections)()
    for block in bank.blocks:
        if set(block.ports) & fed:
            network.writer(bank, block)()


@cache
def ours(
    folder: Path, step: float, stop: float, rates: bool = True, master: str = "plain"
) -> dict[str, np.ndarray]:
    """The work cycle with harvester.ssp of `folder`, or without its rate wires: SIGNALS every 20 ms."""
    system = load(folder / "harvester.ssp")
    if not rates:
        system = system.without("*_rate", "*_acceleration")
    with pytest.MonkeyPatch.context() as patch:
        if master == "plain":
            patch.setattr(Network, "settle", _settle)
        known = "jacobi" if master == "plain" else master
        options = {"step": step, "stop": stop, "record": SIGNALS, "record_step": 0.02}
        trace = run(system, master=known, native=master != "plain", **options).trace
    return {name: trace[name][1:] for name in SIGNALS}
