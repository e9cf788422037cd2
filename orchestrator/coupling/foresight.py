"""What all inputs will do in a step, foretold from the linearisations of the components; see joined.py.

Inputs fall into four kinds, by where they come from:

    OPEN     a component that tells how it changes: they are what is found
    DRIVEN   a scenario: their course over the step is known
    LEADING  a component that has stepped already, because its future depends on no other: known
    CLOSED   a component that does not tell how it changes: continued from its past, and taken as known

native/foresight.c does the same at every step, operation by operation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from orchestrator.coupling import signal
from orchestrator.coupling.joined import Joined
from orchestrator.coupling.masters.plan import Outlook
from orchestrator.coupling.network import Network
from orchestrator.coupling.signal import Signal
from orchestrator.coupling.tangent import Tangent
from orchestrator.errors import Problem
from orchestrator.slaves.slave import Buffer, Call
from orchestrator.system.system import Port

OPEN, DRIVEN, LEADING, CLOSED = range(4)
DEGREE = 3
SILENT = "does not tell how it changes with states and inputs, so its outputs are continued from their past"


@dataclass(frozen=True)
class Row:
    """One input of the linear system.

    maker    number of the component that feeds it, or that of a scenario
    signal   None for an input that the FMU moves by itself
    """

    target: Port
    source: Port | None
    factor: float
    maker: int
    signal: Signal | None


@dataclass(frozen=True)
class Telling:
    """A directional derivative, and where what it tells belongs: slopes[to] = factor * into[of]."""

    call: Call
    into: Buffer
    of: Buffer
    to: Buffer
    factor: Buffer

    def __call__(self, slopes: Buffer) -> None:
        self.call()
        slopes[self.to] = self.into[self.of] * self.factor


class Foresight:
    """The inputs of a network that are foretold, and the components that do it.

    rows       all inputs of the linear system; kinds: of each of them
    rates      calls that read the time derivatives of the states; values: the states
    tellings   calls that make the slopes
    age        steps since the linearisation; since: time since then [s]
    last       length of the step before [s]
    """

    def __init__(self, network: Network, outlook: Outlook, turns: Sequence[int]) -> None:
        self.network, self.lag, self.leads, self._outlook = network, outlook.lag, outlook.leads, outlook
        self._first, self._others = list(turns[: outlook.leads]), list(turns[outlook.leads :])
        self._names = list(network.slaves)
        self.rows = [row for row in self._found() if row.target in outlook.heard]
        self.kinds = np.zeros(len(self.rows), np.int32)
        self.rates, self.values, self.tellings = list[Call](), list[Call](), list[Telling]()
        self.joined = Joined(0, len(self.rows))
        self.age, self.since, self.last = outlook.lag, 0.0, 0.0
        self.notes: tuple[str, ...] = ()

    def _found(self) -> Iterator[Row]:
        """All continuous inputs of the components that do not lead."""
        network = self.network
        ports = {place: port for port, place in network.real.index.items()}
        for k in self._others:
            for s in network.parts[k].signals:
                if s.wanted:
                    yield Row(ports[s.target], ports.get(s.source), s.factor, s.maker, s)
            for c in network.connections:
                if c.target.component == self._names[k] and c.target in network.carried:
                    yield Row(c.target, c.source, c.map.factor, self._names.index(c.source.component), None)

    # ---- before the first step

    def begin(self) -> list[int]:
        """Ask the components for their linearisations; returns the order in which all step.

        First come those that lead, then those that tell nothing; then the fastest, because what it does is
        foretold worst, and all after it know better.
        """
        speeds = {k: speed for k in self._others if (speed := self._speed(k)) is not None}
        self._join(list(speeds))
        silent = [k for k in self._others if k not in speeds]
        makers = {row.maker for row in self.rows}
        self.notes = tuple(f"{self._names[k]} {SILENT}" for k in silent if k in makers)
        return [*self._first, *silent, *sorted(speeds, key=lambda k: -speeds[k])]

    def _speed(self, k: int) -> float | None:
        """The largest rate [1/s] at which a component changes by itself; None if it does not tell."""
        if self._names[k] not in self._outlook.open:
            return None
        n = self._size(k)
        tangent = self._tangent(k, np.zeros(n), np.zeros(n))
        try:
            for call in (*tangent.rates, *tangent.values):
                call()
            matrix = tangent.matrix()
        except Problem:
            return None
        if not np.all(np.isfinite(matrix)):
            return None
        return float(np.max(np.abs(np.linalg.eigvals(matrix[:n, :n])), initial=0.0))

    def _size(self, k: int) -> int:
        return len(self.network.parts[k].slave.interface.states)

    def _tangent(self, k: int, f: Buffer, x: Buffer) -> Tangent:
        inputs = [row.target.variable for row in self.rows if row.target.component == self._names[k]]
        fed = dict.fromkeys(row.source.variable for row in self.rows if row.source and row.maker == k)
        return Tangent(self.network.parts[k].slave, inputs, list(fed), f, x)

    def _join(self, open_: Sequence[int]) -> None:
        """Make one system of the components that tell how they change."""
        for i, row in enumerate(self.rows):
            self.kinds[i] = self._kind(row.maker, open_)
            if row.signal:
                row.signal.foreseen = self.kinds[i] in (OPEN, CLOSED)
        self.joined = joined = Joined(sum(map(self._size, open_)), len(self.rows))
        first = 0
        for k in open_:
            last = first + self._size(k)
            tangent = self._tangent(k, joined.f[first:last], joined.x[first:last])
            self.rates += tangent.rates
            self.values += tangent.values
            self.tellings += self._tellings(k, tangent, first)
            first = last
        direct = joined.place(True, 0, True, 0)
        joined.through = any(np.any(t.to >= direct) for t in self.tellings)

    def _kind(self, maker: int, open_: Sequence[int]) -> int:
        if maker == signal.DRIVEN:
            return DRIVEN
        return OPEN if maker in open_ else LEADING if maker in self._first else CLOSED

    def _tellings(self, k: int, tangent: Tangent, first: int) -> Iterator[Telling]:
        """The columns of a component whose states begin at `first`."""
        for column in tangent.columns:
            found = [
                (column.rows.index(i), to, factor)
                for i, j in column.entries
                for to, factor in self._places(k, tangent, first, i, j)
            ]
            of, to, factor = (np.array(a) for a in zip(*found, strict=True))
            yield Telling(column.call, column.into, of.astype(np.int32), to.astype(np.int64), factor)

    def _places(self, k: int, tangent: Tangent, first: int, i: int, j: int) -> Iterator[tuple[int, float]]:
        """Where in the slopes the change of an unknown with a known belongs, and times what factor."""
        own, name = len(tangent.states), self._names[k]
        of_input, column = j >= own, first + j
        if of_input:
            column = [row.target for row in self.rows].index(Port(name, tangent.inputs[j - own]))
        if i < own:
            yield self.joined.place(of_input, column, False, first + i), 1.0
            return
        source = Port(name, tangent.outputs[i - own])
        for r, row in enumerate(self.rows):
            if row.source == source:
                yield self.joined.place(of_input, column, True, r), row.factor

    # ---- at every step

    @np.errstate(all="ignore")  # what is no number is found out at the end
    def look(self, h: float) -> None:
        """Foretell the inputs over a step of length h; the components that lead have done it."""
        joined = self.joined
        for i, row in enumerate(self.rows):
            if row.signal and self.kinds[i] != OPEN:
                self._know(i, row.signal, h)
        for call in (*self.rates, *(self.values if self.lag > 1 else ())):
            call()
        if self.age >= self.lag or not joined.usable:
            for telling in self.tellings:
                telling(joined.slopes)
            joined.join()
            self.age, self.since = 0, 0.0
        if self.lag > 1:
            joined.find_drift(self.last, self.since)
        joined.prepare(h)
        if joined.usable:
            joined.foretell(self.since)
        for i, row in enumerate(self.rows):
            if row.signal and self.kinds[i] == OPEN:
                self._foretell(i, row.signal, h)

    def _know(self, i: int, s: Signal, h: float) -> None:
        """Note what a known input does."""
        if self.kinds[i] == LEADING:
            s.interpolate(DEGREE, h, self.network.length)
        elif self.kinds[i] == CLOSED:
            s.predict(h, self.network.length)
        self.joined.w[i] = s.value
        self.joined.course[:, i] = s.c[1:]

    def _foretell(self, i: int, s: Signal, h: float) -> None:
        """Give an input what was found; without that it is continued from its past."""
        v1, v2, v3 = self.joined.v[:, i].tolist()
        if self.joined.usable and abs(v1) + abs(v2) + abs(v3) < inf:
            s.foresee(v1, v2, v3, h)
        else:
            s.predict(h, self.network.length)

    def accept(self, h: float) -> None:
        """A step of length h stands."""
        self.joined.accept()
        self.age += 1
        self.since += h
        self.last = h
