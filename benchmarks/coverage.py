"""How often do the 95 % intervals of the procedures hold the truth, and how far off are the estimates?

    python -m benchmarks.coverage [--seeds 100] [--machine lumped] [--only openings]

The virtual test rig simulates its benches and joints once; each seed is another noise of the instruments and
another zero of the encoders within one count, since otherwise all seeds would share one rounding of the
angles. The recordings go through files, as a user's do, and `fmus.identification` sees nothing but these.
Truth is what the rig was built from. A second table is on opening curves of valves, whose recordings have
equations of their own (`benchmarks.openings`). Exit status 1 if a parameter of Figs. 5 to 9 or an opening
curve misses a bar.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from multiprocessing import Pool
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.openings import VALVES, Trial, trials
from fmus.components.spool_valve import opening
from fmus.identification.machine import Parameters, lookup, nominal
from fmus.identification.pipeline import PROCEDURES, identify
from fmus.identification.recordings.reading import read_folder
from fmus.identification.results import Estimate, ProcedureResult
from fmus.rig.experiments import ANGLE, EXPERIMENTS, WEIGHED, Experiment, experiment, generator
from fmus.rig.recordings import write
from orchestrator.base.units import parse_unit

VOLTS = (1.5, 2.0, 3.0, 5.0, 8.0, 10.0)
ERROR, CURVE = 0.02, 0.03  # bars: of a parameter, of C_R(V) from 1.5 V up
LEAST, MOST = 0.90, 0.99  # bars: share of intervals that hold the truth
# intervals with a part that no seed changes may always hold the truth: the foot of the opening, which no
# sensor shows, and the leakage of the valve, which is assumed
BOUNDED = ("valve_dead_band", *(f"C_R({x:g} V)" for x in VOLTS))
AREA, ZERO = 0.01, 3.0  # bars of openings: error of the area at full command, zero over the declared one


def truth(known: Parameters) -> dict[str, float]:
    """C_R(V) of the valve and the payload; the parameters of the parts are found by name."""
    v = {
        n: lookup(f"valve_{n}", known).value
        for n in ("area", "dead_band", "full_command", "command_rounding")
    }
    c_d, density = lookup("valve_discharge_coefficient", known).value, lookup("density", known).value
    shares = [float(opening(x, v["dead_band"], v["full_command"], v["command_rounding"])) for x in VOLTS]
    areas = [v["area"] * share for share in shares]
    resistances = {f"C_R({x:g} V)": density / (2 * (c_d * a) ** 2) for x, a in zip(VOLTS, areas, strict=True)}
    return resistances | {"payload[weighing_loaded]": WEIGHED}


def trial(task: tuple[int, str]) -> list[tuple[str, float, float, float]]:
    """One seed: (name, value, low, high) of everything that has a truth."""
    seed, machine = task
    with TemporaryDirectory() as folder:
        for name in EXPERIMENTS:
            if not name.startswith("machine"):
                write(Path(folder), _mounted(experiment(name, machine), seed), seed)
        found = identify(read_folder(folder), joint=False)
    curve = truth(nominal())
    return [(e.name, e.value, e.low, e.high) for e in _with_truth(found.results, curve)]


def _mounted(true: Experiment, seed: int) -> Experiment:
    """The experiment with encoders whose zeros are up to half a count off."""
    signals = dict(true.signals)
    for name, value in true.signals.items():
        if (instrument := true.instruments[name]) == ANGLE:
            count = instrument.resolution * parse_unit(instrument.unit).factor
            signals[name] = value + count * (generator(seed, true.name, f"zero of {name}").random() - 0.5)
    return replace(true, signals=signals)


def _with_truth(results: Iterable[ProcedureResult], curve: Mapping[str, float]) -> Iterator[Estimate]:
    for result in results:
        yield from result.estimates
        yield from (e for e in result.others if e.name in curve)


def main() -> int:
    """Run all seeds on all cores and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--machine", default="lumped")
    parser.add_argument("--only", choices=("parameters", "openings"))
    chosen = parser.parse_args()
    missed = 0
    if chosen.only != "openings":
        missed += _parameters(chosen.seeds, chosen.machine)
    if chosen.only != "parameters":
        missed += _openings(chosen.seeds)
    return 1 if missed else 0


