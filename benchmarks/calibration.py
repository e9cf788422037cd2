"""Calibration of the error estimate: `python -m benchmarks.calibration [CASES [SEED]]`.

A case is a random combination of variants (the 72 of docs/fidelity.md), scenario, master and step. Its truth
is a run by hermite at 0.25 ms with a tolerance of 1e-9 in the FMUs. A case counts as stable if the true error
of every joint speed is below a tenth of its range. The tables, one for `error_estimate=True` and one for
"fast", have the share of cases whose estimated RMS error is between 0.5 and 2 times, and between 0.2 and 5
times the true one: of the worst joint speed, and of every joint speed, joint angle and chamber pressure by
itself. The last column is the share of points at which the truth is inside the band: of these signals where
their error is above 1e-8 of the range, as a mean over the runs.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fmus.machine.build import data, harvester
from fmus.machine.parts import FAMILIES, OTHER_CIRCUITS
from orchestrator import Coupling, Problem, System, Trace, load, run
from orchestrator.base.files import VARIANTS
from orchestrator.engine.result import Result

PARTS = {part: [v for v in variants if v not in OTHER_CIRCUITS] for part, variants in FAMILIES.items()}
POINTS = np.array([0.0, 1.0, 1.4, 3.0, 3.4, 4.0, 4.2, 6.0])  # s
STROKE = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, -0.7, -0.7])
STROKES = {
    "time": POINTS,
    "swing_command": 3.0 * STROKE,
    "boom_command": 4.0 * STROKE,
    "stick_command": -4.0 * STROKE,
}
# scenario -> its inputs, and the end of a run [s]
SCENARIOS: Mapping[str, tuple[Any, float]] = {
    "work cycle": (data("scenarios/work_cycle.csv"), 10.0),
    "strokes": (STROKES, 6.0),
    "boom up": (data("scenarios/boom_up.csv"), 6.0),
}
MASTERS = {
    "jacobi": Coupling("jacobi"),
    "gauss-seidel": Coupling("gauss-seidel"),
    "gauss-seidel order 2": Coupling("gauss-seidel", order=2),
    "hermite": Coupling("hermite"),
    "interface-jacobian": Coupling("interface-jacobian"),
}
STEPS = (1e-3, 2e-3, 5e-3, 1e-2)  # s
TRUTH = Coupling("hermite", guard=1e-3, tolerance=1e-8)
RECORD_STEP = 0.02  # s
SPEEDS = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
ANGLES = [f"manipulator.{joint}_angle" for joint in ("swing", "boom", "stick")]
PRESSURES = [f"boom_stick.{c}_{side}_pressure" for c in ("boom", "stick") for side in ("head", "rod")]
SIGNALS = [*SPEEDS, *ANGLES, *PRESSURES, "swing.swing_pressure_a", "swing.swing_pressure_b"]
STABLE = 0.1  # of the range
STANDING = 1e-3  # rad/s: range of a joint that does not move
RESOLVED = 1e-8  # of the range: errors of the truth itself


@dataclass(frozen=True)
class Case:
    """One run."""

    variants: tuple[str, ...]
    scenario: str
    master: str
    step: float

    def swaps(self, folder: Path) -> dict[str, Path]:
        """The FMU of each part."""
        names = zip(PARTS, self.variants, strict=True)
        return {part: folder / VARIANTS / f"{part}_{variant}.fmu" for part, variant in names}


def cases(rng: np.random.Generator) -> Iterator[Case]:
    """Random cases without end."""
    while True:
        variants = tuple(str(rng.choice(names)) for names in PARTS.values())
        scenario, master = str(rng.choice(list(SCENARIOS))), str(rng.choice(list(MASTERS)))
        yield Case(variants, scenario, master, float(rng.choice(STEPS)))


def simulated(
    system: System, case: Case, folder: Path, coupling: Coupling, step: float, **options: Any
) -> Any:
    """A run of the scenario of a case with its variants."""
    scenario, stop = SCENARIOS[case.scenario]
    fixed = {"stop": stop, "record_step": RECORD_STEP, "isolate": False}
    return run(system, scenario, master=coupling, step=step, swap=case.swaps(folder), **fixed, **options)


def errors(trace: Trace, truth: Trace) -> dict[str, float]:
    """True RMS errors over the range of each signal that moves."""
    common = [name for name in SIGNALS if name in trace.signals and name in truth.signals]
    moving = [name for name in common if np.ptp(truth[name]) > STANDING]
    return {n: float(np.sqrt(np.mean((trace[n] - truth[n]) ** 2)) / np.ptp(truth[n])) for n in moving}


def share(ratios: list[float], factor: float) -> str:
    """Percentage of ratios between 1/factor and factor."""
    values = np.array(ratios)
    return f"{100 * np.mean((values > 1 / factor) & (values < factor)):6.1f} %"


class Ratios:
    """Estimated over true RMS errors by master: of the worst joint speed, and of every signal."""

    def __init__(self) -> None:
        self._worst: dict[str, list[float]] = {name: [] for name in MASTERS}
        self._each: dict[str, list[float]] = {name: [] for name in MASTERS}
        self._inside: dict[str, list[float]] = {name: [] for name in MASTERS}

    def add(self, master: str, found: Mapping[str, float], result: Result, truth: Trace) -> None:
        """found: true errors over the range of each signal."""
        estimated = {e.name: e.rms for e in result.card.errors}
        speeds = [name for name in SPEEDS if name in found]
        most = max(estimated.get(name, 0.0) for name in speeds) / max(found[name] for name in speeds)
        self._worst[master].append(most)
        resolved = [name for name, e in found.items() if e > RESOLVED]
        self._each[master] += [estimated.get(n, 0.0) / found[n] for n in resolved]
        if band := result.band:
            known = [name for name in resolved if name in band.signals]
            inside = [np.abs(truth[name] - result.trace[name]) <= band[name] for name in known]
            if inside:
                self._inside[master].append(float(np.mean(inside)))

    def print(self) -> None:
        """Print the table."""
        columns = "".join(f"{text:>10}" for text in ("0.5 to 2", "0.2 to 5") * 2 + ("in band",))
        print(f"{'':<32}{'worst joint speed':^20}{'every signal':^20}")
        print(f"{'':<24}{'runs':>6}  {columns}")
        for master in (*MASTERS, "all"):
            names = MASTERS if master == "all" else [master]
            tables = (self._worst, self._each, self._inside)
            a, b, inside = ([r for name in names for r in table[name]] for table in tables)
            shares = f"{share(a, 2):>10}{share(a, 5):>10}{share(b, 2):>10}{share(b, 5):>10}"
            shares += f"{100 * np.mean(inside):8.1f} %"
            print(f"{master:<24}{len(a):>6}  {shares}")


def main(count: int = 500, seed: int = 1) -> None:
    """Print the tables."""
    forms: dict[bool | Literal["fast"], Ratios] = {True: Ratios(), "fast": Ratios()}
    stable = unstable = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        harvester().write(folder)
        system = load(folder / "harvester.ssp")

        @cache
        def truth(variants: tuple[str, ...], scenario: str) -> Trace:
            case = Case(variants, scenario, "hermite", 0.0)
            trace: Trace = simulated(system, case, folder, TRUTH, 2.5e-4, tolerance=1e-9).trace
            return trace

        chosen = cases(np.random.default_rng(seed))
        while stable < count:
            case = next(chosen)
            true = truth(case.variants, case.scenario)
            master = MASTERS[case.master]
            try:
                results = []
                for form in forms:
                    result = simulated(system, case, folder, master, case.step, error_estimate=form)
                    results.append((errors(result.trace, true), result))
            except Problem:
                unstable += 1
                continue
            if max(e for found, _ in results for name, e in found.items() if name in SPEEDS) > STABLE:
                unstable += 1
                continue
            stable += 1
            for ratios, (found, result) in zip(forms.values(), results, strict=True):
                ratios.add(case.master, found, result, true)
    print(f"{count} stable cases; {unstable} unstable ones left out. Estimated over true RMS error:")
    for form, ratios in forms.items():
        print(f"\nerror_estimate={form!r}")
        ratios.print()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
