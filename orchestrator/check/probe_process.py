"""Runs a task on an FMU in a child process with limits of time and memory, and returns its outcome.

A child process imports what tasks need and then, on Linux, runs each of them in a fork of itself.
"""

import os
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.base.processes import machine_memory
from orchestrator.fmi.description import ModelDescription
from orchestrator.worker.process import LimitExceeded, Pool, Worker, WorkerLimits

TARGET = "orchestrator.check.tasks.runner:main"
ELSEWHERE = "time_and_state:elsewhere"  # needs a process with other addresses
CONTENTS = {"pid": int, "remark": tuple[str, str], "case": int, "crash": str, "done": Any, "idle": type(None)}
MAX_ATTEMPTS = 6  # child processes for one task; each continues after the case that crashed the one before


@dataclass(frozen=True)
class ProbeLimits(WorkerLimits):
    """Default limits of one probe, changed by `use_probe_limits`; `worker.process` enforces them.

    work_time   wall time [s] that the probe fills with steps and instances
    """

    call_time: float = 10.0
    total_time: float = 60.0
    memory: float = machine_memory() / 4
    work_time: float = 0.5


_limits = [ProbeLimits()]
_halt = threading.Event()  # set by an interrupt; all child processes are stopped then
_places = threading.Semaphore(max(2, min(4, os.cpu_count() or 1)))  # for child processes that work
_pool = Pool(lambda: Worker(TARGET, lambda: CONTENTS, "probe", in_folder=True))


@contextmanager
def use_probe_limits(limits_: ProbeLimits) -> Iterator[None]:
    """Use other limits inside of a with block."""
    _limits.append(limits_)
    try:
        yield
    finally:
        _limits.remove(limits_)


def probe_limits() -> ProbeLimits:
    """The limits in force."""
    return _limits[-1]


@dataclass
class Outcome:
    """Remarks and result of a task, and how its child process failed.

    remarks   (severity, text) of each finding
    crashes   messages about cases that crashed a child process and were skipped
    failure   message about the end of the process before the end of the task; empty if the task is complete
    late      the process was stopped because its time was over; the FMU may only be slow
    result    data for a later task
    case      number of the last case that began; -1 if the task has no cases
    """

    remarks: list[tuple[str, str]] = field(default_factory=list)
    crashes: list[str] = field(default_factory=list)
    failure: str = ""
    late: bool = False
    result: Any = None
    case: int = -1

    @property
    def failed(self) -> bool:
        """The task is incomplete, or it found an error."""
        return bool(self.failure) or any(severity == "error" for severity, _ in self.remarks)


def run(
    folder: Path,
    description: ModelDescription,
    kind: str,
    task: str,
    options: Mapping[str, bool] | None = None,
    payload: Any = None,
) -> Outcome:
    """Run a task on one interface; after a crash in one of its cases a new process runs the other cases.

    options   `perturbable` and `summed` of `Trial`
    payload   data for the task
    """
    trial = {"folder": folder, "description": description, "kind": kind, "seconds": probe_limits().work_time}
    trial |= {**(options or {}), "payload": payload, "first_case": 0}
    outcome = Outcome()
    for _ in range(MAX_ATTEMPTS):
        with _places:
            attempt = _attempt({"task": task, "trial": trial})
        outcome.remarks += attempt.remarks
        outcome.result, outcome.case = attempt.result, attempt.case
        if not attempt.failure or attempt.late or attempt.case < 0:
            outcome.failure, outcome.late = attempt.failure, attempt.late
            break
        outcome.crashes.append(attempt.failure)
        trial["first_case"] = attempt.case + 1
    return outcome


def _attempt(job: Mapping[str, Any]) -> Outcome:
    """Run the task in one child process, an idle one if there is one."""
    outcome, done, idle = Outcome(), False, False
    pool = Pool(_pool.start, kept=0) if job["task"] == ELSEWHERE else _pool
    try:
        with pool.worker() as worker:
            worker.put(job)
            for name, content in worker.messages(probe_limits(), _halt):
                if name == "pid":
                    worker.working = content
                elif name == "remark":
                    outcome.remarks.append(content)
                elif name == "case":
                    outcome.case = content
                elif name == "crash":
                    outcome.failure = content
                elif name == "done" and not outcome.failure:
                    done, outcome.result = True, content
                if idle := name == "idle":
                    break
            if not done and not outcome.failure:
                outcome.failure = worker.report
            worker.reusable = idle
    except LimitExceeded as limit:
        outcome.failure, outcome.late = str(limit), limit.timed_out
    return outcome


@contextmanager
def probe_threads(run: bool) -> Iterator[ThreadPoolExecutor]:
    """Threads that run tasks; child processes end with the block, also after an interrupt.

    run   start two child processes already, which takes them up to two tenths of a second
    """
    pool = ThreadPoolExecutor()
    try:
        _pool.warm(2 * run)
        yield pool
    finally:
        _halt.set()
        pool.shutdown(cancel_futures=True)
        _halt.clear()
        _pool.close()
