"""Findings of a diagnosis among the outputs of an FMU, whatever its name, and since when each is a fault.

A finding is three outputs: NAME, its size; NAME_deviation, the standard deviation of it, 0 without one; and
NAME_state, 1 for a fault, 0 for none, -1 if that cannot be told. The description of NAME_state contains
"1 a fault (REPAIR)", that of NAME its text. In the same FMU, an output with a deviation but without a state
is an estimate, such as a payload. An input `reset` forgets faults.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.base.signals import bare_name
from orchestrator.base.units import factor_and_offset, pretty, reader_unit
from orchestrator.data.table import Array
from orchestrator.fmi.description import FmuVariable
from orchestrator.ssp.system import System

REPAIR = re.compile(r"\b1 a fault \((.+)\)")
RESET = "reset"
STATE = 0.5  # above it there is a fault
UNKNOWN = 10.0  # deviation over the nominal value, above which an estimate is not known


@dataclass(frozen=True)
class Finding:
    """A finding, or an estimate, which has no repair.

    name             `component.variable` of its size
    unit             displayed unit, typeset
    factor, offset   from the unit of the FMU to that unit
    most             deviation above which an estimate is not known, in the unit of the FMU
    """

    name: str
    text: str
    repair: str
    unit: str
    factor: float = 1.0
    offset: float = 0.0
    most: float = math.inf

    @property
    def signals(self) -> tuple[str, ...]:
        """Size, deviation, and state of a finding."""
        return (self.name, f"{self.name}_deviation", *([f"{self.name}_state"] if self.repair else []))


def findings(system: System) -> tuple[Finding, ...]:
    """All of a system, in the order of its outputs; the estimates are those of an FMU with findings."""
    outputs = {str(port): system.variable(port) for port in system.ports("output")}
    states = {name: REPAIR.search(outputs[name].description) for name in outputs if name.endswith("_state")}
    found = [
        _finding(name, variable, match[1] if (match := states.get(f"{name}_state")) else "")
        for name, variable in outputs.items()
        if variable.is_real and f"{name}_deviation" in outputs
    ]
    diagnosing = {one.name.rpartition(".")[0] for one in found if one.repair}
    return tuple(one for one in found if one.name.rpartition(".")[0] in diagnosing)


def resets(system: System, found: Sequence[Finding]) -> tuple[str, ...]:
    """The inputs without a connection that forget faults."""
    diagnosing = {one.name.rpartition(".")[0] for one in found}
    taken = {connection.target for connection in system.connections}
    free = (port for port in system.ports("input") if port.variable == RESET and port not in taken)
    return tuple(str(port) for port in free if port.component in diagnosing and system.variable(port).is_real)


def _finding(name: str, variable: FmuVariable, repair: str) -> Finding:
    """In the words and units of a mechanic."""
    unit = variable.unit.name if variable.unit else "1"
    shown = "degC" if unit == "K" else reader_unit(unit)
    factor, offset = factor_and_offset(unit, shown, name)
    text = (variable.description or bare_name(name)).removeprefix("1: ")  # of one that is there or not
    text = f"{text[:1].upper()}{text[1:]}".replace("degC", "°C")
    text, repair = text.replace("_", " "), repair.replace("_", " ")
    most = UNKNOWN * variable.nominal if variable.nominal and not repair else math.inf
    return Finding(name, text, repair, pretty(shown).replace("deg", "°"), factor, offset, most)


class FindingTable:
    """What the findings are now, from the frames of the machine.

    rows   for each finding: size and deviation in its displayed unit, state, and the simulated time [s] since
           when it is a fault; NaN for what is not known; empty before the first frame
    """

    def __init__(self, found: Sequence[Finding], signals: Sequence[str]) -> None:
        """signals: of the machine, those of the findings among them."""
        column = {name: k for k, name in enumerate(signals)}
        three = [[*(column[name] for name in one.signals), -1][:3] for one in found]  # the last one is NaN
        self._columns = np.array(three, dtype=int).reshape(-1, 3).T
        scales = [(one.factor, one.offset, one.most) for one in found]
        self._factor, self._offset, self._most = np.array(scales, dtype=float).reshape(-1, 3).T
        self._since = np.full(len(found), np.nan)
        self.rows: Array = np.empty((0, 4))

    def add(self, times: Array, values: Array) -> None:
        """Add frames that follow each other: times (n,), values (n, signals)."""
        if not len(times):
            return
        table = np.column_stack((values, np.full(len(times), np.nan)))
        size, deviation, states = (table[:, columns] for columns in self._columns)
        for t, state in zip(times, states, strict=True):
            self._since = np.where(state > STATE, np.fmin(self._since, t), np.nan)
        known = np.where(deviation[-1] > self._most, np.nan, size[-1])
        scaled = (known * self._factor + self._offset, deviation[-1] * abs(self._factor))
        self.rows = np.column_stack((*scaled, states[-1], self._since))
