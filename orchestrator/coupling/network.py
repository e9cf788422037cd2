"""The running system: values of all outputs and inputs in two flat arrays, and their exchange.

All Real variables that are exchanged or recorded stand in one float64 array, all others in one int32 array.
A component's variables that are read (or set) together stand side by side, so that each get or set is one
call into the FMU on a slice. The exchange at a communication point runs through the stages of
`dependencies.output_order`: read the outputs that are known, carry them over, set the inputs they feed.

Between communication points the inputs that a master moves follow the polynomials of `signal.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from orchestrator.coupling.bank import Bank, Block, Link
from orchestrator.coupling.drive import Drive
from orchestrator.coupling.driver import Driver
from orchestrator.coupling.loop import Loop
from orchestrator.coupling.masters.plan import Plan
from orchestrator.coupling.part import Part
from orchestrator.coupling.signal import DRIVEN, NO_SLOPE, Signal
from orchestrator.slaves.slave import Call, Slave
from orchestrator.system.bonds import find_bonds
from orchestrator.system.dependencies import Order, output_order
from orchestrator.system.system import Connection, Port, System

FIRST = -1  # the stage of inputs that a scenario sets, before all others
TIED = -2  # from here on downwards: the stages of ports that algebraic loops read and set


class Network:
    """Slaves, their exchanged values, and the calls that move them.

    real, whole   banks of the Real values and of all others (Integer, Enumeration, Boolean)
    parts         the components in the order of the system
    loops, tied   what may be algebraic loops; those of them that are
    signals       inputs that move inside a step
    used          shape (2, real values): what moving inputs were at both ends of the step, else NaN
    moving        the inputs of the signals
    carried       inputs that the FMUs move by themselves, from a rate input or as one
    lengths       of the two steps before, the last one first [s]; 0 at the start
    bonds         of each power bond the signals of its effort and its flow, where both move
    """

    def __init__(
        self,
        system: System,
        slaves: Mapping[str, Slave],
        drive: Drive | None = None,
        probes: Iterable[Port] | None = None,
        factors: Mapping[str, int] | None = None,
    ) -> None:
        """probes: what is wanted beside what connections carry; default: all outputs, all that is exposed."""
        self.system, self.slaves, self.drive = system, slaves, drive
        self.order: Order = output_order(system)
        self.connections = [c for c in system.connections if system.variable(c.target).causality == "input"]
        self.real, self.whole = Bank(np.float64), Bank(np.int32)
        reads, writes = self._place(probes)
        self.used = np.full((2, len(self.real.values)), np.nan)
        self.parts = [Part(slave, self.used) for slave in slaves.values()]
        for name, part in zip(slaves, self.parts, strict=True):
            part.factor = (factors or {}).get(name, 1)
        self.loops = [Loop(slaves, knot) for knot, _ in self.order.knots]
        self.tied: list[Loop] = []
        self.exchange_calls = self._compile(reads, writes)
        self.driver = Driver(self, drive) if drive else None
        self.signals: list[Signal] = []
        self.moving, self.carried = set[Port](), set[Port]()
        self._driven: list[Signal] = []
        self.slopes = np.zeros(0)
        self.lengths = 0.0, 0.0
        self.bonds: list[tuple[Signal, Signal]] = []
        self._kept = self.real.values.copy(), self.whole.values.copy()

    @property
    def notes(self) -> tuple[str, ...]:
        """What to say about the exchange after a run."""
        return self.order.notes + tuple(loop.note for loop in self.loops)

    # ---- what masters call

    def exchange(self, t: float) -> None:
        """Set driven inputs to their value at t, then bring all outputs and inputs up to date."""
        for slave in self.slaves.values():
            slave.log.time = t
        if self.driver:
            self.driver.put(t)
        for call in self.exchange_calls:
            call()

    def begin(self, t: float) -> None:
        """Make everything known at the start of the run.

        The slope of an output may depend on those of the inputs, so they are told until all have passed.
        """
        self.exchange(t)
        self._tie()
        for _ in range(self.order.count + 1):
            self.tell()
            for s in self.signals:
                s.begin(*self._source(s))
            for part in self.parts:
                part.give(0.0, 0.0, False)

    def ahead(self, t: float, h: float) -> None:
        """Look up what driven inputs will be in the step from t to t + h."""
        if self.driver:
            self.driver.look_ahead(t, h)
            for s, middle, value in zip(self._driven, self.driver.middle, self.driver.coming, strict=True):
                s.drive(float(middle), float(value), h)

    def arrive(self, h: float, maker: int) -> None:
        """Note what the sources of one component are at the end of the step, after `Part.read`."""
        for s in self.signals:
            if s.maker == maker and not s.tied:
                s.arrive(*self._source(s), h, self.lengths)

    def _tie(self) -> None:
        """Mark what is in an algebraic loop; slopes told there depend on each other, and are not used."""
        self.tied = [loop for loop in self.loops if loop.circular]
        ends = {self.real.index[p] for loop in self.tied for p in loop.outputs}
        for s in self.signals:
            if s.source in ends:
                s.tied, s.slope = True, NO_SLOPE

    def untie(self, h: float) -> None:
        """Solve the algebraic loops at the end of a step that may be computed again."""
        for loop in self.tied:
            loop()
        for s in self.signals:
            if s.tied:
                s.arrive(*self._source(s), h, self.lengths)

    def tell(self) -> None:
        """Read the slopes of all outputs that move an input."""
        for part in self.parts:
            if part.tell:
                part.tell()

    def settle(self, t: float, h: float) -> None:
        """End the step from t to t + h, for which all components have stepped."""
        self.exchange(t + h)
        self.tell()
        for s in self.signals:
            if s.maker != DRIVEN:
                s.arrive(*self._source(s), h, self.lengths)

    def accept(self, h: float) -> None:
        """The end of the step is the beginning of the next one."""
        for s in self.signals:
            s.accept(h, self.length)
        self.lengths = h, self.length

    def keep(self) -> None:
        """Remember the beginning of a step, to be able to repeat it."""
        self._kept[0][:], self._kept[1][:] = self.real.values, self.whole.values
        for part in self.parts:
            if part.kept:
                part.keep()

    def restore(self, t: float) -> None:
        """Go back to the beginning of the step, t."""
        self.real.values[:], self.whole.values[:] = self._kept
        for part in self.parts:
            if part.kept:
                part.restore()
        self.exchange(t)  # for FMUs whose inputs are not part of their state

    def forget(self) -> None:
        """Free what was kept."""
        for part in self.parts:
            part.forget()

    @property
    def length(self) -> float:
        """Length of the step before [s]."""
        return self.lengths[0]

    def _source(self, s: Signal) -> tuple[float, float]:
        """Value and slope of a source now, in the input's unit."""
        if s.maker == DRIVEN:
            return float(self.real.values[s.target]), 0.0
        value = float(self.real.values[s.source]) * s.factor + s.offset
        return value, 0.0 if s.slope == NO_SLOPE else float(self.slopes[s.slope]) * s.factor

    # ---- building: what moves inside a step

    def move(self, plan: Plan) -> None:
        """Let inputs move as planned; called once, before the run."""
        known = self.system.connections if plan.watches else plan.moved
        found = [c for c in known if self._continuous(c.target) and self._continuous(c.source)]
        found = [c for c in found if self.system.variable(c.target).causality == "input"]
        found = [c for c in found if self._matters(c.target)]
        moved = {c.target for c in plan.moved}
        self.carried = self._carried({c.target for c in found})
        wired = {c.target: c for c in found if c.target not in self.carried}
        driven = self.driver.moving if self.driver else []
        asked = [c.source for c in wired.values() if plan.asks(c.source.component)]
        held = {p for p in (*wired, *driven) if not self.slaves[p.component].follows(p.variable, 1)}
        told = self._read_slopes(p for p in asked if not self._blind(p, held))
        for name, part in zip(self.slaves, self.parts, strict=True):
            ports = [p for p in [*wired, *driven] if p.component == name]
            mine = [self._signal(p, wired.get(p), plan, p in moved, told) for p in ports]
            part.follow([p.variable for p in ports], mine, plan.corrected)
            self.signals += mine
        self.moving = {*wired} & moved | {*driven}
        by_target = {s.target: s for s in self.signals}
        self._driven = [by_target[self.real.index[p]] for p in driven]
        pairs = [(self.real.index[b.effort], self.real.index[b.flow]) for b in find_bonds(self.system)]
        self.bonds = [(by_target[e], by_target[f]) for e, f in pairs if e in by_target and f in by_target]

    def _blind(self, output: Port, held: set[Port]) -> bool:
        """Would its FMU tell a slope without that of an input, because it takes none?"""
        depends = self.slaves[output.component].interface.depends(output.variable)
        return any(Port(output.component, u) in held for u in depends)

    def _continuous(self, port: Port) -> bool:
        return self.system.variable(port).is_continuous

    def _carried(self, moved: set[Port]) -> set[Port]:
        """Inputs that move by themselves, with a rate input, or that merely are the rate of a moved one."""
        fed = {c.target for c in self.connections}
        power = {p for bond in find_bonds(self.system) for p in (bond.effort, bond.flow)}
        carried = set[Port]()
        for name, slave in self.slaves.items():
            for u, rate in slave.interface.rates.items():
                port, speed = Port(name, u), Port(name, rate)
                if u not in slave.interface.sloped and speed in fed:
                    carried.add(port)
                if port in moved and port not in carried and speed not in power:
                    carried.add(speed)
        return carried

    def _signal(
        self, port: Port, wire: Connection | None, plan: Plan, moved: bool, told: Mapping[Port, int]
    ) -> Signal:
        """An input that moves; without `moved` one that is only watched."""
        slave, target = self.slaves[port.component], self.real.index[port]
        scale = abs(self.system.variable(port).nominal or 1.0)  # 1 if not declared, by the standard
        if wire is None:
            return Signal(target, -1, 1.0, 0.0, DRIVEN, NO_SLOPE, slave.follows(port.variable, 1), 1, scale=scale)
        rate = Port(port.component, slave.interface.rates.get(port.variable, ""))
        rated = any(c.target == rate for c in self.connections)
        wanted = max(plan.order, plan.degree, int(plan.corrected)) if moved else 0
        return Signal(
            target=target,
            source=self.real.index[wire.source],
            factor=wire.map.factor,
            offset=wire.map.offset,
            maker=list(self.slaves).index(wire.source.component),
            slope=told.get(wire.source, NO_SLOPE),
            degree=slave.follows(port.variable, wanted),
            wanted=wanted,
            order=plan.order if moved else min(1, plan.order + rated),
            free=not self.system.components[wire.source.component].interface.of("input"),
            scale=scale,
        )

    def _matters(self, port: Port) -> bool:
        """Does anything that others use depend on this input?"""
        face = self.slaves[port.component].interface
        return port.variable not in face.inert and face.matters(port.variable, self._sources(port.component))

    def _sources(self, component: str) -> set[str]:
        """Outputs of a component that feed others."""
        return {c.source.variable for c in self.connections if c.source.component == component}

    def _read_slopes(self, sources: Iterable[Port]) -> dict[Port, int]:
        """Arrange for the slopes of outputs to be read; returns their places among `slopes`."""
        wanted = dict.fromkeys(sources)
        able = []
        for name, slave in self.slaves.items():
            mine = [p for p in wanted if p.component == name]
            told = set(slave.tells([p.variable for p in mine]) if mine else ())
            able += [p for p in mine if p.variable in told]
        self.slopes = np.zeros(len(able))
        for name, part in zip(self.slaves, self.parts, strict=True):
            rows = [i for i, p in enumerate(able) if p.component == name]
            if rows:
                into = self.slopes[rows[0] : rows[-1] + 1]
                part.tell = part.slave.slope_reader([able[i].variable for i in rows], into)
        return {p: i for i, p in enumerate(able)}

    # ---- building: the exchange

    def bank(self, port: Port) -> Bank:
        """The bank that holds this port's value."""
        return self.real if self.system.variable(port).is_real else self.whole

    def _place(self, probes: Iterable[Port] | None) -> tuple[list[tuple[Bank, Block]], list[tuple[Bank, Block]]]:
        """Give every output, probe and fed input its place; returns the blocks to read and to set."""
        last = max(self.order.count - 1, 0)
        wanted = set(self.order.stages if probes is None else probes) | {c.source for c in self.connections}
        outputs = {p: s for p, s in self.order.stages.items() if p in wanted and self._numeric(p)}
        inputs = {c.target: self.order.stages[c.source] for c in self.connections}
        for i, (knot, _) in enumerate(self.order.knots):  # in blocks of their own, which no stage touches
            outputs |= {c.source: (TIED - i,) for c in knot.connections}
            inputs |= {c.target: (TIED - i,) for c in knot.connections}
        inputs |= {p: (FIRST,) for p in (self.drive.columns if self.drive else ())}
        more = self.system.exposed if probes is None else probes
        outputs |= {p: (last,) for p in more if p not in outputs and p not in inputs}
        reads, writes = [], []
        for bank in (self.real, self.whole):
            reads += [(bank, b) for b in bank.add(self.system, self._of(bank, outputs))]
            writes += [(bank, b) for b in bank.add(self.system, self._of(bank, inputs))]
        return reads, writes

    def _numeric(self, port: Port) -> bool:
        return self.system.variable(port).kind != "String"

    def _of(self, bank: Bank, stages: Mapping[Port, tuple[int, ...]]) -> dict[Port, tuple[int, ...]]:
        return {p: s for p, s in stages.items() if self.bank(p) is bank}

    def _compile(self, reads: list[tuple[Bank, Block]], writes: list[tuple[Bank, Block]]) -> list[Call]:
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
