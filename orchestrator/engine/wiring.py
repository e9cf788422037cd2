"""The exchanged values of a run in flat arrays, and connections as index arrays into them.

Algebraic loops: inputs that decide the outputs which feed them.

Where the values of a system stand, and the calls that exchange them at a communication point.

All Real variables that are exchanged or recorded stand in one float64 array, all others in one int32 array.
A component's variables that are read (or set) together stand side by side, so that each get or set is one
call into the FMU on a slice. The exchange at a communication point runs through the stages of
`dependencies.output_order`: read the outputs that are known, carry them over, set the inputs they feed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.engine.algebraic_loop import (
    CIRCULAR,
    EVALUATIONS,
    SINGULAR,
    SOLVED,
    SOLVES,
    WORST,
    Member,
    Newton,
    Slots,
)
from orchestrator.fmi.calls import Buffer, Call, Slave, access
from orchestrator.ssp.dependencies import Knot, Order, output_order
from orchestrator.ssp.system import Connection, Port, System


@dataclass(frozen=True)
class Block:
    """Variables of one component and one kind that are read or set in the same stages; a slice of a bank."""

    component: str
    kind: str
    stages: tuple[int, ...]
    ports: tuple[Port, ...]
    first: int


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
    """Connections as index arrays into a bank; calling it copies the sources to the targets."""

    def __init__(self, bank: Bank, connections: Sequence[Connection]) -> None:
        self.source = bank.places(c.source for c in connections)
        self.target = bank.places(c.target for c in connections)
        self.values = bank.values
        self.factor = np.array([c.map.factor for c in connections]).astype(bank.values.dtype)
        self.offset = np.array([c.map.offset for c in connections]).astype(bank.values.dtype)
        self.plain = bool(np.all(self.factor == 1) and np.all(self.offset == 0))

    def __call__(self) -> None:
        values = self.values[self.source]
        self.values[self.target] = values if self.plain else values * self.factor + self.offset


class Loop:
    """One algebraic loop; calling it solves for its inputs, starting at what they were before.

    inputs, outputs    its ports, those of one component side by side
    members            its components
    targets, sources   places of its ports among the values of a bank, see `bind`; none at first
    """

    def __init__(self, slaves: Mapping[str, Slave], knot: Knot) -> None:
        self.knot, self._slaves = knot, slaves
        wires = sorted(knot.connections, key=lambda c: self._place(c.target))
        self.inputs = [c.target for c in wires]
        self.outputs = sorted({c.source for c in wires}, key=self._place)
        u, y = np.zeros(len(self.inputs)), np.zeros(len(self.outputs))
        self.members = list(self._members(u, y))
        numbered = [(self.outputs.index(c.source), c.map.factor, c.map.offset) for c in wires]
        self.newton = Newton(u, y, self.members, numbered, np.array([self._nominal(p) for p in self.inputs]))
        self._values, self.targets, self.sources = np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._begun = False

    def _place(self, port: Port) -> tuple[int, str, str]:
        variable = self._slaves[port.component].interface.variables[port.variable]
        return list(self._slaves).index(port.component), access(variable), port.variable

    def _nominal(self, port: Port) -> float:
        return abs(self._slaves[port.component].interface.variables[port.variable].nominal or 0.0)

    def _members(self, u: Buffer, y: Buffer) -> Iterator[Member]:
        first = first_output = 0
        for name, group in groupby(self.inputs, key=lambda p: p.component):
            inputs = [p.variable for p in group]
            outputs = [p.variable for p in self.outputs if p.component == name]
            yield Member(self._slaves[name], Slots(inputs, u, first), Slots(outputs, y, first_output))
            first, first_output = first + len(inputs), first_output + len(outputs)

    def bind(self, bank: Bank) -> None:
        """Take the inputs from a bank, and put there what is found."""
        self._values = bank.values
        self.targets, self.sources = bank.places(self.inputs), bank.places(self.outputs)

    def __call__(self) -> None:
        newton, bound = self.newton, len(self.targets) > 0
        if not self._begun:
            newton.begin(self.knot.declared)
            self._begun = True
        elif bound:
            newton.u[:] = self._values[self.targets]
        self.judge(newton.solve(self.knot.sweeps))
        if bound:
            self._values[self.targets], self._values[self.sources] = newton.u, newton.y

    @property
    def circular(self) -> bool:
        """Is it a loop? One that nobody declares is seen by what outputs do, or when values do not settle."""
        return self.knot.declared or bool(self.newton.flags[CIRCULAR])

    # ---- what to say

    def judge(self, verdict: int) -> None:
        """Raise where there is no solution."""
        if verdict != SOLVED:
            t = max(self._slaves[p.component].log.time for p in self.inputs)
            raise Problem(f"{self.knot.text}: no solution at t = {t:.9g} s: {self._why(verdict)}")

    def _why(self, verdict: int) -> str:
        newton = self.newton
        for port, y in zip(self.outputs, newton.y.tolist(), strict=True):
            if not isfinite(y):
                return f"{port} is {y}"
        if verdict == SINGULAR:
            return "a change of its inputs comes back the same, so that no values or all of them fit"
        size = np.maximum(newton.seen, np.maximum(np.abs(newton.u), np.abs(newton.g)))
        worst = int(np.argmax(np.abs(newton.residual) / np.where(size > 0, size, 1.0)))
        port, u, g = self.inputs[worst], newton.u[worst], newton.g[worst]
        return f"{port} is set to {u:.6g} and would become {g:.6g}, a residual of {u - g:.3g}"

    @property
    def note(self) -> str:
        """What it is and how it was solved."""
        newton, text = self.newton, self.knot.text
        often = f"{newton.counts[EVALUATIONS] / max(int(newton.counts[SOLVES]), 1):.2g} evaluations each"
        if not self.circular:
            return f"{text}; their values are carried round until nothing changes, {often}"
        ways = {"directional derivatives" if m.trusted[0] else "differences" for m in self.members}
        how = f"solved at every communication point by Newton's method with {' and '.join(sorted(ways))}"
        return f"{text}: {how}, {often}, residual at most {newton.shares[WORST]:.0e} of the magnitude"


FIRST = -1  # the stage of inputs that a scenario sets, before all others
TIED = -2  # from here on downwards: the stages of ports that algebraic loops read and set

Blocks = list[tuple[Bank, Block]]


class Wiring:
    """Slaves, the banks of their values, and the calls of an exchange.

    real, whole      banks of the Real values and of all others (Integer, Enumeration, Boolean)
    connections      those that feed inputs
    loops            what may be algebraic loops
    exchange_calls   all calls of one exchange, in order, but for those that a scenario makes first
    """

    def __init__(
        self,
        system: System,
        slaves: Mapping[str, Slave],
        driven: Collection[Port] = (),
        probes: Iterable[Port] | None = None,
    ) -> None:
        """driven: inputs that a scenario sets.

        probes: what is wanted beside what connections carry; default: all outputs, all that is exposed.
        """
        self.system, self.slaves, self.driven = system, slaves, driven
        self.order: Order = output_order(system)
        self.connections = [c for c in system.connections if system.variable(c.target).causality == "input"]
        self.real, self.whole = Bank(np.float64), Bank(np.int32)
        reads, writes = self._place(probes)
        self.loops = [Loop(slaves, knot) for knot, _ in self.order.knots]
        self.exchange_calls = self._compile(reads, writes)

    def matters(self, port: Port) -> bool:
        """Does anything that others use depend on this input?"""
        face = self.slaves[port.component].interface
        used = {c.source.variable for c in self.connections if c.source.component == port.component}
        return port.variable not in face.inert and face.matters(port.variable, used)

    def bank(self, port: Port) -> Bank:
        """The bank that holds this port's value."""
        return self.real if self.system.variable(port).is_real else self.whole

    def reader(self, bank: Bank, block: Block) -> Call:
        """The bound call that reads a block."""
        names = [p.variable for p in block.ports]
        return self.slaves[block.component].reader(names, bank.slice(block))

    def writer(self, bank: Bank, block: Block) -> Call:
        """The bound call that sets a block."""
        names = [p.variable for p in block.ports]
        return self.slaves[block.component].writer(names, bank.slice(block))

    def read_again(self, component: str) -> list[Call]:
        """Calls that read all connected outputs of a component, for masters that step one by one."""
        sources = {c.source for c in self.connections}
        blocks = [(bank, b) for bank in (self.real, self.whole) for b in bank.blocks]
        return [
            self.reader(bank, b) for bank, b in blocks if b.component == component and sources & set(b.ports)
        ]

    # ---- building

    def _place(self, probes: Iterable[Port] | None) -> tuple[Blocks, Blocks]:
        """Give every output, probe and fed input its place; returns the blocks to read and to set."""
        last = max(self.order.count - 1, 0)
        wanted = set(self.order.stages if probes is None else probes) | {c.source for c in self.connections}
        outputs = {p: s for p, s in self.order.stages.items() if p in wanted and self._numeric(p)}
        inputs = {c.target: self.order.stages[c.source] for c in self.connections}
        for i, (knot, _) in enumerate(self.order.knots):  # in blocks of their own, which no stage touches
            outputs |= {c.source: (TIED - i,) for c in knot.connections}
            inputs |= {c.target: (TIED - i,) for c in knot.connections}
        inputs |= {p: (FIRST,) for p in self.driven}
        more = self.system.exposed if probes is None else probes
        outputs |= {p: (last,) for p in more if p not in outputs and p not in inputs}
        reads, writes = Blocks(), Blocks()
        for bank in (self.real, self.whole):
            reads += [(bank, b) for b in bank.add(self.system, self._of(bank, outputs))]
            writes += [(bank, b) for b in bank.add(self.system, self._of(bank, inputs))]
        return reads, writes

    def _numeric(self, port: Port) -> bool:
        return self.system.variable(port).kind != "String"

    def _of(self, bank: Bank, stages: Mapping[Port, tuple[int, ...]]) -> dict[Port, tuple[int, ...]]:
        return {p: s for p, s in stages.items() if self.bank(p) is bank}

    def _compile(self, reads: Blocks, writes: Blocks) -> list[Call]:
        """All calls of one exchange, in order."""
        calls: list[Call] = []
        tied = {c.target for loop in self.loops for c in loop.knot.connections}
        for loop in self.loops:
            loop.bind(self.real)
        for stage in range(max(self.order.count, 1)):
            calls += [self.reader(bank, b) for bank, b in reads if stage in b.stages]
            solved = zip(self.loops, self.order.knots, strict=True)
            calls += [loop for loop, (_, stages) in solved if stage in stages]
            for bank in (self.real, self.whole):
                links = [c for c in self.connections if stage in self.order.stages[c.source]]
                links = [c for c in links if self.bank(c.source) is bank and c.target not in tied]
                calls += [Link(bank, links)] if links else []
            calls += [self.writer(bank, b) for bank, b in writes if stage in b.stages]
        return calls
