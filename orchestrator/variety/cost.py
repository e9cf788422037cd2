"""The time that a run spends inside each FMU.

That of its fmi2DoStep or fmi3DoStep as called through ctypes, less that of an empty call of the same kind
right after it; of each step, and of each empty call, the least disturbed of several runs counts. Machines
differ and are noisy: compare figures of one sitting only.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.runs.simulation import open_slave, run
from orchestrator.slaves.slave import Slave
from orchestrator.system.system import Component, System

Spent = dict[str, list[tuple[int, int]]]  # of each component: time of each step and of an empty call [ns]


def timed(spent: Spent) -> Callable[[Component], Slave]:
    """Opens slaves whose calls of fmi2DoStep or fmi3DoStep are timed, the call through ctypes included."""

    def opener(component: Component) -> Slave:
        slave: Any = open_slave(component)
        step, nothing, mine = slave._step, _empty_call(), spent.setdefault(component.name, [])

        def measured(*arguments: Any) -> int:
            begin = perf_counter_ns()
            status: int = step(*arguments)
            between = perf_counter_ns()
            nothing(*arguments)
            mine.append((between - begin, perf_counter_ns() - between))
            return status

        slave._step = measured
        return slave  # type: ignore[no-any-return]

    return opener


def _empty_call() -> Callable[..., int]:
    """A call that does nothing, to be given the arguments of a step."""
    address = ctypes.cast(ctypes.pythonapi.Py_IsInitialized, ctypes.c_void_p).value or 0
    nothing = ctypes.CFUNCTYPE(ctypes.c_int)(address)  # types of arguments would have to be checked
    return partial(nothing, ctypes.c_void_p())


def inside(systems: Sequence[System], repeats: int = 3, **options: Any) -> list[dict[str, float]]:
    """Of each system: component -> mean time per step inside it [us]; `options` go to `run`.

    The systems take turns, so that what disturbs the machine for a while disturbs all of them.
    """
    least: list[dict[str, NDArray[np.float64]]] = [{} for _ in systems]
    for _ in range(repeats):
        for system, best in zip(systems, least, strict=True):
            spent: Spent = {}
            run(system, open=timed(spent), native=False, **options)
            for name, steps in spent.items():
                best[name] = np.minimum(best.get(name, np.inf), steps)
    return [{n: float(np.subtract(*steps.mean(axis=0))) / 1e3 for n, steps in best.items()} for best in least]
