"""Recording a run: one row of values per recorded point, in memory laid out beforehand.

The energy that the coupling of a power bond makes up or loses during a run.

Component X receives the effort e and sends the flow f; component Y receives f and sends e. Over a step each
of them works with the input it was given, not with the true one, so the power that Y delivers and the power
that X takes differ:

    residual power = e_true f_used - e_used f_true            [W]

Its integral over the run is the energy that the coupling made up (+) or lost (-), summed step by step with
the trapezoidal rule. `used` at the end of a step is read back from the FMUs (or follows from the slope that
the master gave), so inputs that an FMU moves by itself inside the step are judged as what they were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace
from orchestrator.engine.network import Network
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.calls import Call, access
from orchestrator.ssp.power_bonds import Bond
from orchestrator.ssp.system import Outlet, Port

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


ROWS = 1024  # steps between two summations


@dataclass(frozen=True)
class BondEnergy:
    """Energies of one bond over a run [J].

    residual    what the coupling made up; errors of opposite sign cancel
    turnover    the same without cancelling: the sum of its magnitude over the steps
    exchanged   integral of the magnitude of the power
    """

    name: str
    residual: float
    turnover: float
    exchanged: float

    @property
    def relative(self) -> float:
        """Residual over exchanged energy."""
        return self.residual / self.exchanged if self.exchanged > 0 else 0.0


class Monitor:
    """Watches the bonds of a network during a run; `energies` gives the sums so far.

    readers   calls that read back the bond inputs that the master does not move into `seen`
    """

    def __init__(self, network: Network, bonds: list[Bond]) -> None:
        ports = [p for b in bonds for p in (b.effort, b.flow)]
        self._bonds, self._values, self._used = bonds, network.real.values, network.used
        self.places = network.real.places(ports)
        self.moved = np.array([p in network.moving for p in ports], dtype=bool)
        back = sorted((p for p in ports if p not in network.moving), key=lambda p: _group(network, p))
        self.seen = np.zeros(len(back))
        self.spread = np.array([back.index(p) if p in back else -1 for p in ports], dtype=np.intp)
        self.readers = _readers(network, back, self.seen)
        self.step = np.zeros(ROWS)
        self.first, self.last, self.true = (np.zeros((ROWS, len(ports))) for _ in range(3))
        self._before = np.zeros(len(ports))
        self.rows = 0
        self._sums = np.zeros((3, len(bonds)))

    def begin(self) -> None:
        """Note the true values at the start of the run."""
        self._before = self._values[self.places]

    def stepped(self, h: float) -> None:
        """After a step of length h, before new inputs are set: note what the FMUs worked with."""
        if not self._bonds:
            return
        for read in self.readers:
            read()
        row = self.rows
        self.step[row] = h
        self.first[row] = np.where(self.moved, self._used[0, self.places], self._values[self.places])
        back = self.seen[self.spread] if len(self.seen) else 0.0
        self.last[row] = np.where(self.moved, self._used[1, self.places], back)

    def settled(self) -> None:
        """After new inputs are set: note what would have been true."""
        if not self._bonds:
            return
        self.true[self.rows] = self._values[self.places]
        self.rows += 1

    @property
    def full(self) -> bool:
        """The steps have to be added up before there is room for another one."""
        return self.rows == ROWS

    def sum(self) -> None:
        """Add up the steps since the last time."""
        n, self.rows = self.rows, 0
        end = self.true[:n]
        start = np.concatenate([self._before[None], end])[:n]
        self._before = end[-1].copy() if n else self._before
        h = 0.5 * self.step[:n, None]
        made = h * (_residual(start, self.first[:n]) + _residual(end, self.last[:n]))
        power = np.abs(start[:, 0::2] * start[:, 1::2]) + np.abs(end[:, 0::2] * end[:, 1::2])
        self._sums += np.array([made.sum(axis=0), np.abs(made).sum(axis=0), (h * power).sum(axis=0)])

    def energies(self) -> list[BondEnergy]:
        """The energies of all bonds up to now."""
        self.sum()
        return [BondEnergy(b.name, *(b.scale * self._sums[:, i])) for i, b in enumerate(self._bonds)]


def _group(network: Network, port: Port) -> tuple[str, str]:
    return port.component, access(network.system.variable(port))


def _readers(network: Network, ports: list[Port], into: NDArray[np.float64]) -> list[Call]:
    """One call per component and type; `ports` are sorted by them."""
    calls, first = [], 0
    for (component, _), group in groupby(ports, key=lambda p: _group(network, p)):
        names = [p.variable for p in group]
        calls.append(network.slaves[component].reader(names, into[first : first + len(names)]))
        first += len(names)
    return calls


def _residual(true: NDArray[np.float64], used: NDArray[np.float64]) -> NDArray[np.float64]:
    """Residual power, shape (steps, bonds), from columns that alternate effort and flow."""
    return true[:, 0::2] * used[:, 1::2] - used[:, 0::2] * true[:, 1::2]
