"""Findings of a diagnosis among the outputs of an FMU, whatever its name, and since when each is a fault.

A finding is three outputs: NAME, its size; NAME_deviation, the standard deviation of it, 0 without one; and
NAME_state, 1 for a fault, 0 for none, -1 if that cannot be told. The description of NAME_state contains
"1 a fault (REPAIR)", and after a semicolon may follow the fault in a sentence, or two for a smaller | larger
size than that of the healthy machine; that of NAME is its text. In the same FMU, an output with a deviation
but without a state is an estimate, such as a payload. An input `reset` forgets faults.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from orchestrator.base.units import factor_and_offset, pretty, reader_unit
from orchestrator.fmi.description import FmuVariable
from orchestrator.ssp.system import System

REPAIR, RESET = re.compile(r"\b1 a fault \((.+)\)"), "reset"
UNKNOWN = 10.0  # deviation over the nominal value, above which an estimate is not known


@dataclass(frozen=True)
class Finding:
    """A finding, or an estimate, which has no repair.

    signals   `component.variable` of size, deviation and state
    unit      displayed unit, typeset
    scale     factor and offset to that unit, and the deviation above which an estimate is not known
    words     the fault in a sentence, of a size below that of the healthy machine and above; default: text
    """

    signals: tuple[str, ...]
    text: str
    repair: str
    unit: str
    scale: tuple[float, float, float] = (1.0, 0.0, inf)
    words: tuple[str, ...] = ()


def findings(system: System) -> tuple[tuple[Finding, ...], tuple[str, ...]]:
    """Those of a system, in the order of its outputs, and the free inputs that forget them."""
    found, resets = list[Finding](), list[str]()
    free = set(system.ports("input")) - {connection.target for connection in system.connections}
    for name, component in system.components.items():
        outputs = {v.name: v for v in component.interface.of("output") if v.is_real}
        own = [_finding(name, v, outputs) for n, v in outputs.items() if f"{n}_deviation" in outputs]
        if any(one.repair for one in own):
            found += own
            resets += [str(port) for port in free if port == (name, RESET)]
    return tuple(found), tuple(resets)


def _finding(component: str, size: FmuVariable, outputs: dict[str, FmuVariable]) -> Finding:
    """In the words and units of a mechanic."""
    state = outputs.get(f"{size.name}_state")
    repair = found[1] if state and (found := REPAIR.search(state.description)) else ""
    names = tuple(
        f"{component}.{size.name}{end}" for end in ("", "_deviation", "_state")[: 3 if repair else 2]
    )
    unit = size.unit.name if size.unit else "1"
    shown = "degC" if unit == "K" else reader_unit(unit)
    text = (size.description or size.name).removeprefix("1: ").replace("degC", "°C").replace("_", " ")
    most = UNKNOWN * size.nominal if size.nominal and not repair else inf
    scale = (*factor_and_offset(unit, shown, names[0]), most)
    words = (text[:1].upper() + text[1:], repair.replace("_", " "), pretty(shown).replace("deg", "°"))
    told = state.description.partition("; ")[2] if state else ""
    return Finding(names, *words, scale, tuple(told.split(" | ")) if told else ())


class FindingTable:
    """What the findings of a machine are now.

    rows   for each finding: size and deviation in its displayed unit, state, and the simulated time [s] since
           when it is a fault; NaN for what is not known; empty before the first frame
    """

    def __init__(self, found: Sequence[Finding], signals: Sequence[str], since: Callable[[int], Any]) -> None:
        """signals, since: of the machine."""
        three = [[*map(list(signals).index, one.signals), -1][:3] for one in found]  # the last one is NaN
        self._columns = np.array(three, dtype=int).reshape(-1, 3).T
        self._factor, self._offset, self._most = np.array([one.scale for one in found]).reshape(-1, 3).T
        self._frames, self._number, self._since = since, -1, np.full(len(found), np.nan)
        self.rows = np.empty((0, 4))

    def look(self) -> None:
        """Add the frames since the last call."""
        if not len(self._since):
            return
        numbers, times, _, values = self._frames(self._number)
        if len(numbers):
            table = np.column_stack((values, np.full(len(times), np.nan)))
            size, deviation, states = (table[:, columns] for columns in self._columns)
            for t, state in zip(times, states, strict=True):
                self._since = np.where(state > 0.5, np.fmin(self._since, t), np.nan)
            known = np.where(deviation[-1] > self._most, np.nan, size[-1]) * self._factor + self._offset
            self._number = int(numbers[-1])
            self.rows = np.column_stack((known, deviation[-1] * self._factor, states[-1], self._since))
