"""`harvester rig`: record the experiments of the paper on a virtual test rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import app


@app.command()
def rig(
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Folder for the recordings; it may contain earlier recordings, but no other files.",
        ),
    ],
    machine: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="Variants of the simulated machine: lumped (as in the paper) or detailed."
        ),
    ] = "detailed",
    seed: Annotated[
        int, typer.Option(metavar="N", help="Seed of the noise, 0 or more; equal seeds give equal files.")
    ] = 0,
) -> None:
    """Record the paper's experiments on a virtual test rig.

    Writes CSV files like those of a real test rig, from simulations.
    """
    import os

    from fmus.rig import write_all

    write_all(out, machine, seed, processes=os.cpu_count() or 1)
