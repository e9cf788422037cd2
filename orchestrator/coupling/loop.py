"""Algebraic loops: inputs that decide the outputs which feed them, found by Newton's method.

The unknowns u are the inputs of a loop. The FMUs make outputs y of them, and the connections should make the
same inputs of those:

    r(u) = u - g(u) = 0,   g_i = factor_i y_k(u) + offset_i                  r_i in the unit of u_i

A step of Newton's method solves  dr/du du = -r;  dy/du comes from directional derivatives where an FMU has
them, else from differences, one input after the other. It is kept, to the next communication point, too, as
long as the residual falls fast with it. A step that does not make the residual smaller is halved.

native/loop.c does the same, operation by operation.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from math import inf, isfinite

import numpy as np

from orchestrator.coupling.bank import Bank
from orchestrator.coupling.linear import factorised, solve
from orchestrator.coupling.member import Member
from orchestrator.errors import Problem
from orchestrator.slaves.slave import Slave, access
from orchestrator.system.knots import Knot
from orchestrator.system.system import Port

# Residuals as shares of the magnitude of the input: its largest value until now, or its nominal value.
NEAR = 1e-10  # wanted: far below the error of any coupling, far above the rounding of a model in double precision
ENOUGH = 1e-6  # accepted where no step makes it smaller: single precision, or an FMU that iterates inside
LIMIT = 20  # steps; Newton's method doubles the digits with each, so this is long after it failed
FAST = 0.1  # a kept Jacobian is good while each step takes away nine tenths of the residual
HALVINGS = 10  # of a step; then its direction is wrong
SOLVED, SINGULAR, STUCK = 0, -1, -2
USABLE, REAL_LOOP = 0, 1  # flags: there is a Jacobian; values carried round did not settle
SOLVES, EVALUATIONS = 0, 1  # counts
NORM, SHARE, WORST = 0, 1, 2  # residuals: over the magnitude at first, over the one now; largest accepted


class Loop:
    """One algebraic loop; calling it solves for its inputs, starting at what they were before.

    u, y       inputs and outputs of the loop
    bind       makes it work on values of a bank; else it has only its own
    """

    def __init__(self, slaves: Mapping[str, Slave], knot: Knot) -> None:
        self.knot, self._slaves = knot, slaves
        wires = sorted(knot.connections, key=lambda c: self._place(c.target))
        self.inputs = [c.target for c in wires]
        self.outputs = sorted({c.source for c in wires}, key=self._place)
        n, m = len(self.inputs), len(self.outputs)
        self.source = np.array([self.outputs.index(c.source) for c in wires], np.int64)
        self.factor, self.offset = (np.array([getattr(c.map, k) for c in wires]) for k in ("factor", "offset"))
        self._wires = [(self.outputs.index(c.source), c.map.factor, c.map.offset) for c in wires]
        self.y, self.slopes, self.matrix = np.zeros(m), np.zeros((m, n)), np.zeros((n, n))
        self.u, self.g, self.residual, self.step = (np.zeros(n) for _ in range(4))
        self.before, self.start, self.scale, self.unit = (np.zeros(n) for _ in range(4))
        self.seen = np.array([abs(self._nominal(p)) for p in self.inputs])
        self.rows = np.zeros(n, np.int32)
        self.flags, self.counts, self.shares = np.zeros(2, np.int32), np.zeros(2, np.int64), np.zeros(3)
        self.members = self._members()
        self._begun = False
        self.values, self.targets, self.sources = np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64)

    def _place(self, port: Port) -> tuple[int, str]:
        variable = self._slaves[port.component].interface.variables[port.variable]
        return list(self._slaves).index(port.component), access(variable)

    def _nominal(self, port: Port) -> float:
        return self._slaves[port.component].interface.variables[port.variable].nominal or 0.0

    def _members(self) -> list[Member]:
        members, at = [], (0, 0)
        for name, group in groupby(self.inputs, key=lambda p: p.component):
            inputs = [p.variable for p in group]
            outputs = [p.variable for p in self.outputs if p.component == name]
            members.append(Member(self._slaves[name], (inputs, outputs), self.u, self.y, at))
            at = at[0] + len(inputs), at[1] + len(outputs)
        return members

    def bind(self, bank: Bank) -> None:
        """Take the inputs from a bank, and put what is found there."""
        self.values = bank.values
        self.targets, self.sources = bank.places(self.inputs), bank.places(self.outputs)

    def __call__(self) -> None:
        if not self._begun:
            self._begin()
        elif len(self.targets):
            self.u[:] = self.values[self.targets]
        self.judge(self._solve())
        if len(self.targets):
            self.values[self.targets], self.values[self.sources] = self.u, self.y

    def _begin(self) -> None:
        """Start at what the FMUs have, and try their derivatives."""
        for member in self.members:
            member.start()
        self._evaluate()
        self._measure_units()
        for member in self.members:
            if self.knot.declared:
                member.trust(self.unit)
            else:
                member.derivative = None
        self.counts[:] = 0
        self._begun = True

    # ---- the solution

    def _solve(self) -> int:
        self.scale[:] = 0.0
        self.counts[SOLVES] += 1
        if self.knot.sweeps and not self.flags[REAL_LOOP]:
            self.start[:] = self.u
            if self._carry_round():
                return self._accept()
            self.flags[REAL_LOOP] = 1
            self.u[:] = self.start
        self._evaluate()
        verdict = self._newton()
        return self._accept() if self.shares[SHARE] <= ENOUGH and verdict != SINGULAR else verdict

    def _carry_round(self) -> bool:
        """Set the inputs to what the outputs make of them, until that changes nothing."""
        for _ in range(self.knot.sweeps):
            self._evaluate()
            if self.shares[SHARE] == 0.0:
                return True
            self.u[:] = self.g
        self._evaluate()
        return bool(self.shares[SHARE] <= NEAR)

    def _newton(self) -> int:
        """From an evaluated start to where the residual is small, or no longer becomes smaller."""
        fresh = False
        for _ in range(LIMIT):
            if self.shares[SHARE] <= NEAR:
                return SOLVED
            if not self.flags[USABLE]:
                if not self._linearise():
                    return SINGULAR
                fresh = True
            norm = float(self.shares[NORM])
            better = self._descend(norm, fresh)
            if fresh and not better:
                return STUCK
            self.flags[USABLE] = better and self.shares[NORM] <= FAST * norm
            fresh = False
        return SOLVED if self.shares[SHARE] <= NEAR else STUCK

    def _descend(self, norm: float, fresh: bool) -> bool:
        """Take a step, at most so long that the residual becomes smaller; with an old Jacobian try it once."""
        unit, residual = self.unit.tolist(), self.residual.tolist()
        step = [r / w for r, w in zip(residual, unit, strict=True)]
        solve(self.matrix.tolist(), self.rows.tolist(), step)
        self.step[:] = [d * w for d, w in zip(step, unit, strict=True)]
        self.before[:] = self.u
        size = 1.0
        for _ in range(HALVINGS if fresh else 1):
            self.u[:] = [a - size * d for a, d in zip(self.before.tolist(), self.step.tolist(), strict=True)]
            self._evaluate()
            if self.shares[NORM] < norm:
                return True
            size *= 0.5
        self.u[:] = self.before
        self._evaluate()
        return False

    def _evaluate(self) -> None:
        """The outputs that belong to the inputs, and the residual."""
        for member in self.members:
            member()
        self.counts[EVALUATIONS] += 1
        norm = share = 0.0
        y = self.y.tolist()
        for i, (u, (k, factor, offset)) in enumerate(zip(self.u.tolist(), self._wires, strict=True)):
            g = y[k] * factor + offset
            r = u - g
            self.g[i], self.residual[i] = g, r
            if not abs(r) < inf:
                norm = share = inf
            elif r != 0.0:
                size = max(float(self.seen[i]), abs(u), abs(g))
                if self.scale[i] == 0.0:
                    self.scale[i] = size
                norm, share = max(norm, abs(r) / float(self.scale[i])), max(share, abs(r) / size)
        self.shares[NORM], self.shares[SHARE] = norm, share

    def _measure_units(self) -> None:
        """The magnitudes of the inputs."""
        for i, u in enumerate(self.u.tolist()):
            size = max(float(self.seen[i]), abs(u))
            self.unit[i] = 1.0 if size == 0.0 else size

    def _linearise(self) -> bool:
        """Find the Jacobian, of residuals and inputs over their magnitudes, and its factors."""
        self._measure_units()
        for member in self.members:
            member.slope(self.unit, self.slopes)
        unit, slopes = self.unit.tolist(), self.slopes.tolist()
        matrix = [
            [float(i == j) - factor * slopes[k][j] * unit[j] / unit[i] for j in range(len(unit))]
            for i, (k, factor, _) in enumerate(self._wires)
        ]
        rows = [0] * len(unit)
        found = factorised(matrix, rows)
        self.matrix[:], self.rows[:] = matrix, rows
        return found

    def _accept(self) -> int:
        for i, u in enumerate(self.u.tolist()):
            self.seen[i] = max(float(self.seen[i]), abs(u))
        self.shares[WORST] = max(float(self.shares[WORST]), float(self.shares[SHARE]))
        return SOLVED

    # ---- what to say

    def judge(self, verdict: int) -> None:
        """Raise where there is no solution."""
        if verdict == SOLVED:
            return
        t = max(self._slaves[p.component].log.time for p in self.inputs)
        raise Problem(f"{self.knot.text}: no solution at t = {t:.9g} s: {self._why(verdict)}")

    def _why(self, verdict: int) -> str:
        wrong = next((i for i, y in enumerate(self.y.tolist()) if not isfinite(y)), None)
        if wrong is not None:
            return f"{self.outputs[wrong]} is {self.y[wrong]}"
        if verdict == SINGULAR:
            return "a change of its inputs comes back the same, so no value of them or every one fits"
        sizes = np.maximum(np.maximum(self.seen, np.abs(self.u)), np.abs(self.g))
        i = int(np.argmax(np.abs(self.residual) / np.where(sizes > 0, sizes, 1.0)))
        left = f"residual {self.residual[i]:.3g}"
        return f"{left}, {self.inputs[i]} is set to {self.u[i]:.6g} and would become {self.g[i]:.6g}"

    @property
    def note(self) -> str:
        """What it is and how it was solved."""
        mean = self.counts[EVALUATIONS] / max(int(self.counts[SOLVES]), 1)
        often = f"{mean:.2g} evaluations each"
        if self.knot.sweeps and not self.flags[REAL_LOOP]:
            return f"{self.knot.text}; their values are carried round until nothing changes, {often}"
        ways = {"directional derivatives" if m.derivative else "differences" for m in self.members}
        how = f"solved at every communication point by Newton's method with {' and '.join(sorted(ways))}"
        return f"{self.knot.text}: {how}, {often}, residual at most {self.shares[WORST]:.0e} of the magnitude"
