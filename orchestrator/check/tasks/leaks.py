"""Instances one after the other, two thousand times: what do they leave behind?"""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Simulation

ROUNDS = 2000  # instances
WARM = 200  # before the memory is measured: caches fill once
WINDOW = 50  # between two looks at the clock
LOADS = 40
LEAK = 16.0  # bytes per instance: the smallest block that an allocator hands out takes more
NOISE = 8e3  # bytes by which the interpreter's own memory goes up and down
PAGES = 1e6  # the same where only the pages of the process are known
FULL = 64e6  # bytes: enough to be sure


def leak(trial: Trial) -> Iterator[Remark]:
    """Two thousand instances leave no memory, no file handle and no thread behind."""
    if not _warmed(trial):
        yield "note", f"an instance takes too long for a look at {ROUNDS} of them"
        return
    measures: dict[str, tuple[Callable[[], float], float, float]] = {
        "bytes of memory": (memory, LEAK, NOISE if _counter() else PAGES),
        "file handles": (handles, 0.01, 2),
        "threads": (running, 0.01, 2),
    }
    looks = {name: [measure()] for name, (measure, _, _) in measures.items()}
    for _ in _windows(trial, looks["bytes of memory"]):
        for name, (measure, _, _) in measures.items():
            looks[name].append(measure())
    for name, (_, limit, noise) in measures.items():
        growth, done = _growth(looks[name], noise), WINDOW * (len(looks[name]) - 1)
        if growth > limit:
            yield "error", f"each instance leaves {growth:.3g} {name} behind (of {done} instances)"


def _windows(trial: Trial, sizes: Sequence[float]) -> Iterator[None]:
    """Instances, with a pause after each window, until time is over or the memory is full."""
    deadline = time.monotonic() + 4 * trial.seconds
    for n in range(ROUNDS // WINDOW):
        if n > 1 and (time.monotonic() > deadline or sizes[-1] - sizes[0] > FULL):
            return
        for _ in range(WINDOW):
            _life(trial)
        yield


def _growth(looks: Sequence[float], noise: float) -> float:
    """Growth per instance, of the half in which it is less: a leak goes on, a table that doubles does not."""
    half = (len(looks) - 1) // 2
    return min(
        (b - a - noise / 2) / (WINDOW * windows)
        for a, b, windows in (
            (looks[0], looks[half], half),
            (looks[half], looks[-1], len(looks) - 1 - half),
        )
    )


def _warmed(trial: Trial) -> bool:
    """Make the first instances; False when that takes too long."""
    deadline = time.monotonic() + 20 * trial.seconds
    for _ in range(WARM):
        if time.monotonic() > deadline:
            return False
        _life(trial)
    return True


def _life(trial: Trial) -> None:
    Simulation(trial).begin().close()


def memory() -> float:
    """Bytes in use: exactly, from the C library, where it tells; else pages of the process."""
    gc.collect()
    function = _counter()
    if function is None:
        return _pages()
    function.restype = _Mallinfo
    info = function()
    return float(info.uordblks + info.hblkhd)


def _counter() -> Any:
    """The function of the C library that counts memory; None where it has none."""
    try:
        return ctypes.CDLL(None).mallinfo2
    except (AttributeError, OSError, TypeError):
        return None


class _Mallinfo(ctypes.Structure):
    _fields_ = [
        (n, ctypes.c_size_t)
        for n in (
            *("arena", "ordblks", "smblks", "hblks", "hblkhd"),
            *("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"),
        )
    ]


def _pages() -> float:
    if sys.platform == "linux":
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
        return float(pages) * os.sysconf("SC_PAGE_SIZE")
    if sys.platform == "win32":
        return 0.0
    import resource

    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def handles() -> float:
    """Open files."""
    if sys.platform == "win32":
        count = ctypes.c_ulong(0)
        kernel = ctypes.windll.kernel32
        kernel.GetProcessHandleCount(kernel.GetCurrentProcess(), ctypes.byref(count))
        return float(count.value)
    return float(len(os.listdir("/dev/fd")))


def running() -> float:
    """Threads of this process, where it is known."""
    folder = Path("/proc/self/task")
    return float(len(os.listdir(folder))) if folder.is_dir() else 0.0


def reload(trial: Trial) -> Iterator[Remark]:
    """Loading, making an instance, freeing and unloading, again and again."""
    before = handles()
    for n in range(LOADS):
        trial.beacon.inputs(f"(loaded for the {n + 1}. time)")
        library = trial.load(trial.folder)
        trial.instance(library=library).free()
        trial.beacon.call("unloading the binary")
        library.close()
    if handles() - before > LOADS / 2:
        yield "error", f"each unloading leaves {(handles() - before) / LOADS:.3g} file handles behind"
