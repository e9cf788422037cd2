"""A task in a child process: its limits, and what it said, handed over and how it ended."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.fmi.raw_description import ModelDescription
from orchestrator.worker.process import LimitExceeded, Worker, WorkerLimits, machine_memory

ATTEMPTS = 6  # children for one task, each of which goes on after the crash of the one before


@dataclass(frozen=True)
class ProbeLimits(WorkerLimits):
    """What a probe may take; `work`: wall time [s] that it fills with steps and instances."""

    call_time: float = 10.0
    total_time: float = 60.0
    memory: float = machine_memory() / 4
    work_time: float = 0.8


_limits = [ProbeLimits()]
_halt = threading.Event()  # set by an interrupt: children are to be stopped


@contextmanager
def use_probe_limits(changed: ProbeLimits) -> Iterator[None]:
    """Other limits for the time of a block."""
    _limits.append(changed)
    try:
        yield
    finally:
        _limits.remove(changed)


def probe_limits() -> ProbeLimits:
    """The limits in force."""
    return _limits[-1]


@dataclass
class Outcome:
    """What a child said, how it ended ("" when as it should), and what it hands over.

    crashes   ends in stages that were left out after it
    late      it was stopped because its time was over, which may only mean that the FMU is slow
    """

    said: list[tuple[str, str]] = field(default_factory=list)
    crashes: list[str] = field(default_factory=list)
    end: str = ""
    late: bool = False
    result: Any = None
    stage: int = -1

    @property
    def failed(self) -> bool:
        """Did it not end as it should, or find an error?"""
        return bool(self.end) or any(severity == "error" for severity, _ in self.said)


def run(
    folder: Path,
    description: ModelDescription,
    kind: str,
    task: str,
    habits: Mapping[str, bool] | None = None,
    payload: Any = None,
) -> Outcome:
    """One task for one interface; after a crash in one of its stages a new child does the rest.

    habits    what is known of the FMU, see `Trial`
    payload   what the task needs
    """
    trial = {"folder": folder, "description": description, "kind": kind, "seconds": probe_limits().work_time}
    trial |= {**(habits or {}), "payload": payload, "first": 0}
    whole = Outcome()
    for _ in range(ATTEMPTS):
        part = _attempt({"task": task, "trial": trial})
        whole.said += part.said
        whole.result, whole.stage = part.result, part.stage
        if not part.end or part.late or part.stage < 0:
            whole.end, whole.late = part.end, part.late
            return whole
        whole.crashes.append(part.end)
        trial["first"] = part.stage + 1
    return whole


def _attempt(job: Mapping[str, Any]) -> Outcome:
    """Start, watch and read one child."""
    child, outcome, done = (
        Worker("orchestrator.check.tasks.runner:main", "probe", inside=True),
        Outcome(),
        False,
    )
    try:
        child.put(job)
        try:
            for message in child.messages(probe_limits(), _halt):
                if "severity" in message:
                    outcome.said.append((message["severity"], message["text"]))
                outcome.stage = message.get("stage", outcome.stage)
                outcome.end = message.get("crash", outcome.end)
                if "done" in message and not outcome.end:
                    done, outcome.result = True, message["result"]
        except LimitExceeded as limit:
            outcome.end, outcome.late = str(limit), limit.timed_out
        if not done and not outcome.end:
            outcome.end = child.report
        return outcome
    finally:
        child.close()


def in_parallel(work: Callable[[str], Outcome], kinds: Sequence[str]) -> list[Outcome]:
    """Some work for several interfaces at the same time; an interrupt stops the children at once."""
    try:
        with ThreadPoolExecutor() as pool:
            try:
                return list(pool.map(work, kinds))
            except BaseException:
                _halt.set()  # the threads of the pool are waited for
                raise
    finally:
        _halt.clear()
