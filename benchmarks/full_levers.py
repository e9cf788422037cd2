"""Full levers at the default master and step, for each variant of drives and supply, against the reference.

    python -m benchmarks.full_levers                          # 960 cases, half an hour on two cores
    python -m benchmarks.full_levers --drives compensated --supply load_sensing --ramps 0.3
    python -m benchmarks.full_levers --guard 0                # without the guard, as other tools step

Five combinations of levers, four ramps and four poses each; 2 s, then the levers are held. A row has the
largest errors of its cases: joint speeds (RMS over range), mean flow of the pumps that no drive takes, energy
error of the coupling. Exit status 1 if one of the first two exceeds 1 %.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator import Result, reference, run

SYSTEM = Path("build/harvester.ssp")
DRIVES = ("lumped", "quasistatic", "detailed", "compensated")
SUPPLIES = ("ideal", "engine_pump", "load_sensing")
LEVERS = {  # boom, stick, swing [V]
    "boom up": (10, 0, 0),
    "boom up, stick out": (10, -10, 0),
    "all three": (10, -10, 10),
    "all three at 85 %": (8.5, -8.5, 8.5),
    "boom down, stick in, swing": (-10, 10, -10),
}
RAMPS = (0.1, 0.3, 0.5, 1.0)  # [s]
POSES = ("nominal", "reach", "raised", "close")
BEGIN, STOP, RECORD = 0.3, 2.0, 0.005  # [s]
SPEEDS = ("boom_velocity", "stick_velocity", "swing_speed")
LIMIT = 0.01
TOLERANCE = 1e-9  # of the reference, far below the limit


@dataclass(frozen=True)
class Case:
    """One run; ramp: of the levers [s]."""

    drives: str
    supply: str
    levers: str
    ramp: float
    pose: str


@dataclass(frozen=True)
class Errors:
    """Errors of a case: of speeds (RMS over range), of the mean flow, of the energy; steps taken."""

    speed: float
    flow: float
    energy: float
    steps: int


def cases(drives: str, supply: str, ramps: tuple[float, ...]) -> Iterator[Case]:
    """All cases of two variants."""
    for levers, ramp, pose in product(LEVERS, ramps, POSES):
        yield Case(drives, supply, levers, ramp, pose)


def errors(case: Case, options: dict[str, Any]) -> Errors:
    """The errors of one run at the default master and step."""
    levers = zip(("boom_command", "stick_command", "swing_command"), LEVERS[case.levers], strict=True)
    scenario = {"time": [0.0, BEGIN, BEGIN + case.ramp, STOP]} | {n: [0, 0, v, v] for n, v in levers}
    swap = {"swing": case.drives, "boom_stick": case.drives, "supply": case.supply}
    common: dict[str, Any] = {"stop": STOP, "parameters": [case.pose], "swap": swap, "record_step": RECORD}
    truth = reference(SYSTEM, scenario, tolerance=TOLERANCE, **common)
    result = run(SYSTEM, scenario, isolate=False, **common, **options)
    return Errors(
        max(_nrmse(result[f"manipulator.{n}"], truth[f"manipulator.{n}"]) for n in SPEEDS),
        _lost_flow(result),
        max((abs(b.relative) for b in result.card.bonds if b.exchanged > 1.0), default=0.0),
        result.card.steps,
    )


def _nrmse(values: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((values - truth) ** 2)) / max(np.ptp(truth), 1e-3))


def _lost_flow(result: Result) -> float:
    """Mean flow of the pumps that goes nowhere, over their mean flow."""
    pumps = [n for n in result if n.startswith("supply.pump") and n.endswith("_flow")]
    if not pumps:
        return 0.0
    moving = result.time >= BEGIN
    time, pressure = result.time[moving], result["supply.supply_pressure"][moving]
    stored = 2e-12 * (pressure[-1] - pressure[0])  # [m3], by the parameter rail_capacitance

    def volume(*names: str) -> float:
        return float(sum(np.trapezoid(result[n][moving], time) for n in names if n in result))

    others = volume("supply.supply_flow", "supply.relief_flow", "supply.rail_leakage_flow") + stored
    return abs(volume(*pumps) - others) / volume(*pumps)


def main() -> int:
    """Print a row for each pair of variants; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drives", nargs="+", default=DRIVES)
    parser.add_argument("--supply", nargs="+", default=SUPPLIES)
    parser.add_argument("--ramps", nargs="+", type=float, default=RAMPS)
    for name, kind in (("master", str), ("step", float), ("guard", float), ("order", int)):
        parser.add_argument(f"--{name}", type=kind)
    given = vars(parser.parse_args())
    options = {n: v for n in ("master", "step", "guard", "order") if (v := given[n]) is not None}
    worst = 0.0
    print("|drives|supply|cases|speed|flow of the pumps|energy|above 1 %|steps of 1 ms|")
    print("|---|---|--:|--:|--:|--:|--:|--:|")
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for drives, supply in product(given["drives"], given["supply"]):
            run_cases = list(cases(drives, supply, tuple(given["ramps"])))
            found = list(pool.map(partial(errors, options=options), run_cases))
            above = sum(max(e.speed, e.flow) > LIMIT for e in found)
            largest = [max(getattr(e, n) for e in found) for n in ("speed", "flow", "energy")]
            worst = max(worst, *largest[:2])
            shares = "|".join(f"{100 * x:.2g} %" for x in largest)
            steps = np.mean([e.steps for e in found]) * 1e-3 / STOP
            print(f"|{drives}|{supply}|{len(found)}|{shares}|{above}|{steps:.2f}|", flush=True)
            for case, e in zip(run_cases, found, strict=True):
                if max(e.speed, e.flow) > LIMIT:
                    print(f"above: {case}: {e}", file=sys.stderr)
    return int(worst > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
