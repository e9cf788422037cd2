"""`harvester rig`: the experiments of the paper on a virtual test rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import app


@app.command()
def rig(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the recordings go.")],
    machine: Annotated[
        str, typer.Option(metavar="NAME", help="lumped, the set of the paper, or detailed.")
    ] = "detailed",
    seed: Annotated[int, typer.Option(metavar="N", help="Of the noise; equal seeds give equal files.")] = 0,
) -> None:
    """Record the paper's experiments on a virtual test rig.

    CSV files as of a real one, but simulated.
    """
    from fmus.rig import write_all

    write_all(out, machine, seed)
