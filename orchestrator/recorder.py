"""Recording a run: one row of values per communication point, in memory laid out beforehand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.network import Network
from orchestrator.system import Outlet, Port
from orchestrator.trace import Trace


class Recorder:
    """Collects all outputs and fed inputs of a network, or the chosen ports."""

    def __init__(self, network: Network, rows: int, chosen: Sequence[Port] | None = None) -> None:
        self._network = network
        self.time = np.zeros(rows)
        self._rows = 0
        index = [*network.real.index, *network.whole.index]
        self._ports = list(chosen) if chosen is not None else _ordered(network, index)
        ports = self._ports if chosen is not None else index  # all: as they stand in the banks
        self._real = [p for p in ports if p in network.real.index]
        self._whole = [p for p in ports if p in network.whole.index]
        self._real_places = network.real.places(self._real) if chosen is not None else slice(None)
        self._whole_places = network.whole.places(self._whole)
        self._reals = np.zeros((rows, len(self._real)))
        self._wholes = np.zeros((rows, len(self._whole)), dtype=np.int32)

    def add(self, t: float) -> None:
        """Record the values at time t [s]."""
        row = self._rows
        self.time[row] = t
        self._reals[row] = self._network.real.values[self._real_places]
        if self._whole:
            self._wholes[row] = self._network.whole.values[self._whole_places]
        self._rows = row + 1

    def check(self, since: int) -> int:
        """Refuse NaN and infinity in rows from `since` on; returns the number of rows."""
        if not np.isfinite(self._reals[since : self._rows]).all():
            row, column = np.argwhere(~np.isfinite(self._reals[since : self._rows]))[0]
            value, t = self._reals[since + row, column], self.time[since + row]
            raise Problem(f"{self._real[column]}: expected a finite value, got {value} at t = {t:.9g} s")
        return self._rows

    def trace(self, outlets: Sequence[Outlet] = ()) -> Trace:
        """What was recorded so far, together with the outputs of the whole system."""
        n = self._rows
        columns: dict[Port, NDArray[np.float64]] = {}
        columns |= {p: self._reals[:n, i].copy() for i, p in enumerate(self._real)}
        columns |= {p: self._wholes[:n, i].astype(np.float64) for i, p in enumerate(self._whole)}
        signals = {str(p): columns[p] for p in self._ports}
        units = {str(p): u.name for p in self._ports if (u := self._network.system.variable(p).unit)}
        for outlet in outlets:
            if outlet.source in columns:
                signals[outlet.name] = outlet.map.factor * columns[outlet.source] + outlet.map.offset
                units |= {outlet.name: outlet.unit.name} if outlet.unit else {}
        return Trace(self.time[:n].copy(), signals, units)


def _ordered(network: Network, ports: list[Port]) -> list[Port]:
    """Ports by component, outputs before inputs, each in the order of declaration."""
    place = {}
    for i, component in enumerate(network.system.components.values()):
        for j, v in enumerate(component.interface.variables.values()):
            place[Port(component.name, v.name)] = (i, v.causality == "input", j)
    return sorted(ports, key=place.__getitem__)
