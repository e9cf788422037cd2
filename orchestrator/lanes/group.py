"""Machines in the lanes of a core: how the models of a system are coupled, and groups of machines.

native/machines.cpp steps a group by the plan of the engine's master. What lanes do not have raises
`NotInLanes`: other FMUs than native ones, algebraic loops, the master interface-jacobian.
"""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.processes import available_cores
from orchestrator.base.progress import doing
from orchestrator.data.table import Array
from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.job import Job, open_slave
from orchestrator.engine.network import Network
from orchestrator.engine.result import BondEnergy, energies_above, unreliable_energies
from orchestrator.engine.scenario import DrivenInputs
from orchestrator.engine.simulation_loop import bonds_of, step_control
from orchestrator.lanes.compiled import LANES, Model, NotInLanes, compiled_model, header, machines_library
from orchestrator.ssp.masters import Plan
from orchestrator.ssp.system import Component, Connection, Port, System

ALIGNMENT = 64  # bytes, of a vector
# members of a coupling input that any number of machines have in common
COMMON = ("source_component", "order", "autonomous", "noisy", "factor", "offset", "scale")
COMPILING = "compiling the FMUs for this processor, which is done once; lanes=False compiles nothing"


class Status(StrEnum):
    """How a run ended; EARLY: an FMU asked for the end, NOT_RELIABLE: it is complete."""

    OK = "ok"
    EARLY = "early"
    FAILED = "failed"
    NOT_RELIABLE = "unreliable"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Ended:
    """Why a machine ended early, or is not reliable; limit: time_limit or memory_limit, if that ended it."""

    status: Status
    reason: str
    limit: str = ""


def aligned(size: int) -> NDArray[np.uint8]:
    """Zeroed memory that begins at a multiple of the length of a vector."""
    memory = np.zeros(size + ALIGNMENT, np.uint8)
    offset = -memory.ctypes.data % ALIGNMENT
    return memory[offset : offset + size]


def vectors(*shape: int) -> Array:
    """Aligned zeros, one for each machine: shape (..., lanes)."""
    return aligned(8 * LANES * int(np.prod(shape))).view(np.float64).reshape(*shape, LANES)


