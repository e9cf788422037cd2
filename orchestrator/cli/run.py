"""`harvester run`: co-simulate a system and record its signals."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import (
    BUILD,
    SYSTEM,
    CouplingOptions,
    RunOptions,
    StepOptions,
    System,
    app,
    with_option_groups,
)


@app.command()
@with_option_groups
def run(
    *,
    system: System = SYSTEM,
    case: RunOptions,
    steps: StepOptions,
    out: Annotated[Path, typer.Option(metavar="FILE", help="File for the trace (.csv or .parquet).")] = BUILD
    / "trace.csv",
    error_estimate: Annotated[
        bool,
        typer.Option(
            "--error-estimate",
            help="Repeat the run at half and at twice the step, or at a tenth of the tolerance of"
            " --adaptive; print the change of the signals and the order.",
        ),
    ] = False,
    coupled: CouplingOptions,
) -> None:
    """Co-simulate a system and record its signals."""
    from orchestrator.engine.run import run_to_file

    options = case.options() | steps.options() | {"error_estimate": error_estimate}
    result, file = run_to_file(system, case.scenario, out, coupling=coupled.given(), **options)
    print(f"{result.card.text()}\n\n{file}")
