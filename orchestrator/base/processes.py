"""Cores, memory and folders: work in several processes, refusal of results that cannot fit."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem

FLOAT64 = 8  # bytes of a number in memory


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
    import multiprocessing  # on first use, because a child process of `check` must start fast
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool

    others = multiprocessing.active_children()
    context = multiprocessing.get_context("spawn")  # the same on all systems
    with ProcessPoolExecutor(processes, context, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        try:
            yield pool.map
        except BrokenProcessPool:
            raise Problem("a helper process was ended from outside, such as for too little memory") from None
        finally:  # an interrupt does not wait for what they compute
            for child in multiprocessing.active_children():
                if child not in others:
                    child.terminate()


def remove_folder(folder: Path) -> None:
    """Remove a folder as far as possible, also one with more levels than Python can call functions."""
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except RecursionError:
        with suppress(OSError):  # Windows has no `rm`, and no paths that long
            subprocess.run(["rm", "-rf", "--", folder], capture_output=True, check=False)


def machine_memory() -> float:
    """Memory of this machine [bytes]; infinite if unknown."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def resident_memory(process: int) -> float:
    """Resident memory of a process [bytes]; 0 if it has ended, and on systems that do not report it."""
    try:
        pages = Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1]
    except (OSError, IndexError):
        return 0.0
    return float(pages) * os.sysconf("SC_PAGE_SIZE")


def size_text(rows: int, signals: int, number: int = FLOAT64) -> str:
    """How much the rows of a trace are, in words; number: bytes of each number."""
    return f"{rows:.3g} points of {signals} signals, {number * rows * (signals + 1) / 1e9:.2g} GB of values"


def check_room(rows: int, signals: int, folder: Path | None = None, number: int = FLOAT64) -> None:
    """Refuse rows that do not fit on the disk of a folder, or into memory if there is none.

    number   bytes of each number there
    """
    free = shutil.disk_usage(folder).free if folder else machine_memory()
    if number * rows * (signals + 1) > free:
        where = f"on the disk of {folder}" if folder else "into memory"
        size, advice = size_text(rows, signals, number), "choose a longer record step or stop earlier"
        raise Problem(f"{size}, do not fit {where}, {free / 1e9:.2g} GB; {advice}")
