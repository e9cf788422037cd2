"""A run of one FMU under the names of a reference or layout that was made for a system of several."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from orchestrator.files.trace import Trace
from orchestrator.validation.reference import Reference, Signal


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


def once(reference: Reference) -> Reference:
    """Without signals that are those of another one under the name of another component.

    One sensor on a line that feeds two components is one variable of the FMU that holds both.
    """
    kept: dict[str, Signal] = {}
    for name, signal in reference.signals.items():
        twins = (s for n, s in kept.items() if _variable(n) == _variable(name))
        if not any(np.array_equal(s.values, signal.values) and s.unit == signal.unit for s in twins):
            kept[name] = signal
    return replace(reference, signals=kept)


def _variable(name: str) -> str:
    return name.partition(".")[2]
