"""The running system: values of all outputs and inputs in two flat arrays, and their exchange.

All Real variables that are exchanged or recorded stand in one float64 array, all others in one int32 array.
A component's variables that are read (or set) together stand side by side, so that each get or set is one
call into the FMU on a slice. The exchange at a communication point runs through the stages of
`dependencies.output_order`: read the outputs that are known, carry them over, set the inputs they feed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.coupling.drive import Drive
from orchestrator.slaves.slave import Buffer, Call, Slave, access
from orchestrator.system.dependencies import Order, output_order
from orchestrator.system.system import Connection, Port, System


@dataclass(frozen=True)
class Block:
    """Variables of one component and one kind that are read or set in the same stages; a slice of a bank."""

    component: str
    kind: str
    stages: tuple[int, ...]
    ports: tuple[Port, ...]
    first: int


DRIVEN = -1  # the stage of inputs that a scenario sets, before all others


class Bank:
    """One array of values and where each port stands in it."""

    def __init__(self, dtype: Any) -> None:
        self.blocks: list[Block] = []
        self.index: dict[Port, int] = {}
        self.values: Buffer = np.zeros(0, dtype)

    def add(self, system: System, stages: Mapping[Port, tuple[int, ...]]) -> list[Block]:
        """Append ports, grouped into blocks."""
        groups: dict[tuple[str, str, tuple[int, ...]], list[Port]] = {}
        for port, when in stages.items():
            groups.setdefault((port.component, access(system.variable(port)), when), []).append(port)
        added = []
        for (component, kind, when), ports in groups.items():
            added.append(Block(component, kind, when, tuple(ports), len(self.index)))
            self.index.update({port: len(self.index) + i for i, port in enumerate(ports)})
        self.blocks += added
        self.values = np.zeros(len(self.index), self.values.dtype)
        return added

    def slice(self, block: Block) -> Buffer:
        """The values of one block, as a view."""
        return self.values[block.first : block.first + len(block.ports)]

    def places(self, ports: Iterable[Port]) -> NDArray[np.intp]:
        """Positions of ports in `values`."""
        return np.array([self.index[p] for p in ports], dtype=np.intp)


class Link:
    """Connections as index arrays into a bank."""

    def __init__(self, bank: Bank, connections: Sequence[Connection]) -> None:
        self.source = bank.places(c.source for c in connections)
        self.target = bank.places(c.target for c in connections)
        self._bank = bank.values
        self._factor = np.array([c.map.factor for c in connections]).astype(bank.values.dtype)
        self._offset = np.array([c.map.offset for c in connections]).astype(bank.values.dtype)
        self._plain = bool(np.all(self._factor == 1) and np.all(self._offset == 0))

    def arriving(self) -> Buffer:
        """What the targets should receive now, shape (n,)."""
        values = self._bank[self.source]
        return values if self._plain else values * self._factor + self._offset

    def carry(self) -> None:
        """Copy the sources to the targets."""
        self._bank[self.target] = self.arriving()


class Network:
    """Slaves, their exchanged values, and the calls that move them.

    real, whole   banks of the Real values and of all others (Integer, Enumeration, Boolean)
    slopes        slope [1/s] that the master gave to each Real input for the current step, NaN where it gave
                  none; aligned with real.values
    """

    def __init__(
        self,
        system: System,
        slaves: Mapping[str, Slave],
        drive: Drive | None = None,
        probes: Iterable[Port] = (),
    ) -> None:
        self.system, self.slaves, self.drive = system, slaves, drive
        self.order: Order = output_order(system)
        self.connections = [c for c in system.connections if system.variable(c.target).causality == "input"]
        self.real, self.whole = Bank(np.float64), Bank(np.int32)
        reads, writes = self._place(probes)
        self.slopes = np.full(len(self.real.values), np.nan)
        self._exchange = self._compile(reads, writes)
        self._driver = Driver(self, drive) if drive else None
        self._stepped: list[Callable[[float], None]] = []
        self._settled: list[Call] = []

    # ---- what masters call

    def tilt(self, t: float, h: float) -> None:
        """Give driven inputs their slope over the coming step, where the FMU can use it."""
        if self._driver:
            self._driver.tilt(t, h)

    def exchange(self, t: float) -> None:
        """Set driven inputs to their value at t, then bring all outputs and inputs up to date."""
        if self._driver:
            self._driver.put(t)
        for call in self._exchange:
            call()

    def settle(self, t: float, h: float) -> None:
        """End the step from t to t + h, for which all components have stepped."""
        for stepped in self._stepped:
            stepped(h)
        self.exchange(t + h)
        for settled in self._settled:
            settled()

    def watch(self, stepped: Callable[[float], None], settled: Call) -> None:
        """After each step call `stepped(h)` before the inputs change, and `settled()` after."""
        self._stepped.append(stepped)
        self._settled.append(settled)

    def read_again(self, component: str) -> list[Call]:
        """Calls that read all connected outputs of a component, for masters that step one by one."""
        sources = {c.source for c in self.connections}
        blocks = [(bank, b) for bank in (self.real, self.whole) for b in bank.blocks]
        return [
            self.reader(bank, b) for bank, b in blocks if b.component == component and sources & set(b.ports)
        ]

    # ---- building

    def bank(self, port: Port) -> Bank:
        """The bank that holds this port's value."""
        return self.real if self.system.variable(port).is_real else self.whole

    def _place(self, probes: Iterable[Port]) -> tuple[list[tuple[Bank, Block]], list[tuple[Bank, Block]]]:
        """Give every output, probe and fed input its place; returns the blocks to read and to set."""
        last = max(self.order.count - 1, 0)
        outputs = {p: s for p, s in self.order.stages.items() if self.system.variable(p).kind != "String"}
        inputs = {c.target: self.order.stages[c.source] for c in self.connections}
        inputs |= {p: (DRIVEN,) for p in (self.drive.columns if self.drive else ())}
        outputs |= {p: (last,) for p in probes if p not in outputs and p not in inputs}
        reads, writes = [], []
        for bank in (self.real, self.whole):
            reads += [(bank, b) for b in bank.add(self.system, self._of(bank, outputs))]
            writes += [(bank, b) for b in bank.add(self.system, self._of(bank, inputs))]
        return reads, writes

    def _of(self, bank: Bank, stages: Mapping[Port, tuple[int, ...]]) -> dict[Port, tuple[int, ...]]:
        return {p: s for p, s in stages.items() if self.bank(p) is bank}

    def _compile(self, reads: list[tuple[Bank, Block]], writes: list[tuple[Bank, Block]]) -> list[Call]:
        """All calls of one exchange, in order."""
        calls: list[Call] = []
        for stage in range(max(self.order.count, 1)):
            calls += [self.reader(bank, b) for bank, b in reads if stage in b.stages]
            for bank in (self.real, self.whole):
                links = [c for c in self.connections if stage in self.order.stages[c.source]]
                links = [c for c in links if self.bank(c.source) is bank]
                calls += [Link(bank, links).carry] if links else []
            calls += [self.writer(bank, b) for bank, b in writes if stage in b.stages]
        return calls

    def reader(self, bank: Bank, block: Block) -> Call:
        """The bound call that reads a block."""
        names = [p.variable for p in block.ports]
        return self.slaves[block.component].reader(names, bank.slice(block))

    def writer(self, bank: Bank, block: Block) -> Call:
        """The bound call that sets a block."""
        names = [p.variable for p in block.ports]
        return self.slaves[block.component].writer(names, bank.slice(block))


