"""The process of a machine in real time as its parent sees it: started, asked, ended."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.realtime.setup import Setup
from orchestrator.realtime.shared_memory import Memory
from orchestrator.worker.process import Worker


@dataclass(frozen=True)
class Task:
    """Handed over through the pipe.

    address   of the shared memory
    rows      frames that it holds
    first     number of the first frame
    serial    of the last command that is not for this session
    """

    setup: Setup
    address: str
    rows: int
    first: int
    serial: int


PATIENCE = 3.0  # [s] for an orderly end, then it is killed


class Process:
    """One process, from its start until `end` is called or nobody knows it any more."""

    def __init__(self, setup: Setup, memory: Memory, rows: int, first: int, serial: int) -> None:
        """See `Task`."""
        target = "orchestrator.realtime.child:main"
        self._worker = Worker(target, "live", PATIENCE, descriptors=memory.descriptors)
        self.end = self._worker.close
        memory.handed_over()
        self._worker.put(Task(setup, memory.address, rows, first, serial))

    @property
    def pid(self) -> int:
        """Its number."""
        return self._worker.pid

    @property
    def fate(self) -> str:
        """How the process ended; empty while it lives."""
        return self._worker.ending and f"the process of the machine ended: {self._worker.ending}"
