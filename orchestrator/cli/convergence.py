"""`harvester convergence`: error over communication step, for each master."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import BUILD, SYSTEM, Case, System, app, spread

STUDY = BUILD / "convergence"


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
    from fmus.machine.build import data
    from orchestrator.studies.convergence_study import convergence as study

    usually = data("reference/work_cycle.csv")
    options = case.options() | {"scenario": case.scenario, "usually": usually}
    study(system, reference, out, steps, masters, signals or (), repeats, **options)
