"""Child processes that run the samples of a study, so that a crash of an FMU ends only its own run.

Each Dask worker keeps as many processes as it has threads.
"""

from __future__ import annotations

import pickle
import queue
import re
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from distributed import WorkerPlugin, get_worker

from orchestrator.base.errors import Problem
from orchestrator.base.processes import machine_memory
from orchestrator.base.text import first_names
from orchestrator.lanes.one_by_one import with_originals
from orchestrator.studies.cases import Unit
from orchestrator.studies.single_run import RunOutcome, failed
from orchestrator.studies.study import Study
from orchestrator.worker.process import LimitExceeded, Worker, WorkerLimits

# Each process uses one thread, because there is a process on every core.
THREADS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")
CONTENTS = {"originals": dict[str, str], "outcomes": tuple[list[RunOutcome], bool]}  # what a process may send
STOPPED = re.compile(r"(time_limit|memory_limit) = ([\d.e+-]+): ")  # begins the reason of a stopped run
WRITTEN = 1e-8  # relative rounding of a limit in a reason, of 9 digits
MEMORY_SHARE = 0.25  # of the machine's memory, for one run without a limit of its own


class ProcessPool(WorkerPlugin):  # type: ignore[misc]  # Dask has no types
    """Plugin of a Dask worker with its child processes, one for each thread, started on demand."""

    def __init__(self, name: str, data: bytes) -> None:
        """name: name of the plugin in this cluster; data: pickled payload."""
        self.name, self._data = name, data
        self._idle: queue.SimpleQueue[Worker]
        self._processes: dict[Worker, Mapping[str, str]]  # unpacked FMU -> original FMU

    def setup(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """Read the study; called on the Dask worker."""
        self._study = pickle.loads(self._data).study
        self._limits = run_limits(self._study)
        self._idle, self._processes, self._stop = queue.SimpleQueue(), {}, threading.Event()

    def teardown(self, worker: Any) -> None:  # noqa: ARG002  Dask passes it
        """End all processes, including those that run a sample."""
        self._stop.set()
        for process in tuple(self._processes):
            self._close(process)

    def run(self, batch: Sequence[Unit]) -> list[RunOutcome]:
        """Run samples; if a sample ends its process, the next one runs in another process."""
        return [outcome for unit in batch for outcome in self._run(unit)]

    def _run(self, unit: Unit) -> list[RunOutcome]:
        """Run samples together; if they end their process or exceed a limit, each one by itself."""
        process = self._process()
        process.forget_printed()  # by the run before
        process.put(unit)
        originals = self._processes[process]
        try:
            outcomes, process.reusable = self._answer(process, self._limits)
            self._idle.put(process) if process.reusable else self._close(process)
        except ProcessEnded as ended:
            self._close(process)
            if len(unit) > 1:
                return [outcome for sample in unit for outcome in self._run((sample,))]
            outcomes = [failed(self._study, unit[0].run, str(ended))]
        return [replace(o, reason=with_originals(o.reason, originals)) for o in outcomes]

    def _answer(self, process: Worker, limits: WorkerLimits) -> Any:
        """The answer of a process to the last message; raises ProcessEnded if it ends or is stopped."""
        try:
            for _, answer in process.messages(limits, self._stop):
                return answer
        except LimitExceeded as limit:
            name = "time_limit" if limit.timed_out else "memory_limit"
            raise ProcessEnded(f"{name} = {_by_key(limits)[name]:.9g}: {limit}") from None
        raise ProcessEnded(process.report)

    def _process(self) -> Worker:
        """An idle process, else a new one that has read the payload."""
        with suppress(queue.Empty):
            return self._idle.get_nowait()
        if self._stop.is_set():
            raise Problem("the study is stopped")
        single_thread = {f"{name}_NUM_THREADS": "1" for name in THREADS}
        process = Worker(
            "orchestrator.studies.payload:main", lambda: CONTENTS, "sweep", environment=single_thread
        )
        self._processes[process] = {}
        process.put(self._data)
        try:
            self._processes[process] = self._answer(process, WorkerLimits())
            process.fmus = first_names(self._processes[process].values())
        except ProcessEnded as ended:
            self._close(process)
            raise Problem(f"a process for runs could not be started: {ended}") from None
        return process

    def _close(self, process: Worker) -> None:
        process.close()
        self._processes.pop(process, None)


def run_limits(study: Study) -> WorkerLimits:
    """The limits of a run of a study on this machine."""
    memory = MEMORY_SHARE * machine_memory() if study.memory_limit is None else 1e9 * study.memory_limit
    return WorkerLimits(total_time=study.time_limit, memory=memory)


def _by_key(limits: WorkerLimits) -> Mapping[str, float]:
    """The limits by the keys of a study file and in its units, [s] and [GB]."""
    return {"time_limit": limits.total_time, "memory_limit": limits.memory / 1e9}


def limit_is_raised(reason: str, limits: WorkerLimits) -> bool:
    """Did a limit stop the run that failed for this reason, and is that limit larger now?"""
    stopped = STOPPED.match(reason)
    return stopped is not None and _by_key(limits)[stopped[1]] > float(stopped[2]) * (1 + WRITTEN)


class ProcessEnded(Exception):
    """A process ended, or was stopped because it exceeded a limit."""


def run_batch(name: str, batch: Sequence[Unit]) -> list[RunOutcome]:
    """The Dask task: run samples in the processes of this Dask worker."""
    pool = get_worker().plugins.get(name)
    if not isinstance(pool, ProcessPool):
        raise Problem(f"worker {get_worker().address}: expected the plugin {name}, got none")
    return pool.run(batch)
