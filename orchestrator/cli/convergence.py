"""`harvester convergence`: the error of each master over the communication step."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import (
    BUILD,
    RunOptions,
    System,
    app,
    system_file,
    tell_built,
    with_option_groups,
)

STUDY = BUILD / "convergence"


@app.command()
@with_option_groups
def convergence(
    *,
    system: System = None,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Reference (.csv with .toml); default: the monolithic solution for the work cycle,"
            " the hermite run with the smallest step for any other run.",
        ),
    ] = None,
    steps: Annotated[
        str, typer.Option(metavar="S,S,...", help="Communication steps [s], separated by commas.")
    ] = "0.0005,0.001,0.002,0.005,0.01,0.02",
    masters: Annotated[
        str,
        typer.Option(
            metavar="NAME,...",
            help="Names of masters (jacobi, gauss-seidel, hermite, interface-jacobian), labels of settings"
            " such as 'hermite 2 passes', or patterns of labels such as '*order 1', separated by commas;"
            " default: all.",
        ),
    ] = "",
    signals: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help=(
                "Signals whose error is computed, such as '*_pressure*'; repeatable, one table for "
                "each; default: speeds and pressures."
            ),
        ),
    ] = None,
    case: RunOptions,
    repeats: Annotated[
        int,
        typer.Option(
            metavar="N", help="Number of times that each run is timed, at least 1; the median is reported."
        ),
    ] = 3,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the tables and figures.")] = STUDY,
) -> None:
    """Compute the error of each master over the communication step, and its cost.

    Prints tables, and writes them as CSV with figures.
    """
    from fmus.package_files import data
    from orchestrator.studies.convergence.convergence_study import convergence as study

    system = system_file(system)
    tell_built(system, {})
    work_cycle = data("reference/work_cycle.csv")
    options = case.options() | {"scenario": case.scenario, "default_reference": work_cycle}
    study(system, reference, out, steps, masters, signals or (), repeats, **options)
