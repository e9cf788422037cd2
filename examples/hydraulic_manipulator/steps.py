"""M1 at several communication steps, both masters, with rate ports and without: the table of README.md."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from figure import draw_steps
from machine import build, solve
from rich.console import Console
from rich.table import Table
from run import M1, REFERENCE, Outcome, simulate

from orchestrator import RunFailed, read
from orchestrator.validation import read_reference

STEPS = (0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 15e-3, 20e-3, 40e-3)  # [s]
DRAWN = (10e-3, 20e-3, 40e-3)
HEADINGS = ("master", "ports", "step", "s1", "p_1", "p_2", "residual of the bond")
PUBLISHED = {
    "force-displacement Jacobi, 15 ms": "m1_force_jacobi_15ms.csv",
    "pressure-displacement Jacobi, 40 ms": "m1_pressure_jacobi_40ms.csv",
}


def attempt(system: Path, step: float, master: str) -> Outcome | float:
    """The outcome, or the time [s] up to which the run came."""
    try:
        return simulate(system, M1, step, master)
    except RunFailed as failure:
        return float(failure.result.trace.time[-1])


def cells(outcome: Outcome | float) -> list[str]:
    """Largest errors from the joined ODE and energy residual of the power bond over the exchanged energy."""
    if isinstance(outcome, float):
        return [f"fails at {outcome:.2f} s", "-", "-", "-"]
    (bond,) = outcome.result.card.bonds
    pressures = [f"{100 * outcome.relative(f'hydraulics.{n}'):.2g} %" for n in ("p_1", "p_2")]
    return [f"{1e3 * outcome.error('arm.s1'):.2g} mm", *pressures, f"{100 * abs(bond.relative):.1g} %"]


def main() -> None:
    """Print the table and draw the runs with held inputs beside the published ones."""
    folder = Path("build/hydraulic_manipulator")
    systems = build(folder)
    table, drawn = Table(*HEADINGS), {}
    for master in ("jacobi", "gauss-seidel"):
        for ports, system in systems.items():
            for step in STEPS:
                outcome = attempt(system, step, master)
                table.add_row(master, ports, f"{1e3 * step:g} ms", *cells(outcome))
                if isinstance(outcome, Outcome) and step in DRAWN and (master, ports) == ("jacobi", "held"):
                    drawn[f"Jacobi, held, {1e3 * step:g} ms"] = outcome.result.trace
    Console(width=110).print(table)
    published = {label: read_reference(REFERENCE.with_name(name)) for label, name in PUBLISHED.items()}
    truth = solve(read(M1), np.linspace(0, 10, 10001))
    print(f"wrote {draw_steps(drawn, published, truth, folder / 'steps.png')}")


if __name__ == "__main__":
    main()
