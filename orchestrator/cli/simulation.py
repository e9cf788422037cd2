"""Commands that run systems: run, validate, compare, convergence."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.app import BUILD, SYSTEM, app
from orchestrator.commands.coupled import Coupled
from orchestrator.commands.options import Case, Steps, System
from orchestrator.commands.reading import seconds
from orchestrator.commands.spread import spread

STUDY = BUILD / "convergence"


@app.command()
@spread
def run(
    *,
    system: System = SYSTEM,
    case: Case,
    steps: Steps,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Where the trace goes (.csv or .parquet).")
    ] = BUILD / "trace.csv",
    error_estimate: Annotated[
        bool,
        typer.Option(
            "--error-estimate",
            help="Run again at half and at twice the step, or at a tenth of the tolerance of --adaptive;"
            " tell change and order.",
        ),
    ] = False,
    coupled: Coupled,
) -> None:
    """Co-simulate a system and record its signals."""
    from orchestrator.commands import commands

    options = case.options() | steps.options() | {"error_estimate": error_estimate}
    commands.run(system, case.scenario, out, coupling=coupled.given(), **options)


@app.command()
@spread
def validate(
    *,
    system: System = SYSTEM,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Reference or measurement, .csv with .toml; default: the work cycle."
        ),
    ] = None,
    layout: Annotated[
        Path | None, typer.Option(metavar="FILE", help="What the report shows (.toml).")
    ] = None,
    play: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Signals of the reference that go into the run beside its commands, such as"
            " '*.supply_pressure'; repeatable.",
        ),
    ] = None,
    case: Case,
    steps: Steps,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where run.csv and the report go.")] = BUILD,
    coupled: Coupled,
) -> None:
    """Co-simulate and compare with a reference.

    Writes a report; exit status 1 if a limit is missed.
    """
    from fmus.build import data
    from orchestrator.commands.validate import validate as judged

    usual = data("reference/work_cycle.csv"), data("reference/work_cycle.layout.toml")
    options = case.options() | steps.options() | {"coupling": coupled.given(), "play": play or ()}
    if not judged(system, case.scenario, reference, layout, out, usual=usual, **options):
        raise typer.Exit(1)


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
    from orchestrator.commands import commands

    commands.compare(traces, out, against=against, signals=signals or (), start=start, stop=stop)


@app.command()
@spread
def convergence(
    *,
    system: System = SYSTEM,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Reference, .csv with .toml; default: of the harvester's work cycle its solution,"
            " of any other run the finest hermite run.",
        ),
    ] = None,
    steps: Annotated[
        str, typer.Option(metavar="S,S,...", help="Communication steps [s], with commas.")
    ] = "0.0005,0.001,0.002,0.005,0.01,0.02",
    masters: Annotated[
        str,
        typer.Option(
            metavar="NAME,...",
            help="Only these, such as jacobi, 'hermite 2 passes' or '*order 1'; default: all.",
        ),
    ] = "",
    signals: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="What to judge, such as '*_pressure*'; repeatable, one table each;"
            " default: speeds and pressures.",
        ),
    ] = None,
    case: Case,
    repeats: Annotated[
        int, typer.Option(metavar="N", help="How often each run is timed; the median counts.")
    ] = 3,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where numbers and pictures go.")] = STUDY,
) -> None:
    """Error over communication step for all masters.

    And what each costs: tables, numbers, pictures.
    """
    from fmus.build import data
    from orchestrator.convergence.command import convergence as study

    usually = data("reference/work_cycle.csv")
    options = case.options() | {"scenario": case.scenario, "usually": usually}
    study(system, reference, out, steps, masters, signals or (), repeats, **options)
