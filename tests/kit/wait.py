"""Waiting without a clock: a test ends as soon as something holds, and only a failure takes long."""

import os
import time
from collections.abc import Callable
from pathlib import Path

LONG = 120.0  # s; only a test that fails waits for it, also on a computer that does much else


def until(condition: Callable[[], object], patience: float = LONG) -> bool:
    """Wait until something holds; False if it does not in time."""
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.005)
    return True


def runs(pid: int) -> bool:
    """Is there such a process, and not one that only waits to be noticed?"""
    try:
        os.kill(pid, 0)
        state = Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[0]
        return state not in "ZX"
    except (OSError, IndexError):
        return False
