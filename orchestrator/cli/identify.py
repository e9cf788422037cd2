"""`harvester identify`: parameters from recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import BUILD, app


@app.command()
def identify(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Recordings: data files, each with a .toml that describes it."),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the parameters go (.toml).")] = Path(
        "parameters.toml"
    ),
    report: Annotated[
        Path, typer.Option(metavar="DIR", help="Where identification.html and .json go.")
    ] = BUILD,
    joint: Annotated[
        bool, typer.Option("--joint/--no-joint", help="Refine all together, if the machine was recorded.")
    ] = True,
    inertia: Annotated[
        bool, typer.Option("--inertia", help="Estimate inertial parameters from joint motion, too.")
    ] = False,
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="What the joint refinement may change; repeatable; default: what a work cycle shows.",
        ),
    ] = None,
    starts: Annotated[
        int,
        typer.Option(metavar="N", help="Refine again from N random starts: do they lead to the same result?"),
    ] = 4,
) -> None:
    """Find the machine's parameters from recordings.

    By the paper's procedures, then all together.
    """
    from fmus.identification.command import run as identified
    from fmus.identification.machine import FREE
    from orchestrator.base.files import folder as made

    made(out.parent)
    made(report)
    identified(folder, out, report, joint=joint, inertial=inertia, names=tuple(free or FREE), starts=starts)
