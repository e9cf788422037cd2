"""`harvester sweep`: a parameter study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.base.errors import Problem
from orchestrator.cli.options import app, positive


@app.command()
def sweep(
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="What is varied, run and kept.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where the results go; default: build/sweeps/ and the file's name."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Runs at the same time on this machine; default: one per core.",
            parser=positive,
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="URL", help="A Dask cluster to run on instead, such as tcp://host:8786."),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Delete what DIR holds of a study, begin anew.")
    ] = False,
    no_report: Annotated[bool, typer.Option("--no-report", help="Leave out the page report.html.")] = False,
) -> None:
    """Run a study on all cores; started again it goes on. Exit status 1 if no run came to its end."""

    from orchestrator.studies.parameter_study import run

    if workers and scheduler:
        raise Problem("--workers: expected none with --scheduler, which runs on the workers that it has")
    if not run(study, out, workers, scheduler, fresh, report=not no_report):
        raise typer.Exit(1)
