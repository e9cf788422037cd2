"""A group of machines in the lanes of a core: its memory, its start and its steps, by native/group.cpp."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from orchestrator.lanes.compiled import NotInLanes, group_library, header, lane_count
from orchestrator.lanes.plan import Lanes
from orchestrator.ssp.system import Port

ALIGNMENT = 64  # bytes, of a vector
OK, EARLY, FAILED = "ok", "early", "failed"

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ended:
    """Why and when [s] a machine ended early; status: EARLY if an FMU asked for it, else FAILED."""

    status: str
    reason: str
    time: float


def aligned(size: int) -> NDArray[np.uint8]:
    """Zeroed memory that begins at a multiple of the length of a vector."""
    memory = np.zeros(size + ALIGNMENT, np.uint8)
    offset = -memory.ctypes.data % ALIGNMENT
    return memory[offset : offset + size]


class Group:
    """Machines in lanes. After `reset`, `set` changes values of single machines; `begin` starts the run."""

    def __init__(self, lanes: Lanes) -> None:
        h, lane = header(), lane_count()
        self.lanes = lanes
        self._memory = [aligned(m.struct.size) for m in lanes.models]
        self._courses = aligned(max(lanes.plan.input_count, 1) * h.COURSE_VECTORS * 8 * lane)
        self._pace = aligned(h.PACE_VECTORS * 8 * lane).view(np.int64).reshape(h.PACE_VECTORS, lane)
        self._time, self._alive = self._pace[0].view(np.float64), self._pace[2]
        self._failures = (h.Failure * lane)()
        self._instances = np.zeros(len(lanes.models), np.uint64)
        self._changed = aligned(len(lanes.models) * 8 * lane)
        self.struct = h.Group(
            instances=self._instances.ctypes.data,
            courses=self._courses.ctypes.data,
            pace=self._pace.ctypes.data,
            failures=ctypes.addressof(self._failures),
            changed=self._changed.ctypes.data,
        )
        self._create()
        self._defaults = [memory.copy() for memory in self._memory]

    # ---- values before the start

    def _create(self) -> None:
        """Make the instances, with the start values of the system."""
        create = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double)
        tolerance = self.lanes.job.execution.tolerance or 0.0
        for k, (model, memory) in enumerate(zip(self.lanes.models, self._memory, strict=True)):
            self._instances[k] = create(model.struct.create)(memory.ctypes.data, tolerance)
        for name, component in self.lanes.system.components.items():
            for variable, value in component.start.items():
                self.set(Port(name, variable), float(value))

    def reset(self) -> None:
        """Go back to the values of the system before the start."""
        for memory, defaults in zip(self._memory, self._defaults, strict=True):
            memory[:] = defaults
        self._courses[:] = 0
        self._pace[:] = 0
        self._alive[:] = -1
        ctypes.memset(self._failures, 0, ctypes.sizeof(self._failures))
        self._step_sizes = self.lanes.step_sizes()
        self.struct.step_size = ctypes.addressof(self._step_sizes) if self._step_sizes else None
        self.struct.row = self.struct.done = 0

    def _view(self, component: int, name: str, rows: int) -> Array:
        """An array of an instance, shape (rows, lanes)."""
        instance = header().Instance.from_address(int(self._instances[component]))
        pointer = ctypes.cast(getattr(instance, name), ctypes.POINTER(ctypes.c_double))
        return cast(Array, np.ctypeslib.as_array(pointer, (rows, lane_count())))

    def set(self, port: Port, value: float | Array) -> None:
        """Set a parameter, an input or the start value of a state: one value, or shape (lanes,)."""
        k, reference = self.lanes.index[port.component], self.lanes.reference(port)
        model = self.lanes.models[k].struct
        self._view(k, "values", reference + 1)[reference] = value
        number = reference - model.parameters
        if 0 <= number < model.inputs:
            self._view(k, "last_set", number + 1)[number] = value
        elif number >= 0:
            self._view(k, "start", number - model.inputs + 1)[number - model.inputs] = value

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
        self.struct.done, self._time[:] = point, times.start + point * times.step

    def _call(self, function: str, *arguments: Any) -> int:
        plan, group = ctypes.byref(self.lanes.plan), ctypes.byref(self.struct)
        return int(getattr(group_library(), function)(plan, group, *arguments))

    def adopt(self, other: Group, lanes: NDArray[np.bool_]) -> None:
        """Replace machines by those in the same lanes of another group, which has just begun."""
        self._call("group_adopt", ctypes.byref(other.struct), lanes.astype(np.int64).ctypes)

    def record(self, first: int, rows: Sequence[Array], count: int) -> None:
        """Record signals of the machines from `first` on in arrays of shape (count, points)."""
        self._rows = np.array([row.ctypes.data for row in rows], np.uint64)
        self.struct.rows, self.struct.points = self._rows.ctypes.data, rows[0].shape[1] if rows else 0
        self.struct.machine, self.struct.machines = first, min(lane_count(), count - first)

    def command(self, values: Array) -> None:
        """Hold commands in place of the scenario from now on, shape (columns of the scenario, lanes)."""
        self._commands = np.ascontiguousarray(values, np.float64)
        self.struct.commands = self._commands.ctypes.data

    def stop(self) -> None:
        """End a run in another thread as soon as possible, for good."""
        self.struct.stop = 1

    def run(
        self, first: int, values: Mapping[Port, Array], rows: Sequence[Array], count: int
    ) -> dict[int, Ended]:
        """Simulate the machines from `first` on; returns those that ended early.

        values   of all machines, shape (count,)
        rows     one array for each signal of all machines, shape (count, points), which is filled
        """
        if self.struct.stop:
            return {}
        lanes = np.minimum(
            first + np.arange(lane_count()), count - 1
        )  # those in excess repeat the last machine
        self.reset()
        for port, array in values.items():
            self.set(port, array[lanes])
        self.record(first, rows, count)
        self.begin()
        self.advance(self.lanes.times.steps)
        return {first + lane: ended for lane, ended in self.ended() if first + lane < count}

    # ---- failures

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Machines that have failed, shape (lanes,)."""
        return np.asarray(self._alive == 0)

    def ended(self) -> Iterator[tuple[int, Ended]]:
        """Lane and reason of the machines that have failed."""
        for lane, failure in enumerate(self._failures):
            if failure.kind:
                yield lane, Ended(FAILED, self._reason(failure), failure.time)

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
            cause = (
                "more inner steps than allowed"
                if f.kind == h.TOO_MANY_INNER_STEPS
                else "tolerance not reached"
            )
            text = f"{cause} {when}; the largest error is in {model.name(f.index)} = {f.value:.6g}"
        return f"{model.component}: {text}"
