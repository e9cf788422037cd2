"""A running system: its components, the values of all signals, and the calls that exchange them.

A component is an FMU with the calls that step it, set its inputs and read its outputs. All Real variables
that are exchanged or recorded are in one float64 array, all Integer, Enumeration and Boolean variables in one
int64 array. A component's variables that are read (or set) together are contiguous, so that each get or set
is one call into the FMU on a slice. The exchange at a communication point runs through the stages of
`dependencies.output_order`: read the outputs of the stage, copy them along the connections, set the inputs
that they feed. `initialise` makes the values consistent before the run.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.text import grouped
from orchestrator.engine.algebraic_loop import AlgebraicLoop, solver
from orchestrator.engine.c_library import Binding
from orchestrator.engine.scenario import DrivenInputs, Scenario
from orchestrator.fmi.calls import TEXTS, Buffer, Call, Slave, StepCalls, calls_by_type, set_starts
from orchestrator.fmi.description import Value
from orchestrator.ssp.dependencies import (
    DependencyCycle,
    OutputOrder,
    influential_inputs,
    initial_groups,
    output_order,
)
from orchestrator.ssp.system import Connection, Port, System


class RunningComponent:
    """A component as a master uses it: the Python side of `Component` in engine.h.

    slave          the FMU
    struct         `Component` of engine.h: its steps, what it saves; `busy`: wall time in its steps, with the
                   calls that set its coupling inputs [s]
    stepping       the calls by which C steps the FMU; None if Python does
    inputs         indices of its coupling inputs, which are contiguous
    values         of the coupling inputs that are set as values; empty if only derivatives are set
    derivatives    of the coupling inputs, those of one input by ascending order
    input_writes   calls that set `values`, if there are any, and `derivatives`
    output_reads   calls that read the outputs that other components use
    slope_reads    calls that read the slopes of those outputs, if the FMU gives them
    simplified     coupling inputs of which the FMU follows a lower degree than the master asks for
    held_inputs    calls that set the inputs that cannot change inside a step to the newest value of their
                   source, for sequential masters
    """

    def __init__(self, slave: Slave, struct: Any) -> None:
        self.slave, self.struct = slave, struct
        self.inputs, self.simplified = range(0), set[str]()
        self.output_reads: Sequence[Call] = ()
        self.slope_reads: Sequence[Call] = ()
        self.held_inputs: Sequence[Call] = ()
        self.values, self.derivatives = np.zeros(0), np.zeros(0)
        self.input_writes: list[Call] = []
        self._saved_state: Any = None
        self.stepping: StepCalls | None = None

    def make_input_writes(self, first: int, names: Sequence[str], inputs: Sequence[Any], jumps: bool) -> None:
        """Make the calls that set its coupling inputs.

        first    index of its first coupling input among those of all components
        names    the variables
        inputs   the `CouplingInput` of engine.h of each variable
        jumps    the inputs may be discontinuous at the start of a step of the FMU, so that values must be
                 set, not only derivatives; as where it goes on after an event inside of a step
        """
        self.inputs = range(first, first + len(inputs))
        if not inputs:
            return
        pairs = zip(names, inputs, strict=True)
        self.simplified = {n for n, s in pairs if s.fmu_degree < s.requested_degree}
        if self.struct.substeps > 1 or self.simplified or jumps or getattr(self.slave, "event_mode", False):
            # degree 0: the input is only watched and held over the step; other calls set it
            with_values = [n for n, s in zip(names, inputs, strict=True) if s.requested_degree]
            self.values = np.zeros(len(with_values))
            self.input_writes += calls_by_type(self.slave, with_values, self.values, self.slave.writer)
        degrees = {n: min(s.fmu_degree, s.requested_degree) for n, s in zip(names, inputs, strict=True)}
        derivatives = [(name, k + 1) for name, degree in degrees.items() for k in range(degree)]
        self.derivatives = np.zeros(len(derivatives))
        self._add_derivative_writes(derivatives)

    def _add_derivative_writes(self, derivatives: Sequence[tuple[str, int]]) -> None:
        """Add calls that set derivatives, given by name and order.

        If rate inputs take the derivatives, those of different FMI types need separate calls.
        """
        if not derivatives:
            return
        slave, interface = self.slave, self.slave.interface
        names, orders = zip(*derivatives, strict=True)
        if interface.can_interpolate_inputs:
            self.input_writes.append(slave.input_derivative_writer(names, self.derivatives, orders))
            return
        of_rate = {interface.rate_inputs[name]: name for name in names}

        def write(rates: Sequence[str], values: Buffer) -> Call:
            return slave.input_derivative_writer([of_rate[rate] for rate in rates], values)

        self.input_writes += calls_by_type(slave, [*of_rate], self.derivatives, write)

    # ---- the structure of the C engine

    def fill_stepping(self, binding: Binding) -> None:
        """Fill the members for stepping the FMU. Python steps it if its class has no `stepping`."""
        struct = self.struct
        make: Callable[[bool], StepCalls] | None = getattr(self.slave, "stepping", None)
        if make:
            self.stepping = step = make(bool(struct.rollback))
            struct.call = binding.pointer(step.slot)
            for name, value in step.members.items():
                setattr(struct, name, value)
        struct.clock = binding.at(np.asarray(self.slave.log.clock))
        struct.never_restored = not struct.rollback

    def fill_inputs_and_outputs(self, binding: Binding) -> None:
        """Fill the members for inputs and outputs."""
        struct = self.struct
        struct.first_input, struct.input_count = self.inputs.start, len(self.inputs)
        struct.sets_values = len(self.values) > 0
        struct.values, struct.derivatives = binding.at(self.values), binding.at(self.derivatives)
        for name in ("input_writes", "output_reads", "held_inputs", "slope_reads"):
            setattr(struct, name, binding.program(getattr(self, name)))

    def check_status(self, function: int | None, status: int) -> None:
        """Raise the Problem for a status that is not OK.

        function   address of the FMI function that returned it: get state or set state; None: a step
        """
        assert self.stepping is not None
        self.stepping.checks[function or 0](status)

    # ---- saved state; C saves and restores that of a component that it steps

    def save(self) -> None:
        """Save the state of a component that Python steps."""
        self._saved_state = self.slave.save(self._saved_state)

    def restore(self) -> None:
        """Restore the saved state."""
        self.slave.restore(self._saved_state)

    def free_saved_state(self) -> None:
        """Free the state that C or Python saved, if there is one."""
        if self.struct.state:
            self._saved_state, self.struct.state = ctypes.c_void_p(self.struct.state), None
        if self._saved_state is not None:
            self.slave.free_state(self._saved_state)
            self._saved_state = None


@dataclass(frozen=True)
class Block:
    """A slice of an array: variables of one component, one FMI type, and the same stages of the exchange.

    They belong to the same clocks, if they belong to any.

    stages   none for variables of algebraic loops, scenarios and clocks, which others read and set
    first    index of the first variable
    """

    component: str
    stages: tuple[int, ...]
    ports: tuple[Port, ...]
    first: int


class SignalArray:
    """An array of signal values, and the index of each port in it."""

    def __init__(self, name: str, dtype: Any) -> None:
        self.name = name
        self.blocks: list[Block] = []
        self.index: dict[Port, int] = {}
        self.values: Buffer = np.zeros(0, dtype)

    def add(
        self,
        system: System,
        stages: Mapping[Port, tuple[int, ...]],
        kind: Callable[[Port], tuple[bool, ...]] = lambda _: (),
    ) -> list[Block]:
        """Append ports, grouped into blocks, by stages and kind."""

        def group_of(port: Port) -> tuple[Any, ...]:
            variable = system.variable(port)
            return port.component, variable.function_type, stages[port], variable.clocks, kind(port)

        blocks = []
        for (component, _, same, *_), ports in grouped(_by_array(system, stages), group_of).items():
            blocks.append(Block(component, same, tuple(ports), len(self.index)))
            self.index.update({port: len(self.index) + i for i, port in enumerate(ports)})
        self.blocks += blocks
        self.values = np.append(self.values, np.zeros(len(stages), self.values.dtype))
        return blocks

    def slice(self, block: Block) -> Buffer:
        """The values of one block, as a view."""
        return self.values[block.first : block.first + len(block.ports)]

    def indices(self, ports: Iterable[Port]) -> NDArray[np.int64]:
        """The indices of ports, shape (n,)."""
        return np.array([self.index[p] for p in ports], dtype=np.int64)


def _by_array(system: System, ports: Iterable[Port]) -> list[Port]:
    """The ports, with all elements of an array at the first of them, in order: FMUs take them whole."""
    found = [*ports]
    variables = {p: system.variable(p) for p in found}
    if not any(v.array for v in variables.values()):
        return found
    of_array = grouped(found, lambda p: (p.component, (variables[p].array or variables[p]).name))
    return [p for same in of_array.values() for p in sorted(same, key=lambda p: variables[p].position)]


Blocks = list[tuple[SignalArray, Block]]


class Network:
    """The FMUs of a system, the arrays of their values, and the calls of an exchange.

    binding          the C library and the objects that it refers to
    components       by name
    driven           the inputs that a scenario drives; rates: their rate inputs, and they themselves
    reals, integers  arrays of the Real values, and of all others (Integer, Enumeration, Boolean)
    input_ends       shape (2, Real values): coupling inputs at both ends of a step; NaN for other signals
    passed           inputs of the system that its outputs pass on, with their start values
    connections      connections to inputs
    loops            potential algebraic loops
    exchange_calls   all calls of one exchange, in order, except `first_reads`, of the outputs of stage 0, and
                     those that set the driven inputs after them
    with_events      components whose FMUs take inputs that are not continuous in event mode
    instant_calls    calls that set inputs that are not continuous, for FMUs that take them in event mode only
    discrete         array -> those inputs, and others that are not continuous and influence a state; and
                     their values at the last instant; changes: places of those that have changed
    """

    def __init__(
        self,
        system: System,
        slaves: Mapping[str, Slave],
        scenario: Scenario | None = None,
        recorded: Iterable[Port] | None = None,
        substeps: Mapping[str, int] | None = None,
        binding: Binding | None = None,
        events: bool = False,
    ) -> None:
        """recorded: ports that are recorded, connected or not; default: all outputs and all exposed inputs.

        substeps: how many steps components take in one communication step; default: 1.
        events: FMUs with event mode take inputs that are not continuous there, see `events.Instants`.
        """
        self.system, self.slaves, self.binding = system, slaves, binding or Binding()
        made = [self.binding.h.Component(substeps=(substeps or {}).get(name, 1)) for name in slaves]
        self._structs = self.binding.array(self.binding.h.Component, made)
        self.components = {
            name: RunningComponent(slave, self._structs[k]) for k, (name, slave) in enumerate(slaves.items())
        }
        self._influential = influential_inputs(system)
        self.with_events = {n for n, s in slaves.items() if events and getattr(s, "event_mode", False)}
        numbers = [c for c in system.connections if system.variable(c.source).is_number]
        self.connections = [c for c in numbers if system.variable(c.target).causality == "input"]
        self.reals, self.integers = SignalArray("reals", np.float64), SignalArray("integers", np.int64)
        self.rates = scenario.rates(system) if scenario else {}
        driven = [*scenario.columns, *self.rates] if scenario else []
        self.order: OutputOrder = output_order(system, driven)
        self._stages = max(self.order.count, 2 if driven else 1)
        output_blocks, input_blocks = self._allocate(recorded, driven)
        self.passed = system.passed_starts(scenario.passed if scenario else ())
        for port, value in self.passed.items():
            self._array(port).add(system, {port: ()})
            self._array(port).values[-1] = value
        self._blocks = [(array, block) for array in (self.reals, self.integers) for block in array.blocks]
        self._block_of = {port: i for i, (_, block) in enumerate(self._blocks) for port in block.ports}
        self.input_ends = np.full((2, len(self.reals.values)), np.nan)
        self.texts = Texts(system, slaves)
        self.loops = [AlgebraicLoop(self.binding, slaves, cycle) for cycle, _ in self.order.cycles]
        self.first_reads = [self._get_call(array, b) for array, b in output_blocks if 0 in b.stages]
        self.exchange_calls = self._exchange(output_blocks, input_blocks)
        self.driven: DrivenInputs | None = None
        inputs = [*(c.target for c in self.connections), *driven]
        held = [p for p in inputs if self._is_held(p) and not self._clocked(p)]
        texts = [c.target for c in system.connections if system.variable(c.source).kind in TEXTS]
        self.held_values = {p for p in (*inputs, *texts) if self._clocked(p)}
        self.instant_calls = [self._set_call(*block) for block in self._blocks_of(set(held))]
        others = [
            c.target for c in self.connections if not (system.is_continuous(c) or self._clocked(c.target))
        ]
        watched = dict.fromkeys([*held, *(p for p in others if p in self._influential)])
        self.discrete = {}
        for array in (self.reals, self.integers):
            ports = [p for p in watched if p in array.index]
            self.discrete[array.name] = ports, np.zeros(len(ports), array.values.dtype)
        self.changes = np.zeros(len(watched), np.int32)
        if scenario:
            calls = self.set_calls({p for p in (*scenario.columns, *self.rates) if not self._is_held(p)})
            self.driven = DrivenInputs(scenario, system, self.reals.index, self.integers.index, calls)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the exchange for the user."""
        of_fmus = [note for slave in self.slaves.values() for note in getattr(slave, "notes", ())]
        return (*self.order.notes, *(loop.note for loop in self.loops), *of_fmus)

    def is_influential(self, port: Port) -> bool:
        """Does a state depend on this input, directly or through other components?"""
        return port in self._influential

    def _is_held(self, port: Port) -> bool:
        """Does its FMU take an input or parameter in event mode only?"""
        return port.component in self.with_events and not self.system.variable(port).is_continuous

    def _clocked(self, port: Port) -> bool:
        """Is a variable set or read only while its clock ticks, see `clocks`?"""
        return self.system.variable(port).clocked

    def store(self, port: Port, value: Value, ticks: bool = False) -> None:
        """Store the value of a signal; ticks: a text, at a tick of its clock."""
        if not self.system.variable(port).is_number:
            self.texts.store(port, str(value), self.slaves[port.component].log.time, ticks)
        elif (at := self._array(port).index.get(port)) is not None:
            self._array(port).values[at] = value

    # ---- calls

    def connected_outputs(self, component: str) -> set[Port]:
        """The outputs of a component that feed inputs."""
        of = {c.source for c in self.connections if c.source.component == component}
        return {port for port in of if not self._clocked(port)}

    def copy_and_set_calls(self, connections: Sequence[Connection]) -> list[Any]:
        """Calls that copy values along connections and set the inputs."""
        return [*self.copies(connections), *self.set_calls({c.target for c in connections})]

    def get_calls(self, ports: set[Port]) -> list[Call]:
        """Calls that read the blocks with these ports."""
        return [self._get_call(*block) for block in self._blocks_of(ports)]

    def set_calls(self, ports: set[Port]) -> list[Call]:
        """Calls that set the blocks with these ports."""
        return [self._set_call(*block) for block in self._blocks_of(ports)]

    def _blocks_of(self, ports: set[Port]) -> Blocks:
        """The blocks with these ports, in the order of the arrays."""
        return [self._blocks[i] for i in sorted({self._block_of[p] for p in ports if p in self._block_of})]

    def value(self, port: Port) -> float:
        """The value of a number."""
        value: float = (array := self._array(port)).values[array.index[port]].item()
        return value

    def together(self, port: Port) -> tuple[Port, ...]:
        """The variables that are set in one call with a variable."""
        return self._blocks[self._block_of[port]][1].ports if port in self._block_of else (port,)

    def _array(self, port: Port) -> SignalArray:
        return self.reals if self.system.variable(port).is_real else self.integers

    def _get_call(self, array: SignalArray, block: Block) -> Call:
        return self.slaves[block.component].reader([p.variable for p in block.ports], array.slice(block))

    def _set_call(self, array: SignalArray, block: Block) -> Call:
        return self.slaves[block.component].writer([p.variable for p in block.ports], array.slice(block))

    def copies(self, connections: Iterable[Connection]) -> list[Any]:
        """Instructions that copy values along connections."""
        by_types = grouped(connections, lambda c: (self._array(c.source).name, self._array(c.target).name))
        return [self._copy(by_types[types]) for types in sorted(by_types, reverse=True)]

    def _copy(self, connections: Sequence[Connection]) -> Any:
        """The instruction that copies values along connections, without factors and offsets of identities."""
        source, target = self._array(connections[0].source), self._array(connections[0].target)
        binding, at, dtype = self.binding, self.binding.at, target.values.dtype
        maps = {
            "factor": np.array([c.map.factor for c in connections]).astype(dtype),
            "offset": np.array([c.map.offset for c in connections]).astype(dtype),
        }
        identity = np.all(maps["factor"] == 1) and np.all(maps["offset"] == 0)
        struct = binding.h.ConnectionCopy(
            source=at(source.indices(c.source for c in connections)),
            target=at(target.indices(c.target for c in connections)),
            **({} if identity else {name: at(values) for name, values in maps.items()}),
            table=binding.value_table(
                (source.index[c.source], target.index[c.target], c.map) for c in connections
            ),
            count=len(connections),
            array=binding.array_of(target.values) if source is target else binding.h.WIDENED,
        )
        return binding.h.Instruction(binding.h.COPY, 0, binding.pointer(struct))

    def _allocate(self, recorded: Iterable[Port] | None, driven: Iterable[Port]) -> tuple[Blocks, Blocks]:
        """Assign indices to outputs, recorded ports and fed inputs; returns the blocks to read and to set."""
        requested = set(self.order.stages if recorded is None else recorded)
        requested |= {c.source for c in self.connections}
        numeric = {p for p in requested if self.system.variable(p).is_number}
        outputs = {p: stages for p, stages in self.order.stages.items() if p in numeric}
        inputs = {c.target: self.order.stages[c.source] for c in self.connections}
        loops = [c for cycle, _ in self.order.cycles for c in cycle.connections]
        outputs |= dict.fromkeys((c.source for c in loops), ())
        inputs |= dict.fromkeys((*(c.target for c in loops), *driven), ())
        read = [o.source for o in self.system.outputs.values() if o.source.component]  # also local variables
        others = [*self.system.exposed, *read] if recorded is None else recorded
        others = [p for p in others if self.system.variable(p).is_number]
        given, last = {*self.system.ports("input")}, self._stages - 1
        outputs |= {p: (0 if p in given else last,) for p in others if p not in outputs and p not in inputs}
        for of in (outputs, inputs):
            of |= dict.fromkeys(filter(self._clocked, of), ())
        driven = {*driven}

        def kind(port: Port) -> tuple[bool, bool]:
            return self._is_held(port), port in driven

        output_blocks, input_blocks = Blocks(), Blocks()
        for array in (self.reals, self.integers):
            for stages, blocks in ((outputs, output_blocks), (inputs, input_blocks)):
                of_array = {p: same for p, same in stages.items() if self._array(p) is array}
                blocks += [(array, b) for b in array.add(self.system, of_array, kind)]
        return output_blocks, input_blocks

    def _exchange(self, output_blocks: Blocks, input_blocks: Blocks) -> list[Any]:
        """All calls of one exchange, in order."""
        calls: list[Any] = []
        loop_inputs = {c.target for loop in self.loops for c in loop.cycle.connections}
        connections = [
            c for c in self.connections if c.target not in loop_inputs and not self._clocked(c.target)
        ]
        for loop in self.loops:
            loop.set_indices(self.reals.indices(loop.inputs), self.reals.indices(loop.outputs))
        for stage in range(self._stages):
            calls += [self._get_call(array, b) for array, b in output_blocks if stage and stage in b.stages]
            loops_with_stages = zip(self.loops, self.order.cycles, strict=True)
            calls += [loop.instruction for loop, (_, stages) in loops_with_stages if stage in stages]
            calls += self.copies([c for c in connections if stage in self.order.stages[c.source]])
            inputs = [(array, b) for array, b in input_blocks if not self._is_held(b.ports[0])]
            calls += [self._set_call(array, b) for array, b in inputs if stage in b.stages]
        return [*calls, self.texts.exchange] if self.texts.plain else calls

    # ---- C

    def fill(self) -> None:
        """Fill the C structures: components, values, exchange and algebraic loops."""
        binding, sim = self.binding, self.binding.simulation
        saved_reals, saved_integers = self.reals.values.copy(), self.integers.values.copy()
        binding.components = [*self.components.values()]
        for component in binding.components:
            component.fill_stepping(binding)
        sim.components, sim.component_count = binding.pointer(self._structs), len(self.components)
        sim.reals, sim.integers = binding.at(self.reals.values), binding.at(self.integers.values)
        sim.saved_reals, sim.saved_integers = binding.at(saved_reals), binding.at(saved_integers)
        sim.real_count, sim.integer_count = len(saved_reals), len(saved_integers)
        sim.input_ends = binding.at(self.input_ends)
        sim.first_reads, sim.exchange = map(binding.program, (self.first_reads, self.exchange_calls))
        sim.loops = binding.at(np.array([loop.address for loop in self.loops], np.uint64))
        sim.loop_count = len(self.loops)
        sim.events.changes = binding.at(self.changes)
        for array in (self.reals, self.integers):
            ports, values = self.discrete[array.name]
            kind = array.name.removesuffix("s")
            setattr(sim.events, f"{kind}_targets", binding.at(array.indices(ports)))
            setattr(sim.events, array.name, binding.at(values))
            setattr(sim.events, f"{kind}_count", len(ports))
        # slopes of outputs of each stage need those of the one before
        sim.initial_rounds = self.order.count + 1

    def free_saved_states(self) -> None:
        """Free the states that were saved for a rollback."""
        for component in self.components.values():
            component.free_saved_state()


