"""The cores of this computer, and a function like `map` whose work is done in several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any


def available_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def mapping(processes: int) -> Iterator[Callable[..., Iterable[Any]]]:
    """A function like `map`, with results in the order of its arguments.

    processes   number of processes; below 2 the work is done in this one. A program that asks for more needs
                the guard `if __name__ == "__main__"`, because each process imports its main module.

    An interrupt ends this process only, and the others with it.
    """
    if processes < 2:
        yield map
        return
    context = multiprocessing.get_context("spawn")  # the same on all systems
    with context.Pool(processes, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        yield pool.imap
