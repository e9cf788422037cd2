"""How one component changes with its states and inputs, as its FMU tells at a communication point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from orchestrator.slaves.slave import Buffer, Call, Slave, access


@dataclass(frozen=True)
class Column:
    """A directional derivative along several knowns that share no unknown, so that one call tells all.

    call      puts into `into` how the unknowns `rows` change
    entries   pairs of an unknown and the known that it changes with, by number
    """

    call: Call
    into: Buffer
    rows: Sequence[int]
    entries: Sequence[tuple[int, int]]


class Tangent:
    """Unknowns are time derivatives of the states, then outputs; knowns are the states, then inputs.

    rates     calls that read the time derivatives of the states into `f`, shape (n,)
    values    calls that read the states into `x`, shape (n,)
    columns   all directional derivatives
    """

    def __init__(
        self, slave: Slave, inputs: Sequence[str], outputs: Sequence[str], f: Buffer, x: Buffer
    ) -> None:
        face = slave.interface
        self.states, self.inputs, self.outputs = list(face.states), inputs, outputs
        rates = list(face.states.values())
        self.rates, self.values = _reads(slave, rates, f), _reads(slave, self.states, x)
        self._knowns, self._unknowns = [*self.states, *inputs], [*rates, *outputs]
        self.columns = [self._column(slave, group) for group in self._groups(slave)]

    def matrix(self) -> Buffer:
        """All changes now, shape (unknowns, knowns); raises Problem where the FMU cannot tell."""
        found = np.zeros((len(self._unknowns), len(self._knowns)))
        for column in self.columns:
            column.call()
            for i, j in column.entries:
                found[i, j] = column.into[column.rows.index(i)]
        return found

    def _groups(self, slave: Slave) -> list[list[tuple[int, int]]]:
        """Entries of each column: a known joins others as long as no unknown depends on two of them."""
        told = [slave.interface.knowns.get(name) for name in self._unknowns]
        groups: list[list[tuple[int, int]]] = []
        for j, known in enumerate(self._knowns):
            mine = [i for i, on in enumerate(told) if on is None or known in on]
            room = [group for group in groups if not {i for i, _ in group} & set(mine)]
            if not room and mine:
                groups.append([])
                room = groups[-1:]
            for group in room[:1]:
                group += [(i, j) for i in mine]
        return groups

    def _column(self, slave: Slave, entries: list[tuple[int, int]]) -> Column:
        rows, knowns = sorted({i for i, _ in entries}), sorted({j for _, j in entries})
        of, by = [self._unknowns[i] for i in rows], [self._knowns[j] for j in knowns]
        into = np.zeros(len(rows))
        return Column(slave.derivative(of, by, np.ones(len(by)), into), into, rows, entries)


def _reads(slave: Slave, names: Sequence[str], into: Buffer) -> list[Call]:
    """One call for each row of variables of one type."""
    calls, first = list[Call](), 0
    for _, group in groupby(names, key=lambda name: access(slave.interface.variables[name])):
        row = list(group)
        calls.append(slave.reader(row, into[first : first + len(row)]))
        first += len(row)
    return calls