class Texts:
    """Signals that are texts, of type String or Binary: they are copied when they change.

    wires      output -> the inputs that it feeds; plain: of those that belong to no clock
    last       output -> its last value
    changes    time [s], output and value of each change so far, and of each tick of the clock of an output
    of_ticks   output -> place in `changes` of its value at the present tick
    """

    def __init__(self, system: System, slaves: Mapping[str, Slave]) -> None:
        of = grouped(system.connections, lambda c: c.source)
        texts = [p for p in system.ports("output") if system.variable(p).kind in TEXTS]
        outputs = [p for p in texts if p in of or slaves[p.component].reads(system.variable(p))]
        self._system, self._slaves = system, slaves
        self.wires = {p: [c.target for c in of.get(p, ())] for p in outputs}
        self.plain = {p: to for p, to in self.wires.items() if not system.variable(p).clocked}
        self.last = dict[Port, str]()
        self.changes, self.of_ticks = list[tuple[float, str, str]](), dict[Port, int]()

    def store(self, port: Port, value: str, t: float, ticks: bool = False) -> None:
        """Store a value, and set the inputs that belong to no clock, if it is another one.

        ticks   its clock ticks: it has one value then, the last one that is stored
        """
        same = self.last.get(port) == value
        if port in self.of_ticks:
            self.changes[self.of_ticks[port]] = t, str(port), value
        elif port in self.wires and (ticks or not same):
            self.of_ticks |= {port: len(self.changes)} if ticks else {}
            self.changes.append((t, str(port), value))
        if same:
            return
        self.last[port] = value
        for target in self.wires.get(port, ()):
            if not self._system.variable(target).clocked:
                self._slaves[target.component].set(target.variable, value)

    def exchange(self) -> None:
        """Read and store the outputs that belong to no clock."""
        for port in self.plain:
            slave = self._slaves[port.component]
            self.store(port, str(slave.get(port.variable)), slave.log.time)

    def withdraw(self, t: float) -> None:
        """Forget what has changed after a time [s], in a step that is repeated."""
        withdrawn = set[str]()
        while self.changes and self.changes[-1][0] > t:
            withdrawn.add(self.changes.pop()[1])
        for name in withdrawn:
            port = self._system.port(name)
            del self.last[port]
            self.last |= next(({port: value} for _, n, value in reversed(self.changes) if n == name), {})


