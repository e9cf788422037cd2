"""What is recorded of a run: rows of values at communication points, and the energy error of the coupling.

Component X receives the effort e and sends the flow f; component Y receives f and sends e. Over a step each
of them works with the input it was given, not with the true one, so the power that Y delivers and the power
that X takes differ:

    residual power = e_true f_used - e_used f_true            [W]

Its integral over the run is the energy error of the coupling (+: energy from nowhere, -: lost energy), summed
step by step with the trapezoidal rule. `used` at the end of a step is read back from the FMUs (or follows
from the slope that the master gave), so inputs that an FMU moves by itself inside the step are judged as what
they were.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace
from orchestrator.engine.c_library import Binding
from orchestrator.engine.component import calls_by_type
from orchestrator.engine.network import Network
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.calls import Call
from orchestrator.ssp.power_bonds import Bond
from orchestrator.ssp.system import Outlet, Port

BLOCK = 256  # points between two calls of `settle`, at most


class _Block:
    """The points of one block, which C fills: `time` [s] of shape (n,), numbers of shape (n, signals)."""

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

    def take(self, first: int, fresh: _Block, rows: NDArray[np.intp]) -> None:
        """Copy rows of a block to the places from `first` on; makes room if there is none."""
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

    fresh    the points since the last call of `settle`
    made     `Recorder` of engine.h, which knows how many they are: `filled`
    """

    def __init__(self, network: Network, times: Grid, chosen: Sequence[Port] | None = None) -> None:
        self._network, self._every = network, times.every
        index = [*network.real.index, *network.whole.index]
        self._ports = list(chosen) if chosen is not None else _ordered(network, index)
        ports = self._ports if chosen is not None else index  # all: as they stand in the banks
        self._real = [p for p in ports if p in network.real.index]
        self._whole = [p for p in ports if p in network.whole.index]
        self.fresh = _Block(len(self._real), len(self._whole))
        self._kept = _room(times.rows + 1, len(self._real), len(self._whole))
        self._rows = self.points = 0
        self.made: Any = None

    def fill(self, binding: Binding) -> None:
        """Let C write the points; all Real values are recorded as they stand in the bank."""
        network, fresh, at = self._network, self.fresh, binding.at
        everything = self._real == [*network.real.index]
        binding.simulation.recorder = binding.h.Recorder(
            places=None if everything else at(network.real.places(self._real)),
            whole_places=at(network.whole.places(self._whole)),
            **binding.all_at(fresh, "time reals wholes"),
            count=len(self._real),
            whole_count=len(self._whole),
            room=BLOCK,
        )
        self.made = binding.simulation.recorder

    def settle(self) -> None:
        """Keep what is due of the points since the last call; a number that is not finite ends the record."""
        finite = np.isfinite(self.fresh.reals[: self.made.filled])
        if finite.all():
            return self._keep()
        row, column = np.argwhere(~finite)[0]
        self.made.filled = int(row)
        self._keep()
        value, t = self.fresh.reals[row, column], self.fresh.time[row]
        raise Problem(f"{self._real[column]}: expected a finite value, got {value} at t = {t:.9g} s")

    def _keep(self) -> None:
        """The due points; below them stands the latest one until the next is due."""
        n = self.made.filled
        if n == 0:
            return
        due = np.arange(-self.points % self._every, n, self._every)
        self._kept.take(self._rows, self.fresh, np.append(due, n - 1))
        self._rows, self.points, self.made.filled = self._rows + len(due), self.points + n, 0

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


@dataclass(frozen=True)
class BondEnergy:
    """Energies of one bond over a run [J].

    residual    energy error of the coupling; errors of opposite sign cancel
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


class EnergyMonitor:
    """Watches the bonds of a network during a run; native/simulation_loop.c adds the energy of each step.

    Inputs that the master does not move are read back from the FMUs.
    """

    def __init__(self, network: Network, moving: Collection[Port], bonds: Sequence[Bond]) -> None:
        """moving: the inputs that the master moves."""
        ports = [p for b in bonds for p in (b.effort, b.flow)]
        self._network, self._bonds = network, bonds
        self.places = network.real.places(ports)
        self.moved = np.array([p in moving for p in ports], dtype=np.uint8)
        self._back = sorted((p for p in ports if p not in moving), key=lambda p: p.component)
        self.spread = np.array(
            [self._back.index(p) if p in self._back else -1 for p in ports], dtype=np.int64
        )
        self.seen = np.zeros(len(self._back))
        self.start, self.first, self.last = (np.zeros(len(ports)) for _ in range(3))
        self.sums = np.zeros((3, len(bonds)))

    def fill(self, binding: Binding) -> None:
        """Give the arrays to C."""
        readers, first = list[Call](), 0
        for name, group in groupby(self._back, key=lambda p: p.component):
            slave, names = self._network.slaves[name], [p.variable for p in group]
            readers += calls_by_type(slave, names, self.seen[first : first + len(names)], slave.reader)
            first += len(names)
        binding.simulation.energy = binding.h.EnergyMonitor(
            **binding.all_at(self, "places moved spread seen start first last sums"),
            count=len(self.places),
            readers=binding.program(readers),
        )

    def energies(self) -> list[BondEnergy]:
        """The energies of all bonds up to now."""
        return [BondEnergy(b.name, *(b.scale * self.sums[:, i])) for i, b in enumerate(self._bonds)]
