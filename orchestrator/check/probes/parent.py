"""Starts a child for each probe, watches it, and turns a crash, a hang or an exit into words."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.worker.process import Worker, machine_memory

POLL = 0.01  # s between looks at the child
UNFINISHED = "unfinished"


@dataclass(frozen=True)
class Limits:
    """Wall times [s] and memory.

    call     longest single call into the FMU; a longer one is a hang
    probe    longest probe of one side
    work     what one probe fills with steps, instances and the like
    memory   largest child [bytes], where /proc tells; 0: a quarter of the machine's memory
    """

    call: float = 10.0
    probe: float = 60.0
    work: float = 0.8
    memory: float = 0.0


_limits = [Limits()]
_halt = threading.Event()  # set by an interrupt: children are to be stopped


@contextmanager
def limits(changed: Limits) -> Iterator[None]:
    """Other limits for the time of a block."""
    _limits.append(changed)
    try:
        yield
    finally:
        _limits.remove(changed)


def current() -> Limits:
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

    def take(self, line: Mapping[str, Any]) -> None:
        """A message of the child."""
        if "severity" in line:
            self.said.append((line["severity"], line["text"]))
        self.stage = line.get("stage", self.stage)
        if "crash" in line:
            self.end = line["crash"]
        if "done" in line and self.end == UNFINISHED:
            self.end, self.result = "", line["result"]


def run(
    folder: Path, side: str, task: str, habits: Mapping[str, bool] | None = None, payload: Any = None
) -> Outcome:
    """One probe; after a crash in one of its stages a new child does the rest, a few times over.

    habits    what is known of the FMU, see `Bench`
    payload   what the task needs
    """
    whole = Outcome()
    first = 0
    for _ in range(6):
        job = {"folder": str(folder), "side": side, "task": task, "first": first, "habits": habits or {}}
        part = _child(job | {"seconds": current().work, "payload": payload})
        whole.said += part.said
        whole.result, whole.stage = part.result, part.stage
        if not part.end or part.late or part.stage < 0:
            whole.end, whole.late = part.end, part.late
            return whole
        whole.crashes.append(part.end)
        first = part.stage + 1
    return whole


def _child(job: Mapping[str, Any]) -> Outcome:
    """Start, watch and read one child."""
    child = Worker("orchestrator.check.child.main:main", "probe", inside=True)
    try:
        child.put(job)
        outcome = Outcome(end=UNFINISHED)
        end, late = _watch(child, outcome)
        outcome.end, outcome.late = end or _ending(child, outcome), late
        return outcome
    finally:
        child.close()


def _watch(child: Worker, outcome: Outcome) -> tuple[str, bool]:
    """Read until the end; why the child is to be stopped and where it stood, and is only its time over?"""
    begin = moved = time.monotonic()
    count, most = -1, current().memory or machine_memory() / 4
    while True:
        try:
            outcome.take(child.get(POLL))
        except TimeoutError:
            child.quieten()
        except EOFError:
            return "", False
        seen, now = child.seen, time.monotonic()
        if seen.count != count:
            count, moved = seen.count, now
        if count and now - moved > current().call:  # before the first call it is Python that starts
            return f"hang: no return within {current().call:g} s {seen}", False
        if child.memory > most:
            return f"takes more than {most / 1e9:.3g} GB of memory, stopped {seen}", False
        if now - begin > current().probe:
            return f"not done within {current().probe:g} s, stopped {seen}", True
        if _halt.is_set():
            return "interrupted", True


def side_by_side(work: Callable[[str], Outcome], sides: Sequence[str]) -> list[Outcome]:
    """Some work for several sides at the same time; an interrupt stops the children at once."""
    try:
        with ThreadPoolExecutor() as pool:
            try:
                return list(pool.map(work, sides))
            except BaseException:
                _halt.set()  # the threads of the pool are waited for
                raise
    finally:
        _halt.clear()


def _ending(child: Worker, outcome: Outcome) -> str:
    """How the child ended, in words; empty when it did its job."""
    if outcome.end != UNFINISHED:
        return outcome.end
    more = f' ("{child.last_words[:120]}")' if child.last_words else ""
    how = child.ending.replace("exit status", "the process ended with exit status")
    return f"{how} {child.seen}{more}"
