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

from collections.abc import Collection, Mapping, Sequence
from itertools import compress, groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.text import first_names
from orchestrator.base.units import IDENTITY
from orchestrator.data.trace_writer import Points, RowLayout, TraceSink
from orchestrator.engine.c_library import Binding
from orchestrator.engine.network import Network
from orchestrator.engine.result import BondEnergy
from orchestrator.engine.time_grid import Grid
from orchestrator.fmi.calls import Call, calls_by_type
from orchestrator.fmi.description import WHOLE, Value
from orchestrator.ssp.power_bonds import Bond
from orchestrator.ssp.system import Port

BLOCK = 256  # points between two calls of `collect`, at most
Array = NDArray[np.float64]


class PointBlock:
    """The points since the last call of `collect`, filled by C; values have the shape (points, signals)."""

    def __init__(self, layout: RowLayout, memory: Any) -> None:
        self.time = np.frombuffer(memory, np.float64, BLOCK)
        reals, integers, first = BLOCK * layout.reals, BLOCK * layout.integers, 8 * BLOCK
        self.reals = np.frombuffer(memory, np.float64, reals, first).reshape(BLOCK, layout.reals)
        flat = np.frombuffer(memory, np.int64, integers, first + 8 * reals)
        self.integers = flat.reshape(BLOCK, layout.integers)

    @staticmethod
    def size(layout: RowLayout) -> int:
        """Size of its memory [bytes]."""
        return BLOCK * (8 + 8 * (layout.reals + layout.integers))

    def points(self, rows: slice | NDArray[np.intp]) -> Points:
        """Times, Real and Integer values of some points; views of the memory for a slice."""
        return self.time[rows], self.reals[rows], self.integers[rows]

    def finite_rows(self, filled: int) -> int:
        """Number of rows before the first one with a value that is not finite."""
        finite = np.isfinite(self.reals[:filled]).all(axis=1)
        return filled if finite.all() else int(np.argmin(finite))


def recorded_rows(collected: int, filled: int, every: int) -> NDArray[np.intp]:
    """The rows of a block that are recorded; `collected`: number of points before the block."""
    return np.arange(-collected % every, filled, every)


class Recorder:
    """Passes recorded points to a sink: all signals in the arrays of a network, or selected ones.

    C writes every communication point to a block. The points of the grid are recorded, and always the latest
    one.

    layout   the recorded signals
    """

    def __init__(
        self, network: Network, times: Grid, sink: TraceSink, selected: Sequence[Port] | None = None
    ) -> None:
        self._network, self._sink = network, sink
        all_ports = [p for p in (*network.reals.index, *network.integers.index) if p.component]
        # in the order of the arrays
        ports = [p for p in all_ports if _is_applied(network, p)] if selected is None else list(selected)
        passed = network.passed if selected is None else ()
        self._reals = [p for p in (*ports, *passed) if p in network.reals.index]
        self._integers = [p for p in (*ports, *passed) if p in network.integers.index]
        self.layout = self._layout(ports if selected is not None else _ordered(network, ports), times.every)
        self.block = PointBlock(self.layout, network.binding.allocate("rows", PointBlock.size(self.layout)))
        self._between: Points | None = None  # the latest point, if it is not on the grid
        self._struct: Any = None
        self._rounded: set[Port] = set()
        sink.begin(self.layout, times.rows + 1)

    def _layout(self, ports: Sequence[Port], every: int) -> RowLayout:
        system = self._network.system
        column = {p: k for k, p in enumerate([*self._reals, *self._integers])}
        sources = {str(p): (p, IDENTITY, system.variable(p).unit) for p in ports}
        for outlet in system.outputs.values():
            if outlet.source in column:
                sources[outlet.name] = (outlet.source, outlet.map, outlet.unit)
        return RowLayout(
            names=tuple(sources),
            units={name: unit.name for name, (*_, unit) in sources.items() if unit},
            columns=np.array([column[port] for port, *_ in sources.values()], np.intp),
            scaled=[k for k, name in enumerate(sources) if name in system.outputs],
            maps=[linear for name, (_, linear, _) in sources.items() if name in system.outputs],
            reals=len(self._reals),
            integers=len(self._integers),
            every=every,
        )

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
        self._struct = binding.simulation.recorder

    def collect(self) -> None:
        """Pass on the points of the block; raises Problem at the first value that is not finite."""
        filled, n = self._struct.filled, self._pass_on()
        if n < filled:
            row = self.block.reals[n]
            column = int(np.argmin(np.isfinite(row)))
            signal, t = self._reals[column], self.block.time[n]
            raise Problem(f"{signal}: expected a finite value, got {row[column]} at t = {t:.9g} s")

    def resume(self) -> None:
        """Go on from a saved run, whose last point is the first one here."""
        self._struct.filled, every = 0, self.layout.every
        latest = (self._struct.collected - 1) % every
        self._struct.collected = latest + 1
        reals, integers = self._network.reals, self._network.integers
        row = reals.values[reals.indices(self._reals)], integers.values[integers.indices(self._integers)]
        if latest == 0:
            t = np.array([self._network.binding.simulation.t])
            self._sink.append_points(t, row[0][None], row[1][None])

    def _pass_on(self) -> int:
        """Pass on the points before the first one with a value that is not finite; returns their number."""
        n = self.block.finite_rows(self._struct.filled)
        if n:
            large = np.abs(self.block.integers[:n]).max(axis=0) > WHOLE
            self._rounded.update(compress(self._integers, large.tolist()))
            rows = recorded_rows(self._struct.collected, n, self.layout.every)
            self._sink.append_points(*self.block.points(slice(n) if len(rows) == n else rows))
            is_recorded = len(rows) and rows[-1] == n - 1
            self._between = None if is_recorded else self.block.points(np.arange(n - 1, n))
        self._struct.collected += n
        self._struct.filled = 0
        return n

    def finish(self) -> None:
        """Pass on the points that are left, and the latest one also if it is between two of the grid."""
        if self._struct:
            self._pass_on()
        if self._between:
            self._sink.append_points(*self._between)
            self._between = None

    @property
    def notes(self) -> tuple[str, ...]:
        """A note on values that the numbers of a trace cannot hold."""
        names = first_names(sorted(map(str, self._rounded)))
        return (f"{names}: whole numbers above 2^53 may be rounded where they are recorded",) if names else ()

    def end_at(self, t: float, driven: Mapping[Port, Value]) -> None:
        """Make a last point at t [s] from the values that the FMUs have now, and those of driven inputs."""
        driven = {**self._network.passed, **driven}
        values = {p: driven[p] if p in driven else self._network.slaves[p.component].get(p.variable)
                  for p in (*self._reals, *self._integers)}  # fmt: skip
        reals = np.array([[values[p] for p in self._reals]], float)
        whole = [int(values[p]) for p in self._integers]
        for port, value in zip(self._integers, whole, strict=True):
            if not -(2**63) <= value < 2**63:
                raise Problem(f"{port.variable}: expected a value in the range of int64, got {value}")
        self._between = np.array([t]), reals, np.array([whole], np.int64)


