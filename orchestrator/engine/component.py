"""One component in a run: its slave, the inputs it is given as polynomials, and the outputs others need."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from orchestrator.engine.input_signal import Signal, at, projected, shifted, slope_at
from orchestrator.fmi.calls import Buffer, Call, Slave, access


class Part:
    """A component as masters see it.

    signals   its inputs that move inside a step
    reads     calls that bring the outputs that others use into the bank
    tell      call that reads the slopes of those outputs, where the FMU tells them
    newest    calls that set inputs which cannot move to their newest value, for masters that step one by one
    rough     some inputs cannot follow the polynomial that is wanted
    factor    how many steps the FMU takes in one communication step
    even      length of each of them [s] if it must be the same to the last bit, else 0
    kept      its state is kept at the beginning of every step, to go back there
    """

    def __init__(self, slave: Slave, used: Buffer) -> None:
        """used: shape (2, n): what Real inputs were at both ends of the step, where a master moved them."""
        self.slave, self._used = slave, used
        self.signals: list[Signal] = []
        self.reads: Sequence[Call] = ()
        self.newest: Sequence[Call] = ()
        self.tell: Call | None = None
        self.factor, self.even, self.kept = 1, 0.0, False
        self.rough = False
        self.values, self.derivatives = np.zeros(0), np.zeros(0)
        self.writers: list[Call] = []  # of values and derivatives
        self.state: object = None

    def follow(self, names: Sequence[str], signals: Sequence[Signal], jumps: bool) -> None:
        """Let these inputs move; `names` of the variables; they may jump at the beginning of a step."""
        self.signals = list(signals)
        if not signals:
            return
        moved = [(n, s) for n, s in zip(names, signals, strict=True) if s.degree]
        self.rough = any(s.degree < s.wanted for s in signals)
        if self.factor > 1 or self.rough or jumps:
            followed = [n for n, s in zip(names, signals, strict=True) if s.wanted]
            self.values = np.zeros(len(followed))
            self._set(followed)
        rows = [(n, k + 1) for n, s in moved for k in range(min(s.degree, s.wanted))]
        self.derivatives = np.zeros(len(rows))
        self._set_derivatives(rows)

    def _set(self, names: Sequence[str]) -> None:
        """Calls that set `values`, one for each row of variables of one type."""
        first, variables = 0, self.slave.interface.variables
        for _, group in groupby(names, key=lambda name: access(variables[name])):
            row = list(group)
            self.writers.append(self.slave.writer(row, self.values[first : first + len(row)]))
            first += len(row)

    def _set_derivatives(self, rows: Sequence[tuple[str, int]]) -> None:
        """Calls that set `derivatives` of names and orders; as rate inputs they may be of several types."""
        face, first = self.slave.interface, 0

        def word(row: tuple[str, int]) -> str:
            return "" if face.interpolates else access(face.variables[face.rates[row[0]]])

        for _, group in groupby(rows, key=word):
            names, orders = zip(*group, strict=True)
            into = self.derivatives[first : first + len(names)]
            write = self.slave.slope_writer(names, into, orders if face.interpolates else ())
            self.writers.append(write)
            first += len(names)

    def give(self, begin: float, length: float, last: bool) -> None:
        """Give the inputs their polynomials from `begin` [s] after the start of the step on."""
        place = row = 0
        for s in self.signals:
            c = projected(shifted(s.c, begin) if begin else s.c, s.degree, length)
            if s.wanted and len(self.values):
                self.values[place] = c[0]
                place += 1
            for k in range(min(s.degree, s.wanted)):
                self.derivatives[row] = (1.0, 2.0, 6.0)[k] * c[k + 1]
                row += 1
            if begin == 0.0 and s.wanted:
                self._used[0, s.target] = c[0]
            if last and s.wanted:
                self._used[1, s.target] = at(c, length)
        for write in self.writers:
            write()

    def advance(self, t: float, h: float) -> None:
        """Take the step from t to t + h [s], in as many steps of its own as `factor` tells."""
        many = self.factor
        for j in range(many):
            begin, last = h * j / many, j == many - 1
            end = h if last else h * (j + 1) / many  # what is multiplied and divided may not be what it was
            self.give(begin, end - begin, last)
            now = t + begin
            self.slave.step(now, self.even or t + end - now)

    def finish(self, h: float) -> None:
        """Let inputs that could only be followed roughly end as they should, before outputs are read."""
        if not self.rough:
            return
        place = row = 0
        for s in self.signals:
            if s.wanted:
                self.values[place] = at(s.c, h)
                place += 1
            for k in range(min(s.degree, s.wanted)):
                self.derivatives[row] = slope_at(s.c, h) if k == 0 else 0.0
                row += 1
        for write in self.writers:
            write()

    def read(self) -> None:
        """Bring the outputs that others use, and their slopes, up to date."""
        for read in self.reads:
            read()
        if self.tell:
            self.tell()

    # ---- rollback

    def keep(self) -> None:
        """Remember the state of the FMU."""
        self.state = self.slave.save(self.state)

    def restore(self) -> None:
        """Go back to the state that was kept."""
        self.slave.restore(self.state)

    def forget(self) -> None:
        """Free what was kept."""
        if self.state is not None:
            self.slave.forget(self.state)
            self.state = None
