"""Builds the two FMUs, co-simulates a manoeuvre, compares it with what is known, draws it.

    python examples/hydraulic_manipulator/run.py
    python examples/hydraulic_manipulator/run.py --step 0.02 --ports held
    python examples/hydraulic_manipulator/run.py --manoeuvre my_own.csv

A manoeuvre is a CSV file with the columns time [s] and kappa [1], linear between the rows. Every run is
compared with the joined ODE of the same equations, M1 also with the solution that its authors published.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from figure import draw
from machine import build, solve
from rich.console import Console
from rich.table import Table

from orchestrator import Problem, Result, Trace, read_trace, run, write_trace
from orchestrator.data.recording import Recording, read_recording
from orchestrator.results.validation import Validation, validate
from orchestrator.results.validation_report import summary

HERE = Path(__file__).resolve().parent
M1 = HERE / "m1.csv"
REFERENCE = HERE.parents[1] / "data/reference/hydraulic_manipulator/m1_reference.csv"
SIGNALS = {"arm.s1": "m", "arm.s1_dot": "m/s", "hydraulics.p_1": "Pa", "hydraulics.p_2": "Pa", "arm.f_h": "N"}


@dataclass(frozen=True)
class Outcome:
    """A run, the joined ODE at its communication points, and what was published with the comparison."""

    result: Result
    truth: Trace
    reference: Recording | None
    validation: Validation | None

    def error(self, signal: str) -> float:
        """Largest difference from the joined ODE over all communication points, in SI units."""
        return float(np.max(np.abs(self.result.trace[signal] - self.truth[signal])))

    def relative(self, signal: str) -> float:
        """Largest difference over the value [1], sample by sample."""
        truth = self.truth[signal]
        return float(np.max(np.abs((self.result.trace[signal] - truth) / truth)))


def simulate(system: Path, manoeuvre: Path, step: float, master: str) -> Outcome:
    """Co-simulate `manoeuvre` with the communication step [s] and compare."""
    scenario = read_trace(manoeuvre)
    if list(scenario.signals) != ["kappa"] or len(scenario.time) < 2:
        raise Problem(f"{manoeuvre}: expected the columns time, kappa and two rows or more")
    result = run(system, scenario, master=master, step=step)
    truth = solve(scenario, result.trace.time)
    reference = read_recording(REFERENCE) if manoeuvre.resolve() == M1 else None
    validation = validate(result.trace, reference) if reference else None
    return Outcome(result, truth, reference, validation)


def errors(outcome: Outcome) -> Table:
    """The largest error of each signal from the joined ODE."""
    table = Table(title="Compared with: the joined ODE", title_justify="left")
    for heading in ("signal", "max. error", "of the largest value"):
        table.add_column(heading, justify="left" if heading == "signal" else "right")
    for name, unit in SIGNALS.items():
        share = outcome.error(name) / np.max(np.abs(outcome.truth[name]))
        table.add_row(name, f"{outcome.error(name):.3g} {unit}", f"{100 * share:.2g} %")
    return table


def main() -> int:
    """The command line; exit status 1 when the published solution is missed."""
    parser = argparse.ArgumentParser(description="The hydraulic manipulator benchmark as two FMUs.")
    parser.add_argument("--manoeuvre", type=Path, default=M1, help="CSV with time [s] and kappa [1]")
    parser.add_argument("--step", type=float, default=1e-3, help="communication step [s]")
    parser.add_argument("--master", default="gauss-seidel", help="jacobi or gauss-seidel")
    parser.add_argument(
        "--ports", choices=("rates", "held"), default="rates", help="with rate ports or without"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("build/hydraulic_manipulator"), help="folder to write to"
    )
    given = parser.parse_args()
    console = Console()
    system = build(given.out)[given.ports]
    outcome = simulate(system, given.manoeuvre, given.step, given.master)
    console.print(outcome.result.card.text(), "")
    console.print(errors(outcome), "")
    if outcome.validation:
        print(f"{summary(outcome.validation)}\n")
    picture = draw(outcome.result.trace, outcome.truth, outcome.reference, given.out / "result.png")
    trace = write_trace(outcome.result.trace, given.out / "result.csv")
    console.print(f"wrote {system}, {trace} and {picture}", soft_wrap=True)
    return 0 if outcome.validation is None or outcome.validation.passed else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Problem as mistake:
        sys.exit(f"error: {mistake}")
