"""`harvester crane`: a machine of one's own from one file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from orchestrator.base.extras import require
from orchestrator.base.options import Kind
from orchestrator.cli.options import command


@command
def crane(
    action: Annotated[Literal["new", "check"], Kind("ACTION", positional=True)],
    file: Annotated[Path, Kind("FILE", positional=True)],
) -> None:
    """Describe a crane of your own in one file: begin one, or check it.

    `harvester build --crane FILE` then builds its FMUs and its system.

    action   new: write a commented file of a small crane; check: print range, lever, forces, holding pressure
             and speed of each axis, or all mistakes.
    file     The description of the crane (.toml).
    """
    require("build", "harvester crane")
    from fmus.crane.check import check, table
    from fmus.crane.description import new, read

    if action == "new":
        print(new(file))
        return
    description = read(file)
    print(table(description, check(description)))
