"""`harvester run`: co-simulate a system and record its signals."""

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
    seconds,
    system_file,
    with_option_groups,
)


@app.command()
@with_option_groups
def run(
    *,
    system: System = None,
    case: RunOptions,
    steps: StepOptions,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="File for the trace (.csv, .parquet, .mat).")
    ] = BUILD / "trace.csv",
    error_estimate: Annotated[
        bool,
        typer.Option(
            "--error-estimate",
            help="Estimate the error of the outputs that the coupling causes. If an FMU has no directional "
            "derivatives, repeat the run at half and at twice the step, and print the change of the signals.",
        ),
    ] = False,
    time_limit: Annotated[
        float | None,
        typer.Option(
            metavar="S", help="Limit of the wall time of the run [s]; default: no limit.", parser=seconds
        ),
    ] = None,
    memory_limit: Annotated[
        float | None,
        typer.Option(
            metavar="GB",
            help=(
                "Memory limit of the process that runs the FMUs [GB, 1e9 bytes]; default: the "
                "memory of the computer."
            ),
            parser=number,
        ),
    ] = None,
    accurate: AccuracyOptions,
    coupled: CouplingOptions,
) -> None:
    """Co-simulate a system and record its signals."""
    from orchestrator.engine.isolated import start_process

    system = system_file(system)
    start_process()  # before the slow imports
    from orchestrator.engine.run import run_to_file

    options = case.options() | steps.options() | accurate.options()
    options |= {"error_estimate": error_estimate, "default_accuracy": 1e-3}
    options |= {"time_limit": time_limit} if time_limit is not None else {}
    options |= {"memory_limit": 1e9 * memory_limit} if memory_limit is not None else {}
    result, file = run_to_file(system, case.scenario, out, coupling=coupled.given(), **options)
    print(f"{result.card.text()}\n\n{file}")