class Instances:
    """The instances of all models for one group, in one memory of vectors.

    values, slopes, last_set   of each component, the index of its first one in the memory
    """

    def __init__(self, lanes: Lanes) -> None:
        """With the start values of the system."""
        self._lanes = lanes
        sizes = [model.struct.size for model in lanes.models]
        self.memory = aligned(sum(sizes))
        base = self.memory.ctypes.data
        create = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double)
        tolerance = lanes.job.options.tolerance or 0.0
        places = base + np.cumsum([0, *sizes[:-1]])
        pairs = zip(lanes.models, places.tolist(), strict=True)
        made = [create(model.struct.create)(place, tolerance) for model, place in pairs]
        self.addresses = np.array(made, np.uint64)
        structs = [header().Instance.from_address(int(address)) for address in self.addresses]
        self.values, self.slopes, self.last_set = (
            [(getattr(s, name) - base) // (8 * LANES) for s in structs]
            for name in ("values", "slopes", "last_set")
        )
        for name, component in lanes.system.components.items():
            for variable, value in component.start.items():
                self.set(Port(name, variable), float(value))
        self.defaults = self.memory.copy()

    def set(self, port: Port, value: float | Array) -> None:
        """Set a parameter, an input or the start value of a state: one value, or shape (lanes,)."""
        k, reference = self._lanes.index[port.component], self._lanes.reference(port)
        model = self._lanes.models[k].struct
        number = reference - model.parameters
        places = [("values", reference)]
        if 0 <= number < model.inputs:
            places.append(("last_set", number))
        elif number >= 0:
            places.append(("start", number - model.inputs))
        instance = header().Instance.from_address(int(self.addresses[k]))
        for name, row in places:
            pointer = ctypes.cast(getattr(instance, name), ctypes.POINTER(ctypes.c_double))
            np.ctypeslib.as_array(pointer, (row + 1, LANES))[row] = value


def _compiled(components: Collection[Component], generated: bool) -> list[Model]:
    """The models, by several compilers at once, and a line if anything is to be compiled."""
    with ExitStack() as stack, ThreadPoolExecutor(available_cores()) as threads:
        first = Lock()

        def begin() -> None:
            if first.acquire(blocking=False):
                stack.enter_context(doing(COMPILING))

        return list(threads.map(partial(compiled_model, begin=begin, generated=generated), components))


class Lanes:
    """A system in lanes: its models, and what all groups of machines have in common.

    job       the run of one machine
    signals   recorded variables
    models    compiled, by component; index: component -> its number
    places    index of each variable in the memory of `Instances`
    """

    def __init__(self, job: Job, signals: Sequence[Port], generated: bool = False) -> None:
        """Raises NotInLanes if the system or its coupling is not supported; generated: see `sources_of`."""
        self.job, self.system, self.times, self.signals = job, job.system, job.times, signals
        _check_coupling(job)
        self.models = _compiled(self.system.components.values(), generated)
        self.index = {name: k for k, name in enumerate(self.system.components)}
        with ExitStack() as stack:
            slaves = {}
            for name, component in self.system.components.items():
                slaves[name] = open_slave(component)
                stack.callback(slaves[name].close)
            self._network = Network(self.system, slaves, job.scenario, signals)
            self.at = self._network.binding.at
            if self._network.loops:
                raise NotInLanes(self._network.loops[0].cycle.text)
            self._instances = Instances(self)
            self.places = {
                Port(model.component, name): first + reference
                for model, first in zip(self.models, self._instances.values, strict=True)
                for name, reference in model.names.items()
            }
            self.plan = job.coupling.method.planned(self.system, job.coupling)
            self._inputs = CouplingInputs(self._network, self.plan)
            self.control = step_control(job)
            self.bonds = bonds_of(job, self._network)
            ports = [p for b in self.bonds for p in (b.effort, b.flow)]
            ends = np.array([self._input(p)[:2] for p in ports], np.int64).reshape(-1, 2)
            now, last = (self.at(np.ascontiguousarray(part)) for part in ends.T)
            varied = self.at(np.array([p in self._inputs.varying for p in ports], np.uint8))
            self._energy = {"indices": now, "read_indices": now, "set_indices": last, "varied": varied}
            self._energy["count"] = len(ports)
            self.inputs, self.slopes = self._coupling_inputs()
            self._make_programs()
            self.driven, self.scenario = self._scenario()

    def reference(self, port: Port) -> int:
        """The value reference of a variable."""
        return self.models[self.index[port.component]].names[port.variable]

    # ---- structures

    def _array(self, kind: Any, values: Sequence[Any]) -> int:
        """The address of an array of structures."""
        binding = self._network.binding
        return binding.pointer(binding.array(kind, values))

    def fill(self, group: Any) -> None:
        """Fill the members of `Group` of machines.h that are the same for all groups."""
        h, sim, plan, times = header(), group.sim, self.plan, self.times
        group.models = self.at(np.array([ctypes.addressof(m.struct) for m in self.models], np.uint64))
        group.wires, group.wire_count = self.wires, self.wire_count
        signals = [h.Signal(self.index[p.component], self.reference(p)) for p in self.signals]
        group.signals, group.signal_count = self._array(h.Signal, signals), len(signals)
        group.every = times.every
        for name, value in self._energy.items():
            setattr(sim.energy, name, value)
        sim.exchange, sim.initial_rounds = self.exchange, self._network.order.count + 1
        sim.component_count, sim.input_count = len(self.models), len(self.inputs)
        sim.order, sim.degree = self.at(np.array(plan.order, np.int32)), plan.degree
        sim.sequential, sim.passes, sim.tolerance = plan.sequential, plan.passes, plan.tolerance
        sim.error_tolerance, sim.saves = self.control.tolerance if self.control else 0.0, self.saves
        sim.divided, sim.divided_count = self.at(np.array(times.divided)), len(times.divided)
        sim.start, sim.step, sim.total = times.start, times.step, times.steps

    @property
    def saves(self) -> bool:
        """Are the states saved at the beginning of each step?"""
        return self.plan.passes > 1 or self.control is not None

    def step_sizes(self) -> Any:
        """The control of the steps of each machine of a new group; None: equal steps."""
        if (c := self.control) is None:
            return None
        struct = replace(c, repeats=True).struct(header(), self._inputs.power)
        return (header().StepSize * LANES)(*[struct] * LANES)

    def _input(self, port: Port) -> tuple[int, int, int]:
        """Index of an input in the memory, that of its last set value, number of its component."""
        k = self.index[port.component]
        number = self.reference(port) - self.models[k].struct.parameters
        return self.places[port], self._instances.last_set[k] + number, k

    def _wire(self, c: Connection, checked: bool = False) -> Any:
        ends = self.places[c.source], *self._input(c.target)
        return header().Wire(c.map.factor, c.map.offset, *ends, checked)

    def _coupling_inputs(self) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """The inputs that the master varies or watches, and the index of each source's slope; -1: none."""
        h, sources = header(), {c.target: c.source for c in self._network.connections}
        rows = np.zeros(len(self._inputs.inputs), np.dtype(h.CouplingInput))
        slopes = np.full(len(rows), -1)
        for i, (port, s) in enumerate(zip(self._inputs.ports, self._inputs.inputs, strict=True)):
            for name in COMMON:
                rows[name][i] = getattr(s, name)
            rows["target"][i] = self.places[port]
            rows["source"][i] = -1 if s.source < 0 else self.places[sources[port]]
            rows["slope_factor"][i] = s.slope_factor
            rows["fmu_degree"][i], rows["requested_degree"][i] = h.DEGREE, h.DEGREE * (s.requested_degree > 0)
            if wire := self._inputs.rate_wires.get(port):  # as in a run: the value of the rate output
                slopes[i] = self.places[wire.source]
            elif s.source_slope:
                source = sources[port]
                slopes[i] = self._instances.slopes[self.index[source.component]] + self.reference(source)
        return rows, slopes

    def _scenario(self) -> tuple[int, dict[str, Any]]:
        """The number of driven inputs, and the members of `Scenario` that are the same for all groups."""
        h = header()
        if self._network.driven is None:
            return 0, {}
        assert self.job.scenario is not None
        driven = DrivenInputs(self.job.scenario, self.system, self.places, {}, ())
        inputs = [self._inputs.ports.index(port) for port in driven.continuous]
        ports = [(port, False) for port in driven.continuous] + [(rate, True) for rate in self._network.rates]
        wires = [h.Wire(1.0, 0.0, 0, *self._input(port), checked) for port, checked in ports]
        program = self._program([h.Instruction(h.DRIVE, len(wires), self._array(h.Wire, wires))])
        return len(inputs), driven.members(self.at, inputs) | {"input_writes": program}

    # ---- the calls of a step

    def _program(self, instructions: Sequence[Any]) -> Any:
        return header().Program(len(instructions), self._array(header().Instruction, instructions))

    def _make_programs(self) -> None:
        """Make the programs of each component, and that of an exchange."""
        h, plan = header(), self.plan
        driven = self._network.driven
        if driven and driven.held:
            raise NotInLanes("the scenario drives inputs that are not continuous")
        instructions, wires = self._exchange()
        self.wires, self.wire_count = self._array(h.Wire, wires), len(wires)
        place = self.wires
        for instruction in instructions:
            if instruction.type == h.COPY:
                instruction.operand = place
                place += instruction.index * ctypes.sizeof(h.Wire)
        self.exchange = self._program(instructions)
        used = {self.index[port.component] for port in self._inputs.slope_outputs}
        held = self._inputs.held(plan.order) if plan.sequential else [[] for _ in self.models]
        self.programs = []
        for k, connections in enumerate(held):
            copied = self._array(h.Wire, [self._wire(c) for c in connections])
            programs = {
                "input_writes": [h.Instruction(h.FOLLOW, k)],
                "held_inputs": [h.Instruction(h.HOLD, len(connections), copied)],
                "slope_reads": [h.Instruction(h.SLOPES, k)] if k in used else [],
            }
            self.programs.append({name: self._program(calls) for name, calls in programs.items()})

    def components(self, values: Sequence[Array], derivatives: Sequence[Array]) -> Any:
        """The components of a group, as structures of engine.h."""
        targets = [self.index[port.component] for port in self._inputs.ports]
        first = np.searchsorted(targets, range(len(self.models) + 1))
        structs = (header().Component * len(self.models))()
        for k, struct in enumerate(structs):
            struct.first_input, struct.input_count = first[k], first[k + 1] - first[k]
            struct.substeps, struct.rollback, struct.repeated = 1, self.saves, k in self.plan.repeated
            struct.values, struct.derivatives = values[k].ctypes.data, derivatives[k].ctypes.data
            for name, program in self.programs[k].items():
                setattr(struct, name, program)
        return structs

    def _exchange(self) -> tuple[list[Any], list[Any]]:
        """The instructions of an exchange, and the wires in the order in which they are copied.

        A component computes its outputs again if an input on which they depend directly is not settled, when
        as many of its sources as possible are known.
        """
        h, network, system = header(), self._network, self.system
        source = {c.target: c.source for c in network.connections}
        settled, known = _settled(system, self.plan, self._inputs, network.rates)
        needed = {*source.values()} | {*network.order.stages}.intersection(self.signals)
        checked = {u for y in needed for u in _direct(system, y)} - settled
        pending, program, ordered = needed - known, list[Any](), list[Any]()

        def copy(outputs: set[Port]) -> None:
            copied = [c for c in network.connections if c.source in outputs]
            program.append(h.Instruction(h.COPY, len(copied)))
            ordered.extend(self._wire(c, c.target in checked) for c in copied)

        copy(known)
        while pending:
            waiting = {name: {y for y in pending if y.component == name} for name in self.index}
            ready = {
                name: {y for y in outputs if pending.isdisjoint(source.get(u) for u in _direct(system, y))}
                for name, outputs in waiting.items()
            }
            name = max(ready, key=lambda n: (len(ready[n]) > 0, ready[n] == waiting[n], len(ready[n])))
            program.append(h.Instruction(h.OUTPUTS, self.index[name]))
            pending -= ready[name]
            copy(ready[name])
        numbers = ((self.index[p.component], self.reference(p)) for p in self.signals)
        rates = {k for k, reference in numbers if self.models[k].is_derivative(reference)}
        return program + [h.Instruction(h.DERIVATIVES, k) for k in sorted(rates)], ordered


def _check_coupling(job: Job) -> None:
    """Raise NotInLanes for settings of the master that lanes do not have."""
    c = job.coupling
    reasons = {
        f"the master {c.method.name}": not c.method.lanes,
        "several steps of a component in a communication step": any(n > 1 for n in c.factors.values()),
        "adaptive steps without a record step": job.times.free,
    }
    if found := next((reason for reason, applies in reasons.items() if applies), None):
        raise NotInLanes(found)


def _direct(system: System, output: Port) -> list[Port]:
    """The inputs on which an output depends directly."""
    names = system.components[output.component].interface.direct_inputs(output.variable)
    return [Port(output.component, name) for name in names]


def _settled(
    system: System, plan: Plan, inputs: CouplingInputs, rates: Collection[Port]
) -> tuple[set[Port], set[Port]]:
    """Inputs that end a step at their final value, and outputs that depend directly on no others.

    These inputs are open, driven, or end at an output of this kind of a component that steps before.
    `rates` are inputs that get the slope of a driven one.
    """
    source = {c.target: c.source for c in system.connections}
    varied = inputs.varying - {*inputs.driven}
    names, settled, known, before = list(system.components), set[Port](), set[Port](), set[str]()
    for k in plan.order:
        interface = system.components[names[k]].interface
        for port in (Port(names[k], v.name) for v in interface.of("input")):
            moves = port.variable not in interface.model.held_inputs  # inside a step
            follows = port in varied and source[port].component in before and source[port] in known
            if port not in rates and (port not in source or (moves and (port in inputs.driven or follows))):
                settled.add(port)
        ports = (Port(names[k], name) for name in interface.variables)
        known |= {port for port in ports if settled.issuperset(_direct(system, port))}
        if plan.sequential:
            before.add(names[k])
    return settled, known


class Group:
    """Machines in lanes. `reset` chooses values of single machines; `begin` starts the run."""

    def __init__(self, lanes: Lanes) -> None:
        h, count = header(), lanes.inputs.size
        self.lanes, self._instances = lanes, Instances(lanes)
        base = self._instances.memory.ctypes.data
        self._inputs = aligned(lanes.inputs.nbytes).view(lanes.inputs.dtype)
        self._template = lanes.inputs.copy()
        slopes = base + 8 * LANES * lanes.slopes
        self._template["source_slope"] = np.where(lanes.slopes >= 0, slopes, 0)
        values, derivatives = ([vectors(n * max(count, 1)) for _ in lanes.models] for n in (1, h.DEGREE))
        self._components = lanes.components(values, derivatives)
        self._failures = (h.Failure * LANES)()
        self._changed = vectors(len(lanes.models))
        self._has_stepped = np.zeros(len(lanes.models), np.uint8)
        self._alive_arrays = values, derivatives
        self._memory = aligned(ctypes.sizeof(h.Group))
        self.struct = h.Group.from_buffer(self._memory)
        lanes.fill(self.struct)
        self.struct.instances = self._instances.addresses.ctypes.data
        self.struct.failures = ctypes.addressof(self._failures)
        self.struct.changed = self._changed.ctypes.data
        self._sim = self.struct.sim
        self._sim.reals, self._sim.inputs = base, self._inputs.ctypes.data
        self._sim.components = ctypes.addressof(self._components)
        self._sim.has_stepped = self._has_stepped.ctypes.data
        self._scenario: Any = None
        if lanes.driven:  # the inputs that the scenario drives, and memory for commands in its place
            self._ends = vectors(2, lanes.driven)
            self._commands = vectors(lanes.scenario["width"])
            self._scenario_memory = aligned(ctypes.sizeof(h.Scenario))
            self._scenario = h.Scenario.from_buffer(self._scenario_memory)
            for name, value in lanes.scenario.items():
                setattr(self._scenario, name, value)
            self._scenario.at_end, self._scenario.at_midpoint = (ends.ctypes.data for ends in self._ends)
            self._sim.scenario = ctypes.addressof(self._scenario)
        # memory of the energy monitor; its sums have the shape (3, bonds, lanes)
        bonds, self._sim.real_count = len(lanes.bonds), self._instances.memory.size // (8 * LANES)
        self._sums, self._input_ends = vectors(3, bonds), vectors(2, self._sim.real_count)
        self._energy, energy = vectors(3, 2 * bonds + 1), self._sim.energy
        energy.start, energy.used_start, energy.used_end = (array.ctypes.data for array in self._energy)
        energy.sums, energy.read_values = self._sums.ctypes.data, base
        self._sim.input_ends = self._input_ends.ctypes.data
        self._time, self._alive = np.ctypeslib.as_array(self._sim.t), np.ctypeslib.as_array(self._sim.alive)
        self._length = np.ctypeslib.as_array(self._sim.length)

    # ---- values before the start

    def reset(self, values: Mapping[Port, Array]) -> None:
        """Go back to the values of the system before the start, but for values of shape (lanes,)."""
        self._instances.memory[:] = self._instances.defaults
        for port, array in values.items():
            self._instances.set(port, array)
        self._inputs[:] = self._template
        self._time[:] = self._length[:] = self._sums[:] = 0.0
        self._alive[:] = -1
        ctypes.memset(self._failures, 0, ctypes.sizeof(self._failures))
        self._step_sizes = self.lanes.step_sizes()
        self._sim.step_size = ctypes.addressof(self._step_sizes) if self._step_sizes else None
        self._sim.next_divided[:] = [0] * LANES
        self.struct.row = self._sim.done = 0
        if self._scenario:
            self._scenario.evaluated_at[:] = self._scenario.since[:] = [np.nan] * LANES

    # ---- the run

    def begin(self) -> None:
        """Make the start values consistent and record them."""
        if not self._call("group_initialise"):
            raise NotInLanes("the start values depend on each other")
        self._call("group_begin")

    def advance(self, point: int) -> None:
        """Step up to a communication point."""
        self._call("group_advance", ctypes.c_int64(point))

    def move(self, point: int) -> None:
        """Begin at a communication point instead of the first one."""
        times = self.lanes.times
        self._sim.done, self._time[:] = point, times.start + point * times.step

    def _call(self, function: str, *arguments: Any) -> int:
        return int(getattr(machines_library(), function)(ctypes.byref(self.struct), *arguments))

    def adopt(self, other: Group, lanes: NDArray[np.bool_]) -> None:
        """Replace machines by those in the same lanes of another group, which has just begun."""
        self._call("group_adopt", ctypes.byref(other.struct), lanes.astype(np.int64).ctypes)

    def record(self, first: int, rows: Sequence[Array], count: int) -> None:
        """Record signals of the machines from `first` on in arrays of shape (count, points)."""
        self._rows = np.array([row.ctypes.data for row in rows], np.uint64)
        self.struct.rows, self.struct.points = self._rows.ctypes.data, rows[0].shape[1] if rows else 0
        self.struct.machine, self.struct.machines = first, min(LANES, count - first)

    def command(self, values: Array) -> None:
        """Hold commands in place of the scenario from now on, shape (columns of the scenario, lanes)."""
        self._commands[:] = values
        self._scenario.commands = self._commands.ctypes.data
        self._scenario.evaluated_at[:] = [np.nan] * LANES
        for component in self._components:
            component.sets_values = 1

    def stop(self) -> None:
        """End a run in another thread as soon as possible, for good."""
        self.struct.stop = 1

    def run(
        self, first: int, values: Mapping[Port, Array], rows: Sequence[Array], count: int
    ) -> dict[int, Ended]:
        """Simulate the machines from `first` on; returns those that ended early or are not reliable.

        values   of all machines, shape (count,)
        rows     one array for each signal of all machines, shape (count, points), which is filled
        """
        if self.struct.stop:
            return {}
        # those in excess repeat the last machine
        lanes = np.minimum(first + np.arange(LANES), count - 1)
        self.reset({port: array[lanes] for port, array in values.items()})
        self.record(first, rows, count)
        self.begin()
        self.advance(self.lanes.times.steps)
        return {first + lane: ended for lane, ended in self.doubted().items() if first + lane < count}

    # ---- failures

    def doubted(self) -> dict[int, Ended]:
        """The machines that have failed or are not reliable, by lane."""
        found, (residual, _, exchanged) = dict(self.ended()), self._energies()
        for lane in np.flatnonzero(energies_above(residual, exchanged).any(axis=0)).tolist():
            lines = unreliable_energies(self.energies(lane))
            found.setdefault(lane, Ended(Status.NOT_RELIABLE, "; ".join(lines)))
        return found

    def energies(self, lane: int) -> list[BondEnergy]:
        """The energies of all bonds of a machine until now."""
        pairs = zip(self.lanes.bonds, self._energies()[:, :, lane].T, strict=True)
        return [BondEnergy(bond.name, *sums) for bond, sums in pairs]

    def _energies(self) -> Array:
        """Residual, turnover and exchanged energy [J], shape (3, bonds, lanes)."""
        scales = np.array([bond.scale for bond in self.lanes.bonds], np.float64)
        return self._sums * scales[:, None]

    def ended(self) -> Iterator[tuple[int, Ended]]:
        """Lane and reason of the machines that have failed."""
        for lane, failure in enumerate(self._failures):
            if failure.kind:
                yield lane, Ended(Status.FAILED, self._reason(failure))

    def _reason(self, f: Any) -> str:
        h, model, when = header(), self.lanes.models[f.component], f"at t = {f.time:.9g} s"
        if f.kind == h.REQUIREMENT_VIOLATED:
            statement = model.requirement(f.index)
            text = f'requirement "{statement}" is violated {when}: {f.value:.6g}, expected > 0'
        elif f.kind == h.SINGULAR_SYSTEM:
            text = f"the linear system of the smallest inner step that was tried is singular {when}"
        elif f.kind == h.DERIVATIVE_NOT_FINITE:
            text = f"the derivative of {model.name(f.index)} is {f.derivative:g} {when}"
        elif f.kind == h.VALUE_NOT_FINITE:
            text = f"{model.name(f.index)} is {f.value:g} {when}, expected a finite number"
        else:
            many = f.kind == h.TOO_MANY_INNER_STEPS
            cause = "more inner steps than allowed" if many else "tolerance not reached"
            text = f"{cause} {when}; the largest error is in {model.name(f.index)} = {f.value:.6g}"
        return f"{model.component}: {text}"
