"""`harvester compare`: compare the results of several runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import BUILD, app, seconds


@app.command()
def compare(
    traces: Annotated[
        list[Path], typer.Argument(metavar="TRACE...", help="Two or more traces (.csv, .parquet, .mat).")
    ],
    against: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Trace to compare with; default: the first TRACE."),
    ] = None,
    signals: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Signals to show, such as '*_pressure*'; repeatable; default: speeds, pressures and angles."
            " The summary covers all signals.",
        ),
    ] = None,
    start: Annotated[
        float | None,
        typer.Option(
            metavar="T",
            help="Start of the time window [s]; default: start of the overlap.",
            parser=seconds,
        ),
    ] = None,
    stop: Annotated[
        float | None,
        typer.Option(
            metavar="T", help="End of the time window [s]; default: end of the overlap.", parser=seconds
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(metavar="DIR", help="Folder of comparison.html, .png and .json."),
    ] = BUILD,
) -> None:
    """Compare traces of runs.

    Prints the difference of each signal and the cost of each run, and draws the signals.
    """
    from orchestrator.base.files import make_folder
    from orchestrator.results.comparison import compare as compare_traces
    from orchestrator.results.comparison_report import text, write

    comparison = compare_traces(traces, against=against, signals=signals or (), start=start, stop=stop)
    make_folder(out)
    page, picture, numbers = write(comparison, out)
    print(f"{text(comparison)}\n\npage: {page}\npicture: {picture}\nnumbers: {numbers}")
