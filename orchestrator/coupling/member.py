"""One component in an algebraic loop: its inputs and outputs there, and how the ones change with the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import groupby
from math import copysign

import numpy as np

from orchestrator.errors import Problem
from orchestrator.slaves.slave import Buffer, Call, Slave, access

SHIFT = 1e-6  # of the magnitude: far above rounding, single precision included, far below what curves a function
ALIKE = 0.1  # derivatives further from differences than this share of the largest would spoil convergence


class Member:
    """Sets its inputs and reads its outputs in the arrays of a loop.

    first, count            its inputs stand there in `u`
    first_output, outputs   its outputs stand there in `y`
    derivative              call that puts into `into` how the outputs change when the inputs move along `seed`;
                            None where the FMU offers none, or wrong ones
    """

    def __init__(
        self, slave: Slave, names: tuple[Sequence[str], Sequence[str]], u: Buffer, y: Buffer, at: tuple[int, int]
    ) -> None:
        """names: of inputs and outputs, alike by `access`; at: the places of the first of them in `u` and `y`."""
        inputs, outputs = names
        self.u, self.y, self.name = u, y, slave.name
        (self.first, self.first_output), self.count, self.outputs = at, len(inputs), len(outputs)
        u, y = u[self.first : self.first + self.count], y[self.first_output : self.first_output + self.outputs]
        self.starters = _calls(slave, slave.reader, inputs, u)
        self.writers = _calls(slave, slave.writer, inputs, u)
        self.readers = _calls(slave, slave.reader, outputs, y)
        self.seed, self.into = np.zeros(self.count), np.zeros(self.outputs)
        self.derivative: Call | None = None
        if slave.interface.directional:
            self.derivative = slave.derivative(outputs, inputs, self.seed, self.into)

    def start(self) -> None:
        """Read from the FMU what its inputs are."""
        for read in self.starters:
            read()

    def __call__(self) -> None:
        for call in (*self.writers, *self.readers):
            call()

    def slope(self, unit: Buffer, slopes: Buffer) -> None:
        """Put into `slopes`, shape (outputs, inputs) of the loop, how outputs change with inputs.

        unit   magnitudes of the inputs of the loop
        Inputs and outputs of the FMU are not what they were, those in the arrays are.
        """
        if self.derivative:
            self._told(self.derivative, slopes)
        else:
            self._measured(unit, slopes)

    def _told(self, derivative: Call, slopes: Buffer) -> None:
        for j in range(self.count):
            self.seed[:] = 0.0
            self.seed[j] = 1.0
            derivative()
            slopes[self.first_output : self.first_output + self.outputs, self.first + j] = self.into

    def _measured(self, unit: Buffer, slopes: Buffer) -> None:
        own = slice(self.first_output, self.first_output + self.outputs)
        before = self.y[own].copy()
        for j in range(self.first, self.first + self.count):
            u = float(self.u[j])
            self.u[j] = u + copysign(SHIFT * float(unit[j]), u)
            moved = float(self.u[j]) - u
            self()
            slopes[own, j] = [(a - b) / moved for a, b in zip(self.y[own].tolist(), before.tolist(), strict=True)]
            self.u[j] = u
        self.y[own] = before

    def trust(self, unit: Buffer) -> None:
        """Do without derivatives that fail, or that are not what the outputs do."""
        if not self.derivative:
            return
        told, measured = (np.zeros((len(self.y), len(self.u))) for _ in range(2))
        self._measured(unit, measured)
        self()
        with suppress(Problem), np.errstate(invalid="ignore", over="ignore"):
            self._told(self.derivative, told)
            largest = np.max(np.abs(measured) * unit, axis=1, keepdims=True)
            if np.all(np.abs(told - measured) * unit <= ALIKE * largest):
                return
        self.derivative = None


def _calls(
    slave: Slave, make: Callable[[Sequence[str], Buffer], Call], names: Sequence[str], values: Buffer
) -> list[Call]:
    """One call for each type of variable."""
    calls, first = list[Call](), 0
    for _, group in groupby(names, key=lambda name: access(slave.interface.variables[name])):
        same = list(group)
        calls.append(make(same, values[first : first + len(same)]))
        first += len(same)
    return calls
