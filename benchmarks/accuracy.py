"""Accuracy mode against exhaustive search: `python -m benchmarks.accuracy [CASES [SEED]]`.

A case is a random combination of variants and a scenario of `benchmarks.calibration`, with each of three
accuracies of the joint speeds. The true error is the RMS deviation over time, over the range of each joint
speed that moves, from a run by hermite at 0.25 ms with a tolerance of 1e-9 in the FMUs. The cost is the
processor time of the steps of all runs that an accuracy needs, with their error estimates. It is divided by
that of the cheapest equal steps without estimate that meet the accuracy, of five masters and six steps.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.calibration import MASTERS, SCENARIOS, SPEEDS, STANDING, TRUTH, Case, cases
from fmus.machine.build import build_machine
from orchestrator import Problem, System, Trace, load, run
from orchestrator.engine import job
from orchestrator.engine import run as engine_run
from orchestrator.engine.job import RunEnd
from orchestrator.engine.result import Result

ACCURACIES = (1e-2, 1e-3, 1e-4)
STEPS = (5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # s
REPEATS = 3  # of each run; the least time counts
MARKS = "<!-- accuracy -->\n", "<!-- end -->"

Truth = dict[str, tuple[Callable[[Any], Any], float]]


class Measured:
    """Runs of a case, with the processor time of their steps."""

    def __init__(self, system: System, folder: Path, case: Case) -> None:
        scenario, stop = SCENARIOS[case.scenario]
        self._system, self._scenario = system, scenario
        self._options = {"stop": stop, "swap": case.swaps(folder), "record": SPEEDS, "isolate": False}
        true = self(master=TRUTH, step=2.5e-4, record_step=1e-3, tolerance=1e-9).trace
        self._truth: Truth = {
            name: (CubicSpline(true.time, true[name]), float(np.ptp(true[name])))
            for name in SPEEDS
            if np.ptp(true[name]) > STANDING
        }

    def __call__(self, **options: Any) -> Result:
        """Run the scenario."""
        return run(self._system, self._scenario, **self._options, **options)

    def error(self, trace: Trace) -> float:
        """The largest true error of a joint speed."""
        t = trace.time
        squares = [
            np.trapezoid(np.square(trace[name] - true(t)), t) / (t[-1] - t[0]) / span**2
            for name, (true, span) in self._truth.items()
        ]
        return float(np.sqrt(max(squares)))

    def equal_steps(self) -> list[tuple[float, float]]:
        """Error and cost [s] of all masters and steps that are stable."""
        found = []
        for coupling in MASTERS.values():
            for step in STEPS:
                try:
                    results = [self(master=coupling, step=step) for _ in range(REPEATS)]
                except Problem:
                    continue
                found.append((self.error(results[0].trace), min(r.card.wall for r in results)))
        return found

    def accurate(self, accuracy: float, walls: list[float]) -> tuple[float, float, int]:
        """Error, cost [s] and number of the runs for an accuracy; walls: receives the cost of each run."""
        costs = []
        for _ in range(REPEATS):
            walls.clear()
            result = self(accuracy=accuracy, accuracy_of=SPEEDS)
            costs.append(sum(walls))
        return self.error(result.trace), min(costs), len(walls)


def measure_all_runs(walls: list[float]) -> None:
    """Note the cost [s] of each run, also of those that fail or are not accurate enough."""
    simulate = engine_run.simulate

    def noted(*arguments: Any) -> RunEnd:
        end = simulate(*arguments)
        walls.append(end.wall)
        return end

    engine_run.simulate = noted
    # times of other processes do not count
    job.time = SimpleNamespace(perf_counter=time.thread_time)  # type: ignore[assignment]


def main(count: int = 60, seed: int = 1) -> None:
    """Print the table, and write it into docs/coupling.md."""
    walls: list[float] = []
    measure_all_runs(walls)
    rows: dict[float, list[tuple[float, float, int]]] = {a: [] for a in ACCURACIES}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build_machine(folder)
        system = load(folder / "harvester.ssp")
        chosen = cases(np.random.default_rng(seed))
        for _ in range(count):
            case = replace(next(chosen), master="", step=0.0)
            measured = Measured(system, folder, case)
            fixed = measured.equal_steps()
            for accuracy, row in rows.items():
                try:
                    error, cost, runs = measured.accurate(accuracy, walls)
                except Problem as problem:
                    print(f"{case.scenario} {'-'.join(case.variants)}: {problem}", flush=True)
                    error, cost, runs = np.inf, np.nan, len(walls)
                best = min((c for e, c in fixed if e <= accuracy), default=np.nan)
                row.append((error / accuracy, cost / best, runs))
    lines = [
        "|accuracy|cases|reached|cost: median|95 % quantile|runs, on average|",
        "|--:|--:|--:|--:|--:|--:|",
    ]
    for accuracy, row in rows.items():
        errors, costs, runs_of = (np.array(column) for column in zip(*row, strict=True))
        quantiles = np.nanquantile(costs, [0.5, 0.95])
        reached = 100 * np.mean(errors <= 1.0)
        shares = f"{reached:.0f} %|{quantiles[0]:.2f}|{quantiles[1]:.2f}|{np.mean(runs_of):.1f}"
        lines.append(f"|{accuracy:g}|{len(row)}|{shares}|")
    table = "\n".join(lines)
    print(table)
    page = Path(__file__).parents[1] / "docs" / "coupling.md"
    before, rest = page.read_text(encoding="utf-8").split(MARKS[0])
    after = rest[rest.index(MARKS[1]) :]
    page.write_text(f"{before}{MARKS[0]}{table}\n{after}", encoding="utf-8")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
