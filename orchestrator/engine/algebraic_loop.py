"""Algebraic loops: inputs that decide the outputs which feed them. native/algebraic_loop.c solves them."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from itertools import groupby
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.engine.c_library import Binding
from orchestrator.engine.component import calls_by_type
from orchestrator.fmi.calls import Call, Slave, function_type
from orchestrator.ssp.dependencies import DependencyCycle
from orchestrator.ssp.system import Port

VECTORS = "u g residual step before start scale unit seen"  # of the inputs


class AlgebraicLoop:
    """One algebraic loop, whose inputs and outputs stand in a bank of values.

    inputs, outputs   its ports, those of one component side by side
    made              `AlgebraicLoop` of engine.h
    """

    def __init__(self, binding: Binding, slaves: Mapping[str, Slave], cycle: DependencyCycle) -> None:
        self.cycle, self._slaves, self._binding = cycle, slaves, binding
        wires = sorted(cycle.connections, key=lambda c: self._place(c.target))
        self.inputs = [c.target for c in wires]
        self.outputs = sorted({c.source for c in wires}, key=self._place)
        n, m = len(self.inputs), len(self.outputs)
        self._arrays = {name: np.zeros(n) for name in VECTORS.split()} | {
            "y": np.zeros(m),
            "slopes": np.zeros((m, n)),
            "matrix": np.zeros((n, n)),
            "shares": np.zeros(3),
            "rows": np.zeros(n, np.int32),
            "flags": np.zeros(3, np.int32),
            "counts": np.zeros(2, np.int64),
            "source": np.array([self.outputs.index(c.source) for c in wires], np.int64),
            "factor": np.array([c.map.factor for c in wires]),
            "offset": np.array([c.map.offset for c in wires]),
        }
        self._arrays["seen"][:] = [self._nominal(p) for p in self.inputs]
        self.made = binding.h.AlgebraicLoop(
            **{name: binding.at(array) for name, array in self._arrays.items()},
            count=n,
            outputs=m,
            rounds=cycle.passes,
            declared=cycle.declared,
        )
        self._members = list(self._fill_members())
        self.address = binding.checked(self.made, self)

    def _place(self, port: Port) -> tuple[int, str, str]:
        variable = self._slaves[port.component].interface.variables[port.variable]
        return list(self._slaves).index(port.component), function_type(variable), port.variable

    def _nominal(self, port: Port) -> float:
        return abs(self._slaves[port.component].interface.variables[port.variable].nominal or 0.0)

    def _fill_members(self) -> Iterator[Any]:
        """Its components: how they set their inputs, read their outputs, and how these change with those."""
        binding, u, y = self._binding, self._arrays["u"], self._arrays["y"]
        groups = [
            (name, [p.variable for p in group])
            for name, group in groupby(self.inputs, key=lambda p: p.component)
        ]
        members = binding.array(binding.h.LoopMember, [binding.h.LoopMember()] * len(groups))
        self.made.members, self.made.member_count = binding.pointer(members), len(groups)
        first = first_output = 0
        for made, (name, inputs) in zip(members, groups, strict=False):
            slave = self._slaves[name]
            outputs = [p.variable for p in self.outputs if p.component == name]
            own_u, own_y = u[first : first + len(inputs)], y[first_output : first_output + len(outputs)]
            made.starters = binding.program(calls_by_type(slave, inputs, own_u, slave.reader))
            made.writers = binding.program(calls_by_type(slave, inputs, own_u, slave.writer))
            made.readers = binding.program(calls_by_type(slave, outputs, own_y, slave.reader))
            made.first, made.count, made.first_output, made.outputs = (
                first,
                len(inputs),
                first_output,
                len(outputs),
            )
            made.trusted = slave.interface.directional_derivatives
            seed, into = np.zeros(len(inputs)), np.zeros(len(outputs))
            call = (
                slave.directional_derivative(outputs, inputs, seed, into) if made.trusted else _no_derivative
            )
            binding.fill_derivative(made.derivative, call, seed, into)
            first, first_output = first + len(inputs), first_output + len(outputs)
            yield made

    def bind(self, inputs: NDArray[np.int64], outputs: NDArray[np.int64]) -> None:
        """Say where its ports stand in the bank."""
        self.made.targets, self.made.sources = self._binding.at(inputs), self._binding.at(outputs)

    def instruction(self, binding: Binding) -> Any:
        """The instruction that solves it."""
        return binding.h.Instruction(binding.h.LOOP, 0, self.address)

    @property
    def circular(self) -> bool:
        """Is it a loop? One that nobody declares is seen by what outputs do, or when values do not settle."""
        return self.cycle.declared or bool(self._arrays["flags"][self._binding.h.CIRCULAR])

    # ---- messages

    def check_status(self, status: int) -> None:
        """Raise that there is no solution."""
        t = max(self._slaves[p.component].log.time for p in self.inputs)
        raise Problem(f"{self.cycle.text}: no solution at t = {t:.9g} s: {self._why(status)}")

    def _why(self, status: int) -> str:
        arrays = self._arrays
        for port, y in zip(self.outputs, arrays["y"].tolist(), strict=True):
            if not isfinite(y):
                return f"{port} is {y}"
        if status == self._binding.h.SINGULAR:
            return "a change of its inputs comes back the same, so that no values or all of them fit"
        size = np.maximum(arrays["seen"], np.maximum(np.abs(arrays["u"]), np.abs(arrays["g"])))
        worst = int(np.argmax(np.abs(arrays["residual"]) / np.where(size > 0, size, 1.0)))
        port, u, g = self.inputs[worst], arrays["u"][worst], arrays["g"][worst]
        return f"{port} is set to {u:.6g} and would become {g:.6g}, a residual of {u - g:.3g}"

    @property
    def note(self) -> str:
        """What it is and how it was solved."""
        h, counts, text = self._binding.h, self._arrays["counts"], self.cycle.text
        often = f"{counts[h.EVALUATIONS] / max(int(counts[h.SOLVES]), 1):.2g} evaluations each"
        if not self.circular:
            return f"{text}; their values are carried round until nothing changes, {often}"
        ways = {"directional derivatives" if m.trusted else "differences" for m in self._members}
        how = f"solved at every communication point by Newton's method with {' and '.join(sorted(ways))}"
        worst = self._arrays["shares"][h.WORST]
        return f"{text}: {how}, {often}, residual at most {worst:.0e} of the magnitude"


def _no_derivative() -> None:
    """Stands where an FMU has no directional derivatives; never called."""


def solver(slaves: Mapping[str, Slave], cycle: DependencyCycle) -> Call:
    """What solves a loop by itself, again and again: for initialisation."""
    binding = Binding()
    loop = AlgebraicLoop(binding, slaves, cycle)
    n, m = len(loop.inputs), len(loop.outputs)
    binding.simulation.real = binding.at(np.zeros(n + m))
    loop.bind(np.arange(n), np.arange(n, n + m))
    return lambda: binding.call("loop_solve", ctypes.byref(loop.made))
