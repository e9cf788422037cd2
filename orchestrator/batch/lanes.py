"""Machines in the vector lanes of one core: the native FMUs of a system, compiled for eight machines at once.

Native FMUs of this project contain their C sources. `Lanes` compiles the model of each FMU with a vector type
in place of double (native/model.cpp), and couples them as the engine does (native/group.cpp). Systems for
which that is not possible raise `NotInLanes`.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.compiler import PLATFORMS, SUFFIX, CompilerError, host, linker_arguments, shared_library
from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.engine.c_library import engine_h, structures, without_comments
from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.job import Job
from orchestrator.engine.masters import MASTERS, Plan
from orchestrator.engine.network import Network
from orchestrator.engine.time_grid import Grid
from orchestrator.ssp.system import Component, Connection, Port, System

FOLDER = Path(__file__).parent / "native"
ENGINE = Path(__file__).parents[1] / "engine" / "native"
# C files of a native FMU that model.cpp includes
SOURCES = (
    *("sizes.h", "model.h", "model.c", "start.h", "start.c", "opening_curve.h"),
    *("solver.h", "inputs.h", "inputs.c", "rosenbrock.c"),
)
MASTERS_IN_LANES = ("jacobi", "gauss-seidel", "hermite")
FLAGS = (
    *("-x", "c++", "-std=gnu++20", "-O2", "-g0", "-s", "-shared", "-fvisibility=hidden"),
    *("-nostdinc++", "-nostdlib++", "-fno-exceptions", "-fno-rtti"),
    *("-Wall", "-Wextra", "-Werror", "-Wno-unused-function"),
    *("-ffp-contract=fast", "-freciprocal-math", "-fno-signed-zeros", "-fno-math-errno"),
    "-fno-trapping-math",
)
# features of NumPy that a level of x86-64 needs, best level first
LEVELS = {"x86_64_v4": ("AVX512_SKX",), "x86_64_v3": ("AVX2", "FMA3")}
ALIGNMENT = 64  # bytes, of a vector

Array = NDArray[np.float64]


class NotInLanes(Problem):
    """The system cannot be simulated in lanes; the message says why."""


# ---- libraries


@cache
def processor() -> str:
    """The instruction set to compile for, as the compiler calls it."""
    if not host().startswith("x86_64"):
        return "baseline"
    from numpy._core._multiarray_umath import __cpu_features__ as features

    return next((name for name, needed in LEVELS.items() if all(map(features.get, needed))), "baseline")


def _compiled(name: str, file: str, code: Mapping[str, bytes]) -> Path:
    """The library of a C++ file of this package, for this computer."""
    target = PLATFORMS[host()]
    library = f"{name}_lanes{SUFFIX}"
    own = {path.name: path.read_bytes() for path in FOLDER.glob("*.h")}
    flags = ["-target", target.target, f"-mcpu={processor()}", *FLAGS]
    flags += ["-fPIC"] if SUFFIX != ".dll" else []
    arguments = [*flags, file, *linker_arguments(library, target, ("-lm",))]
    return shared_library(library, {**code, **own, file: (FOLDER / file).read_bytes()}, arguments)


def _model_library(component: Component) -> Path:
    """The library of the model of a component; raises NotInLanes if it is not a native FMU."""
    assert component.source is not None
    try:
        code = {name: component.source.member(f"sources/{name}").read() for name in SOURCES}
    except Problem:
        raise NotInLanes(f"{component.name} ({component.source}) is not a native FMU with C sources") from None
    try:
        return _compiled(component.interface.identifier, "model.cpp", code)
    except CompilerError as error:
        raise NotInLanes(f"{component.name}: {error}") from None


@cache
def _group_library() -> ctypes.CDLL:
    code = {name: (ENGINE / name).read_bytes() for name in ("engine.h", "step_size.c")}
    try:
        return ctypes.CDLL(str(_compiled("group", "group.cpp", code)))
    except CompilerError as error:
        raise NotInLanes(str(error)) from None


@cache
def _h() -> Any:
    """Structures and constants of group.h, by name."""
    texts = [(FOLDER / name).read_text(encoding="utf-8") for name in ("lanes.h", "group.h")]
    return structures(without_comments("\n".join(texts)))

@dataclass(frozen=True)
class Model:
    """The compiled model of a component.

    struct   `Model` of group.h
    names    variable name -> value reference
    """

    component: str
    library: ctypes.CDLL
    struct: Any
    names: Mapping[str, int]

    def requirement(self, index: int) -> str:
        """The description of a requirement."""
        describe = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_int32)(self.struct.requirement)
        return (describe(index) or b"").decode()

    def name(self, reference: int) -> str:
        """The name of a variable."""
        return next(name for name, r in self.names.items() if r == reference)


def _model(component: Component) -> Model:
    library = ctypes.CDLL(str(_model_library(component)))
    library.lane_model.restype = ctypes.c_void_p
    struct = _h().Model.from_address(library.lane_model())
    variables = component.interface.variables.values()
    if strange := [v.name for v in variables if not v.is_real and v.causality != "independent"]:
        raise NotInLanes(f"{component.name}.{strange[0]} is not a Real variable")
    return Model(component.name, library, struct, {v.name: v.reference for v in variables})


# ---- the plan of all groups


class Lanes:
    """A system in lanes: its models, and the plan of the master for all groups.

    job       the run of one machine
    signals   recorded ports
    """

    def __init__(self, job: Job, times: Grid, signals: Sequence[Port]) -> None:
        """Raises NotInLanes if the system or its coupling is not supported."""
        self.system, self.times, self.signals = job.system, times, signals
        self.tolerance = job.execution.tolerance or 0.0
        _check_coupling(job, times)
        with ThreadPoolExecutor() as threads:
            self.models = list(threads.map(_model, self.system.components.values()))
        self.index = {name: k for k, name in enumerate(self.system.components)}
        self._alive: list[Any] = []
        with ExitStack() as stack:
            slaves = {}
            for name, component in self.system.components.items():
                slaves[name] = job.execution.open(component)
                stack.callback(slaves[name].close)
            network = Network(self.system, slaves, job.scenario, signals)
            if network.loops:
                raise NotInLanes(network.loops[0].cycle.text)
            plan = MASTERS[job.coupling.master](self.system, job.coupling)
            inputs = CouplingInputs(network, plan)
            control = job.control(inputs, times)
            self.plan = self._plan(network, plan, inputs, job)
            self._step_size = control and {
                "h": min(max(control.first, control.smallest), control.largest),
                "smallest": control.smallest,
                "largest": control.largest,
                "repeats": 1,
                "power": inputs.power,
            }
            if control:
                self.plan.adaptive, self.plan.guard = 1, control.tolerance

    def reference(self, port: Port) -> int:
        """The value reference of a variable."""
        return self.models[self.index[port.component]].names[port.variable]

    def step_size(self) -> Any:
        """The control of the steps of a new group; None: equal steps."""
        return engine_h().StepSize(**self._step_size) if self._step_size else None

    # ---- its structures

    def _array(self, kind: Any, values: Sequence[Any]) -> int:
        """The address of a C array."""
        array = (kind * max(len(values), 1))(*values)
        self._alive.append(array)
        return ctypes.addressof(array)

    def _numbers(self, values: Any, dtype: Any = np.int32) -> int:
        array = np.ascontiguousarray(values, dtype)
        self._alive.append(array)
        return array.ctypes.data

    def _input_index(self, port: Port) -> int:
        return self.reference(port) - self.models[self.index[port.component]].struct.parameters

    def _connection(self, c: Connection) -> Any:
        return _h().Connection(
            self.index[c.source.component],
            self.reference(c.source),
            self.index[c.target.component],
            self._input_index(c.target),
            c.map.factor,
            c.map.offset,
        )

    def _plan(self, network: Network, plan: Plan, inputs: CouplingInputs, job: Job) -> Any:
        h, count = _h(), len(self.models)
        by_target = {c.target: c for c in network.connections}
        position = {k: i for i, k in enumerate(plan.order)}
        rows = []
        for port, s in zip(inputs.ports, inputs.inputs, strict=True):
            driven = s.source_component == DRIVEN
            target = self.index[port.component]
            connection = (
                h.Connection(DRIVEN, 0, target, self._input_index(port), 1.0, 0.0)
                if driven
                else self._connection(by_target[port])
            )
            in_order = not driven and position[s.source_component] < position[target]
            degrees = s.requested_degree, s.order, s.autonomous, int(in_order)
            rows.append(h.Input(connection, s.scale, *degrees))
        components = [self.index[port.component] for port in inputs.ports]
        held = inputs.held(plan.order) if plan.sequential else [[] for _ in range(count)]
        exchange, ordered = self._exchange(network, plan, inputs)
        uses_slopes = {s.source_component for s in inputs.inputs} if plan.needs_slopes else set()
        result = h.Plan(
            models=self._numbers([ctypes.addressof(m.struct) for m in self.models], np.uint64),
            inputs=self._array(h.Input, rows),
            connections=self._array(h.Connection, [*map(self._connection, ordered)]),
            held=self._array(h.Connection, [self._connection(c) for group in held for c in group]),
            exchange=self._array(h.Instruction, exchange),
            order=self._numbers(plan.order),
            first_input=self._numbers(np.searchsorted(components, range(count + 1))),
            first_held=self._numbers(np.cumsum([0, *map(len, held)])),
            repeated=self._numbers([k in plan.repeated for k in range(count)]),
            needs_slopes=self._numbers([k in uses_slopes for k in range(count)]),
            signals=self._array(
                h.Signal, [h.Signal(self.index[p.component], self.reference(p)) for p in self.signals]
            ),
            events=self._numbers(self.times.events, np.float64),
            event_count=len(self.times.events),
            start=self.times.start,
            step=self.times.step,
            steps=self.times.steps,
            every=self.times.every,
            pass_tolerance=plan.tolerance,
            component_count=count,
            input_count=len(rows),
            connection_count=len(ordered),
            exchange_count=len(exchange),
            signal_count=len(self.signals),
            degree=plan.degree,
            sequential=plan.sequential,
            passes=plan.passes,
            initial_rounds=network.order.count + 1,
        )
        if network.driven:
            self._drive(result, network.driven, inputs)
        return result

    def _drive(self, plan: Any, driven: Any, inputs: CouplingInputs) -> None:
        """Add the scenario to the plan."""
        if len(driven.discrete) or len(driven.integers):
            raise NotInLanes("the scenario drives inputs that are not continuous")
        columns = zip(driven.continuous, driven.columns, driven.factor, driven.offset, strict=True)
        drives = [
            _h().Drive(column, self.index[p.component], self._input_index(p), inputs.ports.index(p), *linear)
            for p, column, *linear in columns
        ]
        time, base, slopes, anchor = driven.table.arrays
        plan.drives, plan.drive_count = self._array(_h().Drive, drives), len(drives)
        for name, array in (("time", time), ("base", base), ("slopes", slopes), ("anchor", anchor)):
            setattr(plan, name, self._numbers(array, np.float64))
        plan.samples, plan.width = len(time), base.shape[1]

    def _exchange(
        self, network: Network, plan: Plan, inputs: CouplingInputs
    ) -> tuple[list[Any], list[Connection]]:
        """The instructions of an exchange, and all connections in the order in which they are copied.

        Outputs are computed anew only where an input that they depend on has changed after the step of their
        component.
        """
        h, stages = _h(), network.order.stages
        final = _final_outputs(self.system, plan, {p for p in inputs.varying if p not in inputs.driven}, inputs.driven)
        needed = {c.source for c in network.connections} | set(self.signals)
        program: list[Any] = []
        ordered: list[Connection] = []
        for stage in range(max(network.order.count, 1)):
            again = {p.component for p, s in stages.items() if stage in s and p in needed and p not in final}
            program += [h.Instruction(h.OUTPUTS, self.index[name], 0) for name in sorted(again)]
            copied = [c for c in network.connections if stage in stages[c.source]]
            program.append(h.Instruction(h.COPY, len(ordered), len(copied)))
            ordered += copied
        derivatives = {
            k
            for p in self.signals
            if (m := self.models[k := self.index[p.component]].struct)
            and 0 <= self.reference(p) - m.parameters - m.inputs - m.states < m.states
        }
        return program + [h.Instruction(h.DERIVATIVES, k, 0) for k in sorted(derivatives)], ordered


DRIVEN = -1


def _check_coupling(job: Job, times: Grid) -> None:
    """Raise NotInLanes for settings of the master that lanes do not have."""
    c = job.coupling
    reasons = {
        f"the master {c.master}": c.master not in MASTERS_IN_LANES,
        "corrected inputs": c.correct,
        "several steps of a component in a communication step": any(n > 1 for n in c.factors.values()),
        "control of the energy": c.adaptive is not None and c.controls_energy,
        "adaptive steps without a record step": times.free,
    }
    if found := next((reason for reason, applies in reasons.items() if applies), None):
        raise NotInLanes(found)


def _final_outputs(system: System, plan: Plan, varied: set[Port], driven: Sequence[Port]) -> set[Port]:
    """Outputs that do not change after the step of their component.

    They depend directly on nothing, or on inputs that end at an output of this kind of a component that has
    stepped before.
    """
    source = {c.target: c.source for c in system.connections}
    names, final, before = list(system.components), set[Port](), set[str]()
    for k in plan.order:
        interface = system.components[names[k]].interface
        settled = {
            v.name
            for v in interface.of("input")
            if (port := Port(names[k], v.name)) in driven
            or port not in source
            or (port in varied and source[port].component in before and source[port] in final)
        }
        final |= {
            Port(names[k], v.name)
            for v in interface.variables.values()
            if not interface.direct_inputs(v.name) - settled
        }
        if plan.sequential:
            before.add(names[k])
    return final


# ---- groups


def lanes_of_group() -> int:
    """Number of machines in a group."""
    return int(_h().LANES)


def aligned(size: int) -> NDArray[np.uint8]:
    """Zeroed memory at a multiple of the length of a vector."""
    memory = np.zeros(size + ALIGNMENT, np.uint8)
    offset = -memory.ctypes.data % ALIGNMENT
    return memory[offset : offset + size]


OK, EARLY, FAILED = "ok", "early", "failed"


@dataclass(frozen=True)
class Ended:
    """Why and when [s] a machine ended early; status: "early" if an FMU asked for it, else "failed"."""

    status: str
    reason: str
    time: float


class Group:
    """The memory of machines in lanes; values are set before `begin`."""

    def __init__(self, lanes: Lanes) -> None:
        h = _h()
        self.lanes, plan = lanes, lanes.plan
        self._memory = [aligned(m.struct.size) for m in lanes.models]
        self._courses = aligned(max(plan.input_count, 1) * COURSE * 8 * h.LANES)
        self._alive = aligned(8 * h.LANES)
        self._failures = (h.Failure * h.LANES)()
        self._instances = np.zeros(len(lanes.models), np.uint64)
        self.struct = h.Group(
            instances=self._instances.ctypes.data,
            courses=self._courses.ctypes.data,
            alive=self._alive.ctypes.data,
            failures=ctypes.addressof(self._failures),
        )

    def reset(self, machines: int) -> None:
        """Default values of the system in all lanes, of which the first ones are used."""
        h, struct = _h(), self.struct
        for k, (model, memory) in enumerate(zip(self.lanes.models, self._memory, strict=True)):
            create = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double)(model.struct.create)
            self._instances[k] = create(memory.ctypes.data, self.lanes.tolerance)
        self._courses[:] = 0
        self._alive.view(np.int64)[:] = -1
        ctypes.memset(self._failures, 0, ctypes.sizeof(self._failures))
        self._step_size = self.lanes.step_size()
        struct.step_size = ctypes.addressof(self._step_size) if self._step_size else None
        struct.machines = machines
        for name in ("row", "done", "event", "step_count", "pass_count", "interval", "history"):
            setattr(struct, name, 0)
        struct.length = struct.shorter = 0.0
        for name, component in self.lanes.system.components.items():
            for variable, value in component.start.items():
                self.set(Port(name, variable), float(value))

    def values(self, component: int) -> Array:
        """The values of a component by value reference, shape (variables, lanes)."""
        return self._view(component, "values")

    def _view(self, component: int, name: str) -> Array:
        h, model = _h(), self.lanes.models[component].struct
        instance = h.Instance.from_address(int(self._instances[component]))
        count = model.parameters + model.inputs + 2 * model.states + model.outputs
        rows = {"start": model.states, "last_set": model.inputs}.get(name, count)
        pointer = ctypes.cast(getattr(instance, name), ctypes.POINTER(ctypes.c_double))
        return np.ctypeslib.as_array(pointer, (max(rows, 1), h.LANES))

    def set(self, port: Port, value: float | Array) -> None:
        """Set a parameter, an input or the start value of a state in all lanes."""
        k, reference = self.lanes.index[port.component], self.lanes.reference(port)
        model = self.lanes.models[k].struct
        self.values(k)[reference] = value
        if (i := reference - model.parameters) >= 0:
            if i < model.inputs:
                self._view(k, "last_set")[i] = value
            else:
                self._view(k, "start")[i - model.inputs] = value

    def run(
        self, first: int, values: Mapping[Port, Array], count: int, rows: Sequence[Array]
    ) -> dict[int, Ended]:
        """Simulate the machines from `first` on; returns the failures by machine.

        values   of all machines, shape (count,)
        rows     one array for each signal of all machines, shape (count, points), which is filled
        """
        if self.struct.stop:
            return {}
        machines = min(lanes_of_group(), count - first)
        indices = np.minimum(first + np.arange(lanes_of_group()), count - 1)  # lanes in excess repeat the last one
        self.reset(machines)
        for port, array in values.items():
            self.set(port, array[indices])
        addresses = np.array([row.ctypes.data for row in rows], np.uint64)
        self.struct.rows, self.struct.machine = addresses.ctypes.data, first
        self.struct.points = rows[0].shape[1] if rows else 0
        self.begin()
        self.advance(self.lanes.times.steps)
        return {first + lane: ended for lane, ended in self.failures()}

    def stop(self) -> None:
        """End a run in another thread as soon as possible."""
        self.struct.stop = 1

    def begin(self) -> None:
        """Make the start consistent and record it."""
        if not _group_library().group_initialise(ctypes.byref(self.lanes.plan), ctypes.byref(self.struct)):
            raise NotInLanes("the start values do not settle")
        _group_library().group_begin(ctypes.byref(self.lanes.plan), ctypes.byref(self.struct))

    def advance(self, point: int) -> None:
        """Step up to a communication point."""
        _group_library().group_advance(
            ctypes.byref(self.lanes.plan), ctypes.byref(self.struct), ctypes.c_int64(point)
        )

    def failures(self) -> Iterator[tuple[int, Ended]]:
        """Lane and failure of the machines that have failed."""
        for lane in range(self.struct.machines):
            if (f := self._failures[lane]).kind:
                yield lane, Ended(FAILED, self._reason(f), f.time)

    def _reason(self, f: Any) -> str:
        h, model = _h(), self.lanes.models[f.component]
        where = f"at t = {f.time:.9g} s"
        if f.kind == h.REQUIREMENT_VIOLATED:
            statement = model.requirement(f.index)
            text = f'requirement "{statement}" is violated {where}: {f.value:.6g}, expected > 0'
        elif f.kind == h.VALUE_NOT_FINITE:
            text = f"{model.name(f.index)} is {f.value:g} {where}, expected a finite number"
        elif f.kind == h.DERIVATIVE_NOT_FINITE:
            text = f"the derivative of {model.name(f.index)} is {f.derivative:g} {where}"
        elif f.kind == h.SINGULAR_SYSTEM:
            text = f"the linear system of the smallest inner step that was tried is singular {where}"
        else:
            text = (
                f"tolerance not reached with an inner step of {f.step:.3g} s {where}; "
                f"the largest error is in {model.name(f.index)} = {f.value:.6g}"
            )
        return f"{model.component}: {text}"


COURSE = 13  # vectors in `Course` of group.h
