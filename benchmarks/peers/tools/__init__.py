"""One module for each tool, all with the same `run`; a tool that is not installed is left out.

Each times its loop over the steps alone: FMUs are loaded and initialised before, results are read afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module

import numpy as np


@dataclass(frozen=True)
class Run:
    """What one run gives.

    wall      time of the loop [s]
    steps     in the loop
    signals   judged signals at the times `time` [s]; none where nothing was recorded
    """

    wall: float
    steps: int
    time: np.ndarray
    signals: Mapping[str, np.ndarray]


def nothing(wall: float, steps: int) -> Run:
    """A run without a record."""
    return Run(wall, steps, np.zeros(0), {})


def find(tool: str) -> Callable[..., Run]:
    """`run(system, stop, record, judged, **options)` of a tool; raises ImportError or OSError without it."""
    run: Callable[..., Run] = import_module(f"{__name__}.{tool}").run
    return run
