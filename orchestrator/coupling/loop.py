"""Algebraic loops: inputs that decide the outputs which feed them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import groupby
from math import isfinite

import numpy as np

from orchestrator.coupling.bank import Bank
from orchestrator.coupling.member import Member, Slots
from orchestrator.coupling.newton import CIRCULAR, EVALUATIONS, SINGULAR, SOLVED, SOLVES, WORST, Newton
from orchestrator.errors import Problem
from orchestrator.slaves.slave import Buffer, Slave, access
from orchestrator.system.knots import Knot
from orchestrator.system.system import Port


class Loop:
    """One algebraic loop; calling it solves for its inputs, starting at what they were before.

    inputs, outputs    its ports, those of one component side by side
    members            its components
    targets, sources   places of its ports among the values of a bank, see `bind`; none at first
    """

    def __init__(self, slaves: Mapping[str, Slave], knot: Knot) -> None:
        self.knot, self._slaves = knot, slaves
        wires = sorted(knot.connections, key=lambda c: self._place(c.target))
        self.inputs = [c.target for c in wires]
        self.outputs = sorted({c.source for c in wires}, key=self._place)
        u, y = np.zeros(len(self.inputs)), np.zeros(len(self.outputs))
        self.members = list(self._members(u, y))
        numbered = [(self.outputs.index(c.source), c.map.factor, c.map.offset) for c in wires]
        self.newton = Newton(u, y, self.members, numbered, np.array([self._nominal(p) for p in self.inputs]))
        self._values, self.targets, self.sources = np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._begun = False

    def _place(self, port: Port) -> tuple[int, str, str]:
        variable = self._slaves[port.component].interface.variables[port.variable]
        return list(self._slaves).index(port.component), access(variable), port.variable

    def _nominal(self, port: Port) -> float:
        return abs(self._slaves[port.component].interface.variables[port.variable].nominal or 0.0)

    def _members(self, u: Buffer, y: Buffer) -> Iterator[Member]:
        first = first_output = 0
        for name, group in groupby(self.inputs, key=lambda p: p.component):
            inputs = [p.variable for p in group]
            outputs = [p.variable for p in self.outputs if p.component == name]
            yield Member(self._slaves[name], Slots(inputs, u, first), Slots(outputs, y, first_output))
            first, first_output = first + len(inputs), first_output + len(outputs)

    def bind(self, bank: Bank) -> None:
        """Take the inputs from a bank, and put there what is found."""
        self._values = bank.values
        self.targets, self.sources = bank.places(self.inputs), bank.places(self.outputs)

    def __call__(self) -> None:
        newton, bound = self.newton, len(self.targets) > 0
        if not self._begun:
            newton.begin(self.knot.declared)
            self._begun = True
        elif bound:
            newton.u[:] = self._values[self.targets]
        self.judge(newton.solve(self.knot.sweeps))
        if bound:
            self._values[self.targets], self._values[self.sources] = newton.u, newton.y

    @property
    def circular(self) -> bool:
        """Is it a loop? One that nobody declares is seen by what outputs do, or when values do not settle."""
        return self.knot.declared or bool(self.newton.flags[CIRCULAR])

    # ---- what to say

    def judge(self, verdict: int) -> None:
        """Raise where there is no solution."""
        if verdict != SOLVED:
            t = max(self._slaves[p.component].log.time for p in self.inputs)
            raise Problem(f"{self.knot.text}: no solution at t = {t:.9g} s: {self._why(verdict)}")

    def _why(self, verdict: int) -> str:
        newton = self.newton
        for port, y in zip(self.outputs, newton.y.tolist(), strict=True):
            if not isfinite(y):
                return f"{port} is {y}"
        if verdict == SINGULAR:
            return "a change of its inputs comes back the same, so that no values or all of them fit"
        size = np.maximum(newton.seen, np.maximum(np.abs(newton.u), np.abs(newton.g)))
        worst = int(np.argmax(np.abs(newton.residual) / np.where(size > 0, size, 1.0)))
        port, u, g = self.inputs[worst], newton.u[worst], newton.g[worst]
        return f"{port} is set to {u:.6g} and would become {g:.6g}, a residual of {u - g:.3g}"

    @property
    def note(self) -> str:
        """What it is and how it was solved."""
        newton, text = self.newton, self.knot.text
        often = f"{newton.counts[EVALUATIONS] / max(int(newton.counts[SOLVES]), 1):.2g} evaluations each"
        if not self.circular:
            return f"{text}; their values are carried round until nothing changes, {often}"
        ways = {"directional derivatives" if m.trusted[0] else "differences" for m in self.members}
        how = f"solved at every communication point by Newton's method with {' and '.join(sorted(ways))}"
        return f"{text}: {how}, {often}, residual at most {newton.shares[WORST]:.0e} of the magnitude"
