"""M1 at many communication steps with all masters: the tables and pictures of README.md.

python examples/hydraulic_manipulator/steps.py
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from figure import draw_steps
from machine import RATES, build, solve
from run import M1, REFERENCE

from orchestrator import load, read_trace, run
from orchestrator.base.text import TextTable
from orchestrator.base.units import factor_and_offset
from orchestrator.data.recording import Recording, read_recording
from orchestrator.ssp.coupling import Coupling
from orchestrator.studies.convergence.convergence_report import report, table, write
from orchestrator.studies.convergence.convergence_study import (
    SETTINGS,
    ConvergenceStudy,
    Setting,
    SettingRun,
    run_as_reference,
    run_settings,
)

FOLDER = Path("build/hydraulic_manipulator")
STEPS = (0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 40e-3, 100e-3)  # [s]
REPEATS = 9  # a run takes milliseconds
RATE_INPUTS = tuple(target for _, target in RATES)
SIGNALS = ("hydraulics.p_1", "hydraulics.p_2", "arm.s1")  # the first quantity is drawn
DRAWN = {
    "Jacobi, held, 10 ms": ("held", Coupling("jacobi"), 10e-3),
    "Jacobi, held, 40 ms": ("held", Coupling("jacobi"), 40e-3),
    "hermite, 2 passes, 40 ms": ("rates", Coupling("hermite", passes=2), 40e-3),
}
PUBLISHED = {
    "force-displacement Jacobi, 15 ms": "m1_force_jacobi_15ms.csv",
    "pressure-displacement Jacobi, 40 ms": "m1_pressure_jacobi_40ms.csv",
}


def ode_solution() -> Recording:
    """The joined ODE at every millisecond."""
    return run_as_reference(
        "the joined ODE", solve(read_trace(M1), np.linspace(0, 10, 10001)).select(SIGNALS)
    )


def manipulator(
    system: Path,
    settings: Sequence[Setting] = SETTINGS,
    steps: Sequence[float] = STEPS,
    repeats: int = REPEATS,
) -> ConvergenceStudy:
    """All masters at all steps."""
    solution = ode_solution()
    runs = run_settings(load(system), solution, settings, steps, repeats, RATE_INPUTS, scenario=M1)
    return ConvergenceStudy(solution, tuple(runs))


def length_table(study: ConvergenceStudy) -> TextTable:
    """The largest difference of the actuator's length at any instant [mm]."""

    def cell(run: SettingRun) -> str:
        assert run.errors  # of a stable run
        row = run.errors["arm.s1"]
        factor, _ = factor_and_offset(row.unit, "mm", row.signal)
        return f"{factor * row.metrics.maximum_error:.2g}".replace("e-0", "e-")

    title = f"position: largest difference [mm] from {study.reference.heading}"
    return table(study, title, cell)


def beside_the_published(systems: dict[str, Path], path: Path) -> Path:
    """Draw errors of s1 over time, of some runs and of the co-simulations of the benchmark's authors."""
    ode = solve(read_trace(M1), np.linspace(0, 10, 10001))
    runs = {
        label: run(systems[ports], M1, master=coupling, step=step).trace
        for label, (ports, coupling, step) in DRAWN.items()
    }
    published = {label: read_recording(REFERENCE.with_name(name)) for label, name in PUBLISHED.items()}
    return draw_steps(runs, published, ode, path)


def main() -> None:
    """Print the tables, write numbers and pictures."""
    systems = build(FOLDER)
    study = manipulator(systems["rates"])
    print("\n".join(length_table(study).lines()))
    print(report(study).text(), *write(study, FOLDER), sep="\n")
    print(beside_the_published(systems, FOLDER / "steps.png"))


if __name__ == "__main__":
    main()
