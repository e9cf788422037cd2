"""`harvester compare`: results of several runs against one of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import BUILD, app, seconds


@app.command()
def compare(
    traces: Annotated[
        list[Path], typer.Argument(metavar="TRACE...", help="Two or more traces (.csv, .parquet) of runs.")
    ],
    against: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The trace to compare with; default: the first.")
    ] = None,
    signals: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="What to show, such as '*_pressure*'; repeatable; default: speeds, pressures and angles."
            " The summary covers all signals.",
        ),
    ] = None,
    start: Annotated[
        float | None, typer.Option(metavar="T", help="Begin of the window [s].", parser=seconds)
    ] = None,
    stop: Annotated[
        float | None, typer.Option(metavar="T", help="End of the window [s].", parser=seconds)
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where comparison.png and comparison.json go.")
    ] = BUILD,
) -> None:
    """Compare traces of runs.

    Difference of each signal from one of them, cost, and a picture.
    """

    from orchestrator.base.files import folder
    from orchestrator.results.comparison import compare as compared
    from orchestrator.results.comparison_report import text, write

    found = compared(traces, against=against, signals=signals or (), start=start, stop=stop)
    folder(out)
    picture, numbers = write(found, out)
    print(f"{text(found)}\n\npicture: {picture}\nnumbers: {numbers}")
