"""Deadlines of frames, histogram of their latencies, process priority, and speed factors."""

import gc
import os
import sys
import time
from contextlib import suppress
from math import log
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem

SLOWEST, FASTEST = 0.1, 10.0  # times real time


def speed_factor(factor: float) -> float:
    """Check a speed factor. Raises `Problem` outside 0.1 to 10."""
    if not SLOWEST <= factor <= FASTEST:
        raise Problem(f"speed: expected a factor from {SLOWEST:g} to {FASTEST:g}, got {factor:g}")
    return float(factor)


LEAST, MOST, RATIO = 1e-6, 100.0, 1.02  # smallest and largest latency [s]; ratio of neighbouring bins
BINS = int(log(MOST / LEAST) / log(RATIO)) + 2


def latency_bin(latency: float) -> int:
    """Index of the bin of a latency [s]."""
    return min(max(int(log(max(latency, LEAST) / LEAST) / log(RATIO)), 0), BINS - 1)


def latency_quantile(bins: NDArray[np.int64], fraction: float) -> float:
    """Latency [s] that a fraction of the frames does not exceed, within 1 %; 0 without frames."""
    total = np.cumsum(bins)
    if total[-1] == 0:
        return 0.0
    index = int(np.searchsorted(total, fraction * total[-1]))
    return float(LEAST * RATIO ** (index + 0.5))


BEHIND = 0.1  # [s]; a longer delay is not caught up: the clock slips
YIELDED = 0.02  # sleep after an overdue frame, as a fraction of the frame, so that other processes run
PRIORITY_VARIABLE = "HARVESTER_PRIORITY"  # environment variable; "ordinary": no raised priority
PRIORITY = 10  # SCHED_FIFO priority: above ordinary processes, below kernel threads


class DeadlineClock:
    """Deadlines on the monotonic clock: each is the previous one plus a frame, so delays do not accumulate.

    due       time at which the next frame is due [s]
    slipped   total time by which deadlines were moved because the machine could not keep up [s]
    """

    def __init__(self) -> None:
        self.due, self.slipped, self._length = time.monotonic(), 0.0, 0.0

    def begin(self, length: float) -> None:
        """Set the next deadline: `length` [s] from now."""
        self._length, self.due = length, time.monotonic() + length

    def wait(self) -> None:
        """Sleep until the frame is due. A frame that is overdue by more than `BEHIND` is due now."""
        remaining = self.due - time.monotonic()
        time.sleep(remaining if remaining > 0 else YIELDED * self._length)
        if remaining < -BEHIND:
            now = time.monotonic()
            self.slipped += now - self.due
            self.due = now

    def done(self, length: float) -> None:
        """Set the next deadline: `length` [s] after the current one."""
        self._length = length
        self.due += length


def raise_priority() -> str:
    """Request real-time priority and disable the garbage collector. Returns a note on what was granted."""
    gc.collect()
    gc.freeze()
    gc.disable()
    if os.environ.get(PRIORITY_VARIABLE) == "ordinary":
        return f"ordinary scheduling, as {PRIORITY_VARIABLE} asks for"
    with suppress(AttributeError, OSError):
        # only Linux has these names
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))  # type: ignore[attr-defined,unused-ignore]
        return f"real-time priority {PRIORITY} (SCHED_FIFO)"
    if sys.platform != "win32":
        with suppress(OSError):
            nice = os.nice(-10)
            with suppress(OSError):  # Linux applies nice only within a session
                Path("/proc/self/autogroup").write_text("-10")
            return f"ordinary scheduling, nice {nice}"
    return "ordinary scheduling"
