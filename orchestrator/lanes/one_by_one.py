"""Machines one by one, in processes of the engine, for any FMUs. A crash of an FMU ends only one machine."""

import pickle
import threading
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location, temporary_folder
from orchestrator.base.interrupts import in_threads
from orchestrator.data.trace_writer import TraceInMemory
from orchestrator.engine import simulation_loop
from orchestrator.engine.job import ENDS_EARLY, Execution, Job, Record
from orchestrator.engine.open_job import run_job
from orchestrator.engine.run import finished
from orchestrator.engine.time_grid import Grid
from orchestrator.lanes.group import EARLY, FAILED, Ended
from orchestrator.ssp.system import Port, System
from orchestrator.worker.main import Channel, left_behind
from orchestrator.worker.process import LimitExceeded, Worker

Array = NDArray[np.float64]
CONTENTS = {"signal": Array, "end": tuple[Ended | None, bool]}  # what a process may send
THREADS = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}  # a process is on each core


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
    with temporary_folder("batch-", "the FMUs") as folder:
        system, originals = _unpacked(job.system, folder)
        names = tuple(map(str, signals))
        task = Task(replace(job, system=system, record=Record(names, job.record.step, ())), times, names)
        data = pickle.dumps(task, pickle.HIGHEST_PROTOCOL)

        def work() -> None:
            with closing(MachineProcess(data, job.execution, job.system.fmus, stop)) as process:
                for machine in machines:
                    if stop.is_set():
                        return
                    if job.execution.late:
                        late = f"not begun within {job.execution.time_limit:g} s"
                        ended[machine] = Ended(FAILED, late, float("nan"))
                        continue
                    own = {port: float(array[machine]) for port, array in values.items()}
                    found, end = process.outcome(own)
                    for row, signal in zip(rows, found, strict=False):  # nothing is found after a crash
                        row[machine, : len(signal)] = signal
                    if end is not None:
                        ended[machine] = replace(end, reason=with_originals(end.reason, originals))

        in_threads([work] * max(1, min(workers, count)), stop.set)
    return ended


class MachineProcess:
    """A process that runs machines, replaced by another one if it crashes."""

    def __init__(self, data: bytes, execution: Execution, fmus: str, stop: threading.Event) -> None:
        """data: pickled Task; execution: has the limits; fmus: their names; stop: set to end a run."""
        self._data, self._execution, self._fmus, self._stop = data, execution, fmus, stop
        self._worker: Worker | None = None

    def outcome(self, values: Mapping[Port, float]) -> tuple[Sequence[Array], Ended | None]:
        """Signals of a machine up to its end, and why it ended early."""
        if self._worker is None:
            target = "orchestrator.lanes.one_by_one:main"
            self._worker = Worker(target, lambda: CONTENTS, "batch", environment=THREADS)
            self._worker.fmus = self._fmus
            self._worker.put(self._data)
        worker = self._worker
        worker.put(dict(values))
        found, reason = list[Array](), ""
        try:
            limits = self._execution.worker_limits
            for name, content in worker.messages(limits, self._stop, self._execution.began):
                if name == "end":
                    end, reusable = content
                    if not reusable:
                        self.close()
                    return found, end
                found.append(content)
        except LimitExceeded as limit:
            reason = str(limit)
        self.close()
        return (), Ended(FAILED, reason or worker.report, float("nan"))

    def close(self) -> None:
        """End the process."""
        if self._worker is not None:
            self._worker.close()
        self._worker = None


def _unpacked(system: System, folder: Path) -> tuple[System, dict[str, str]]:
    """The system with FMUs in folders, each component with its own copy; folder -> original FMU."""
    components, originals = dict(system.components), dict[str, str]()
    for number, (name, component) in enumerate(components.items()):
        if component.source is not None:
            place = folder / str(number)
            component.source.extract(place)
            components[name] = replace(component, source=Location(place))
            originals[str(place)] = str(component.source)
    return replace(system, components=components), originals


def with_originals(reason: str, originals: Mapping[str, str]) -> str:
    """A reason with the names of the original FMUs, as folders differ from process to process."""
    for place, original in originals.items():
        reason = reason.replace(place, original)
    return reason


def main(channel: Channel) -> None:
    """A process: read the task, then the values of one machine after the other, and send its signals."""
    simulation_loop.CORES = 1
    task: Task = channel.get()
    while True:
        values, before = channel.get(), left_behind(threads=False)
        signals, end = _outcome(task, values)
        for signal in signals:
            channel.put("signal", signal)
        channel.put("end", (end, left_behind(threads=False) == before))


def _outcome(task: Task, values: Mapping[Port, float]) -> tuple[list[Array], Ended | None]:
    """Signals of a machine up to its end, and why it ended early."""
    sink, end = TraceInMemory(), None
    sink.rows = 0  # until the run begins
    try:
        job = replace(task.job, system=_with_values(task.job.system, values))
        outcome = run_job(job, task.times, sink)
        result = finished(job, task.times, outcome, sink)
        if early := [note for note in result.card.notes if note.startswith(ENDS_EARLY)]:
            end = Ended(EARLY, " ".join(early[0].removeprefix(ENDS_EARLY).split()), outcome.t)
    except Problem as problem:
        time = sink.last if sink.rows else task.times.start
        end = Ended(FAILED, " ".join(str(problem).split()), time)
    return [sink.trace[name] for name in task.signals] if sink.rows else [], end


def _with_values(system: System, values: Mapping[Port, float]) -> System:
    """The system with other start values, in the units of the FMUs."""
    components = dict(system.components)
    for port, value in values.items():
        real = system.variable(port).is_real
        start = {port.variable: value if real else round(value)}
        components[port.component] = components[port.component].chosen(start, "")
    return replace(system, components=components)