# ---- initialisation


def initialise(
    system: System,
    slaves: Mapping[str, Slave],
    driven: Mapping[Port, Value],
    span: tuple[float, float],
    tolerances: Mapping[str, float | None] | None = None,
) -> None:
    """Initialise all FMUs, which are instantiated.

    driven       input -> value at the start time, for inputs that a scenario drives
    span         start and stop time [s]
    tolerances   component -> tolerance of the solver in its FMU
    """
    system.check_sizes(driven)
    for name, slave in slaves.items():
        # the sum of equal steps may be carried by rounding beyond the true stop time
        stop = span[1] if slave.interface.variable_step else span[1] + 4.0 * math.ulp(span[1])
        slave.setup(span[0], stop, tolerances.get(name) if tolerances else None)
        # some FMUs compute start values when they enter initialisation mode
        begin = {p.variable: value for p, value in driven.items() if p.component == name}
        set_starts(slave, system.components[name].with_start(begin, "").whole_start)
    for slave in slaves.values():
        slave.enter()
    _set(slaves, driven)
    propagate(system, slaves)
    for slave in slaves.values():
        slave.exit()


def _set(slaves: Mapping[str, Slave], values: Mapping[Port, Value]) -> None:
    for port, value in values.items():
        slaves[port.component].set(port.variable, value)


