"""`harvester check`: what is wrong with an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import app


@app.command()
def check(
    fmu: Annotated[Path | None, typer.Argument(metavar="FILE", help="Any .fmu file.")] = None,
    for_: Annotated[
        str,
        typer.Option(
            "--for", metavar="TOOL", help="simulink, dymola, openmodelica, amesim, another, or any."
        ),
    ] = "any",
    json: Annotated[
        Path | None, typer.Option(metavar="OUT", help="Write the findings to a file, for programs.")
    ] = None,
    static: Annotated[bool, typer.Option("--static", help="Run nothing of the FMU.")] = False,
    timeout: Annotated[
        float, typer.Option(metavar="SECONDS", help="A call into the FMU that takes longer is a hang.")
    ] = 10.0,
    rules: Annotated[bool, typer.Option("--rules", help="Print the table of rules.")] = False,
) -> None:
    """Tell what is wrong with an FMU, and for which tool.

    Exit status 1 if there are errors.
    """
    from orchestrator.check import command

    if not command.run(fmu, for_, json, rules, static, timeout):
        raise typer.Exit(1)