class Driver:
    """The scenario bound to the inputs it drives."""

    def __init__(self, network: Network, drive: Drive) -> None:
        self._table = drive.table
        self._writers = [
            network.writer(bank, b)
            for bank in (network.real, network.whole)
            for b in bank.blocks
            if DRIVEN in b.stages
        ]
        ports = [p for p in drive.columns if network.system.variable(p).is_real]
        others = [p for p in drive.columns if p not in ports]
        self._real, self._whole = network.real.values, network.whole.values
        self._targets, self._held = network.real.places(ports), network.whole.places(others)
        self._columns = np.array([drive.columns[p][0] for p in ports], dtype=np.intp)
        self._held_columns = np.array([drive.columns[p][0] for p in others], dtype=np.intp)
        self._factor = np.array([drive.columns[p][1].factor for p in ports])
        self._offset = np.array([drive.columns[p][1].offset for p in ports])
        self._tilts = self._slope_writers(network, ports)
        self._ahead: tuple[float | None, NDArray[np.float64]] = (None, np.zeros(0))  # for when, the values

    def _slope_writers(
        self, network: Network, ports: list[Port]
    ) -> list[tuple[NDArray[np.intp], Buffer, Call]]:
        """Per interpolating component: positions among `ports`, buffer of slopes, call."""
        found = []
        for name, slave in network.slaves.items():
            sloped = slave.interface.sloped
            mine = [i for i, p in enumerate(ports) if p.component == name and p.variable in sloped]
            if mine:
                buffer = np.zeros(len(mine))
                call = slave.slope_writer([ports[i].variable for i in mine], buffer)
                found.append((np.array(mine, dtype=np.intp), buffer, call))
        return found

    def _at(self, t: float) -> NDArray[np.float64]:
        """Values of the driven Real inputs at t."""
        values: NDArray[np.float64] = self._table.at(t)[self._columns] * self._factor + self._offset
        return values

    def put(self, t: float) -> None:
        """Set the driven inputs to their value at t."""
        when, values = self._ahead
        self._real[self._targets] = values if when == t else self._at(t)
        if len(self._held):
            self._whole[self._held] = np.rint(self._table.sample(t)[self._held_columns])
        for write in self._writers:
            write()

    def tilt(self, t: float, h: float) -> None:
        """Give the slopes over [t, t + h] to the FMUs that use them."""
        if self._tilts:
            ahead = self._at(t + h)
            self._ahead = (t + h, ahead)
            slopes = (ahead - self._real[self._targets]) / h
            for mine, buffer, write in self._tilts:
                buffer[:] = slopes[mine]
                write()
