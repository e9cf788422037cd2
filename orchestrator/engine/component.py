"""One component in a run: its FMU, the inputs it is given as polynomials, and the outputs others need."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from orchestrator.engine.c_library import Binding
from orchestrator.fmi.calls import Buffer, Call, Slave, StepCalls, function_type

MakeCall = Callable[[Sequence[str], Buffer], Call]


def calls_by_type(slave: Slave, names: Sequence[str], values: Buffer, make: MakeCall) -> list[Call]:
    """One call for each row of variables of one type; `values`, shape (n,), are in the order of the names."""
    made, first = list[Call](), 0
    for _, group in groupby(names, key=lambda name: function_type(slave.interface.variables[name])):
        row = list(group)
        made.append(make(row, values[first : first + len(row)]))
        first += len(row)
    return made


class RunningComponent:
    """A component as masters see it; C has it as `Component` of engine.h.

    inputs         the numbers of its coupling inputs, one after the other
    input_writes   calls that set values and derivatives of these
    output_reads   calls that bring the outputs that others use into the bank
    slope_reads    calls that read the slopes of those outputs, where the FMU gives them
    held_inputs    calls that set inputs which cannot move to their newest value, for sequential masters
    factor         how many steps the FMU takes in one communication step
    even           length of each of them [s] if it must be the same to the last bit, else 0
    rollback       its state is saved at the beginning of every step, to go back there
    made           `Component` of engine.h
    """

    def __init__(self, slave: Slave, factor: int) -> None:
        self.slave, self.factor = slave, factor
        self.inputs = range(0)
        self.output_reads: Sequence[Call] = ()
        self.slope_reads: Sequence[Call] = ()
        self.held_inputs: Sequence[Call] = ()
        self.even, self.rollback, self.rough = 0.0, False, False
        self.values, self.derivatives = np.zeros(0), np.zeros(0)
        self.input_writes: list[Call] = []
        self._state: Any = None
        self._stepping: StepCalls | None = None
        self.made: Any = None

    def follow(self, first: int, names: Sequence[str], inputs: Sequence[Any], jumps: bool) -> None:
        """Let variables move, as coupling inputs from `first` on; they may jump at the start of a step."""
        self.inputs = range(first, first + len(inputs))
        if not inputs:
            return
        moved = [(n, s) for n, s in zip(names, inputs, strict=True) if s.degree]
        self.rough = any(s.degree < s.wanted for s in inputs)
        if self.factor > 1 or self.rough or jumps:
            followed = [n for n, s in zip(names, inputs, strict=True) if s.wanted]
            self.values = np.zeros(len(followed))
            self.input_writes += calls_by_type(self.slave, followed, self.values, self.slave.writer)
        rows = [(n, k + 1) for n, s in moved for k in range(min(s.degree, s.wanted))]
        self.derivatives = np.zeros(len(rows))
        self._write_derivatives(rows)

    def _write_derivatives(self, rows: Sequence[tuple[str, int]]) -> None:
        """Calls that set derivatives of names and orders; as rate inputs they may be of several types."""
        face, first = self.slave.interface, 0

        def word(row: tuple[str, int]) -> str:
            return (
                "" if face.can_interpolate_inputs else function_type(face.variables[face.rate_inputs[row[0]]])
            )

        for _, group in groupby(rows, key=word):
            names, orders = zip(*group, strict=True)
            into = self.derivatives[first : first + len(names)]
            write = self.slave.input_derivative_writer(
                names, into, orders if face.can_interpolate_inputs else ()
            )
            self.input_writes.append(write)
            first += len(names)

    # ---- C

    def fill(self, binding: Binding, made: Any) -> None:
        """Fill what it takes to step the FMU. Python steps it where its class has no `stepping`."""
        self.made, step = made, None
        make: Callable[[bool], StepCalls] | None = getattr(self.slave, "stepping", None)
        if make:
            self._stepping = step = make(self.rollback)
            made.instance, made.fmi, made.flags = step.component, step.fmi, step.flags
            made.do_step, made.get_state, made.set_state = step.do_step, step.get_state, step.set_state
            for name, address in zip(("event", "terminate", "early", "last"), step.results, strict=False):
                setattr(made, name, address)
        made.clock = binding.at(np.asarray(self.slave.log.clock))
        made.final, made.rollback = not self.rollback, self.rollback
        made.even, made.factor = self.even, self.factor

    def fill_calls(self, binding: Binding) -> None:
        """Fill what it exchanges."""
        made = self.made
        made.first, made.count = self.inputs.start, len(self.inputs)
        made.sets_values, made.rough = len(self.values) > 0, self.rough
        made.values, made.derivatives = binding.at(self.values), binding.at(self.derivatives)
        for name in ("input_writes", "output_reads", "held_inputs", "slope_reads"):
            setattr(made, name, binding.program(getattr(self, name)))

    @property
    def in_c(self) -> bool:
        """Does C step it?"""
        return self._stepping is not None

    @property
    def busy(self) -> float:
        """Time in its steps [s]."""
        return float(self.made.busy) if self.made else 0.0

    def check_status(self, where: int | None, status: int) -> None:
        """Raise what there is to say about the status of a step, or of saving or restoring the state."""
        assert self._stepping is not None
        step = self._stepping
        checks = {step.get_state: step.check_get, step.set_state: step.check_set}
        (checks[where] if where else step.check_step)(status)

    # ---- rollback where Python steps it

    def save(self) -> None:
        """Remember the state."""
        self._state = self.slave.save(self._state)

    def restore(self) -> None:
        """Go back to the state that was saved."""
        self.slave.restore(self._state)

    def forget(self) -> None:
        """Free the state that was saved."""
        if self.made is not None and self.made.state:
            self._state, self.made.state = ctypes.c_void_p(self.made.state), None
        if self._state is not None:
            self.slave.free_state(self._state)
            self._state = None
