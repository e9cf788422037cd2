"""`harvester validate`, `compare`, `plot` and `energy`: judge, compare and draw the results of runs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Unpack

from orchestrator.base.errors import Problem
from orchestrator.base.files import DEFAULT_SYSTEM, make_folder, write_whole
from orchestrator.base.options import Kind, Patterns, chosen
from orchestrator.cli.options import BUILD, File, Folder, Scenario, System, Time, command, system_file
from orchestrator.engine.arguments import CoupledArguments
from orchestrator.engine.options import DEFAULT_ACCURACY, RunOptions

if TYPE_CHECKING:
    from orchestrator.pages.figures import TraceFigure
    from orchestrator.results.comparison import Run


@command
def validate(
    system: System = None,
    scenario: Scenario = None,
    reference: File | None = None,
    monolithic: bool = False,
    limit: Annotated[float | None, Kind("E")] = None,
    rate: bool = False,
    layout: File | None = None,
    play: Patterns | None = None,
    out: Folder = BUILD,
    **options: Unpack[CoupledArguments],
) -> bool:
    """Co-simulate a system and compare it with a reference.

    Writes a report. The exit status is 1 if a limit is exceeded.

    reference    Reference or measurement (.csv, .parquet, .mat, .mf4 or .tdms, each with a .toml that
                 describes the columns); default: the reference of the work cycle.
    monolithic   Compare with the monolithic solution of the same FMUs, as `harvester reference` computes it,
                 not with a reference file.
    limit        With `monolithic`: largest NRMSE of a signal; default: the limits of the work cycle's
                 reference, 0.01 with other systems, scenarios or variants.
    rate         Rate the signals by ISO/TS 18571, too: corridor, phase, magnitude and slope.
    layout       Description of the figures in the report (.toml); default: the figures of the harvester; for
                 another system with `reference`: one row per signal.
    play         With `reference` and without `scenario`: further signals of the reference that are inputs of
                 the run, in addition to the commands, such as '*.supply_pressure'; default: none.
    out          Folder of run.csv and the report.
    """
    from fmus.package_files import data
    from orchestrator.results.validate_system import Experiment, validate_system

    file = system_file(system)
    experiment = Experiment(
        file,
        default=(data("reference/work_cycle.csv"), data("reference/work_cycle.layout.toml")),
        scenario=scenario,
        reference=reference,
        layout=layout,
        play=play or (),
        default_system=DEFAULT_SYSTEM if system else file,
        monolithic=monolithic,
        limit=limit,
        rate=rate,
        options=chosen(RunOptions, options, "validate"),
    )
    told = partial(print, flush=True)
    validation, text = validate_system(
        experiment, out, default_accuracy=DEFAULT_ACCURACY["validate"], report=told
    )
    print(text)
    return validation.passed


FORMATS = (".png", ".svg", ".pdf")


@command
def compare(
    traces: Annotated[list[Path], Kind("TRACE...", positional=True)],
    against: File | None = None,
    signals: Patterns | None = None,
    start: Time = None,
    stop: Time = None,
    rate: bool = False,
    out: Folder = BUILD,
) -> None:
    """Compare traces of runs.

    Prints the difference of each signal and the cost of each run, and draws the signals on a page.

    traces    Two or more traces (.csv, .parquet, .mat, .mf4, .tdms).
    against   Trace to compare with; default: the first TRACE.
    signals   Signals to show, such as '*_pressure*', or with component 'boom_stick.*'; default: speeds,
              pressures and angles. The summary covers all signals.
    start     Start of the time window [s]; default: start of the overlap.
    stop      End of the time window [s]; default: end of the overlap.
    rate      Rate the signals that are shown by ISO/TS 18571, too: corridor, phase, magnitude and slope.
    out       Folder of comparison.html and .json.
    """
    from orchestrator.results.comparison import compare as compare_traces
    from orchestrator.results.comparison_report import report

    shown = signals or ()
    comparison = compare_traces(traces, against=against, signals=shown, start=start, stop=stop, rate=rate)
    make_folder(out)
    found = report(comparison)
    page, numbers = found.write(out / "comparison.html")
    print(f"{found.text()}\n\npage: {page}\nnumbers: {numbers}")


@command
def plot(
    files: Annotated[list[Path] | None, Kind("FILE...", positional=True)] = None,
    signals: Patterns | None = None,
    start: Time = None,
    stop: Time = None,
    out: File | None = None,
) -> None:
    """Draw signals of a run over time, one panel per unit.

    With several files their runs are drawn over each other, with different line styles.

    files     Traces of one or several runs, or measurements with a .toml; default: the
              newest trace in build.
    signals   Signals to draw, such as boom_angle, 'boom_*' or, with component, 'boom_stick.*'; default: up to
              six signals of each of four quantities.
    start     Start of the time window [s]; default: all.
    stop      End of the time window [s]; default: all.
    out       File of a picture (.png, .svg, .pdf); default: a page, build/plot.html, with zoom and values.
    """
    from orchestrator.results.report import Figure, Report

    chosen, (first, *others) = _runs(files, out)
    title = ", ".join(run.label for run in (first, *others))
    names = first.trace.window(start, stop).matching(signals or ())
    beside = {run.label: run.trace for run in others}
    figure = first.trace.figure(
        *(signals or ()), title=title, start=start, stop=stop, others=beside, label=first.label
    )
    more = "" if signals else "; choose others with --signals PATTERN"
    print(
        told := f"{len(names)} of {len(first.trace.signals)} signals of {', '.join(map(str, chosen))}{more}"
    )
    if out is None:
        write_whole(BUILD / "plot.html", Report(title, told, [Figure(figure, title)]).html())
        print(f"page: {BUILD / 'plot.html'}")
    else:
        print(f"picture: {_drawn(figure, out)}")


@command
def energy(
    runs: Annotated[list[Path] | None, Kind("RUN...", positional=True)] = None,
    start: Time = None,
    stop: Time = None,
    out: File | None = None,
    json: bool = False,
) -> None:
    """Show where the energy of a run went: heat of each function by cause, pump, engine, load.

    Several runs stand side by side, with differences from the first one.

    runs    Traces of runs of a machine (.csv, .parquet, .mat); default: the newest trace in build.
    start   Start of the time window [s], such as that of a cycle; default: all.
    stop    End of the time window [s]; default: all.
    out     File of a picture (.png, .svg, .pdf); default: a page, build/energy.html, and energy.json.
    json    Print the energies [J] as JSON, without a page.
    """
    from orchestrator.results.energy import energy, figure, report

    _, chosen = _runs(runs, out)
    found = {r.label: energy(r.trace.window(start, stop), r.file or r.label) for r in chosen}
    unreliable = [f"{r.label}: {told}" for r in chosen if r.metadata for told in r.metadata.unreliable]
    shown = report(found, unreliable)
    print(shown.json() if json else shown.text())
    picture = _drawn(figure(found), out) if out else None
    if json:
        return
    if picture:
        print(f"\npicture: {picture}")
    else:
        page, numbers = shown.write(BUILD / "energy.html")
        print(f"\npage: {page}\nnumbers: {numbers}")


def _runs(files: list[Path] | None, out: Path | None) -> tuple[list[Path], list[Run]]:
    """The files and their runs, else the newest run in build; refuses a picture of another format."""
    from orchestrator.engine.result import newest_trace
    from orchestrator.results.comparison import read_runs

    if out is not None and out.suffix.lower() not in FORMATS:
        raise Problem(f"--out {out}: expected a file name ending in .png, .svg or .pdf")
    newest = None if files else newest_trace(BUILD)
    if not (chosen := files or ([newest] if newest else [])):
        raise Problem(f"{BUILD}: expected the trace of a run, got none; make one with: harvester run")
    return chosen, read_runs(chosen)


def _drawn(figure: TraceFigure, picture: Path) -> Path:
    """Draw a figure in the format of the name of its file."""
    from orchestrator.pages.plotting import draw, pdf, png, svg

    make_folder(picture.parent)
    made = draw(figure)
    formats = {".svg": lambda: svg(made).encode(), ".pdf": lambda: pdf(made)}
    return write_whole(picture, formats.get(picture.suffix.lower(), lambda: png(made))())
