"""Linear prediction of the inputs over a step, by the interface Jacobian: the preparation of a run.

Directional derivatives of the FMUs linearise the components, their connections join them to one system.
native/linear_prediction.c has the equations, and solves them at every step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.engine.c_library import Binding, engine_h
from orchestrator.engine.component import calls_by_type
from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.masters import Prediction
from orchestrator.engine.network import Network
from orchestrator.fmi.calls import Buffer, Call, Slave
from orchestrator.ssp.system import Port


@dataclass(frozen=True)
class Column:
    """A directional derivative along several knowns that share no unknown, so that one call gives all.

    call      puts into `into` how the unknowns `rows` change when the knowns move along `seed`
    entries   pairs of an unknown and the known that it changes with, by number
    """

    call: Call
    seed: Buffer
    into: Buffer
    rows: Sequence[int]
    entries: Sequence[tuple[int, int]]


class Linearisation:
    """A component linearised at a communication point, by its directional derivatives.

    Unknowns are time derivatives of the states, then outputs; knowns are the states, then inputs.

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
        self.rates = calls_by_type(slave, rates, f, slave.reader)
        self.values = calls_by_type(slave, self.states, x, slave.reader)
        self._knowns, self._unknowns = [*self.states, *inputs], [*rates, *outputs]
        self.columns = [self._column(slave, group) for group in self._groups(slave)]

    def matrix(self) -> Buffer:
        """All changes now, shape (unknowns, knowns); raises Problem where the FMU gives none."""
        found = np.zeros((len(self._unknowns), len(self._knowns)))
        for column in self.columns:
            column.call()
            for i, j in column.entries:
                found[i, j] = column.into[column.rows.index(i)]
        return found

    def _groups(self, slave: Slave) -> list[list[tuple[int, int]]]:
        """Entries of each column: a known joins others as long as no unknown depends on two of them."""
        declared = [slave.interface.dependencies.get(name) for name in self._unknowns]
        groups: list[list[tuple[int, int]]] = []
        for j, known in enumerate(self._knowns):
            mine = [i for i, on in enumerate(declared) if on is None or known in on]
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
        seed, into = np.ones(len(by)), np.zeros(len(rows))
        return Column(slave.directional_derivative(of, by, seed, into), seed, into, rows, entries)


VECTORS = "f x f0 x0 q"  # of the states
MATRICES = "slopes k kc closed inverse course felt push v stages w w0 rows"
STAGES = 7  # vectors of the states that C works with


