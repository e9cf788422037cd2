"""Cost of the native FMUs and of the co-simulation: `make bench`.

The work cycle, in turn by the FMUs of the three parts and by harvester.fmu, which is all of them in one. The
time inside an FMU is that of its fmi2DoStep as called through ctypes, less that of an empty call of the same
kind; of each step the least disturbed of the repeats counts. Machines differ and are noisy: compare figures
of one run only.
"""

from __future__ import annotations

import ctypes
import statistics
import tempfile
from functools import partial
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.build import build_machine, data
from fmus.machine import SUBSYSTEMS
from orchestrator import System, load, run
from orchestrator.simulation import open_slave

REPEATS = 5
SETTINGS = (("jacobi", 1e-3), ("gauss-seidel", 1e-3), ("gauss-seidel", 5e-3))
WHOLE = "harvester"
Spent = dict[str, NDArray[np.float64]]  # of each FMU: time inside, step by step [ns]


def timed(into: dict[str, list[int]]) -> Any:
    """A factory of slaves whose steps are timed [ns]."""

    def opener(component: Any) -> Any:
        slave = open_slave(component)
        step, spent = slave._step, into.setdefault(component.name, [])  # the bound fmi2DoStep itself

        def measured(*arguments: Any) -> int:
            begin = perf_counter_ns()
            status: int = step(*arguments)
            spent.append(perf_counter_ns() - begin)
            return status

        slave._step = measured
        return slave

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
    return statistics.median(spent)


def once(system: System, master: str, step: float) -> Spent:
    """One run of the work cycle."""
    spent: dict[str, list[int]] = {}
    run(system, data("scenarios/work_cycle.csv"), master=master, step=step, open=timed(spent))
    return {name: np.array(times, dtype=np.float64) for name, times in spent.items()}


def speed(system: System, master: str, step: float) -> tuple[float, float]:
    """Time [us] per step with all that the orchestrator does, and times real time; best of the repeats."""
    cards = [
        run(system, data("scenarios/work_cycle.csv"), master=master, step=step).card for _ in range(REPEATS)
    ]
    best = min(cards, key=lambda card: card.wall)
    return best.wall / best.steps * 1e6, best.real_time_factor


def main() -> None:
    """Print the table."""
    overhead = empty_call()
    print(f"timer and empty ctypes call: {overhead / 1e3:.2f} us, subtracted from each step below\n")
    print(f"{'':<22}us per step inside the FMUs{'':<33}{'us per step in all':>20}{'times real time':>20}")
    heads = [*SUBSYSTEMS, "sum", WHOLE, "whole/sum", "parts", "whole", "parts", "whole"]
    print(f"{'master':<14}{'step':>8}" + "".join(f"{head:>12}" for head in heads))
    with tempfile.TemporaryDirectory() as folder:
        build_machine(Path(folder))
        parts, whole = (load(Path(folder) / f"{WHOLE}.{suffix}") for suffix in ("ssp", "fmu"))
        for master, step in SETTINGS:
            least: Spent = {}
            for _ in range(REPEATS):
                for name, times in (once(parts, master, step) | once(whole, master, step)).items():
                    least[name] = np.minimum(least.get(name, times), times)
            means = {name: (times.mean() - overhead) / 1e3 for name, times in least.items()}
            total = sum(means[name] for name in SUBSYSTEMS)
            costs = [*(means[name] for name in SUBSYSTEMS), total, means[WHOLE], means[WHOLE] / total]
            (slow, slow_factor), (fast, fast_factor) = (speed(s, master, step) for s in (parts, whole))
            cells = "".join(f"{cost:>12.2f}" for cost in costs) + f"{slow:>12.1f}{fast:>12.1f}"
            print(f"{master:<14}{step * 1e3:>5g} ms{cells}{slow_factor:>12.0f}{fast_factor:>12.0f}")


if __name__ == "__main__":
    main()
