"""Tasks that look for leaks of memory, file handles and threads over hundreds of instances."""

import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from orchestrator.base.processes import resident_memory
from orchestrator.check.tasks.runner import Remark, Trial
from orchestrator.check.tasks.trial_run import Simulation
from orchestrator.fmi.library import thread_count

INSTANCES = 2000  # created one after the other if memory, file handles or threads grow
WARM_UP = 200  # instances before the first measurement, while caches fill
WINDOW = 50  # instances between two measurements
LOADS = 40  # times that the library is loaded and unloaded
LEAK = 16.0  # bytes per instance; the smallest block of an allocator is larger
NOISE = 8e3  # bytes by which the memory of the interpreter varies
PAGE_NOISE = 1e6  # bytes; the same if only the pages of the process can be counted
ENOUGH = 64e6  # bytes of growth after which the measurement ends


def leak(trial: Trial) -> Iterator[Remark]:
    """Hundreds of instances leak no memory, no file handle and no thread."""
    if not _warmed_up(trial):
        yield "note", f"an instance takes too long for a test with {INSTANCES} instances"
        return
    measures: dict[str, tuple[Callable[[], float], float, float]] = {
        "bytes of memory": (memory, LEAK, NOISE if _memory_counter() else PAGE_NOISE),
        "file handles": (handles, 0.01, 2),
        "threads": (thread_count, 0.01, 2),
    }
    samples = {name: [measure()] for name, (measure, _, _) in measures.items()}
    deadline = time.monotonic() + 4 * trial.seconds
    for number in range(WINDOW, INSTANCES + 1, WINDOW):
        for _ in range(WINDOW):
            _create_and_free(trial)
        for name, (measure, _, _) in measures.items():
            samples[name].append(measure())
        grown = {name: values[-1] - values[0] for name, values in samples.items()}
        limits = ((grown[name], limit * number, noise) for name, (_, limit, noise) in measures.items())
        clean = all(max(growth, noise) <= limit for growth, limit, noise in limits)  # noise hides no leak
        enough = time.monotonic() > deadline or grown["bytes of memory"] > ENOUGH
        if number > WINDOW and (clean or enough):
            break
    for name, (_, limit, noise) in measures.items():
        growth, count = _growth(samples[name], noise), WINDOW * (len(samples[name]) - 1)
        if growth > limit:
            yield "warning", f"each instance leaks {growth:.3g} {name} (of {count} instances)"


def _growth(samples: Sequence[float], noise: float) -> float:
    """Growth per instance, the smaller one of both halves: a table that doubles is not a leak."""
    half = (len(samples) - 1) // 2
    return min(
        (b - a - noise / 2) / (WINDOW * windows)
        for a, b, windows in (
            (samples[0], samples[half], half),
            (samples[half], samples[-1], len(samples) - 1 - half),
        )
    )


def _warmed_up(trial: Trial) -> bool:
    """Create the first instances; False if that takes too long."""
    deadline = time.monotonic() + 20 * trial.seconds
    for _ in range(WARM_UP):
        if time.monotonic() > deadline:
            return False
        _create_and_free(trial)
    return True


def _create_and_free(trial: Trial) -> None:
    Simulation(trial).begin().close()


def memory() -> float:
    """Bytes in use: exact if the C library counts them, else the pages of the process."""
    gc.collect()
    if function := _memory_counter():
        function.restype = _Mallinfo
        info = function()
        return float(info.uordblks + info.hblkhd)
    if sys.platform in ("linux", "win32"):
        return resident_memory(os.getpid())
    import resource

    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def _memory_counter() -> Any:
    """The function of the C library that counts allocated memory; None if there is none."""
    try:
        return ctypes.CDLL(None).mallinfo2
    except (AttributeError, OSError, TypeError):
        return None


class _Mallinfo(ctypes.Structure):
    """struct mallinfo2 of glibc."""

    _names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in _names.split()]


def handles() -> float:
    """Open files."""
    if sys.platform == "win32":
        count = ctypes.c_ulong(0)
        kernel = ctypes.windll.kernel32
        kernel.GetProcessHandleCount(kernel.GetCurrentProcess(), ctypes.byref(count))
        return float(count.value)
    return float(len(os.listdir("/dev/fd")))


def reload(trial: Trial) -> Iterator[Remark]:
    """Loading, instantiating, freeing and unloading many times leaks no file handle."""
    before = handles()
    for n in range(LOADS):
        trial.activity.case(f"load number {n + 1}")
        library = trial.load(trial.folder)
        trial.instance(library=library).free()
        trial.activity.call("unloading the binary")
        library.close()
    if handles() - before > LOADS / 2:
        yield "warning", f"each load and unload leaks {(handles() - before) / LOADS:.3g} file handles"