def _is_applied(network: Network, port: Port) -> bool:
    """False for a rate that follows from a scenario, and for a command that the scenario replaces.

    That is an output of a replaced source, named as an input.
    """
    system = network.system
    if port in network.rates:
        return False
    read = (outlet.source for outlet in system.outputs.values())
    if port.component not in system.driven_instead or port in read:
        return True
    others = (component.interface for name, component in system.components.items() if name != port.component)
    return all(port.variable not in (v.name for v in interface.of("input")) for interface in others)


def _ordered(network: Network, ports: list[Port]) -> list[Port]:
    """Ports by component, outputs before inputs, each in the order of declaration."""
    places = {name: (k, c.interface) for k, (name, c) in enumerate(network.system.components.items())}

    def place(port: Port) -> tuple[int, bool, int]:
        k, interface = places[port.component]
        is_input = interface.variables[port.variable].causality == "input"
        return k, is_input, interface.positions[port.variable]

    return sorted(ports, key=place)


class EnergyMonitor:
    """Energy errors of power bonds during a run; native/simulation_loop.c adds the energy of each step.

    Inputs that the master does not vary are read back from the FMUs.
    """

    def __init__(self, network: Network, varying: Collection[Port], bonds: Sequence[Bond]) -> None:
        """varying: the inputs that the master varies inside a step."""
        ports = [p for b in bonds for p in (b.effort, b.flow)]
        self._network, self.bonds = network, bonds
        self.indices = network.reals.indices(ports)
        self.varied = np.array([p in varying for p in ports], dtype=np.uint8)
        self._read = sorted((p for p in ports if p not in varying), key=lambda p: p.component)
        index = {port: i for i, port in enumerate(self._read)}
        self.read_indices = np.array([index.get(p, -1) for p in ports], dtype=np.int64)
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
            set_indices=binding.at(self.indices),
            count=len(self.indices),
            input_reads=binding.program(calls),
        )

    @property
    def energies_array(self) -> Array:
        """Residual, sum of its magnitude, exchanged energy of each bond until now [J], shape (3, bonds)."""
        return self.sums * [bond.scale for bond in self.bonds]

    def energies(self) -> list[BondEnergy]:
        """The energies of all bonds until now."""
        pairs = zip(self.bonds, self.energies_array.T, strict=True)
        return [BondEnergy(bond.name, *sums) for bond, sums in pairs]