def _openings(seeds: int) -> int:
    """The table of opening curves; the number of missed bars."""
    tasks = [(valve, seed) for valve in VALVES for seed in range(seeds)]
    with Pool() as pool:
        rows = [trial for each in pool.starmap(trials, tasks, chunksize=1) for trial in each]
    columns = (
        "opening",
        "areas in their 95 % interval",
        "half the interval",
        "largest error of the table between",
        "largest error of the area",
        "largest zero over the declared one",
        "starts in their interval",
        "straight line suffices",
        "bars",
    )
    print(f"| {' | '.join(columns)} |")
    print("|---|---|---|---|---|---|---|---|---|")
    missed = sum(not _opening_row(valve, [t for t in rows if t.valve == valve]) for valve in VALVES)
    print(f"\n{len(VALVES)} valves, {seeds} seeds, {missed} miss a bar\n")
    return missed


def _opening_row(valve: str, rows: Sequence[Trial]) -> bool:
    """One row of the table; whether it meets all bars."""
    held, table = float(np.mean([t.inside for t in rows])), max(t.table for t in rows)
    area, zero = max(abs(t.area) for t in rows), max(t.zero for t in rows)
    good = held >= LEAST and area < AREA and zero <= ZERO
    start, straight = (sum(getattr(t, name) for t in rows) for name in ("start", "straight"))
    starts = "-" if straight == len(rows) else f"{start} of {len(rows)}"
    half = float(np.median([t.half for t in rows]))
    print(
        f"| {valve} | {_percent(held)} | {_percent(half)} | {_percent(table)} | {_percent(area)} "
        f"| {zero:.2f} | {starts} | {straight} of {len(rows)} | {'met' if good else 'MISSED'} |"
    )
    return good


def _parameters(seeds: int, machine: str) -> int:
    """The table of parameters; the number of missed bars."""
    for name in EXPERIMENTS:  # simulated before the processes divide
        if not name.startswith("machine"):
            experiment(name, machine)
    tasks = [(seed, machine) for seed in range(seeds)]
    found: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    with Pool() as pool:
        for done, rows in enumerate(pool.imap_unordered(trial, tasks), 1):
            for name, *numbers in rows:
                found[name].append((numbers[0], numbers[1], numbers[2]))
            print(f"\r{done} of {seeds} seeds", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return report({name: np.array(rows) for name, rows in found.items()}, nominal())


def report(found: Mapping[str, np.ndarray], known: Parameters) -> int:
    """The table; the number of missed bars."""
    curve, missed = truth(known), 0
    print("| parameter | truth | mean error | largest error | half interval | holds the truth | bars |")
    print("|---|---|---|---|---|---|---|")
    for name, rows in found.items():
        true = curve[name] if name in curve else lookup(name, known).value
        error = rows[:, 0] / true - 1
        half = float(np.mean(rows[:, 2] - rows[:, 1])) / 2 / true
        holds = float(np.mean((rows[:, 1] <= true) & (true <= rows[:, 2])))
        good = np.abs(error).max() <= (CURVE if name in curve else ERROR)
        good &= holds >= LEAST and (holds <= MOST or name in BOUNDED)
        missed += not good
        print(
            f"| `{name}` | {true:.4g} | {_percent(error.mean())} | {_percent(np.abs(error).max())} "
            f"| {_percent(half)} | {100 * holds:.0f} % | {'met' if good else 'MISSED'} |"
        )
    print(f"\n{len(found)} quantities, {max(map(len, found.values()))} seeds, {missed} miss a bar")
    print(f"procedures: {', '.join(PROCEDURES)}\n")
    return missed


def _percent(share: float) -> str:
    return f"{100 * share:.3f} %"


if __name__ == "__main__":
    sys.exit(main())
