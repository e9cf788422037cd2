"""`harvester rig`: record the experiments of the paper on a virtual test rig."""

from __future__ import annotations

from typing import Annotated

from orchestrator.base.options import Kind
from orchestrator.cli.options import Folder, Text, command


@command
def rig(out: Folder, machine: Text = "detailed", seed: Annotated[int, Kind("N")] = 0) -> None:
    """Record the paper's experiments on a virtual test rig.

    Writes CSV files like those of a real test rig, from simulations.

    out       Folder for the recordings; it may contain earlier recordings, but no other files.
    machine   Variants of the simulated machine: lumped (as in the paper) or detailed.
    seed      Seed of the noise, 0 or more; equal seeds give equal files.
    """
    import os

    from fmus.rig import write_all

    write_all(out, machine, seed, processes=os.cpu_count() or 1)
