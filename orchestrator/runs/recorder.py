"""Recording a run: one row of values per recorded point, in memory laid out beforehand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from orchestrator.coupling.grid import Grid
from orchestrator.coupling.network import Network
from orchestrator.errors import Problem
from orchestrator.files.trace import Trace
from orchestrator.system.system import Outlet, Port

BLOCK = 256  # points between two calls of `settle`, at most


class _Fresh:
    """Room for the points of one block: `time` [s] of shape (n,), real and whole numbers (n, signals)."""

    def __init__(self, reals: int, wholes: int) -> None:
        self.time = np.zeros(BLOCK)
        self.reals = np.zeros((BLOCK, reals))
        self.wholes = np.zeros((BLOCK, wholes), dtype=np.int32)


class _Kept:
    """All points that are kept, each signal in one piece: numbers of shape (signals, n)."""

    def __init__(self, rows: int, reals: int, wholes: int) -> None:
        self.time = np.zeros(rows)
        self.reals = np.zeros((reals, rows))
        self.wholes = np.zeros((wholes, rows), dtype=np.int32)

    def take(self, first: int, fresh: _Fresh, rows: NDArray[np.intp]) -> None:
        """Copy fresh rows to the places from `first` on; makes room if there is none."""
        last = first + len(rows)
        if last > len(self.time):
            self._grow(2 * last)
        self.time[first:last] = fresh.time[rows]
        self.reals[:, first:last] = fresh.reals[rows].T
        self.wholes[:, first:last] = fresh.wholes[rows].T

    def _grow(self, rows: int) -> None:
        larger = _room(rows, len(self.reals), len(self.wholes))
        n = len(self.time)
        larger.time[:n], larger.reals[:, :n], larger.wholes[:, :n] = self.time, self.reals, self.wholes
        self.time, self.reals, self.wholes = larger.time, larger.reals, larger.wholes


class Recorder:
    """Collects everything that has a place in a network, or the chosen ports.

    Looks at every communication point; keeps those that the grid records, and always the latest one.

    fresh    the points since the last call of `settle`, `filled` of them
    places   of the recorded Real values in the bank; None for all
    """

    def __init__(self, network: Network, times: Grid, chosen: Sequence[Port] | None = None) -> None:
        self._network, self._every = network, times.every
        index = [*network.real.index, *network.whole.index]
        self._ports = list(chosen) if chosen is not None else _ordered(network, index)
        ports = self._ports if chosen is not None else index  # all: as they stand in the banks
        self._real = [p for p in ports if p in network.real.index]
        self._whole = [p for p in ports if p in network.whole.index]
        self.places = network.real.places(self._real) if chosen is not None else None
        self.whole_places = network.whole.places(self._whole)
        self.fresh = _Fresh(len(self._real), len(self._whole))
        self._kept = _room(times.rows + 1, len(self._real), len(self._whole))
        self.filled = self._rows = self.points = 0

    def add(self, t: float) -> None:
        """Note the values at time t [s]."""
        row, fresh, values = self.filled, self.fresh, self._network.real.values
        fresh.time[row] = t
        fresh.reals[row] = values if self.places is None else values[self.places]
        if self._whole:
            fresh.wholes[row] = self._network.whole.values[self.whole_places]
        self.filled = row + 1

    def settle(self) -> None:
        """Keep what is due of the points since the last call; a number that is not finite ends the record."""
        finite = np.isfinite(self.fresh.reals[: self.filled])
        if finite.all():
            return self._keep()
        row, column = np.argwhere(~finite)[0]
        self.filled = int(row)
        self._keep()
        value, t = self.fresh.reals[row, column], self.fresh.time[row]
        raise Problem(f"{self._real[column]}: expected a finite value, got {value} at t = {t:.9g} s")

    def _keep(self) -> None:
        """The due points; below them stands the latest one until the next is due."""
        n = self.filled
        if n == 0:
            return
        due = np.arange(-self.points % self._every, n, self._every)
        self._kept.take(self._rows, self.fresh, np.append(due, n - 1))
        self._rows, self.points, self.filled = self._rows + len(due), self.points + n, 0

    def trace(self, outlets: Sequence[Outlet] = ()) -> Trace:
        """What was recorded so far, together with the outputs of the whole system."""
        self._keep()
        n = self._rows + (self.points > 0 and (self.points - 1) % self._every > 0)
        columns: dict[Port, NDArray[np.float64]] = {}
        columns |= {p: self._kept.reals[i, :n] for i, p in enumerate(self._real)}
        columns |= {p: self._kept.wholes[i, :n].astype(np.float64) for i, p in enumerate(self._whole)}
        signals = {str(p): columns[p] for p in self._ports}
        units = {str(p): u.name for p in self._ports if (u := self._network.system.variable(p).unit)}
        for outlet in outlets:
            if outlet.source in columns:
                signals[outlet.name] = outlet.map.factor * columns[outlet.source] + outlet.map.offset
                units |= {outlet.name: outlet.unit.name} if outlet.unit else {}
        return Trace(self._kept.time[:n], signals, units)


def _room(rows: int, reals: int, wholes: int) -> _Kept:
    """Room for all points to keep."""
    try:
        return _Kept(rows, reals, wholes)
    except (MemoryError, ValueError):  # ValueError: NumPy has no index for so many
        many = f"{rows:.3g} points of {reals + wholes} signals"
        raise Problem(f"{many} do not fit into memory; choose a longer record step or stop earlier") from None


def _ordered(network: Network, ports: list[Port]) -> list[Port]:
    """Ports by component, outputs before inputs, each in the order of declaration."""
    place = {}
    for i, component in enumerate(network.system.components.values()):
        for j, v in enumerate(component.interface.variables.values()):
            place[Port(component.name, v.name)] = (i, v.causality == "input", j)
    return sorted(ports, key=place.__getitem__)
