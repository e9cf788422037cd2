"""The time that a run spends inside each FMU.

That of its fmi2DoStep or fmi3DoStep as called through ctypes, less that of an empty call of the same kind; of
each step the least disturbed of several runs counts. Machines differ and are noisy: compare figures of one
sitting only.
"""

from __future__ import annotations

import ctypes
import statistics
from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.simulation import open_slave, run
from orchestrator.slave import Slave
from orchestrator.system import Component, System

Spent = dict[str, list[int]]  # of each component: time of each step [ns]


def timed(spent: Spent) -> Callable[[Component], Slave]:
    """Opens slaves whose calls of fmi2DoStep or fmi3DoStep are timed, the call through ctypes included."""

    def opener(component: Component) -> Slave:
        slave: Any = open_slave(component)
        step, mine = slave._step, spent.setdefault(component.name, [])

        def measured(*arguments: Any) -> int:
            begin = perf_counter_ns()
            status: int = step(*arguments)
            mine.append(perf_counter_ns() - begin)
            return status

        slave._step = measured
        return slave  # type: ignore[no-any-return]

    return opener


def empty_call() -> float:
    """Time [ns] of the timer and of a call that does nothing, with arguments like those of fmi2DoStep."""
    kind = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)
    nothing = kind(ctypes.cast(ctypes.pythonapi.Py_IsInitialized, ctypes.c_void_p).value or 0)
    call, spent = partial(nothing, ctypes.c_void_p()), []
    time, length = ctypes.c_double(1.0), ctypes.c_double(1e-3)
    for _ in range(20000):
        begin = perf_counter_ns()
        call(time, length, 1)
        spent.append(perf_counter_ns() - begin)
    # the best of several stretches: another program may hold the machine for a while
    return min(statistics.median(spent[k : k + 500]) for k in range(0, len(spent), 500))


def inside(systems: Sequence[System], repeats: int = 3, **options: Any) -> list[dict[str, float]]:
    """Of each system: component -> mean time per step inside it [us]; `options` go to `run`.

    The systems take turns, so that what disturbs the machine for a while disturbs all of them.
    """
    overhead = empty_call()
    least: list[dict[str, NDArray[np.float64]]] = [{} for _ in systems]
    for _ in range(repeats):
        for system, best in zip(systems, least, strict=True):
            spent: Spent = {}
            run(system, open=timed(spent), **options)
            for name, steps in spent.items():
                best[name] = np.minimum(best.get(name, np.inf), steps)
    return [{name: float(steps.mean() - overhead) / 1e3 for name, steps in best.items()} for best in least]
