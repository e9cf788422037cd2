"""A scenario: which inputs it drives, their values over time, and what it takes the place of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, Unsupported, suggest
from orchestrator.base.units import LinearTransformation
from orchestrator.data.trace import Trace
from orchestrator.fmi.description import FmuVariable, Value
from orchestrator.ssp.system import Port, System

LARGEST = 2**31 - 1  # of whole numbers in a run
MUCH, LEAST = 1e-3, 1e-6  # of the range of a column: change of its slope, times the gap between samples
SHARPER = 10.0  # times as much as at the samples around it


class ScenarioTable:
    """Columns over time: linear between the samples, held before the first and after the last."""

    def __init__(self, time: NDArray[np.float64], columns: NDArray[np.float64]) -> None:
        """time: shape (n,) [s], strictly increasing. columns: shape (n, k).

        arrays   times, and of each interval values at its anchor, slopes and the anchor [s]
        """
        slopes = np.diff(columns, axis=0) / np.diff(time)[:, None]
        hold = np.zeros((1, columns.shape[1]))
        self._slopes = np.concatenate([hold, slopes, hold])
        self._base = np.concatenate([columns[:1], columns])
        anchor = np.concatenate([time[:1], time]).astype(np.float64)
        self.arrays = time.astype(np.float64), self._base, self._slopes, anchor

    def row(self, t: float) -> int:
        """The interval that holds t, counted from 0 = before the first sample."""
        return int(np.searchsorted(self.arrays[0], t, side="right"))

    def at(self, t: float) -> NDArray[np.float64]:
        """All columns at time t [s], shape (k,)."""
        row = self.row(t)
        values: NDArray[np.float64] = self._base[row] + (t - self.arrays[3][row]) * self._slopes[row]
        return values

    def corners(self) -> list[float]:
        """Times [s] at which a column changes its slope by much, or by more than around it.

        Rows of a curve that was sampled are no corners; the ends of its ramps are.
        """
        turns = np.abs(np.diff(self._slopes, axis=0))  # at each sample
        gaps = np.diff(self.arrays[0])
        near = np.minimum(np.append(gaps, np.inf), np.insert(gaps, 0, np.inf))
        size = np.ptp(self._base, axis=0)
        share = near[:, None] * turns / np.where(size > 0, size, np.inf)
        around = np.pad(share, ((1, 1), (0, 0)))
        sharp = (share > SHARPER * np.maximum(around[:-2], around[2:])) & (share > LEAST)
        found = ((share > MUCH) | sharp).any(axis=1)
        return [float(t) for t in self.arrays[0][found]]

    def sample(self, t: float) -> NDArray[np.float64]:
        """The last sample at or before t, for inputs that are not continuous; shape (k,)."""
        values: NDArray[np.float64] = self._base[self.row(t)]
        return values


@dataclass(frozen=True)
class Scenario:
    """Which input follows which column of a table, through which linear map."""

    table: ScenarioTable
    columns: Mapping[Port, tuple[int, LinearTransformation]]

    def released(self, system: System) -> System:
        """The system without the connections that the scenario replaces.

        A component without inputs is a scenario itself: driving one of the inputs it feeds silences it as a
        whole, so that the others rest at their start values. The declared rate input of a driven input goes
        with it; one that is not declared may stay, because the slope that a run gives goes before it.
        """
        gone = {*self.columns, *self._rates(system)}
        direct = [c for c in system.connections if c.target in gone]
        sources = dict.fromkeys(c.source.component for c in direct)
        silent = [name for name in sources if not system.components[name].interface.of("input")]
        notes = [self._replaced(system, component) for component in silent]
        others = [str(c) for c in direct if c.source.component not in silent]
        notes += [f"the scenario replaces {', '.join(others)}"] if others else []
        kept = (c for c in system.connections if c not in direct and c.source.component not in silent)
        return replace(system, connections=tuple(kept), notes=(*system.notes, *notes))

    def _rates(self, system: System) -> Iterator[Port]:
        """The inputs that are declared as time derivatives of driven ones."""
        for port in self.columns:
            rates = system.components[port.component].interface.rate_inputs
            if port.variable in rates:
                yield Port(port.component, rates[port.variable])

    def _slopes(self, system: System) -> Iterator[Port]:
        """The inputs that are rates of driven ones by their names, where a run gives the slope itself."""
        for port in self.columns:
            if port.variable in system.components[port.component].interface.ramp_inputs:
                yield Port(port.component, f"{port.variable}_rate")

    def _replaced(self, system: System, component: str) -> str:
        fed = [c.target for c in system.connections if c.source.component == component]
        followed = {*self.columns, *self._rates(system), *self._slopes(system)}
        left = ", ".join(str(port) for port in fed if port not in followed)
        rest = f"; without it these keep their start values: {left}" if left else ""
        return f"the scenario replaces {component}{rest}"

    def initial(self, system: System, t: float) -> dict[Port, Value]:
        """Values of the driven inputs at the start."""
        now, held = self.table.at(t), self.table.sample(t)
        values: dict[Port, Value] = {}
        for port, (column, linear) in self.columns.items():
            variable = system.variable(port)
            if variable.is_real:
                values[port] = linear(float((now if variable.is_continuous else held)[column]))
            else:
                values[port] = round(float(held[column]))
        return values

    def overruled(self, system: System, start: Mapping[str, Value | str]) -> tuple[str, ...]:
        """What to say about start values of driven inputs."""
        names = [name for name in start if any(port in self.columns for port, _ in system.targets(name))]
        return tuple(
            f"{n} is driven by the scenario: the start value {start[n]} has no effect" for n in names
        )


def drive(system: System, trace: Trace, label: str = "scenario") -> Scenario:
    """Match the columns of a scenario with inputs, named as `System.targets` knows them."""
    columns: dict[Port, tuple[int, LinearTransformation]] = {}
    for k, name in enumerate(trace.signals):
        for port, linear in _targets(system, name, label):
            if port in columns:
                raise Problem(f"{label}: column {name!r} drives {port}, which another column drives too")
            columns[port] = (k, linear)
    table = np.stack([np.asarray(v, dtype=np.float64) for v in trace.signals.values()], axis=1)
    for port, (k, _) in columns.items():
        _whole(system.variable(port), table[:, k], f"{label}: column {list(trace.signals)[k]!r}")
    return Scenario(ScenarioTable(trace.time, table), columns)


def _whole(variable: FmuVariable, values: NDArray[np.float64], where: str) -> None:
    """Refuse what a run cannot keep as a whole number."""
    wrong = ~(np.abs(values) <= LARGEST)
    if not variable.is_real and wrong.any():
        found = values[np.argmax(wrong)]
        raise Problem(f"{where}: expected whole numbers up to {LARGEST}, got {found:.17g}")


def _targets(system: System, name: str, label: str) -> tuple[tuple[Port, LinearTransformation], ...]:
    """The inputs that a column drives."""
    try:
        targets = system.targets(name)
    except Problem as problem:
        if isinstance(problem, Unsupported) or name in {p.variable for p in system.ports("input")}:
            raise Problem(f"{label}: column {problem}") from None
        inputs = system.ports("input")
        bare = dict.fromkeys([*system.inputs, *(p.variable for p in inputs)])
        near = suggest(name, [*bare, *map(str, inputs)])
        raise Problem(
            f"{label}: column {name!r} is no input of the system{near}; inputs: {', '.join(bare) or 'none'}"
        ) from None
    for port, _ in () if name in system.inputs else targets:
        variable = system.variable(port)
        if variable.causality != "input" or variable.kind == "String":
            raise Problem(
                f"{label}: column {name!r}: expected an input, got a {variable.kind} {variable.causality}"
            )
    return targets
