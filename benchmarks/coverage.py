"""How often do the 95 % intervals of the procedures hold the truth, and how far off are the estimates?

    python -m benchmarks.coverage [--seeds 100] [--machine lumped]

The virtual test rig simulates its benches and joints once; each seed is another noise of the instruments. The
recordings go through files, as a user's do, and `fmus.identification` sees nothing but these. Truth is what
the rig was built from. Prints a table; exit status 1 if a parameter of Figs. 5 to 9 misses a bar.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from multiprocessing import Pool
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fmus.components.spool_valve import opening
from fmus.identification.estimate import Estimate
from fmus.identification.machine import Parameters, lookup, nominal
from fmus.identification.pipeline import PROCEDURES, identify
from fmus.identification.procedure_result import ProcedureResult
from fmus.identification.recordings.reading import read_folder
from fmus.rig.experiments import EXPERIMENTS, experiment
from fmus.rig.recordings import write

VOLTS = (1.5, 2.0, 3.0, 5.0, 8.0, 10.0)
ERROR, CURVE = 0.02, 0.03  # bars: of a parameter, of C_R(V) from 1.5 V up
LEAST, MOST = 0.90, 0.99  # bars: share of intervals that hold the truth


def truth(known: Parameters) -> dict[str, float]:
    """C_R(V) of the valve; the parameters of the parts are found by name."""
    v = {
        n: lookup(f"valve_{n}", known).value
        for n in ("area", "dead_band", "full_command", "command_rounding")
    }
    c_d, density = lookup("valve_discharge_coefficient", known).value, lookup("density", known).value
    shares = [float(opening(x, v["dead_band"], v["full_command"], v["command_rounding"])) for x in VOLTS]
    areas = [v["area"] * share for share in shares]
    return {f"C_R({x:g} V)": density / (2 * (c_d * a) ** 2) for x, a in zip(VOLTS, areas, strict=True)}


def trial(task: tuple[int, str]) -> list[tuple[str, float, float, float]]:
    """One seed: (name, value, low, high) of everything that has a truth."""
    seed, machine = task
    with TemporaryDirectory() as folder:
        for name in EXPERIMENTS:
            if not name.startswith("machine"):
                write(Path(folder), experiment(name, machine), seed)
        found = identify(read_folder(folder), joint=False)
    curve = truth(nominal())
    return [(e.name, e.value, e.low, e.high) for e in _with_truth(found.results, curve)]


def _with_truth(results: Iterable[ProcedureResult], curve: Mapping[str, float]) -> Iterator[Estimate]:
    for result in results:
        yield from result.estimates
        yield from (e for e in result.others if e.name in curve)


def main() -> int:
    """Run all seeds on all cores and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--machine", default="lumped")
    chosen = parser.parse_args()
    for name in EXPERIMENTS:  # simulated before the processes divide
        if not name.startswith("machine"):
            experiment(name, chosen.machine)
    tasks = [(seed, chosen.machine) for seed in range(chosen.seeds)]
    found: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    with Pool() as pool:
        for done, rows in enumerate(pool.imap_unordered(trial, tasks), 1):
            for name, *numbers in rows:
                found[name].append((numbers[0], numbers[1], numbers[2]))
            print(f"\r{done} of {chosen.seeds} seeds", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return report({name: np.array(rows) for name, rows in found.items()}, nominal())


def report(found: Mapping[str, np.ndarray], known: Parameters) -> int:
    """The table; 1 if a bar is missed."""
    curve, missed = truth(known), 0
    print("| parameter | truth | mean error | largest error | half interval | holds the truth | bars |")
    print("|---|---|---|---|---|---|---|")
    for name, rows in found.items():
        true = curve[name] if name in curve else lookup(name, known).value
        error = rows[:, 0] / true - 1
        half = float(np.mean(rows[:, 2] - rows[:, 1])) / 2 / true
        holds = float(np.mean((rows[:, 1] <= true) & (true <= rows[:, 2])))
        good = np.abs(error).max() <= (CURVE if name in curve else ERROR) and LEAST <= holds <= MOST
        missed += not good
        print(
            f"| `{name}` | {true:.4g} | {_percent(error.mean())} | {_percent(np.abs(error).max())} "
            f"| {_percent(half)} | {100 * holds:.0f} % | {'met' if good else 'MISSED'} |"
        )
    print(f"\n{len(found)} quantities, {max(map(len, found.values()))} seeds, {missed} miss a bar")
    print(f"procedures: {', '.join(PROCEDURES)}")
    return 1 if missed else 0


def _percent(share: float) -> str:
    return f"{100 * share:.3f} %"


if __name__ == "__main__":
    sys.exit(main())
