"""Where the values of a system stand, and the calls that exchange them at a communication point.

All Real variables that are exchanged or recorded stand in one float64 array, all others in one int32 array.
A component's variables that are read (or set) together stand side by side, so that each get or set is one
call into the FMU on a slice. The exchange at a communication point runs through the stages of
`dependencies.output_order`: read the outputs that are known, carry them over, set the inputs they feed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import numpy as np

from orchestrator.coupling.bank import Bank, Block, Link
from orchestrator.coupling.loop import Loop
from orchestrator.slaves.slave import Call, Slave
from orchestrator.system.dependencies import Order, output_order
from orchestrator.system.system import Port, System

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
