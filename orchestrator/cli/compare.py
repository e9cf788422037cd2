"""`harvester compare`: compare the results of several runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from orchestrator.base.options import Kind, Patterns
from orchestrator.cli.options import BUILD, File, Folder, Time, command


@command
def compare(
    traces: Annotated[list[Path], Kind("TRACE...", positional=True)],
    against: File | None = None,
    signals: Patterns = None,
    start: Time = None,
    stop: Time = None,
    out: Folder = BUILD,
) -> None:
    """Compare traces of runs.

    Prints the difference of each signal and the cost of each run, and draws the signals.

    traces    Two or more traces (.csv, .parquet, .mat).
    against   Trace to compare with; default: the first TRACE.
    signals   Signals to show, such as '*_pressure*'; default: speeds, pressures and angles. The summary
              covers all signals.
    start     Start of the time window [s]; default: start of the overlap.
    stop      End of the time window [s]; default: end of the overlap.
    out       Folder of comparison.html, .png and .json.
    """
    from orchestrator.base.files import make_folder
    from orchestrator.results.comparison import compare as compare_traces
    from orchestrator.results.comparison_report import text, write

    comparison = compare_traces(traces, against=against, signals=signals or (), start=start, stop=stop)
    make_folder(out)
    page, picture, numbers = write(comparison, out)
    print(f"{text(comparison)}\n\npage: {page}\npicture: {picture}\nnumbers: {numbers}")