class JoinedSystem:
    """The arrays of n states and m inputs; matrices are (columns, rows), filled up to multiples of BLOCK.

    slopes    A, B, C and D one after the other; a, b, c, d: views of it
    through   outputs depend on inputs directly: D is not 0

    The other arrays are those of `LinearPrediction` in engine.h.
    """

    def __init__(self, n: int, m: int) -> None:
        block = engine_h().BLOCK
        self.n, self.m, self.through = n, m, False
        self.wide, self.broad = wide, broad = -(-n // block) * block, -(-m // block) * block
        self._ends = np.cumsum([n * wide, m * wide, n * broad, m * broad])
        self.slopes = np.zeros(self._ends[-1])
        a, b, c, d, _ = np.split(self.slopes, self._ends)
        shapes = (a, n, wide), (b, m, wide), (c, n, broad), (d, m, broad)
        self.a, self.b, self.c, self.d = (part.reshape(columns, rows) for part, columns, rows in shapes)
        self.k, self.kc = np.zeros((m, broad)), np.zeros((n, broad))
        self.closed, self.inverse = np.zeros((n, wide)), np.zeros((n, wide))
        self.f, self.x, self.f0, self.x0, self.q = (np.zeros(wide) for _ in range(5))
        self.w, self.w0 = np.zeros(broad), np.zeros(broad)
        self.course, self.felt, self.v = (np.zeros((3, broad)) for _ in range(3))
        self.push, self.stages = np.zeros((3, wide)), np.zeros((STAGES, wide))
        self.rows = np.zeros(max(n, m), np.int32)

    def place(self, of_input: bool, column: int, to_input: bool, row: int) -> int:
        """Where in `slopes` the change of a state or an input (`to_input`) with one (`of_input`) stands."""
        part = 2 * to_input + of_input
        first = int(self._ends[part - 1]) if part else 0
        return first + column * int(self.broad if to_input else self.wide) + row

    def made(self, binding: Binding, **more: Any) -> Any:
        """`LinearPrediction` of engine.h, with these arrays and `more`."""
        return binding.h.LinearPrediction(
            **binding.all_at(self, f"{VECTORS} {MATRICES}"),
            **{name: getattr(self, name) for name in ("n", "m", "wide", "broad", "through")},
            **more,
        )


NO_DERIVATIVES = "gives no directional derivatives, so its outputs are extrapolated"


@dataclass(frozen=True)
class LinearInput:
    """One input of the linear system.

    maker    number of the component that feeds it, or DRIVEN
    number   among the coupling inputs; None for an input that the FMU moves by itself
    """

    target: Port
    source: Port | None
    factor: float
    maker: int
    number: int | None


class LinearPrediction:
    """The inputs of a network that are predicted, and the components that it takes.

    leads   so many components step first
    rows    all inputs of the linear system, and `kinds`: of each of them
    """

    def __init__(
        self, network: Network, inputs: CouplingInputs, plan: Prediction, order: Sequence[int]
    ) -> None:
        self._network, self._inputs, self._plan, self._h = network, inputs, plan, engine_h()
        self.leads = plan.leads
        self._first, self._others = list(order[: plan.leads]), list(order[plan.leads :])
        self._names, self._components = list(network.slaves), [*network.components.values()]
        self.rows = [row for row in self._found() if row.target in plan.relevant]
        self.kinds = np.zeros(len(self.rows), np.int32)
        self._linearised: list[Linearisation] = []
        self._columns: list[tuple[Column, list[tuple[int, int, float]]]] = []
        self.joined = JoinedSystem(0, len(self.rows))
        self.notes: tuple[str, ...] = ()

    def _found(self) -> Iterator[LinearInput]:
        """All continuous inputs of the components that do not lead."""
        network = self._network
        ports = {place: port for port, place in network.real.index.items()}
        for k in self._others:
            for i in self._components[k].inputs:
                s = self._inputs.inputs[i]
                if s.wanted:
                    yield LinearInput(ports[s.target], ports.get(s.source), s.factor, s.source_component, i)
            for c in network.connections:
                if c.target.component == self._names[k] and c.target in self._inputs.self_moving:
                    yield LinearInput(
                        c.target, c.source, c.map.factor, self._names.index(c.source.component), None
                    )

    def begin(self) -> list[int]:
        """Linearise the components, which are initialised; returns the order in which all step.

        First come those that lead, then those without directional derivatives; then the fastest, because what
        it does is predicted worst, and all after it know better.
        """
        speeds = {k: speed for k in self._others if (speed := self._speed(k)) is not None}
        self._join(list(speeds))
        closed = [k for k in self._others if k not in speeds]
        makers = {row.maker for row in self.rows}
        self.notes = tuple(f"{self._names[k]} {NO_DERIVATIVES}" for k in closed if k in makers)
        return [*self._first, *closed, *sorted(speeds, key=lambda k: -speeds[k])]

    def _speed(self, k: int) -> float | None:
        """The largest rate [1/s] at which a component changes by itself; None without derivatives."""
        if self._names[k] not in self._plan.linearised:
            return None
        n = self._size(k)
        linear = self._linearisation(k, np.zeros(n), np.zeros(n))
        try:
            for call in (*linear.rates, *linear.values):
                call()
            matrix = linear.matrix()
        except Problem:
            return None
        if not np.all(np.isfinite(matrix)):
            return None
        return float(np.max(np.abs(np.linalg.eigvals(matrix[:n, :n])), initial=0.0))

    def _size(self, k: int) -> int:
        return len(self._components[k].slave.interface.states)

    def _linearisation(self, k: int, f: Buffer, x: Buffer) -> Linearisation:
        inputs = [row.target.variable for row in self.rows if row.target.component == self._names[k]]
        fed = dict.fromkeys(row.source.variable for row in self.rows if row.source and row.maker == k)
        return Linearisation(self._components[k].slave, inputs, list(fed), f, x)

    def _join(self, open_: Sequence[int]) -> None:
        """Make one system of the components with directional derivatives."""
        for i, row in enumerate(self.rows):
            self.kinds[i] = self._kind(row.maker, open_)
            if row.number is not None:
                known = self.kinds[i] not in (self._h.OPEN, self._h.CLOSED)
                self._inputs.inputs[row.number].predicted = not known
        self.joined = joined = JoinedSystem(sum(map(self._size, open_)), len(self.rows))
        first = 0
        for k in open_:
            last = first + self._size(k)
            linear = self._linearisation(k, joined.f[first:last], joined.x[first:last])
            self._linearised.append(linear)
            self._columns += [(c, list(self._entries(k, linear, c, first))) for c in linear.columns]
            first = last
        direct = joined.place(True, 0, True, 0)
        joined.through = any(to >= direct for _, entries in self._columns for _, to, _ in entries)

    def _kind(self, maker: int, open_: Sequence[int]) -> int:
        h = self._h
        kind = h.BY_SCENARIO if maker == h.DRIVEN else h.OPEN if maker in open_ else h.CLOSED
        return int(h.LEADING if maker in self._first else kind)

    def _entries(
        self, k: int, linear: Linearisation, column: Column, first: int
    ) -> Iterator[tuple[int, int, float]]:
        """Where a column belongs whose component's states begin at `first`: from, to, and a factor."""
        own, targets = len(linear.states), [row.target for row in self.rows]
        for i, j in column.entries:
            of_input, at, start = j >= own, first + j, column.rows.index(i)
            if of_input:
                at = targets.index(Port(self._names[k], linear.inputs[j - own]))
            if i < own:
                yield start, self.joined.place(of_input, at, False, first + i), 1.0
                continue
            source = Port(self._names[k], linear.outputs[i - own])
            for r, row in enumerate(self.rows):
                if row.source == source:
                    yield start, self.joined.place(of_input, at, True, r), row.factor

    def fill(self, binding: Binding) -> None:
        """Give the linear system to C."""
        h, at, lag = binding.h, binding.at, self._plan.lag
        columns = binding.array(h.SlopeColumn, [h.SlopeColumn()] * len(self._columns))
        for made, (column, entries) in zip(columns, self._columns, strict=False):
            binding.fill_derivative(made.derivative, column.call, column.seed, column.into)
            start, to, factor = zip(*entries, strict=True)
            made.to, made.factor = at(np.array(to, np.int64)), at(np.array(factor, float))
            setattr(made, "from", at(np.array(start, np.int32)))
            made.entries = len(entries)
        numbers = [-1 if row.number is None else row.number for row in self.rows]
        made = self.joined.made(
            binding,
            rates=binding.program([call for linear in self._linearised for call in linear.rates]),
            values=binding.program([call for linear in self._linearised for call in linear.values]),
            columns=binding.pointer(columns),
            column_count=len(self._columns),
            kinds=at(self.kinds),
            inputs=at(np.array(numbers, np.int32)),
            leads=self.leads,
            lag=lag,
            age=lag,
        )
        binding.simulation.prediction = binding.pointer(made)
