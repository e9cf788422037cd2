"""The running system: what moves between communication points, and how a step begins, ends and is undone.

Inputs that a master moves follow the polynomials of `signal.py` between communication points; `Wiring` has
the values and their exchange.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from orchestrator.coupling.drive import Drive
from orchestrator.coupling.driver import Driver
from orchestrator.coupling.loop import Loop
from orchestrator.coupling.masters.plan import Plan
from orchestrator.coupling.moves import Moves
from orchestrator.coupling.part import Part
from orchestrator.coupling.signal import DRIVEN, NO_SLOPE, Signal
from orchestrator.coupling.wiring import Wiring
from orchestrator.slaves.slave import Slave
from orchestrator.system.bonds import find_bonds
from orchestrator.system.system import Port, System


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
