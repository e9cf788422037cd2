"""Machines one by one, each run in a process, for any FMUs. A crash of an FMU ends only one machine."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, temporary_folder
from orchestrator.base.interrupts import in_threads
from orchestrator.data.table import Array
from orchestrator.data.trace_writer import TraceInMemory
from orchestrator.engine.c_library import library
from orchestrator.engine.isolated import run_isolated
from orchestrator.engine.job import ENDS_EARLY, Job, Options, is_late
from orchestrator.lanes.group import EARLY, FAILED, NOT_RELIABLE, Ended
from orchestrator.ssp.system import Port, System


def run_one_by_one(
    job: Job,
    values: Mapping[Port, Array],
    count: int,
    signals: Sequence[Port],
    rows: Sequence[Array],
    points: Array,
    workers: int,
) -> dict[int, Ended]:
    """Simulate n machines in processes; returns those that ended early or are not reliable.

    values   of all machines, shape (n,), in the unit of the FMU
    rows     one array for each signal of all machines, shape (n, points), which is filled
    points   times of the rows [s], shape (points,)
    """
    library()  # raises the Problem of all machines if there is no engine
    ended: dict[int, Ended] = {}
    machines, stopped = iter(range(count)), threading.Event()

    def between(_: float) -> bool:
        if stopped.is_set():
            raise KeyboardInterrupt
        return False

    with temporary_folder("batch-", "the FMUs") as folder:
        (system,), originals = unpacked([job.system], folder)
        options: Options = {**job.options, "record": [*map(str, signals)]}

        def work() -> None:
            for machine in machines:
                if stopped.is_set():
                    return
                if is_late(options):
                    late = f"not begun within {options['time_limit']:g} s"
                    ended[machine] = Ended(FAILED, late, job.times.start)
                    continue
                own = _with_values(system, {port: float(array[machine]) for port, array in values.items()})
                own_job, own_rows = replace(job, system=own, options=options), [row[machine] for row in rows]
                if end := _simulate(own_job, own_rows, points, between):
                    ended[machine] = replace(end, reason=with_originals(end.reason, originals))

        in_threads([work] * max(1, min(workers, count)), stopped.set)
    return ended


def _simulate(job: Job, rows: Sequence[Array], points: Array, end: Callable[[float], bool]) -> Ended | None:
    """Run a machine, and fill its rows, shape (points,), up to its end; returns why it ended early."""
    sink = TraceInMemory()
    sink.rows = 0  # until the run begins
    try:
        outcome = run_isolated(job, sink, end, cores=1)
        result = job.result(outcome, sink)
    except Problem as problem:
        return Ended(FAILED, " ".join(str(problem).split()), sink.last if sink.rows else job.times.start)
    finally:
        if sink.rows:
            trace, count = sink.trace, min(sink.rows, len(points))
            recorded = job.times.aligned(trace.time[:count]) == points[:count]
            for row, name in zip(rows, job.signals or (), strict=True):
                row[:count][recorded] = trace[name][:count][recorded]
    if reason := early_end(result.card.notes):
        return Ended(EARLY, reason, outcome.t)
    return Ended(NOT_RELIABLE, "; ".join(result.card.unreliable), outcome.t) if not result.reliable else None


def early_end(notes: Sequence[str]) -> str:
    """Why an FMU asked for the end of a run, in one line, from the notes of its card; empty if none did."""
    early = [note.removeprefix(ENDS_EARLY) for note in notes if note.startswith(ENDS_EARLY)]
    return " ".join(early[0].split()) if early else ""


def unpacked(
    systems: Sequence[System], folder: Path, extract: Callable[[Location, Path], None] = Location.extract
) -> tuple[list[System], dict[str, str]]:
    """The systems with FMUs in folders, and folder -> original FMU; extract: unpacks an FMU into a folder.

    Components of one FMU share its folder, and thereby its library, as in `run`.
    """
    copies: dict[Location, Path] = {}
    found = []
    for system in systems:
        components = dict(system.components)
        for name, component in components.items():
            if component.source is None:
                continue
            if component.source not in copies:
                copies[component.source] = folder / f"{len(copies):06}"
                extract(component.source, copies[component.source])
            components[name] = replace(component, source=Location(copies[component.source]))
        found.append(replace(system, components=components))
    return found, {str(place): str(source) for source, place in copies.items()}


def with_originals(reason: str, originals: Mapping[str, str]) -> str:
    """A reason with the names of the original FMUs, as folders differ from process to process."""
    for place, original in originals.items():
        reason = reason.replace(place, original)
    return reason


def _with_values(system: System, values: Mapping[Port, float]) -> System:
    """The system with other start values, in the units of the FMUs."""
    components = dict(system.components)
    for port, value in values.items():
        start = {port.variable: value if system.variable(port).is_real else round(value)}
        components[port.component] = components[port.component].with_start(start, "")
    return replace(system, components=components)
