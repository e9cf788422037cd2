"""One module for each tool, all with the same `run`; a tool that is not installed is left out.

Each times its loop over the steps alone: FMUs are loaded and initialised before, results are read afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from time import perf_counter, process_time

import numpy as np


@dataclass(frozen=True)
class Spent:
    """Time [s]: by the clock on the wall, and of the processor in all threads of this process.

    The second tells little of what runs in parallel, and much where other processes disturb the first.
    """

    wall: float
    cpu: float

    @classmethod
    def until_now(cls) -> Spent:
        """Since some beginning."""
        return cls(perf_counter(), process_time())

    def __sub__(self, other: Spent) -> Spent:
        return Spent(self.wall - other.wall, self.cpu - other.cpu)


@dataclass(frozen=True)
class Run:
    """What one run gives.

    spent     in the loop
    steps     in the loop
    signals   judged signals at the times `time` [s]; none where nothing was recorded
    """

    spent: Spent
    steps: int
    time: np.ndarray
    signals: Mapping[str, np.ndarray]


def nothing(spent: Spent, steps: int) -> Run:
    """A run without a record."""
    return Run(spent, steps, np.zeros(0), {})


def left_out(tool: str, reason: Exception) -> str:
    """One line about a tool that cannot be loaded."""
    advice = "; Debian and Ubuntu: apt-get install libtbb12" if "libtbb" in str(reason) else ""
    return f"left out: {tool}: {reason}{advice}"


def find(tool: str) -> Callable[..., Run]:
    """`run(system, stop, record, judged, **options)` of a tool; raises ImportError or OSError without it."""
    run: Callable[..., Run] = import_module(f"{__name__}.{tool}").run
    return run
