"""`harvester validate`: co-simulate a system and compare it with a reference."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import (
    BUILD,
    AccuracyOptions,
    CouplingOptions,
    RunOptions,
    StepOptions,
    System,
    app,
    number,
    system_file,
    with_option_groups,
)


@app.command()
@with_option_groups
def validate(
    *,
    system: System = None,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help=(
                "Reference or measurement (.csv, .parquet or .mat, each with a .toml that describes "
                "the columns); default: the reference of the work cycle."
            ),
        ),
    ] = None,
    monolithic: Annotated[
        bool,
        typer.Option(
            "--monolithic",
            help=(
                "Compare with the monolithic solution of the same FMUs, as `harvester reference` computes "
                "it, not with a reference file."
            ),
        ),
    ] = False,
    limit: Annotated[
        float | None,
        typer.Option(
            metavar="E",
            help=(
                "With --monolithic: largest NRMSE of a signal; default: the limits of the work cycle's "
                "reference, 0.01 for systems without its signals."
            ),
            parser=number,
        ),
    ] = None,
    layout: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help=(
                "Description of the figures in the report (.toml); default: the figures of the "
                "harvester; for another system with --reference: one row per signal."
            ),
        ),
    ] = None,
    play: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help=(
                "With --reference and without --scenario: further signals of the reference that are "
                "inputs of the run, in addition to the commands, such as '*.supply_pressure'; "
                "repeatable; default: none."
            ),
        ),
    ] = None,
    case: RunOptions,
    steps: StepOptions,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of run.csv and the report.")] = BUILD,
    accurate: AccuracyOptions,
    coupled: CouplingOptions,
) -> None:
    """Co-simulate a system and compare it with a reference.

    Writes a report. The exit status is 1 if a limit is exceeded.
    """
    from fmus.package_files import data
    from orchestrator.results.validate_system import validate_system

    file = system_file(system)
    defaults = data("reference/work_cycle.csv"), data("reference/work_cycle.layout.toml")
    options = case.options() | steps.options() | {"coupling": coupled.given(), "play": play or ()}
    options |= accurate.options() | {"default_accuracy": 1e-4}
    options |= {"monolithic": monolithic, "limit": limit}
    options |= {"default_system": file} if system is None else {}
    if not validate_system(file, case.scenario, reference, layout, out, default=defaults, **options):
        raise typer.Exit(1)
