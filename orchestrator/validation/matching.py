"""A run of one FMU under the names of a reference or layout that was made for a system of several."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from orchestrator.files.trace import Trace


def by_variable(trace: Trace, wanted: Iterable[str]) -> Trace:
    """The signals of one FMU under the wanted names that differ from theirs by the component only.

    Wanted names that share a variable, such as a.flow and b.flow, stay unknown: the FMU has one at most.
    """
    names = dict.fromkeys(wanted)
    seen = Counter(_variable(name) for name in names)
    new = {_variable(name): name for name in names if seen[_variable(name)] == 1}

    def name(own: str) -> str:
        return new.get(_variable(own), own)

    signals = {name(own): values for own, values in trace.signals.items()}
    return Trace(trace.time, signals, {name(own): unit for own, unit in trace.units.items()})


def _variable(name: str) -> str:
    return name.partition(".")[2]
