"""`harvester sweep`: run a parameter study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.cli.options import app, positive_integer, tell_built


@app.command()
def sweep(
    study: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY.toml",
            help="Description of the study: what is varied, what is run, and which results are kept.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results; default: build/sweeps/STUDY."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Number of runs at the same time on this computer; default: one per core.",
            parser=positive_integer,
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="Run on this Dask cluster instead, such as tcp://host:8786; default: this computer.",
        ),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Delete earlier results in DIR and start again.")
    ] = False,
    no_report: Annotated[bool, typer.Option("--no-report", help="Leave out the page report.html.")] = False,
) -> None:
    """Run a parameter study on all cores.

    An interrupted study continues when it is started again. The exit status is 1 if no run succeeded.
    """
    require("sweep", "harvester sweep")
    from orchestrator.studies import read_study
    from orchestrator.studies.parameter_study import run

    chosen = read_study(study)
    tell_built(chosen.system_file, {})
    if workers and scheduler:
        raise Problem(
            "--workers: expected none with --scheduler, whose cluster determines the number of workers"
        )
    if not run(study, out, workers, scheduler, fresh, report=not no_report):
        raise typer.Exit(1)
