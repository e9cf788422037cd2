"""The monolithic solution of the FMUs against the equations, and against a co-simulation, for variants.

    python -m benchmarks.monolithic [--all] [--part 1/4] [--build build]

For each of the 72 combinations of variants in docs/fidelity.md (--all: of all variants), strokes of 3 s of
all joints, in which chambers cavitate, are solved

    by the FMUs        `orchestrator.reference`: FMUs in Model Exchange joined by their connections
    by the equations   `fmus.monolith`: the equations joined symbolically, by CVODES of CasADi
    by hermite         a co-simulation at 0.25 ms, with its own estimate of its error

A row has the largest difference of the first two, over the range of the signal. The RMS difference of the
first and the third is divided by that one's estimate plus the RMS error OWN of the first. A row has the
difference and the ratio of the signal with the largest ratio. Limits: EQUAL for the difference, WITHIN for
the ratio. Exit status 1 if one is missed.

The estimate halves the step, so it does not see errors that do not depend on the step. Those of the FMUs'
solvers and of the passes are made small by tolerances. A guard that gets stricter with the step divides the
first one (in a machine with `engine_pump` flows settle within 1 us after the start).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from fmus.machine.machine import wiring
from fmus.machine.parts import FAMILIES, FERIC, OTHER_CIRCUITS
from fmus.monolith import join, merge_times, simulate
from orchestrator import Result, Trace, reference, run
from orchestrator.engine.refinement import estimated_error
from orchestrator.engine.result import SignalError, changes, signal_errors
from orchestrator.monolithic.reference import master
from orchestrator.ssp.load import load

EQUAL = 1e-8  # of the range of each signal
WITHIN = 2.0  # times the estimate, a change at half the step: at order 1 the error is twice that change
OWN = 1e-9  # RMS error of the reference, over range
TOLERANCE = 1e-12  # of the FMUs
STOP, RECORD, STEP = 3.0, 5e-3, 2.5e-4  # s
SHAPE = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
VOLTS = {"swing_command": 1.5, "boom_command": 2.0, "stick_command": -1.5}
STROKES = {"time": np.array([0.0, 0.5, 0.8, 1.4, 1.6, STOP]), **{n: v * SHAPE for n, v in VOLTS.items()}}
# CVODES bounds the error of a state relative to its nominal value. In a cavity pressures are small and oil is
# soft, so a thousandth of it is bounded.
SCALE, EXACT = 1e-3, 1e-14


def combinations(every: bool = False) -> list[dict[str, str]]:
    """The variants of each part of each machine, without the default ones."""
    names = [[v for v in family if every or v not in OTHER_CIRCUITS] for family in FAMILIES.values()]
    first = {part: next(iter(family)) for part, family in FAMILIES.items()}
    chosen = (dict(zip(FAMILIES, combination, strict=True)) for combination in product(*names))
    return [{part: v for part, v in one.items() if v != first[part]} for one in chosen]


def by_equations(variants: Mapping[str, str], stop: float = STOP) -> Trace:
    """States and outputs of the equations of a machine."""
    chosen = FERIC.chosen(**variants)
    model = join(chosen, *wiring(chosen))
    grid = RECORD * np.arange(round(stop / RECORD) + 1)
    time = merge_times(grid, STROKES["time"][STROKES["time"] < stop])
    inputs = np.tile(model.u, (len(time), 1))
    for name in VOLTS:
        inputs[:, model.inputs.index(name)] = np.interp(time, STROKES["time"], STROKES[name])
        if f"{name}_rate" in model.inputs:  # just after each time; rate outputs alone depend on it
            slopes = np.append(np.diff(STROKES[name]) / np.diff(STROKES["time"]), 0.0)
            at = np.searchsorted(STROKES["time"], time, side="right") - 1
            inputs[:, model.inputs.index(f"{name}_rate")] = slopes[at]
    solved = simulate(replace(model, nominal=SCALE * model.nominal), time, inputs, tolerance=EXACT)
    rows = np.column_stack(solved)[np.searchsorted(time, grid - RECORD / 2)]
    return Trace(grid, dict(zip((*model.states, *model.output_names), rows.T, strict=True)))


def by_fmus(system: Path, variants: Mapping[str, str], stop: float = STOP) -> Result:
    """The monolithic solution of the FMUs."""
    return reference(system, STROKES, swap=variants, stop=stop, record_step=RECORD)


def by_hermite(system: Path, variants: Mapping[str, str], stop: float = STOP) -> Result:
    """The co-simulation; its card has the change of each signal when the step is halved, and the order."""
    options = {"swap": variants, "stop": stop, "record_step": RECORD, "tolerance": TOLERANCE}
    runs = [
        run(system, STROKES, master=master(h / STEP), step=h, **options) for h in (2 * STEP, STEP, STEP / 2)
    ]
    return replace(runs[1], card=replace(runs[1].card, errors=changes(*runs)))


def differences(truth: Result, other: Trace) -> dict[str, SignalError]:
    """Difference of each signal that is not constant, over its range."""
    common = [n for n in truth.trace.signals if n in other.signals]
    nominals = {str(p): truth.system.variable(p).nominal for p in truth.system.ports("output")}
    found = signal_errors(truth.trace.select(common), other.select(common), None, nominals)
    return {e.name: e for e in found if e.name in nominals}


@dataclass(frozen=True)
class Compared:
    """Largest difference from the equations; RMS difference from the co-simulation, and its ratio."""

    equations: SignalError
    cosimulation: SignalError
    ratio: float

    @property
    def good(self) -> bool:
        """Within the limits."""
        return self.equations.largest < EQUAL and self.ratio < WITHIN


def compared(system: Path, variants: Mapping[str, str], stop: float = STOP) -> Compared:
    """All comparisons of one combination."""
    truth, stepped = by_fmus(system, variants, stop), by_hermite(system, variants, stop)
    equations = max(differences(truth, by_equations(variants, stop)).values(), key=lambda e: e.largest)
    estimates = {e.name: estimated_error(e) for e in stepped.card.errors}
    found = [e for e in differences(truth, stepped.trace).values() if e.name in estimates]
    ratios = {e.rms / (estimates[e.name] + OWN): e for e in found}
    largest = max(ratios)
    return Compared(equations, ratios[largest], largest)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--all", action="store_true", help="all variants")
    parser.add_argument("--part", default="1/1", metavar="K/N", help="the K-th of N parts of the table")
    parser.add_argument("--build", default="build", type=Path, help="folder of harvester.ssp")
    arguments = parser.parse_args()
    first, count = map(int, arguments.part.split("/"))
    system, missed = arguments.build / "harvester.ssp", 0
    load(system)  # a missing file is a mistake of the user
    print(f"{'combination':<84}{'equations':>10}{'hermite':>10}{'ratio':>7}")
    for variants in combinations(arguments.all)[first - 1 :: count]:
        found = compared(system, variants)
        missed += not found.good
        name = ", ".join(f"{part} {variant}" for part, variant in variants.items()) or "the default machine"
        numbers = f"{found.equations.largest:>10.1e}{found.cosimulation.rms:>10.1e}{found.ratio:>7.2f}"
        print(f"{name:<84}{numbers}  {found.equations.name}, {found.cosimulation.name}", flush=True)
    sys.exit(f"{missed} combinations miss a limit" if missed else 0)


if __name__ == "__main__":
    main()
