"""One component in a run: its FMU and the calls that step it, set its inputs and read its outputs.

`RunningComponent` makes the calls and fills `Component` of native/engine.h, by which the C engine uses them.
A coupling input is one that follows a polynomial inside a communication step, or that is watched to estimate
the error of the step.
"""

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
    """Calls for `names`, one for each run of consecutive names of the same FMI type.

    values   shape (n,), in the order of the names
    """
    calls, first = list[Call](), 0
    for _, group in groupby(names, key=lambda name: function_type(slave.interface.variables[name])):
        of_type = list(group)
        calls.append(make(of_type, values[first : first + len(of_type)]))
        first += len(of_type)
    return calls


class RunningComponent:
    """A component as a master uses it: the Python side of `Component` in engine.h.

    slave               the FMU
    inputs              indices of its coupling inputs, which are contiguous
    values              of the coupling inputs that are set as values; empty if only derivatives are set
    derivatives         of the coupling inputs, those of one input by ascending order
    input_writes        calls that set `values`, if there are any, and `derivatives`
    output_reads        calls that read the outputs that other components use
    slope_reads         calls that read the slopes of those outputs, if the FMU gives them
    held_inputs         calls that set the inputs that cannot change inside a step to the newest value of
                        their source, for sequential masters
    substeps            how many steps the FMU takes in one communication step
    fixed_step          length of each of these steps [s] if it must be the same to the last bit, else 0
    halved              it takes two steps, and its outputs between them are read
    rollback            its state is saved at the beginning of every step
    simplifies_inputs   some coupling inputs have a lower degree than the master asks for
    struct              `Component` of engine.h
    """

    def __init__(self, slave: Slave, substeps: int) -> None:
        self.slave, self.substeps = slave, substeps
        self.inputs = range(0)
        self.output_reads: Sequence[Call] = ()
        self.slope_reads: Sequence[Call] = ()
        self.held_inputs: Sequence[Call] = ()
        self.fixed_step, self.halved, self.rollback, self.simplifies_inputs = 0.0, False, False, False
        self.values, self.derivatives = np.zeros(0), np.zeros(0)
        self.input_writes: list[Call] = []
        self._saved_state: Any = None
        self._stepping: StepCalls | None = None
        self.struct: Any = None

    def make_input_writes(self, first: int, names: Sequence[str], inputs: Sequence[Any], jumps: bool) -> None:
        """Make the calls that set its coupling inputs.

        first    index of its first coupling input among those of all components
        names    the variables
        inputs   the `CouplingInput` of engine.h of each variable
        jumps    the inputs may be discontinuous at the start of a step of the FMU, so that values must be
                 set, not only derivatives
        """
        self.inputs = range(first, first + len(inputs))
        if not inputs:
            return
        self.simplifies_inputs = any(s.fmu_degree < s.requested_degree for s in inputs)
        if self.substeps > 1 or self.simplifies_inputs or jumps:
            # degree 0: the input is only watched and held over the step; other calls set it
            with_values = [n for n, s in zip(names, inputs, strict=True) if s.requested_degree]
            self.values = np.zeros(len(with_values))
            self.input_writes += calls_by_type(self.slave, with_values, self.values, self.slave.writer)
        derivatives = [
            (n, k + 1)
            for n, s in zip(names, inputs, strict=True)
            for k in range(min(s.fmu_degree, s.requested_degree))
        ]
        self.derivatives = np.zeros(len(derivatives))
        self._add_derivative_writes(derivatives)

    def _add_derivative_writes(self, derivatives: Sequence[tuple[str, int]]) -> None:
        """Add calls that set derivatives, given by name and order.

        If rate inputs take the derivatives, those of different FMI types need separate calls.
        """
        interface, first = self.slave.interface, 0

        def rate_type(derivative: tuple[str, int]) -> str:
            if interface.can_interpolate_inputs:
                return ""
            return function_type(interface.variables[interface.rate_inputs[derivative[0]]])

        for _, group in groupby(derivatives, key=rate_type):
            names, orders = zip(*group, strict=True)
            values = self.derivatives[first : first + len(names)]
            write = self.slave.input_derivative_writer(
                names, values, orders if interface.can_interpolate_inputs else ()
            )
            self.input_writes.append(write)
            first += len(names)

    # ---- the structure of the C engine

    def fill_stepping(self, binding: Binding, struct: Any) -> None:
        """Fill the members for stepping the FMU. Python steps it if its class has no `stepping`."""
        self.struct = struct
        make: Callable[[bool], StepCalls] | None = getattr(self.slave, "stepping", None)
        if make:
            self._stepping = step = make(self.rollback)
            struct.call = binding.pointer(step.slot)
            for name, value in step.members.items():
                setattr(struct, name, value)
        struct.clock = binding.at(np.asarray(self.slave.log.clock))
        struct.never_restored, struct.rollback = not self.rollback, self.rollback
        struct.halved = self.halved
        struct.fixed_step, struct.substeps = self.fixed_step, self.substeps

    def fill_inputs_and_outputs(self, binding: Binding) -> None:
        """Fill the members for inputs and outputs."""
        struct = self.struct
        struct.first_input, struct.input_count = self.inputs.start, len(self.inputs)
        struct.sets_values, struct.simplifies_inputs = len(self.values) > 0, self.simplifies_inputs
        struct.values, struct.derivatives = binding.at(self.values), binding.at(self.derivatives)
        for name in ("input_writes", "output_reads", "held_inputs", "slope_reads"):
            setattr(struct, name, binding.program(getattr(self, name)))

    @property
    def stepped_in_c(self) -> bool:
        """Does C step the FMU, not Python?"""
        return self._stepping is not None

    @property
    def busy_seconds(self) -> float:
        """Wall time in its steps, with the calls that set its coupling inputs [s]."""
        return float(self.struct.busy) if self.struct else 0.0

    def check_status(self, function: int | None, status: int) -> None:
        """Raise the Problem for a status that is not OK.

        function   address of the FMI function that returned it: get state or set state; None: a step
        """
        assert self._stepping is not None
        self._stepping.checks[function or 0](status)

    # ---- saved state; C saves and restores that of a component that it steps

    def save(self) -> None:
        """Save the state of a component that Python steps."""
        self._saved_state = self.slave.save(self._saved_state)

    def restore(self) -> None:
        """Restore the saved state."""
        self.slave.restore(self._saved_state)

    def free_saved_state(self) -> None:
        """Free the state that C or Python saved, if there is one."""
        if self.struct is not None and self.struct.state:
            self._saved_state, self.struct.state = ctypes.c_void_p(self.struct.state), None
        if self._saved_state is not None:
            self.slave.free_state(self._saved_state)
            self._saved_state = None
