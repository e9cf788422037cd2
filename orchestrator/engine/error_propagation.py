"""Preparation of the error estimate of a run: errors of inputs, carried through the linearised system.

native/error_propagation.c has the equations and solves them at every step.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.c_library import Binding
from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.linear_prediction import LinearInput, LinearSystem
from orchestrator.engine.network import Network
from orchestrator.engine.result import EstimatedError
from orchestrator.ssp.system import Connection, Port

LONGEST_LAG = 20  # number of steps between two linearisations, at most
LONGEST_SECTION = 16  # number of steps over which errors are advanced at once, at most
STAGES = 8  # vectors of the states that C uses as working memory
BLOCK = 256  # evaluations of the outputs between two calls of `collect`, at most


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
        self._system = LinearSystem(n, m := len(self._inputs))
        wide, broad = self._system.n_padded, self._system.m_padded
        self.e, self.stages, self.factors = np.zeros(wide), np.zeros((STAGES, wide)), np.zeros((n, wide))
        self.w, self.middle, self.diagonal = np.zeros(broad), np.zeros(broad), np.zeros(n)
        self.defects, self.lengths, self.starts = np.zeros((m, 2)), np.zeros(3), np.zeros(2)
        self._outputs = [
            Port(name, v.name)
            for name, slave in network.slaves.items()
            if name in members
            for v in slave.interface.of("output")
            if v.is_continuous
        ]
        self.y, self.squares, self.largest = (np.zeros(len(self._outputs)) for _ in range(3))
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
                source_component = components.index(c.source.component) if c else -1
                source, factor = (c.source, c.map.factor) if c else (None, 0.0)
                yield LinearInput(port, source, factor, source_component, coupling.get(port))

    def _connect(self) -> None:
        """Make the directional derivatives, and try them."""
        n = self._system.n
        self._system.connect(self._network, self._members, self._inputs, np.zeros(n), np.zeros(n))
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
        self._struct = h.ErrorPropagation(
            system=self._system.system_struct(binding),
            members=binding.pointer(binding.array(h.ErrorMember, list(self._member_structs(binding)))),
            inputs=binding.pointer(
                binding.array(h.ErrorInput, [self._input_struct(h, u) for u in self._inputs])
            ),
            **binding.all_at(self, "e stages factors w middle defects y squares largest lengths diagonal"),
            **binding.all_at(self, "starts times rows"),
            member_count=len(self._members),
            output_count=len(self._outputs),
            lag=1,
            halves=any(c.halved for c in self._network.components.values()),
            longest_section=LONGEST_SECTION,
            capacity=BLOCK,
            longest_lag=LONGEST_LAG,
            sample=self._sample,
        )
        binding.simulation.errors = binding.pointer(self._struct)

    def _input_struct(self, h: Any, u: LinearInput) -> Any:
        if u.coupling_input is None:  # the FMU varies it
            return h.ErrorInput(input=-1)
        target = self._network.components[u.target.component]
        return h.ErrorInput(input=u.coupling_input, substeps=2 if target.halved else target.substeps)

    def _member_structs(self, binding: Binding) -> Iterator[Any]:
        """An `ErrorMember` of engine.h for each component."""
        index = {p: i for i, p in enumerate(self._outputs)}
        first_state = first_input = first_output = 0
        for k in self._members:
            slave = self._slaves[k]
            states, inputs = list(slave.interface.states), self._inputs_of(slave.name)
            others = self._other_connections(slave.name, set(inputs), index)
            outputs = [p.variable for p in self._outputs if p.component == slave.name]
            knowns = [*states, *inputs, *(c.target.variable for c in others)]
            seed, result = np.zeros(len(knowns)), self.y[first_output : first_output + len(outputs)]
            struct = binding.h.ErrorMember(
                first_state=first_state,
                state_count=len(states),
                first_input=first_input,
                input_count=len(inputs),
                copy_count=len(others),
                to=binding.at(np.arange(len(knowns) - len(others), len(knowns), dtype=np.int32)),
                factors=binding.at(np.array([c.map.factor for c in others])),
            )
            setattr(struct, "from", binding.at(np.array([index[c.source] for c in others], np.int32)))
            call = slave.directional_derivative(outputs, knowns, seed, result)
            binding.fill_derivative(struct.outputs, call, seed, result)
            yield struct
            first_state += len(states)
            first_input += len(inputs)
            first_output += len(outputs)

    def _inputs_of(self, component: str) -> list[str]:
        return [u.target.variable for u in self._inputs if u.target.component == component]

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
