"""Doubtful values: start values, columns and times of a user, a factor 1000 from what a system expects.

What is usual follows from the nominal value and the start value that an FMU declares. If it declares no
nominal value at all, a start value of 0 or 1 is regarded as a placeholder, and nothing is doubtful.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.base.errors import Problem, one_line
from orchestrator.base.units import LinearTransformation, doubt, doubts, factor_and_offset
from orchestrator.ssp.system import Port, System, coerce

if TYPE_CHECKING:
    from orchestrator.data.recording import Recording
    from orchestrator.data.trace import Trace

LONG = 1000.0  # [s]; a shorter scenario is not doubtful
LONGER = 20.0  # times the experiment of the system


def usual(system: System, port: Port) -> list[float]:
    """Usual magnitudes of a variable, in the unit of the FMU; none if the FMU says nothing about it."""
    interface, variable = system.components[port.component].interface, system.variable(port)
    nominal, start = interface.nominal(port.variable), 0.0
    if variable.start is not None and variable.is_real:
        start = float(coerce(str(port), variable, variable.start))
    if start == 1.0 and not nominal:
        return []
    return [start or nominal] if variable.causality == "parameter" else [start, nominal]


def doubtful(system: System, port: Port, values: ArrayLike, name: str = "", peak: bool = False) -> str:
    """Why values of a port, in the unit of the FMU, are doubtful; empty if they are not.

    peak   only the largest magnitude counts, as for a signal over time
    """
    variable, sizes = system.variable(port), np.atleast_1d(np.asarray(values, float))
    if not variable.is_real or not len(sizes):
        return ""
    unit, scale = variable.unit.name if variable.unit else "1", usual(system, port)
    largest = sizes[np.argmax(np.abs(sizes))]
    told = (doubt(name or str(port), float(v), unit, scale) for v in ([largest] if peak else sizes))
    return next(filter(None, told), "")


def doubtful_starts(system: System) -> Iterator[str]:
    """The doubtful ones of the start values that a user chose, by --set or in a parameter set."""
    told = set[tuple[str, float]]()  # components may share a parameter
    for component in system.components.values():
        for variable in component.origins:
            value = component.start.get(variable)
            if isinstance(value, float) and (variable, value) not in told:
                told.add((variable, value))
                yield doubtful(system, Port(component.name, variable), value)


@contextmanager
def doubts_told(system: System) -> Iterator[None]:
    """Add the doubtful start values to a Problem of FMUs that refuse them: there is no card to tell them."""
    try:
        yield
    except Problem as problem:
        doubts = dict.fromkeys(filter(None, doubtful_starts(system)))
        problem.args = (one_line("; ".join((str(problem), *doubts))),)
        raise


def doubtful_columns(
    system: System, trace: Trace, columns: Mapping[Port, tuple[int, LinearTransformation]], label: str
) -> Iterator[str]:
    """The doubtful columns and times of a scenario; columns: input -> column and linear map."""
    names = list(trace.signals)
    for port, (k, linear) in columns.items():
        values = linear.factor * trace.signals[names[k]] + linear.offset
        yield doubtful(system, port, values, f"{label}: column {names[k]}", peak=True)
        if system.unit(port) is None and (unit := trace.units.get(names[k], "1")) != "1":
            yield f"{label}: column {names[k]}: no unit of {port} is defined; its values are taken in {unit}."
    yield doubtful_end(system, trace, label)


def doubtful_end(system: System, trace: Trace, label: str) -> str:
    """Why the last time of a trace is doubtful, compared with the experiment of the system and its FMUs."""
    stops = [t for t in (system.stop, *(c.interface.stop for c in system.components.values())) if t]
    end, usual_end = float(trace.time[-1]), max(stops, default=0.0)
    if not usual_end or end < max(LONG, LONGER * usual_end):
        return ""
    return f"{label}: time = {end:.6g} s, usually about {usual_end:g} s; did you mean ms?"


def refuse_long(system: System, trace: Trace, label: str) -> None:
    """Raise Problem if the last time of a scenario is doubtful: its run would take as long."""
    if doubt := doubtful_end(system, trace, label):
        then = 'If so, state unit = "ms" in [time] of its .toml file; if not, give the stop time, or --yes'
        raise Problem(f"{doubt} {then}")


def doubtful_signals(system: System, recording: Recording, label: str) -> Iterator[str]:
    """The doubtful ones of the listed signals of a recording, in units of its file."""
    peaks: list[tuple[str, float, str, list[float]]] = []
    for name in (n for n in recording.signals if n not in recording.unlisted):
        port = next((p for p in system.ports("output") if name in (str(p), p.variable)), None)
        unit = system.variable(port).unit if port else None
        if port and unit:
            peak, of_file = recording.peak(name)
            factor, offset = factor_and_offset(unit.name, of_file, f"{label}: {name}")
            sizes = [factor * size + offset for size in usual(system, port)]
            peaks.append((f"{label}: {name}", peak, of_file, sizes))
    yield from doubts(peaks)


def with_doubts(system: System, doubts: Iterable[str]) -> System:
    """The system with further warnings, each once."""
    new = (d for d in dict.fromkeys(doubts) if d and d not in system.warnings)
    return replace(system, warnings=(*system.warnings, *new))
