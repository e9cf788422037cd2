"""Linear systems: prediction of inputs by the interface Jacobian, estimate of the errors of a run.

Directional derivatives of the FMUs linearise the components; the connections join the linearised components
to one system. native/linear_prediction.c predicts inputs by it, native/error_propagation.c carries the errors
of inputs through it; both have the equations, and solve them at every step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.c_library import Binding, engine_h
from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.network import Network
from orchestrator.engine.result import EstimatedError
from orchestrator.fmi.calls import Buffer, Call, Slave, calls_by_type
from orchestrator.ssp.masters import Plan, Prediction
from orchestrator.ssp.system import Connection, Port

PREDICTION_ROWS, ERROR_ROWS = 6, 8  # vectors of the states that C uses as working memory
LONGEST_LAG = 20  # number of steps between two linearisations, at most
LONGEST_SECTION = 16  # number of steps over which errors are advanced at once, at most
BLOCK = 256  # evaluations of the outputs between two calls of `collect`, at most


@dataclass(frozen=True)
class JacobianColumn:
    """A directional derivative with respect to several knowns, no two of which affect the same unknown.

    call      writes the change of the unknowns `rows` to `result`, if the knowns change along `seed`
    entries   indices (unknown, known) of the elements of the Jacobian that one call gives
    """

    call: Call
    seed: Buffer
    result: Buffer
    rows: Sequence[int]
    entries: Sequence[tuple[int, int]]


class Linearisation:
    """A component linearised at a communication point by its directional derivatives.

    Unknowns are the time derivatives of the states, then the outputs. Knowns are the states, then the inputs.

    rate_reads   calls that read the time derivatives of the states into `f`, shape (n,)
    columns      all directional derivatives; empty if the FMU has none
    """

    def __init__(self, slave: Slave, inputs: Sequence[str], outputs: Sequence[str], f: Buffer) -> None:
        states = slave.interface.states
        self.states, self.inputs, self.outputs = list(states), inputs, outputs
        rates = list(states.values())
        self.rate_reads = calls_by_type(slave, rates, f, slave.reader)
        self._knowns, self._unknowns = [*self.states, *inputs], [*rates, *outputs]
        groups = self._groups(slave) if slave.interface.directional_derivatives else []
        self.columns = [self._column(slave, group) for group in groups]

    def matrix(self) -> Buffer:
        """The Jacobian at this point, shape (unknowns, knowns); raises Problem if the FMU refuses a call."""
        jacobian = np.zeros((len(self._unknowns), len(self._knowns)))
        for column in self.columns:
            column.call()
            for i, j in column.entries:
                jacobian[i, j] = column.result[column.rows.index(i)]
        return jacobian

    def _groups(self, slave: Slave) -> list[list[tuple[int, int]]]:
        """Entries of each column; knowns are in one column if no unknown depends on two of them."""
        dependencies = [slave.interface.dependencies.get(name) for name in self._unknowns]
        groups: list[list[tuple[int, int]]] = []
        for j, known in enumerate(self._knowns):
            dependent = [i for i, names in enumerate(dependencies) if names is None or known in names]
            free = [group for group in groups if not {i for i, _ in group} & set(dependent)]
            if not free and dependent:
                groups.append([])
                free = groups[-1:]
            for group in free[:1]:
                group += [(i, j) for i in dependent]
        return groups

    def _column(self, slave: Slave, entries: list[tuple[int, int]]) -> JacobianColumn:
        rows, columns = sorted({i for i, _ in entries}), sorted({j for _, j in entries})
        unknowns, knowns = [self._unknowns[i] for i in rows], [self._knowns[j] for j in columns]
        seed, result = np.ones(len(knowns)), np.zeros(len(rows))
        call = slave.directional_derivative(unknowns, knowns, seed, result)
        return JacobianColumn(call, seed, result, rows, entries)


Entry = tuple[int, int, float]  # index in the result of a column, index in the matrices, factor


def column_structs(binding: Binding, columns: Sequence[tuple[JacobianColumn, Sequence[Entry]]]) -> Any:
    """An array of `JacobianColumn` of engine.h."""
    structs = binding.array(binding.h.JacobianColumn, [binding.h.JacobianColumn()] * len(columns))
    for struct, (column, entries) in zip(structs, columns, strict=False):
        binding.fill_derivative(struct.derivative, column.call, column.seed, column.result)
        from_, to, factor = zip(*entries, strict=True)
        struct.to, struct.factor = binding.at(np.array(to, np.int64)), binding.at(np.array(factor, float))
        setattr(struct, "from", binding.at(np.array(from_, np.int32)))  # `from` is a keyword of Python
        struct.entries = len(entries)
    return structs


@dataclass(frozen=True)
class LinearInput:
    """One input of the linear system.

    source_component   index of the component that feeds it, or DRIVEN
    coupling_input     its index among the coupling inputs; None if the FMU varies it by a rate input
    """

    target: Port
    source: Port | None
    factor: float
    source_component: int
    coupling_input: int | None


class LinearSystem:
    """The arrays of a linear system with n states and m inputs, for native/linear_system.c.

    Matrices have the shape (columns, rows); the rows are padded to a multiple of BLOCK.

    matrices          A, B, C and D one after the other; a, b, c, d are views of it
    has_feedthrough   outputs depend on inputs directly: D is not 0
    """

    def __init__(self, n: int, m: int) -> None:
        block = engine_h().BLOCK
        self.n, self.m, self.has_feedthrough = n, m, False
        self.n_padded = wide = -(-n // block) * block
        self.m_padded = broad = -(-m // block) * block
        self._ends = np.cumsum([n * wide, m * wide, n * broad, m * broad])
        self.matrices = np.zeros(self._ends[-1])
        a, b, c, d, _ = np.split(self.matrices, self._ends)
        shapes = (a, n, wide), (b, m, wide), (c, n, broad), (d, m, broad)
        self.a, self.b, self.c, self.d = (part.reshape(shape) for part, *shape in shapes)
        self.k, self.kc = np.zeros((m, broad)), np.zeros((n, broad))
        self.closed_loop = np.zeros((n, wide))
        self.pivots = np.zeros(max(n, m), np.int32)
        self.linearised: list[Linearisation] = []
        self._columns: list[tuple[JacobianColumn, list[Entry]]] = []

    def connect(
        self, network: Network, members: Sequence[int], inputs: Sequence[LinearInput], f: Buffer
    ) -> None:
        """Make the directional derivatives of the components `members`; f: see `Linearisation`."""
        first, slaves = 0, [*network.slaves.values()]
        for k in members:
            last = first + len(slaves[k].interface.states)
            linear = linearisation(slaves[k], k, inputs, f[first:last])
            self.linearised.append(linear)
            name = slaves[k].name
            self._columns += [
                (c, list(self._entries(name, linear, c, first, inputs))) for c in linear.columns
            ]
            first = last
        start_of_d = self.matrix_index(True, 0, True, 0)
        self.has_feedthrough = any(to >= start_of_d for _, entries in self._columns for _, to, _ in entries)

    def _entries(
        self,
        name: str,
        linear: Linearisation,
        column: JacobianColumn,
        first: int,
        inputs: Sequence[LinearInput],
    ) -> Iterator[Entry]:
        """Entries of a column; first: index of the first state of the component."""
        n, targets = len(linear.states), [u.target for u in inputs]
        for i, j in column.entries:
            of_input, known, result = j >= n, first + j, column.rows.index(i)
            if of_input:
                known = targets.index(Port(name, linear.inputs[j - n]))
            if i < n:
                yield result, self.matrix_index(of_input, known, False, first + i), 1.0
                continue
            source = Port(name, linear.outputs[i - n])
            for row, u in enumerate(inputs):
                if u.source == source:
                    yield result, self.matrix_index(of_input, known, True, row), u.factor

    def matrix_index(self, of_input: bool, column: int, to_input: bool, row: int) -> int:
        """Index in `matrices` of the effect of a state or an input (`of_input`) on one (`to_input`)."""
        part = 2 * to_input + of_input
        first = int(self._ends[part - 1]) if part else 0
        return first + column * int(self.m_padded if to_input else self.n_padded) + row

    def system_struct(self, binding: Binding) -> Any:
        """`LinearSystem` of engine.h with these arrays."""
        sizes = ("n", "m", "n_padded", "m_padded", "has_feedthrough")
        return binding.h.LinearSystem(
            **binding.all_at(self, "matrices k kc closed_loop pivots"),
            **{name: getattr(self, name) for name in sizes},
            columns=binding.pointer(column_structs(binding, self._columns)),
            column_count=len(self._columns),
        )


def linearisation(slave: Slave, k: int, inputs: Sequence[LinearInput], f: Buffer) -> Linearisation:
    """The linearisation of component k of a linear system with these inputs."""
    of_component = [u.target.variable for u in inputs if u.target.component == slave.name]
    outputs = dict.fromkeys(u.source.variable for u in inputs if u.source and u.source_component == k)
    return Linearisation(slave, of_component, list(outputs), f)


class JoinedSystem(LinearSystem):
    """A linear system with the other arrays of `LinearPrediction` in engine.h."""

    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        wide, broad = self.n_padded, self.m_padded
        self.factors = np.zeros((n, wide))
        self.f, self.w = np.zeros(wide), np.zeros(broad)
        self.course, self.response, self.v = (np.zeros((3, broad)) for _ in range(3))
        self.forcing, self.stages = np.zeros((3, wide)), np.zeros((PREDICTION_ROWS, wide))

    def struct(self, binding: Binding) -> Any:
        """`LinearPrediction` of engine.h with these arrays."""
        arrays = binding.all_at(self, "f w course response forcing v stages factors")
        return binding.h.LinearPrediction(system=self.system_struct(binding), **arrays)


NO_DERIVATIVES = "provides no directional derivatives, so its outputs are extrapolated"


class LinearPrediction:
    """The linear system that predicts inputs of a network: its inputs, components, and structures for C.

    inputs   all inputs of the linear system
    kinds    PREDICTED, BY_SCENARIO, LEADING or EXTRAPOLATED for each of them
    """

    def __init__(self, network: Network, inputs: CouplingInputs, plan: Plan, prediction: Prediction) -> None:
        self._network, self._coupling, self._plan, self._h = network, inputs, prediction, engine_h()
        leading = prediction.leading_count
        self._leading, self._others = list(plan.order[:leading]), list(plan.order[leading:])
        self._names, self._components = list(network.slaves), [*network.components.values()]
        self.inputs = [u for u in self._candidates() if u.target in prediction.relevant]
        self.kinds = np.zeros(len(self.inputs), np.int32)
        self.joined = JoinedSystem(0, len(self.inputs))
        self.notes: tuple[str, ...] = ()

    def _candidates(self) -> Iterator[LinearInput]:
        """All continuous inputs of the components that are not leading."""
        network = self._network
        ports = {index: port for port, index in network.reals.index.items()}
        for k in self._others:
            for i in self._components[k].inputs:
                s = self._coupling.inputs[i]
                if s.requested_degree:
                    yield LinearInput(ports[s.target], ports.get(s.source), s.factor, s.source_component, i)
            for c in network.connections:
                if c.target.component == self._names[k] and c.target in self._coupling.rate_driven:
                    source_component = self._names.index(c.source.component)
                    yield LinearInput(c.target, c.source, c.map.factor, source_component, None)

    def begin(self) -> list[int]:
        """Linearise the components, which are initialised; returns the order in which all step.

        The order is: leading components, components without directional derivatives, then the others from the
        fastest to the slowest. The prediction is worst for the fastest, and the components that follow it get
        its actual outputs.
        """
        speeds = {k: speed for k in self._others if (speed := self._fastest_rate(k)) is not None}
        self._join(list(speeds))
        extrapolated = [k for k in self._others if k not in speeds]
        sources = {u.source_component for u in self.inputs}
        self.notes = tuple(f"{self._names[k]} {NO_DERIVATIVES}" for k in extrapolated if k in sources)
        return [*self._leading, *extrapolated, *sorted(speeds, key=lambda k: -speeds[k])]

    def _fastest_rate(self, k: int) -> float | None:
        """The largest magnitude [1/s] of an eigenvalue of component k; None without derivatives."""
        if self._names[k] not in self._plan.linearised:
            return None
        n = self._state_count(k)
        linear = linearisation(self._components[k].slave, k, self.inputs, np.zeros(n))
        try:
            for call in linear.rate_reads:
                call()
            matrix = linear.matrix()
        except Problem:
            return None
        if not np.all(np.isfinite(matrix)):
            return None
        return float(np.max(np.abs(np.linalg.eigvals(matrix[:n, :n])), initial=0.0))

    def _state_count(self, k: int) -> int:
        return len(self._components[k].slave.interface.states)

    def _join(self, predicted: Sequence[int]) -> None:
        """Join the components with directional derivatives to one system."""
        for i, u in enumerate(self.inputs):
            self.kinds[i] = self._kind(u.source_component, predicted)
            if u.coupling_input is not None:
                by_prediction = self.kinds[i] in (self._h.PREDICTED, self._h.EXTRAPOLATED)
                self._coupling.inputs[u.coupling_input].predicted = by_prediction
        self.joined = joined = JoinedSystem(sum(map(self._state_count, predicted)), len(self.inputs))
        joined.connect(self._network, predicted, self.inputs, joined.f)

    def _kind(self, source_component: int, predicted: Sequence[int]) -> int:
        h = self._h
        if source_component == h.DRIVEN:
            return int(h.BY_SCENARIO)
        if source_component in self._leading:
            return int(h.LEADING)
        return int(h.PREDICTED if source_component in predicted else h.EXTRAPOLATED)

    def fill(self, binding: Binding) -> None:
        """Fill the C structures of the linear system."""
        at = binding.at
        coupling_inputs = [-1 if u.coupling_input is None else u.coupling_input for u in self.inputs]
        linearised = self.joined.linearised
        struct = self.joined.struct(binding)
        struct.rate_reads = binding.program([call for linear in linearised for call in linear.rate_reads])
        struct.kinds, struct.inputs = at(self.kinds), at(np.array(coupling_inputs, np.int32))
        struct.leading_count = self._plan.leading_count
        binding.simulation.prediction = binding.pointer(struct)


class ErrorSystem(LinearSystem):
    """A linear system with the other arrays that carry errors, for native/error_propagation.c."""

    def __init__(self, n: int, m: int) -> None:
        super().__init__(n, m)
        wide, broad = self.n_padded, self.m_padded
        self.e, self.stages, self.factors = np.zeros(wide), np.zeros((ERROR_ROWS, wide)), np.zeros((n, wide))
        self.w, self.middle, self.diagonal = np.zeros(broad), np.zeros(broad), np.zeros(n)
        self.defects, self.lengths, self.starts = np.zeros((m, 2)), np.zeros(3), np.zeros(2)

    def struct(self, binding: Binding, **others: Any) -> Any:
        """`ErrorPropagation` of engine.h with these arrays and other members."""
        arrays = binding.all_at(self, "e stages factors w middle defects lengths diagonal starts")
        return binding.h.ErrorPropagation(system=self.system_struct(binding), **arrays, **others)


class ErrorPropagation:
    """The linear system that carries the errors of a run, and its structures for C.

    missing   why there is no estimate; empty if there is one
    """

    def __init__(self, network: Network, inputs: CouplingInputs, sample: int) -> None:
        """network: its FMUs are initialised; sample: number of steps between two evaluations of outputs."""
        self._network, self._coupling, self._sample = network, inputs, sample
        self._slaves = [*network.slaves.values()]
        connected = {c.target.component for c in network.connections if network.is_influential(c.target)}
        self._members = [k for k, s in enumerate(self._slaves) if s.interface.linearisable]
        members = {self._slaves[k].name for k in self._members}
        names = sorted(connected - members)
        self.missing = f"{names[0]} does not declare states and directional derivatives" if names else ""
        self._inputs = list(self._influential_inputs(members))
        if not self._inputs and not self.missing:
            self.missing = "no connected input influences a declared state"
        n = sum(len(self._slaves[k].interface.states) for k in self._members)
        self._system = ErrorSystem(n, len(self._inputs))
        self._outputs = [
            Port(name, v.name)
            for name, slave in network.slaves.items()
            if name in members
            for v in slave.interface.of("output")
            if v.is_continuous
        ]
        self.y, self.squares, self.largest, self.values = np.zeros((4, len(self._outputs)))
        self.lowest, self.highest = self.values + np.inf, self.values - np.inf
        self.times, self.rows = np.zeros(BLOCK), np.zeros((BLOCK, len(self._outputs)))
        if not self.missing:
            self._connect()

    def _influential_inputs(self, members: set[str]) -> Iterator[LinearInput]:
        """The inputs of the linear system, ordered by component."""
        network, components = self._network, list(self._network.slaves)
        coupling = {p: i for i, p in enumerate(self._coupling.ports)}
        sources = {c.target: c for c in network.connections if network.is_influential(c.target)}
        driven = {p: None for p in self._coupling.driven}
        for name in components:
            for port in (*sources, *driven) if name in members else ():
                if port.component != name or not network.system.variable(port).is_continuous:
                    continue
                c = sources.get(port)
                if c and not network.system.variable(c.source).is_continuous:  # held over a step
                    c = None
                source_component = components.index(c.source.component) if c else -1
                source, factor = (c.source, c.map.factor) if c else (None, 0.0)
                yield LinearInput(port, source, factor, source_component, coupling.get(port))

    def _connect(self) -> None:
        """Make the directional derivatives, and try them."""
        n = self._system.n
        self._system.connect(self._network, self._members, self._inputs, np.zeros(n))
        for k, linear in zip(self._members, self._system.linearised, strict=True):
            try:
                if np.isfinite(linear.matrix()).all():
                    continue
            except Problem:
                pass
            self.missing = f"{self._slaves[k].name} gives no directional derivatives"

    def errors(self) -> dict[str, EstimatedError]:
        """The estimated error of each output so far; empty before the first evaluation."""
        if not (time := self._struct.time):
            return {}
        rows = zip(self._outputs, np.sqrt(self.squares / time).tolist(), self.largest.tolist(), strict=True)
        return {str(port): EstimatedError(rms, largest) for port, rms, largest in rows}

    def collect(self, sink: TraceSink) -> None:
        """Pass on the errors of the outputs at each evaluation since the last call."""
        if filled := self._struct.filled:
            sink.append_errors([str(p) for p in self._outputs], self.times[:filled], self.rows[:filled])
            self._struct.filled = 0

    def fill(self, binding: Binding) -> None:
        """Fill the C structures."""
        h = binding.h
        self._struct = self._system.struct(
            binding,
            members=binding.pointer(self._member_structs(binding)),
            inputs=binding.pointer(
                binding.array(h.ErrorInput, [self._input_struct(h, u) for u in self._inputs])
            ),
            **binding.all_at(self, "y squares largest times rows values lowest highest"),
            output_reads=binding.program(self._reads),
            member_count=len(self._members),
            output_count=len(self._outputs),
            lag=1,
            halves=any(c.struct.halved for c in self._network.components.values()),
            longest_section=LONGEST_SECTION,
            capacity=BLOCK,
            longest_lag=LONGEST_LAG,
            sample=self._sample,
        )
        binding.simulation.errors = binding.pointer(self._struct)

    def _input_struct(self, h: Any, u: LinearInput) -> Any:
        if u.coupling_input is None:  # the FMU varies it
            return h.ErrorInput(input=-1)
        target = self._network.components[u.target.component].struct
        return h.ErrorInput(input=u.coupling_input, substeps=2 if target.halved else target.substeps)

    def _member_structs(self, binding: Binding) -> Any:
        """An array with an `ErrorMember` of engine.h for each component."""
        index, member = {p: i for i, p in enumerate(self._outputs)}, binding.h.ErrorMember
        first_state = first_input = first_output = 0
        structs = binding.array(member, [member()] * len(self._members))
        self._reads = list[Call]()
        for i, (k, linear) in enumerate(zip(self._members, self._system.linearised, strict=True)):
            slave, states, inputs = self._slaves[k], linear.states, linear.inputs
            others = self._other_connections(slave.name, set(inputs), index)
            outputs = [p.variable for p in self._outputs if p.component == slave.name]
            knowns = [*states, *inputs, *(c.target.variable for c in others)]
            own = slice(first_output, first_output + len(outputs))
            seed, result = np.zeros(len(knowns)), self.y[own]
            self._reads += calls_by_type(slave, outputs, self.values[own], slave.reader)
            structs[i] = member(
                first_state=first_state,
                state_count=len(states),
                first_input=first_input,
                input_count=len(inputs),
                copy_count=len(others),
                to=binding.at(np.arange(len(knowns) - len(others), len(knowns), dtype=np.int32)),
                factors=binding.at(np.array([c.map.factor for c in others])),
            )
            setattr(structs[i], "from", binding.at(np.array([index[c.source] for c in others], np.int32)))
            call = slave.directional_derivative(outputs, knowns, seed, result)
            binding.fill_derivative(structs[i].outputs, call, seed, result)
            first_state += len(states)
            first_input += len(inputs)
            first_output += len(outputs)
        return structs

    def _other_connections(
        self, component: str, inputs: set[str], index: dict[Port, int]
    ) -> list[Connection]:
        """Connections to continuous inputs of a component that influence no state."""
        variable = self._network.system.variable
        return [
            c
            for c in self._network.connections
            if c.target.component == component and c.target.variable not in inputs
            if c.source in index and variable(c.target).is_continuous
        ]
