"""A scenario as a function of time: which inputs it drives, and their values."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem, suggest
from orchestrator.interface import Value
from orchestrator.system import Port, System
from orchestrator.trace import Trace
from orchestrator.units import IDENTITY, Linear


class Table:
    """Columns over time: linear between the samples, held before the first and after the last."""

    def __init__(self, time: NDArray[np.float64], columns: NDArray[np.float64]) -> None:
        """time: shape (n,) [s], strictly increasing. columns: shape (n, k)."""
        slopes = np.diff(columns, axis=0) / np.diff(time)[:, None]
        hold = np.zeros((1, columns.shape[1]))
        self._slopes = np.concatenate([hold, slopes, hold])
        self._base = np.concatenate([columns[:1], columns])
        self._time = time.tolist()
        self._anchor = [self._time[0], *self._time]
        self._row = 0

    def row(self, t: float) -> int:
        """The interval that holds t, counted from 0 = before the first sample."""
        time, row = self._time, self._row
        if (row == 0 or time[row - 1] <= t) and (row == len(time) or t < time[row]):
            return row
        self._row = bisect_right(time, t)
        return self._row

    def at(self, t: float) -> NDArray[np.float64]:
        """All columns at time t [s], shape (k,)."""
        row = self.row(t)
        values: NDArray[np.float64] = self._base[row] + (t - self._anchor[row]) * self._slopes[row]
        return values

    def sample(self, t: float) -> NDArray[np.float64]:
        """The last sample at or before t, for inputs that are not continuous; shape (k,)."""
        values: NDArray[np.float64] = self._base[self.row(t)]
        return values


@dataclass(frozen=True)
class Drive:
    """Which input follows which column of a table, through which linear map."""

    table: Table
    columns: Mapping[Port, tuple[int, Linear]]

    def initial(self, system: System, t: float) -> dict[Port, Value]:
        """Values of the driven inputs at the start."""
        now, held = self.table.at(t), self.table.sample(t)
        values: dict[Port, Value] = {}
        for port, (column, linear) in self.columns.items():
            if system.variable(port).is_real:
                values[port] = linear(float(now[column]))
            else:
                values[port] = round(float(held[column]))
        return values

    def overruled(self, system: System, start: Mapping[str, Value | str]) -> tuple[str, ...]:
        """What to say about start values of driven inputs."""
        names = [name for name in start if any(port in self.columns for port, _ in system.targets(name))]
        return tuple(
            f"{n} is driven by the scenario: the start value {start[n]} has no effect" for n in names
        )


def drive(system: System, scenario: Trace, label: str = "scenario") -> Drive:
    """Match the columns of a scenario with the inputs of the system, or with `component.variable`."""
    columns: dict[Port, tuple[int, Linear]] = {}
    connected = {c.target: c for c in system.connections}
    for k, name in enumerate(scenario.signals):
        for port, linear in _targets(system, name, label):
            if port in connected:
                raise Problem(f"{label}: column {name!r} drives {port}, which is fed by {connected[port]}")
            if port in columns:
                raise Problem(f"{label}: column {name!r} drives {port}, which another column drives too")
            columns[port] = (k, linear)
    table = np.stack([np.asarray(v, dtype=np.float64) for v in scenario.signals.values()], axis=1)
    return Drive(Table(scenario.time, table), columns)


def _targets(system: System, name: str, label: str) -> tuple[tuple[Port, Linear], ...]:
    if name in system.inputs:
        return system.inputs[name].targets
    known = [
        *system.inputs,
        *map(str, system.ports("input")),
    ]
    try:
        port = system.port(name)
    except Problem:
        raise Problem(
            f"{label}: column {name!r} is no input of the system{suggest(name, known)}"
            f"; system inputs: {', '.join(system.inputs) or 'none'}"
        ) from None
    variable = system.variable(port)
    if variable.causality != "input" or variable.kind == "String":
        raise Problem(
            f"{label}: column {name!r}: expected an input, got a {variable.kind} {variable.causality}"
        )
    return ((port, IDENTITY),)
