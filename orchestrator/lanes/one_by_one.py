"""Machines one by one, in processes of the engine, for any FMUs. A crash of an FMU ends only one machine."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, temporary_folder
from orchestrator.base.interrupts import in_threads
from orchestrator.data.trace_writer import TraceInMemory
from orchestrator.engine import simulation_loop
from orchestrator.engine.job import ENDS_EARLY, Job, Record
from orchestrator.engine.run import finished
from orchestrator.engine.time_grid import Grid
from orchestrator.lanes.group import EARLY, FAILED, Ended
from orchestrator.ssp.system import Port, System
from orchestrator.worker.main import Channel
from orchestrator.worker.process import Worker, WorkerLimits

Array = NDArray[np.float64]
THREADS = {
    f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")
}  # there is a process on each core


@dataclass(frozen=True)
class Task:
    """What a process gets first: the run of a machine, with FMUs in folders."""

    job: Job
    times: Grid
    signals: tuple[str, ...]


def run_one_by_one(
    job: Job,
    times: Grid,
    values: Mapping[Port, Array],
    count: int,
    signals: Sequence[Port],
    rows: Sequence[Array],
    workers: int,
) -> dict[int, Ended]:
    """Simulate n machines in processes; returns those that ended early.

    values   of all machines, shape (n,), in the unit of the FMU
    rows     one array for each signal of all machines, shape (n, points), which is filled
    """
    ended: dict[int, Ended] = {}
    machines, stop = iter(range(count)), threading.Event()
    with ExitStack() as stack:
        system = _unpacked(job.system, stack)
        record = Record(tuple(map(str, signals)), job.record.step, ())
        task = Task(replace(job, system=system, record=record), times, tuple(map(str, signals)))
        data = pickle.dumps(task, pickle.HIGHEST_PROTOCOL)

        def work() -> None:
            with ExitStack() as processes:
                worker: Worker | None = None
                for machine in machines:
                    if stop.is_set():
                        return
                    if worker is None or not worker.alive:
                        worker = Worker("orchestrator.lanes.one_by_one:main", "batch", environment=THREADS)
                        processes.callback(worker.close)
                        worker.put(data)
                    worker.put({port: float(array[machine]) for port, array in values.items()})
                    answer = next(worker.messages(WorkerLimits(), stop), None)
                    if answer is None:  # the process has ended
                        answer = np.zeros((len(rows), 0)), Ended(FAILED, worker.report, times.start)
                        worker.close()
                        worker = None
                    found, end = answer
                    for row, signal in zip(rows, found, strict=True):
                        row[machine, : len(signal)] = signal
                    if end is not None:
                        ended[machine] = end

        in_threads([work] * max(1, min(workers, count)), stop.set)
    return ended


def _unpacked(system: System, stack: ExitStack) -> System:
    """The system with FMUs in folders; each component has its own copy of the libraries."""
    components = dict(system.components)
    folder = stack.enter_context(temporary_folder("batch-", str(system.name)))
    for number, (name, component) in enumerate(components.items()):
        if component.source is not None:
            place = folder / str(number)
            component.source.extract(place)
            components[name] = replace(component, source=Location(place))
    return replace(system, components=components)


def main(channel: Channel) -> None:
    """A process: read the task, then the values of one machine after the other, and send its signals."""
    simulation_loop.CORES = 1
    task: Task = channel.get()
    while True:
        channel.put(_outcome(task, channel.get()))


def _outcome(task: Task, values: Mapping[Port, float]) -> tuple[Array, Ended | None]:
    """Signals of a machine up to its end, shape (signals, points), and why it ended early."""
    sink, end = TraceInMemory(), None
    sink.rows = 0  # until the run begins
    try:
        job = replace(task.job, system=_with_values(task.job.system, values))
        outcome = job.run(task.times, sink)
        result = finished(job, task.times, outcome, sink, sink.trace)
        if early := [note for note in result.card.notes if note.startswith(ENDS_EARLY)]:
            end = Ended(EARLY, " ".join(early[0].removeprefix(ENDS_EARLY).split()), outcome.t)
    except Problem as problem:
        time = sink.last if sink.rows else task.times.start
        end = Ended(FAILED, " ".join(str(problem).split()), time)
    rows = (
        np.array([sink.trace[name] for name in task.signals])
        if sink.rows
        else np.zeros((len(task.signals), 0))
    )
    return rows, end


def _with_values(system: System, values: Mapping[Port, float]) -> System:
    """The system with other start values, in the units of the FMUs."""
    components = dict(system.components)
    for port, value in values.items():
        real = system.variable(port).is_real
        start = {port.variable: value if real else round(value)}
        components[port.component] = components[port.component].chosen(start, "")
    return replace(system, components=components)
