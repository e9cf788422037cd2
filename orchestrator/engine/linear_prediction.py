"""How one component changes with its states and inputs, as its FMU tells at a communication point.

The linearised components joined by their connections, and what they do over a step.

From a communication point on, with d the changes of all states and v those of all inputs,

    d' = f + A d + B v + drift,     v = C d + D v + w(s),     d(0) = 0

where w(s) are the changes of the inputs whose course is known. So  v = K (C d + w),  K = 1 / (1 - D),  and

    d' = f + (A + B K C) d + B K w(s) + drift

is solved up to h/3, 2h/3 and h by one step each of the L-stable Runge-Kutta method of order 3 whose three
stages have the same diagonal element (Alexander 1977, SIAM J. Numer. Anal. 14(6) 1006-1021). All stages share
the matrix  W = 1 / (1 - gamma h/3 (A + B K C)),  which is kept as long as the linearisation and h.

The drift is what an old linearisation misses: its error grew in proportion to its age T, and goes on like
that over the step: drift(s) = q (T s + s^2/2).

Matrices are stored column by column. native/foresight.c does the same, operation by operation.

What all inputs will do in a step, foretold from the linearisations of the components; see joined.py.

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
from itertools import groupby
from math import inf

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.engine import input_signal
from orchestrator.engine.algebraic_loop import inverted
from orchestrator.engine.input_signal import Signal
from orchestrator.engine.masters import Outlook
from orchestrator.engine.network import Network
from orchestrator.fmi.calls import Buffer, Call, Slave, access
from orchestrator.ssp.system import Port


@dataclass(frozen=True)
class Column:
    """A directional derivative along several knowns that share no unknown, so that one call tells all.

    call      puts into `into` how the unknowns `rows` change
    entries   pairs of an unknown and the known that it changes with, by number
    """

    call: Call
    into: Buffer
    rows: Sequence[int]
    entries: Sequence[tuple[int, int]]


class Tangent:
    """Unknowns are time derivatives of the states, then outputs; knowns are the states, then inputs.

    rates     calls that read the time derivatives of the states into `f`, shape (n,)
    values    calls that read the states into `x`, shape (n,)
    columns   all directional derivatives
    """

    def __init__(
        self, slave: Slave, inputs: Sequence[str], outputs: Sequence[str], f: Buffer, x: Buffer
    ) -> None:
        face = slave.interface
        self.states, self.inputs, self.outputs = list(face.states), inputs, outputs
        rates = list(face.states.values())
        self.rates, self.values = _reads(slave, rates, f), _reads(slave, self.states, x)
        self._knowns, self._unknowns = [*self.states, *inputs], [*rates, *outputs]
        self.columns = [self._column(slave, group) for group in self._groups(slave)]

    def matrix(self) -> Buffer:
        """All changes now, shape (unknowns, knowns); raises Problem where the FMU cannot tell."""
        found = np.zeros((len(self._unknowns), len(self._knowns)))
        for column in self.columns:
            column.call()
            for i, j in column.entries:
                found[i, j] = column.into[column.rows.index(i)]
        return found

    def _groups(self, slave: Slave) -> list[list[tuple[int, int]]]:
        """Entries of each column: a known joins others as long as no unknown depends on two of them."""
        told = [slave.interface.knowns.get(name) for name in self._unknowns]
        groups: list[list[tuple[int, int]]] = []
        for j, known in enumerate(self._knowns):
            mine = [i for i, on in enumerate(told) if on is None or known in on]
            room = [group for group in groups if not {i for i, _ in group} & set(mine)]
            if not room and mine:
                groups.append([])
                room = groups[-1:]
            for group in room[:1]:
                group += [(i, j) for i in mine]
        return groups

    def _column(self, slave: Slave, entries: list[tuple[int, int]]) -> Column:
        rows, knowns = sorted({i for i, _ in entries}), sorted({j for _, j in entries})
        of, by = [self._unknowns[i] for i in rows], [self._knowns[j] for j in knowns]
        into = np.zeros(len(rows))
        return Column(slave.derivative(of, by, np.ones(len(by)), into), into, rows, entries)


def _reads(slave: Slave, names: Sequence[str], into: Buffer) -> list[Call]:
    """One call for each row of variables of one type."""
    calls, first = list[Call](), 0
    for _, group in groupby(names, key=lambda name: access(slave.interface.variables[name])):
        row = list(group)
        calls.append(slave.reader(row, into[first : first + len(row)]))
        first += len(row)
    return calls


GAMMA = 0.43586652150845967
NODES = (GAMMA, (1.0 + GAMMA) / 2.0, 1.0)  # of the stages
EARLIER = (  # weights of the stages before
    (),
    ((1.0 - GAMMA) / 2.0,),
    (-1.5 * GAMMA * GAMMA + 4.0 * GAMMA - 0.25, 1.5 * GAMMA * GAMMA - 5.0 * GAMMA + 1.25),
)
BLOCK = 8
ALIKE = 1e-9  # of a step: another one that differs by less is the same


class Joined:
    """n states and m inputs; shapes of matrices (columns, rows), the rows filled up to a multiple of BLOCK.

    slopes   A, B, C and D one after the other; a, b, c, d: views of it
    f, x     time derivatives of the states, and the states, at the communication point
    w        inputs there, where their course is known, else 0
    course   their coefficients of s, s^2 and s^3, shape (3, m)
    felt     K times that, and push: B times that
    v        the changes of all inputs up to h/3, 2h/3 and h, shape (3, m)
    through  outputs depend on inputs directly: D is not 0
    """

    def __init__(self, n: int, m: int) -> None:
        self.n, self.m, self.through = n, m, False
        self.wide, self.broad = wide, broad = _padded(n), _padded(m)
        self._ends = np.cumsum([n * wide, m * wide, n * broad, m * broad])
        self.slopes = np.zeros(self._ends[-1])
        a, b, c, d, _ = np.split(self.slopes, self._ends)
        self.a, self.b, self.c, self.d = (
            part.reshape(columns, -1) if columns else part.reshape(0, rows)
            for part, columns, rows in ((a, n, wide), (b, m, wide), (c, n, broad), (d, m, broad))
        )
        self.k, self.kc = np.zeros((m, broad)), np.zeros((n, broad))
        self.closed, self.inverse = np.zeros((n, wide)), np.zeros((n, wide))
        self.f, self.x, self.f0, self.x0, self.q = (np.zeros(wide) for _ in range(5))
        self.w, self.w0 = np.zeros(broad), np.zeros(broad)
        self.course, self.felt, self.v = (np.zeros((3, broad)) for _ in range(3))
        self.push = np.zeros((3, wide))
        self.rows = np.zeros(max(n, m), np.int32)
        self.length = 0.0  # that `inverse` is made for; 0: it is not made
        self.usable = False

    def place(self, of_input: bool, column: int, to_input: bool, row: int) -> int:
        """Where in `slopes` the change of a state or an input (`to_input`) with one (`of_input`) stands."""
        part = 2 * to_input + of_input
        first = int(self._ends[part - 1]) if part else 0
        return first + column * (self.broad if to_input else self.wide) + row

    def join(self) -> None:
        """Make one system of the slopes; `usable` tells whether that is possible."""
        self.length, self.usable = 0.0, True
        self.kc[:] = self.c
        if self.through:
            self.k[:] = np.eye(self.m, self.broad) - self.d
            self.usable = inverted(self.k, self.rows)
            self.kc[:] = 0.0
            for j in range(self.n):
                add_product(self.k, self.c[j], self.kc[j])
        self.closed[:] = self.a
        for j in range(self.n):
            add_product(self.b, self.kc[j], self.closed[j])

    def find_drift(self, last: float, since: float) -> None:
        """Find q from the step before, `last` [s] long; `since` [s]: age of the linearisation."""
        self.q[:] = 0.0
        if since == 0.0:
            return
        add_product(self.closed, self.x - self.x0, self.q)
        felt, before = self._felt(self.w), self._felt(self.w0)
        add_product(self.b, felt - before, self.q)
        self.q[:] = (self.f - self.f0 - self.q) / (last * (since - 0.5 * last))

    def accept(self) -> None:
        """This communication point becomes the one before."""
        self.f0[:], self.x0[:], self.w0[:] = self.f, self.x, self.w

    def prepare(self, h: float) -> None:
        """Get ready for a step of length h."""
        if not self.usable or abs(h - self.length) <= ALIKE * h:
            return
        self.length = h
        self.inverse[:] = np.eye(self.n, self.wide) - (GAMMA * (h / 3.0)) * self.closed
        self.usable = inverted(self.inverse, self.rows)

    def foretell(self, since: float) -> None:
        """Find v; `since` [s]: age of the linearisation."""
        delta, d = self.length / 3.0, np.zeros(self.wide)
        for k in range(3):
            self.felt[k] = self._felt(self.course[k])
            self.push[k] = 0.0
            add_product(self.b, self.felt[k], self.push[k])
        for third in range(3):
            rates: list[Buffer] = []
            for node, earlier in zip(NODES, EARLIER, strict=True):
                base, s = d.copy(), delta * (third + node)
                for weight, rate in zip(earlier, rates, strict=True):
                    base += (delta * weight) * rate
                stage, forcing = np.zeros(self.wide), self.f + (since * s + 0.5 * s * s) * self.q
                forcing = base + (GAMMA * delta) * (forcing + _curve(self.push, s))
                add_product(self.inverse, forcing, stage)
                rates.append((stage - base) / (GAMMA * delta))
            d = stage  # the last stage is the end
            self.v[third] = _curve(self.felt, delta * (third + 1))
            add_product(self.kc, d, self.v[third])

    def _felt(self, known: Buffer) -> Buffer:
        """What known changes are to all inputs, through outputs that depend on inputs directly."""
        if not self.through:
            return known
        felt = np.zeros(self.broad)
        add_product(self.k, known, felt)
        return felt


def _curve(c: Buffer, s: float) -> Buffer:
    """Polynomials of s with the coefficients c of s, s^2 and s^3, shape (3, n)."""
    found: Buffer = s * (c[0] + s * (c[1] + s * c[2]))
    return found


def add_product(matrix: Buffer, by: Buffer, to: Buffer) -> None:
    """Add matrix times vector, column by column."""
    for column, factor in zip(matrix, by.tolist(), strict=False):
        if factor != 0.0:
            to += column * factor


def _padded(n: int) -> int:
    """So many rows make full blocks, which C computes at once."""
    return -(-n // BLOCK) * BLOCK


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
        if maker == input_signal.DRIVEN:
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
