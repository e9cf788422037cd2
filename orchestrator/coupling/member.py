"""One component in an algebraic loop: its inputs and outputs there, and how these change with those."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from math import copysign

import numpy as np

from orchestrator.errors import Problem
from orchestrator.slaves.slave import Buffer, Call, Slave, access

SHIFT = 1e-6  # of the magnitude: far above rounding, even of single precision; below what bends a function
ALIKE = 0.1  # derivatives further from differences than this share of the largest would spoil convergence


@dataclass(frozen=True)
class Slots:
    """Variables of a component, those of one type side by side, and their places in an array of a loop."""

    names: Sequence[str]
    values: Buffer
    first: int

    @property
    def range(self) -> range:
        """Their places."""
        return range(self.first, self.first + len(self.names))

    @property
    def own(self) -> Buffer:
        """Their values, as a view."""
        return self.values[self.first : self.first + len(self.names)]

    def calls(self, slave: Slave, make: Callable[[Sequence[str], Buffer], Call]) -> list[Call]:
        """One call for each type of variable."""
        made, at, types = list[Call](), 0, slave.interface.variables
        for _, group in groupby(self.names, key=lambda name: access(types[name])):
            same = list(group)
            made.append(make(same, self.own[at : at + len(same)]))
            at += len(same)
        return made


class Member:
    """Sets its inputs and reads its outputs in the arrays of a loop.

    derivative   call that puts into `into` how the outputs change when the inputs move along `seed`; None
                 where the FMU offers none
    trusted      shape (1,): 1 as long as it is used
    """

    def __init__(self, slave: Slave, inputs: Slots, outputs: Slots) -> None:
        self.inputs, self.outputs = inputs, outputs
        self._starters = inputs.calls(slave, slave.reader)
        self.writers, self.readers = inputs.calls(slave, slave.writer), outputs.calls(slave, slave.reader)
        self.seed, self.into = np.zeros(len(inputs.names)), np.zeros(len(outputs.names))
        self.derivative: Call | None = None
        self.trusted = np.array([slave.interface.directional], np.int32)
        if slave.interface.directional:
            self.derivative = slave.derivative(outputs.names, inputs.names, self.seed, self.into)

    def start(self) -> None:
        """Read from the FMU what its inputs are."""
        for read in self._starters:
            read()

    def __call__(self) -> None:
        for call in (*self.writers, *self.readers):
            call()

    def slope(self, unit: Buffer, slopes: Buffer) -> None:
        """Put into `slopes`, shape (outputs, inputs) of the loop, how outputs change with inputs.

        unit   magnitudes of the inputs of the loop
        Inputs and outputs of the FMU are not what they were afterwards, those in the arrays are.
        """
        if self.derivative and self.trusted[0]:
            self._told(self.derivative, slopes)
        else:
            self._measured(unit, slopes)

    def _told(self, derivative: Call, slopes: Buffer) -> None:
        for k, j in enumerate(self.inputs.range):
            self.seed[:] = 0.0
            self.seed[k] = 1.0
            derivative()
            slopes[self.outputs.range, j] = self.into

    def _measured(self, unit: Buffer, slopes: Buffer) -> None:
        u, before = self.inputs.values, self.outputs.own.tolist()
        for j in self.inputs.range:
            here = float(u[j])
            u[j] = here + copysign(SHIFT * float(unit[j]), here)
            moved = float(u[j]) - here
            self()
            after = self.outputs.own.tolist()
            slopes[self.outputs.range, j] = [(a - b) / moved for a, b in zip(after, before, strict=True)]
            u[j] = here
        self.outputs.own[:] = before

    def trust(self, unit: Buffer) -> None:
        """Do without derivatives that fail, or that are not what the outputs do."""
        if not self.derivative:
            return
        told, measured = (np.zeros((len(self.outputs.values), len(unit))) for _ in range(2))
        self._measured(unit, measured)
        self()
        with suppress(Problem), np.errstate(invalid="ignore", over="ignore"):
            self._told(self.derivative, told)
            largest = np.max(np.abs(measured) * unit, axis=1, keepdims=True)
            if np.all(np.abs(told - measured) * unit <= ALIKE * largest):
                return
        self.trusted[0] = 0
