"""Cost of the native FMUs and of the co-simulation: `make bench`.

One run of the work cycle per master and step. The time inside an FMU is that of its fmi2DoStep as
called through ctypes, less the cost of an empty call of the same kind, measured in the same run.
Machines differ and are noisy: compare figures of one run only.
"""

from __future__ import annotations

import ctypes
import statistics
import tempfile
from pathlib import Path
from time import perf_counter_ns
from typing import Any

from fmus.build import build_machine, data
from fmus.machine import SUBSYSTEMS
from orchestrator import load, run
from orchestrator.simulation import open_slave

REPEATS = 3
SETTINGS = (("jacobi", 1e-3), ("gauss-seidel", 1e-3), ("gauss-seidel", 5e-3))


def timed(into: dict[str, list[int]]) -> Any:
    """A factory of slaves whose steps are timed [ns]."""

    def opener(component: Any) -> Any:
        slave = open_slave(component)
        step, spent = slave._step, into.setdefault(component.name, [])  # the bound fmiXDoStep itself

        def measured(*arguments: Any) -> int:
            begin = perf_counter_ns()
            status: int = step(*arguments)
            spent.append(perf_counter_ns() - begin)
            return status

        slave._step = measured
        return slave

    return opener


def empty_call() -> float:
    """Time [ns] of the timer and of a call through ctypes that does nothing."""
    spent = []
    for _ in range(20000):
        begin = perf_counter_ns()
        ctypes.pythonapi.Py_IsInitialized()
        spent.append(perf_counter_ns() - begin)
    return statistics.median(spent)


def main() -> None:
    """Print the table."""
    overhead = empty_call()
    print(f"timer and empty ctypes call: {overhead / 1e3:.2f} us, subtracted below\n")
    print(f"{'master':<14}{'step':>8}  {'us per step inside':<44}{'us per step':>12}{'times real':>12}")
    head = "".join(f"{name:>13}" for name in [*SUBSYSTEMS, "sum"])
    print(f"{'':<14}{'[ms]':>8}{head}{'in all':>12}{'time':>12}")
    with tempfile.TemporaryDirectory() as folder:
        build_machine(Path(folder))
        system = load(Path(folder) / "harvester.ssp")
        scenario = data("scenarios/work_cycle.csv")
        for master, step in SETTINGS:
            best: dict[str, float] = {}
            factor = total = 0.0
            for _ in range(REPEATS):  # the least disturbed run counts
                spent: dict[str, list[int]] = {}
                run(system, scenario, master=master, step=step, open=timed(spent))
                means = {name: statistics.fmean(values) - overhead for name, values in spent.items()}
                if not best or sum(means.values()) < sum(best.values()):
                    best = means
                card = run(system, scenario, master=master, step=step).card
                if card.real_time_factor > factor:
                    factor, total = card.real_time_factor, card.wall / card.steps * 1e6
            costs = [*(best[name] for name in SUBSYSTEMS), sum(best.values())]
            cells = "".join(f"{cost / 1e3:>13.2f}" for cost in costs)
            print(f"{master:<14}{step * 1e3:>8g}{cells}{total:>12.1f}{factor:>12.0f}")


if __name__ == "__main__":
    main()
