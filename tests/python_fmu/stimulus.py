"""Signals for the inputs of any subsystem: consistent values and rates, both directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fmus.contract import Subsystem, quantities
from fmus.parameters import values

Array = NDArray[np.float64]
TURN = 2 * np.pi / 2.0  # rad/s: there and back in two seconds


def chains(sub: Subsystem) -> list[list[str]]:
    """Each input that is not a rate input, with the inputs that are its derivatives."""
    declared = quantities(sub.inputs)
    rates = {q.rate for q in declared.values()}
    found = []
    for name in (n for n in declared if n not in rates):
        chain = [name]
        while (rate := declared[chain[-1]].rate) is not None:
            chain.append(rate)
        found.append(chain)
    return found


def stimulus(sub: Subsystem, time: Array) -> Mapping[str, Array]:
    """Samples of every input: start + a (1 - cos wt), or a sin wt for commands, with their derivatives."""
    declared, start, signals = quantities(sub.inputs), values(sub).u, {}
    for chain in chains(sub):
        command = chain[0].endswith("command")
        height = (0.4 if command else 0.02 if len(chain) > 1 else 0.1) * declared[chain[0]].nominal
        for order, name in enumerate(chain):
            angle = TURN * time + order * np.pi / 2
            wave = np.sin(angle) if command else float(order == 0) - np.cos(angle)
            signals[name] = (start[name] if order == 0 else 0.0) + height * TURN**order * wave
    return signals


def rows(signals: Mapping[str, Array]) -> Sequence[dict[str, float]]:
    """The samples in the order of time."""
    names, columns = list(signals), np.array(list(signals.values())).T
    return [dict(zip(names, row.tolist(), strict=True)) for row in columns]
