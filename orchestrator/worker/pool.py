"""`Pool`: worker processes of one kind, of which idle ones are kept for the next task."""

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.worker.process import Worker

_of_parent: list[Any] = []  # idle ones, in a forked process; never closed there


class Pool:
    """Worker processes that start when they are needed, for tasks in any number of threads.

    start   starts one
    kept    number of idle ones that wait for the next task, at most
    """

    def __init__(self, start: Callable[[], Worker], kept: float = math.inf) -> None:
        self.start, self._kept = start, kept
        # with the environment variables and the parent at its start
        self._idle: list[tuple[Worker, tuple[int, dict[str, str]]]] = []

    def warm(self, count: int = 1) -> None:
        """Start processes for the next tasks, until so many are idle."""
        while len(self._idle) < count:
            self._idle.append((self.start(), _circumstances()))

    @contextmanager
    def worker(self) -> Iterator[Worker]:
        """An idle process, else a new one; kept for the next task if it is reusable and this one succeeds."""
        worker, circumstances = self._take()
        try:
            worker.forget_printed()
            yield worker
        except BaseException:
            worker.close()
            raise
        if worker.alive and worker.reusable and len(self._idle) < self._kept:
            self._idle.append((worker, circumstances))
        else:
            worker.close()

    def _take(self) -> tuple[Worker, tuple[int, dict[str, str]]]:
        now = _circumstances()
        while True:
            try:
                worker, before = self._idle.pop()
            except IndexError:
                return self.start(), now
            if before[0] != now[0]:
                _of_parent.append(worker)
            elif before == now and worker.alive:
                return worker, now
            else:
                worker.close()

    def close(self) -> None:
        """End the idle processes."""
        with DeferredInterrupts():
            while self._idle:
                self._idle.pop()[0].close()


def _circumstances() -> tuple[int, dict[str, str]]:
    """What a process inherits: an FMU may read environment variables."""
    return os.getpid(), dict(os.environ)
