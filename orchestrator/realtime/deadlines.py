"""Real time: deadlines of frames, latencies in bins of constant memory, priority, and speed factors."""

from __future__ import annotations

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
    """A speed factor that is possible."""
    if not SLOWEST <= factor <= FASTEST:
        raise Problem(f"speed: expected a factor from {SLOWEST:g} to {FASTEST:g}, got {factor:g}")
    return float(factor)


LEAST, MOST, RATIO = 1e-6, 100.0, 1.02  # [s], [s], from bin to bin
BINS = int(log(MOST / LEAST) / log(RATIO)) + 2


def latency_bin(latency: float) -> int:
    """The bin of a latency [s]."""
    return min(max(int(log(max(latency, LEAST) / LEAST) / log(RATIO)), 0), BINS - 1)


def latency_quantile(bins: NDArray[np.int64], share: float) -> float:
    """The latency [s] that a share of them does not exceed, to 1 %; 0 without any."""
    total = np.cumsum(bins)
    if total[-1] == 0:
        return 0.0
    found = int(np.searchsorted(total, share * total[-1]))
    return float(LEAST * RATIO ** (found + 0.5))


BEHIND = 0.1  # [s]: what is further behind than that is not caught up with
YIELDED = 0.02  # of a frame, left to others where there is no time to sleep
PRIORITY_VARIABLE = "HARVESTER_PRIORITY"  # set to "ordinary" by who wants no priority
PRIORITY = 10  # of SCHED_FIFO: above all that is ordinary, below what the system itself does


class DeadlineClock:
    """Deadlines on the monotonic clock: each is the one before plus a frame, so nothing adds up.

    due       when the next frame is due [s]
    slipped   how long the clock was stopped because the machine could not keep up [s]
    """

    def __init__(self) -> None:
        self.due, self.slipped, self._length = time.monotonic(), 0.0, 0.0

    def begin(self, length: float) -> None:
        """The next frame is due a frame, `length` [s], from now."""
        self._length, self.due = length, time.monotonic() + length

    def wait(self) -> None:
        """Sleep until the frame is due; one that is overdue by too much is due now."""
        rest = self.due - time.monotonic()
        time.sleep(rest if rest > 0 else YIELDED * self._length)
        if rest < -BEHIND:
            now = time.monotonic()
            self.slipped += now - self.due
            self.due = now

    def done(self, length: float) -> None:
        """The next frame is due a frame, `length` [s], after this one was."""
        self._length = length
        self.due += length


def raise_priority() -> str:
    """Ask for the processor before others, and keep the garbage collector out; what was granted."""
    gc.collect()
    gc.freeze()
    gc.disable()
    if os.environ.get(PRIORITY_VARIABLE) == "ordinary":
        return "ordinary scheduling, as wished"
    with suppress(AttributeError, OSError):
        # only Linux has these names
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))  # type: ignore[attr-defined,unused-ignore]
        return f"real-time priority {PRIORITY} (SCHED_FIFO)"
    if sys.platform != "win32":
        with suppress(OSError):
            nice = os.nice(-10)
            _favour_session()
            return f"ordinary scheduling, nice {nice}"
    return "ordinary scheduling"


def _favour_session() -> None:
    """Linux shares out processors among sessions first, where the niceness of a process does not count."""
    with suppress(OSError):
        Path("/proc/self/autogroup").write_text("-10")
