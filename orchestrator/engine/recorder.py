"""Recording of a run: rows of values at communication points, and the energy error of the coupling.

Component X receives the effort e and sends the flow f; component Y receives f and sends e. Over a step each
component uses the input that the master gave it, which differs from the true one. So the power that Y
delivers and the power that X receives differ:

    residual power = e_true f_used - e_used f_true            [W]

The integral of the residual power over the run is the energy error of the coupling (positive: created energy,
negative: lost energy). It is summed step by step with the trapezoidal rule. Used inputs at the end of a step
follow from the polynomial that the master gave, or are read back from the FMUs, which may vary them inside
the step.
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

BLOCK = 256  # points between two calls of `collect`, at most


class _Block:
    """The points since the last call of `collect`, filled by C; values have the shape (points, signals)."""

    def __init__(self, reals: int, integers: int) -> None:
        self.time = np.zeros(BLOCK)
        self.reals = np.zeros((BLOCK, reals))
        self.integers = np.zeros((BLOCK, integers), dtype=np.int32)


class _Record:
    """All recorded points; values have the shape (signals, points), so that each signal is contiguous."""

    def __init__(self, points: int, reals: int, integers: int) -> None:
        self.time = np.zeros(points)
        self.reals = np.zeros((reals, points))
        self.integers = np.zeros((integers, points), dtype=np.int32)

    def store(self, first: int, block: _Block, rows: NDArray[np.intp]) -> None:
        """Copy rows of a block to the points from `first` on; the arrays grow if necessary."""
        last = first + len(rows)
        if last > len(self.time):
            self._grow(2 * last)
        self.time[first:last] = block.time[rows]
        self.reals[:, first:last] = block.reals[rows].T
        self.integers[:, first:last] = block.integers[rows].T

    def _grow(self, points: int) -> None:
        larger = _allocate(points, len(self.reals), len(self.integers))
        n = len(self.time)
        larger.time[:n], larger.reals[:, :n], larger.integers[:, :n] = self.time, self.reals, self.integers
        self.time, self.reals, self.integers = larger.time, larger.reals, larger.integers


class Recorder:
    """Records all signals in the arrays of a network, or selected ones.

    C writes every communication point to a block. The points of the grid are recorded, and always the latest
    one.

    block    the points since the last call of `collect`
    points   number of communication points that were collected
    struct   `Recorder` of engine.h; `filled` is the number of points in the block
    """

    def __init__(self, network: Network, times: Grid, selected: Sequence[Port] | None = None) -> None:
        self._network, self._every = network, times.every
        all_ports = [*network.reals.index, *network.integers.index]
        self._ports = list(selected) if selected is not None else _ordered(network, all_ports)
        ports = self._ports if selected is not None else all_ports  # in the order of the arrays
        self._reals = [p for p in ports if p in network.reals.index]
        self._integers = [p for p in ports if p in network.integers.index]
        self.block = _Block(len(self._reals), len(self._integers))
        self._record = _allocate(times.rows + 1, len(self._reals), len(self._integers))
        self._rows = self.points = 0
        self.struct: Any = None

    def fill(self, binding: Binding) -> None:
        """Fill the C structure; if all Real values are recorded, C copies their whole array."""
        network, at = self._network, binding.at
        all_reals = self._reals == [*network.reals.index]
        binding.simulation.recorder = binding.h.Recorder(
            real_indices=None if all_reals else at(network.reals.indices(self._reals)),
            integer_indices=at(network.integers.indices(self._integers)),
            **binding.all_at(self.block, "time reals integers"),
            real_count=len(self._reals),
            integer_count=len(self._integers),
            capacity=BLOCK,
        )
        self.struct = binding.simulation.recorder

    def collect(self) -> None:
        """Record the points of the block; raises Problem at the first value that is not finite."""
        finite = np.isfinite(self.block.reals[: self.struct.filled])
        if finite.all():
            return self._collect_finite()
        row, column = np.argwhere(~finite)[0]
        self.struct.filled = int(row)
        self._collect_finite()
        value, t = self.block.reals[row, column], self.block.time[row]
        raise Problem(f"{self._reals[column]}: expected a finite value, got {value} at t = {t:.9g} s")

    def _collect_finite(self) -> None:
        """Record the points of the grid; the row after them has the latest point, until it is overwritten."""
        n = self.struct.filled
        if n == 0:
            return
        on_grid = np.arange(-self.points % self._every, n, self._every)
        self._record.store(self._rows, self.block, np.append(on_grid, n - 1))
        self._rows, self.points, self.struct.filled = self._rows + len(on_grid), self.points + n, 0

    def trace(self, outlets: Sequence[Outlet] = ()) -> Trace:
        """The recorded signals until now, and outputs of the system."""
        self._collect_finite()
        n = self._rows + (self.points > 0 and (self.points - 1) % self._every > 0)
        columns: dict[Port, NDArray[np.float64]] = {}
        columns |= {p: self._record.reals[i, :n] for i, p in enumerate(self._reals)}
        columns |= {p: self._record.integers[i, :n].astype(np.float64) for i, p in enumerate(self._integers)}
        signals = {str(p): columns[p] for p in self._ports}
        units = {str(p): u.name for p in self._ports if (u := self._network.system.variable(p).unit)}
        for outlet in outlets:
            if outlet.source in columns:
                signals[outlet.name] = outlet.map.factor * columns[outlet.source] + outlet.map.offset
                units |= {outlet.name: outlet.unit.name} if outlet.unit else {}
        return Trace(self._record.time[:n], signals, units)


def _allocate(points: int, reals: int, integers: int) -> _Record:
    """Arrays for all points; raises Problem if the memory is too small."""
    try:
        return _Record(points, reals, integers)
    except (MemoryError, ValueError):  # ValueError: NumPy has no index for so many
        size = f"{points:.3g} points of {reals + integers} signals"
        raise Problem(f"{size} do not fit into memory; choose a longer record step or stop earlier") from None


def _ordered(network: Network, ports: list[Port]) -> list[Port]:
    """Ports by component, outputs before inputs, each in the order of declaration."""
    position = {}
    for i, component in enumerate(network.system.components.values()):
        for j, v in enumerate(component.interface.variables.values()):
            position[Port(component.name, v.name)] = (i, v.causality == "input", j)
    return sorted(ports, key=position.__getitem__)


@dataclass(frozen=True)
class BondEnergy:
    """Energies of one bond over a run [J].

    residual    energy error of the coupling; errors of opposite sign cancel
    turnover    sum of the magnitudes of the energy errors of all steps
    exchanged   integral of the magnitude of the power
    """

    name: str
    residual: float
    turnover: float
    exchanged: float

    @property
    def relative(self) -> float:
        """Residual over exchanged energy; 0 if none is exchanged."""
        return self.residual / self.exchanged if self.exchanged > 0 else 0.0


class EnergyMonitor:
    """Energy errors of power bonds during a run; native/simulation_loop.c adds the energy of each step.

    Inputs that the master does not vary are read back from the FMUs.
    """

    def __init__(self, network: Network, varying: Collection[Port], bonds: Sequence[Bond]) -> None:
        """varying: the inputs that the master varies inside a step."""
        ports = [p for b in bonds for p in (b.effort, b.flow)]
        self._network, self._bonds = network, bonds
        self.indices = network.reals.indices(ports)
        self.varied = np.array([p in varying for p in ports], dtype=np.uint8)
        self._read = sorted((p for p in ports if p not in varying), key=lambda p: p.component)
        self.read_indices = np.array(
            [self._read.index(p) if p in self._read else -1 for p in ports], dtype=np.int64
        )
        self.read_values = np.zeros(len(self._read))
        self.start, self.used_start, self.used_end = (np.zeros(len(ports)) for _ in range(3))
        self.sums = np.zeros((3, len(bonds)))

    def fill(self, binding: Binding) -> None:
        """Fill the C structure."""
        calls, first = list[Call](), 0
        for name, group in groupby(self._read, key=lambda p: p.component):
            slave, names = self._network.slaves[name], [p.variable for p in group]
            values = self.read_values[first : first + len(names)]
            calls += calls_by_type(slave, names, values, slave.reader)
            first += len(names)
        binding.simulation.energy = binding.h.EnergyMonitor(
            **binding.all_at(self, "indices varied read_indices read_values start used_start used_end sums"),
            count=len(self.indices),
            input_reads=binding.program(calls),
        )

    def energies(self) -> list[BondEnergy]:
        """The energies of all bonds until now."""
        return [BondEnergy(b.name, *(b.scale * self.sums[:, i])) for i, b in enumerate(self._bonds)]
