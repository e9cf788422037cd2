"""`harvester identify`: estimate parameters from recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.base.extras import require
from orchestrator.cli.options import BUILD, app


@app.command()
def identify(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder of recordings: data files, each with a .toml that describes the columns.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="File for the estimated parameters (.toml).")
    ] = Path("parameters.toml"),
    report: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of identification.html and identification.json.")
    ] = BUILD,
    joint: Annotated[
        bool,
        typer.Option(
            "--joint/--no-joint",
            help="Refine all parameters together, if there is a recording of the whole machine.",
        ),
    ] = True,
    inertia: Annotated[
        bool,
        typer.Option("--inertia", help="Also estimate inertial parameters, from the motion of the joints."),
    ] = False,
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Parameter that --joint may change, by its name in parameters.toml;"
            " repeatable; default: those that a work cycle excites.",
        ),
    ] = None,
    starts: Annotated[
        int,
        typer.Option(
            metavar="N",
            help=(
                "Repeat the refinement from N random starts, to check whether the result is the "
                "same; 0: no repetitions."
            ),
        ),
    ] = 4,
) -> None:
    """Estimate the machine's parameters from recordings.

    First with each procedure of the paper, then all parameters together. Exit status 0: estimates without a
    warning; 1: estimates and a report are written, but a warning says why the estimates are doubtful, such
    as residuals far above the noise of the sensors; 2: a mistake, nothing is written.
    """
    require("identify", "harvester identify")
    from fmus.identification.command import run as run_identify
    from fmus.identification.machine import FREE
    from orchestrator.base.files import make_folder

    make_folder(out.parent)
    make_folder(report)
    trusted = run_identify(
        folder, out, report, joint=joint, inertial=inertia, names=tuple(free or FREE), starts=starts
    )
    if not trusted:
        raise typer.Exit(1)
