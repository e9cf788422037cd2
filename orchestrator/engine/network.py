"""Which inputs move inside a step, and what each of them follows.

The running system: what moves between communication points, and how a step begins, ends and is undone.

Inputs that a master moves follow the polynomials of `signal.py` between communication points; `Wiring` has
the values and their exchange.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from orchestrator.engine.component import Part
from orchestrator.engine.input_signal import DRIVEN, NO_SLOPE, Signal
from orchestrator.engine.masters import Plan
from orchestrator.engine.scenario import Drive, Driver
from orchestrator.engine.wiring import Loop, Wiring
from orchestrator.fmi.calls import Slave
from orchestrator.ssp.power_bonds import find_bonds
from orchestrator.ssp.system import Connection, Port, System


class Moves:
    """What a plan moves in a wiring.

    carried   inputs that the FMUs move by themselves, from a rate input or as one
    moving    inputs that the master moves
    told      outputs whose slopes the FMUs tell, and their places; those of one component side by side
    """

    def __init__(self, wiring: Wiring, driven: Sequence[Port], plan: Plan) -> None:
        """driven: the inputs that move because a scenario does."""
        self._wiring, self._driven, self._plan = wiring, driven, plan
        self._moved = {c.target for c in plan.moved}
        found = self._found()
        self.carried = self._carried({c.target for c in found})
        self._wired = {c.target: c for c in found if c.target not in self.carried}
        self.moving = {*self._wired} & self._moved | {*driven}
        self.told = {p: i for i, p in enumerate(self._told())}

    def ports(self, component: str) -> list[Port]:
        """The inputs of a component that move or are watched."""
        return [p for p in (*self._wired, *self._driven) if p.component == component]

    def signal(self, port: Port) -> Signal:
        """One of these inputs."""
        wire = self._wired.get(port)
        return self._follows(port, wire) if wire else self._is_driven(port)

    # ---- which

    def _found(self) -> list[Connection]:
        """The connections that may move their inputs, or whose inputs are watched."""
        plan, variable = self._plan, self._wiring.system.variable
        known = self._wiring.system.connections if plan.watches else plan.moved
        found = [c for c in known if variable(c.target).is_continuous and variable(c.source).is_continuous]
        return [
            c for c in found if variable(c.target).causality == "input" and self._wiring.matters(c.target)
        ]

    def _carried(self, moved: set[Port]) -> set[Port]:
        """Inputs that move by themselves, with a rate input, or that merely are the rate of a moved one."""
        wiring = self._wiring
        fed = {c.target for c in wiring.connections}
        power = {p for bond in find_bonds(wiring.system) for p in (bond.effort, bond.flow)}
        carried = set[Port]()
        for name, slave in wiring.slaves.items():
            for u, rate in slave.interface.rates.items():
                port, speed = Port(name, u), Port(name, rate)
                if u not in slave.interface.sloped and speed in fed:
                    carried.add(port)
                if port in moved and port not in carried and speed not in power:
                    carried.add(speed)
        return carried

    # ---- slopes of their sources

    def _told(self) -> Iterable[Port]:
        """The outputs whose slopes are wanted and told, component by component."""
        sources = dict.fromkeys(c.source for c in self._wired.values() if self._plan.asks(c.source.component))
        slaves = self._wiring.slaves
        inputs = (*self._wired, *self._driven)
        held = {p for p in inputs if not slaves[p.component].follows(p.variable, 1)}
        for name, slave in slaves.items():
            mine = [p for p in sources if p.component == name and not self._blind(p, held)]
            told = set(slave.tells([p.variable for p in mine]) if mine else ())
            yield from (p for p in mine if p.variable in told)

    def _blind(self, output: Port, held: set[Port]) -> bool:
        """Would its FMU tell a slope without that of an input, because it takes none?"""
        depends = self._wiring.slaves[output.component].interface.depends(output.variable)
        return any(Port(output.component, u) in held for u in depends)

    # ---- what they follow

    def _is_driven(self, port: Port) -> Signal:
        return Signal(
            target=self._wiring.real.index[port],
            source=-1,
            factor=1.0,
            offset=0.0,
            maker=DRIVEN,
            slope=NO_SLOPE,
            degree=self._wiring.slaves[port.component].follows(port.variable, 1),
            wanted=1,
            scale=self._scale(port),
        )

    def _follows(self, port: Port, wire: Connection) -> Signal:
        wiring, plan, moved = self._wiring, self._plan, port in self._moved
        slave = wiring.slaves[port.component]
        rate = Port(port.component, slave.interface.rates.get(port.variable, ""))
        rated = any(c.target == rate for c in wiring.connections)  # then it moves by itself, at a line
        wanted = max(plan.order, plan.degree, int(plan.corrected)) if moved else 0
        return Signal(
            target=wiring.real.index[port],
            source=wiring.real.index[wire.source],
            factor=wire.map.factor,
            offset=wire.map.offset,
            maker=list(wiring.slaves).index(wire.source.component),
            slope=self.told.get(wire.source, NO_SLOPE),
            degree=slave.follows(port.variable, wanted),
            wanted=wanted,
            order=plan.order if moved else min(1, plan.order + rated),
            free=not wiring.system.components[wire.source.component].interface.of("input"),
            scale=self._scale(port),
        )

    def _scale(self, port: Port) -> float:
        return abs(self._wiring.system.variable(port).nominal or 1.0)  # 1 if not declared, by the standard


class Network(Wiring):
    """A wiring in a run.

    parts         the components in the order of the system
    tied          those of the loops that are algebraic loops
    signals       inputs that move inside a step
    used          shape (2, real values): what moving inputs were at both ends of the step, else NaN
    slopes        of outputs, as told, shape (n,)
    moving        the inputs of the signals, but for those that are only watched
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
        """probes: as in `Wiring`; factors: how many steps components take in one communication step."""
        super().__init__(system, slaves, drive.columns if drive else (), probes)
        self.used = np.full((2, len(self.real.values)), np.nan)
        self.parts = [Part(slave, self.used) for slave in slaves.values()]
        for name, part in zip(slaves, self.parts, strict=True):
            part.factor = (factors or {}).get(name, 1)
        self.tied: list[Loop] = []
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

    # ---- before the run

    def move(self, plan: Plan) -> None:
        """Let inputs move as planned; called once."""
        driven = self.driver.moving if self.driver else []
        moves = Moves(self, driven, plan)
        self._read_slopes(moves.told)
        for name, part in zip(self.slaves, self.parts, strict=True):
            ports = moves.ports(name)
            mine = [moves.signal(p) for p in ports]
            part.follow([p.variable for p in ports], mine, plan.corrected)
            self.signals += mine
        self.moving, self.carried = moves.moving, moves.carried
        by_target = {s.target: s for s in self.signals}
        self._driven = [by_target[self.real.index[p]] for p in driven]
        pairs = [(self.real.index[b.effort], self.real.index[b.flow]) for b in find_bonds(self.system)]
        self.bonds = [(by_target[e], by_target[f]) for e, f in pairs if e in by_target and f in by_target]

    def _read_slopes(self, told: Mapping[Port, int]) -> None:
        """Arrange for the slopes of outputs to be read into their places."""
        self.slopes = np.zeros(len(told))
        for name, part in zip(self.slaves, self.parts, strict=True):
            mine = {p.variable: i for p, i in told.items() if p.component == name}
            if mine:
                rows = list(mine.values())
                part.tell = part.slave.slope_reader(list(mine), self.slopes[rows[0] : rows[-1] + 1])