def propagate(system: System, slaves: Mapping[str, Slave]) -> None:
    """Copy outputs to the inputs that they feed, in the order of the dependencies in initialisation mode.

    Algebraic loops are solved as in the run, see `AlgebraicLoop`.
    """
    clocked = {p for c in system.connections for p in (c.source, c.target) if system.variable(p).clocked}
    wires = [c for c in system.connections if not clocked & {c.source, c.target}]
    connections = grouped(wires, lambda c: c.source)
    for group, cycle in initial_groups(system):
        outputs = [y for y in group if y in connections]
        if cycle:
            others = {y: [c for c in connections[y] if c not in cycle.connections] for y in outputs}
            _solve(slaves, cycle, others)
        else:
            for y in outputs:
                _copy(slaves, y, connections[y])


def _solve(
    slaves: Mapping[str, Slave], cycle: DependencyCycle, others: Mapping[Port, list[Connection]]
) -> None:
    """Solve for the Real signals of a cycle; repeat until its other signals do not change any more.

    others   output of the cycle -> its connections that are not solved for
    """
    solve = solver(slaves, cycle) if cycle.connections else None
    previous: dict[Port, Value] = {}
    for _ in range(1 if cycle.rounds == 1 else len(others) + 1):
        if solve:
            solve()
        current = {y: _copy(slaves, y, connections) for y, connections in others.items()}
        if previous and all(_equal(previous[y], value) for y, value in current.items()):
            return
        previous = current
    if cycle.rounds > 1 and cycle.declared:
        raise Problem(f"the initialisation does not converge: {cycle.text}")


def _equal(old: Value, new: Value) -> bool:
    """Whether two values are equal, except for the tolerance of an FMU that iterates inside."""
    return old == new or (isinstance(new, float) and math.isclose(float(old), new, rel_tol=1e-10))


def _copy(slaves: Mapping[str, Slave], source: Port, connections: list[Connection]) -> Value:
    """Read one output and set the inputs that it feeds; returns the value of the output."""
    value = slaves[source.component].get(source.variable)
    if not isinstance(value, str) and math.isnan(value):
        raise Problem(f"{source}: expected a number in initialisation mode, got {value!r}")
    for c in connections:
        target = slaves[c.target.component]
        target.set(c.target.variable, c.carried(value, target.interface.variables[c.target.variable]))
    return value
