"""Algebraic loops: inputs that determine the outputs which feed them. native/algebraic_loop.c solves them."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.engine.c_library import Binding
from orchestrator.fmi.calls import Call, Slave, calls_by_type
from orchestrator.ssp.dependencies import DependencyCycle
from orchestrator.ssp.system import Port

VECTORS = (
    "u g residual step previous initial initial_magnitude jacobian_scale magnitude"  # one value per input
)


class AlgebraicLoop:
    """One algebraic loop: the arrays and calls that C uses to solve it, and messages about the solution.

    inputs, outputs   its ports, ordered by component
    struct            `AlgebraicLoop` of engine.h
    address           of `struct`; instruction: solves the loop
    """

    def __init__(self, binding: Binding, slaves: Mapping[str, Slave], cycle: DependencyCycle) -> None:
        self.cycle, self._slaves, self._binding = cycle, slaves, binding
        connections = sorted(cycle.connections, key=lambda c: self._sort_key(c.target))
        self.inputs = [c.target for c in connections]
        self.outputs = sorted({c.source for c in connections}, key=self._sort_key)
        n, m = len(self.inputs), len(self.outputs)
        self._arrays = {name: np.zeros(n) for name in VECTORS.split()} | {
            "y": np.zeros(m),
            "sensitivity": np.zeros((m, n)),
            "jacobian": np.zeros((n, n)),
            "residual_norms": np.zeros(3),
            "pivots": np.zeros(n, np.int32),
            "flags": np.zeros(3, np.int32),
            "counts": np.zeros(2, np.int64),
            "output": np.array([self.outputs.index(c.source) for c in connections], np.int64),
            "factor": np.array([c.map.factor for c in connections]),
            "offset": np.array([c.map.offset for c in connections]),
        }
        self._arrays["magnitude"][:] = [self._nominal(p) for p in self.inputs]
        self.struct = binding.h.AlgebraicLoop(
            **{name: binding.at(array) for name, array in self._arrays.items()},
            input_count=n,
            output_count=m,
            copy_rounds=cycle.passes,
            declared=cycle.declared,
        )
        self._members = list(self._fill_members())
        self.address = binding.checked(self.struct, self)
        self.instruction = binding.h.Instruction(binding.h.LOOP, 0, self.address)

    def _sort_key(self, port: Port) -> tuple[int, str, str]:
        variable = self._slaves[port.component].interface.variables[port.variable]
        return list(self._slaves).index(port.component), variable.function_type, port.variable

    def _nominal(self, port: Port) -> float:
        return abs(self._slaves[port.component].interface.variables[port.variable].nominal or 0.0)

    def _fill_members(self) -> Iterator[Any]:
        """Fill a structure for each component: calls that set inputs and read outputs, and the derivative."""
        binding, u, y = self._binding, self._arrays["u"], self._arrays["y"]
        # also those of which the loop has outputs, but no inputs, as these are not Real
        inputs_of = {n: [p.variable for p in self.inputs if p.component == n] for n in self._slaves}
        outputs_of = {n: [p.variable for p in self.outputs if p.component == n] for n in self._slaves}
        groups = [(n, inputs_of[n], outputs_of[n]) for n in self._slaves if inputs_of[n] or outputs_of[n]]
        members = binding.array(binding.h.LoopMember, [binding.h.LoopMember()] * len(groups))
        self.struct.members, self.struct.member_count = binding.pointer(members), len(groups)
        first = first_output = 0
        for struct, (name, inputs, outputs) in zip(members, groups, strict=False):
            slave = self._slaves[name]
            member_u = u[first : first + len(inputs)]
            member_y = y[first_output : first_output + len(outputs)]
            struct.input_reads = binding.program(calls_by_type(slave, inputs, member_u, slave.reader))
            struct.input_writes = binding.program(calls_by_type(slave, inputs, member_u, slave.writer))
            struct.output_reads = binding.program(calls_by_type(slave, outputs, member_y, slave.reader))
            struct.first_input, struct.input_count = first, len(inputs)
            struct.first_output, struct.output_count = first_output, len(outputs)
            struct.uses_derivative = bool(inputs and outputs) and slave.interface.directional_derivatives
            seed, result = np.zeros(len(inputs)), np.zeros(len(outputs))
            call = _no_derivative
            if struct.uses_derivative:
                call = slave.directional_derivative(outputs, inputs, seed, result)
            binding.fill_derivative(struct.derivative, call, seed, result)
            first, first_output = first + len(inputs), first_output + len(outputs)
            yield struct

    def set_indices(self, inputs: NDArray[np.int64], outputs: NDArray[np.int64]) -> None:
        """Set the indices of its ports in the array of Real values."""
        at = self._binding.at
        self.struct.input_indices, self.struct.output_indices = at(inputs), at(outputs)

    @property
    def circular(self) -> bool:
        """Is there a loop? C detects an undeclared one by differences, or if copied values do not settle."""
        return self.cycle.declared or bool(self._arrays["flags"][self._binding.h.CIRCULAR])

    # ---- messages

    def check_status(self, status: int) -> None:
        """Raise a Problem: the loop has no solution."""
        t = max(self._slaves[p.component].log.time for p in self.inputs)
        raise Problem(f"{self.cycle.text}: no solution at t = {t:.9g} s: {self._reason(status)}")

    def _reason(self, status: int) -> str:
        arrays = self._arrays
        for port, y in zip(self.outputs, arrays["y"].tolist(), strict=True):
            if not isfinite(y):
                return f"{port} is {y}"
        if status == self._binding.h.SINGULAR:
            return "its Jacobian is singular, so there is no solution, or infinitely many"
        magnitude = np.maximum(arrays["magnitude"], np.maximum(np.abs(arrays["u"]), np.abs(arrays["g"])))
        worst = int(np.argmax(np.abs(arrays["residual"]) / np.where(magnitude > 0, magnitude, 1.0)))
        port, u, g = self.inputs[worst], arrays["u"][worst], arrays["g"][worst]
        return f"{port} is set to {u:.6g} and would become {g:.6g}, a residual of {u - g:.3g}"

    @property
    def note(self) -> str:
        """A remark for the user: the loop, and how it was solved."""
        h, counts, text = self._binding.h, self._arrays["counts"], self.cycle.text
        often = f"{counts[h.EVALUATIONS] / max(int(counts[h.SOLVES]), 1):.2g} evaluations each"
        if not self.circular:
            return f"{text}; their values are copied along the connections until nothing changes, {often}"
        members = [m for m in self._members if m.input_count]
        ways = {"directional derivatives" if m.uses_derivative else "differences" for m in members}
        how = f"solved at every communication point by Newton's method with {' and '.join(sorted(ways))}"
        worst = self._arrays["residual_norms"][h.WORST]
        return f"{text}: {how}, {often}, residual at most {worst:.0e} of the magnitude"


def _no_derivative() -> None:
    """Placeholder for an FMU without directional derivatives; never called."""


def solver(slaves: Mapping[str, Slave], cycle: DependencyCycle) -> Call:
    """A call that solves one loop without a network, for initialisation."""
    binding = Binding()
    loop = AlgebraicLoop(binding, slaves, cycle)
    n, m = len(loop.inputs), len(loop.outputs)
    binding.simulation.reals = binding.at(np.zeros(n + m))
    loop.set_indices(np.arange(n), np.arange(n, n + m))
    return lambda: binding.call("loop_solve", ctypes.byref(loop.struct))
