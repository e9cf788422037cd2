"""`harvester view`: watch and drive the machine in a browser."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.cli.options import (
    BUILD,
    SYSTEM,
    Set,
    Swap,
    app,
    assignments,
    swaps,
    system_file,
    tell_built,
)

CONTROL = BUILD / "harvester_control.ssp"


@app.command()
def view(
    system: Annotated[
        Path | None,
        typer.Argument(
            metavar="SYSTEM",
            help=(
                "An .ssp or .fmu file; default: build/harvester_control.ssp, in which the joysticks "
                "can also move the tip; else build/harvester.ssp, else the one in the installed package."
            ),
        ),
    ] = None,
    replay: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Start with the replay of this result file (.csv, .parquet, .mat); default: none.",
        ),
    ] = None,
    pose: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Parameter set with the initial pose, such as reach; default: the pose in the system.",
        ),
    ] = "",
    swap: Swap = None,
    set_: Set = None,
    port: Annotated[
        int, typer.Option(metavar="N", min=0, max=65535, help="TCP port; 0 selects a free one.")
    ] = 8080,
    host: Annotated[
        str,
        typer.Option(
            metavar="HOST",
            help="Name or address to listen on, such as 0.0.0.0 for all; any other than a loopback address"
            " requires a token.",
        ),
    ] = "127.0.0.1",
    token: Annotated[
        str,
        typer.Option(
            metavar="TEXT",
            help="Token that the page requires, at least 16 characters; default: none for a loopback"
            " address, else a random one.",
        ),
    ] = "",
    open_: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
    results: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Folder of the results that can be replayed, and of recorded sessions."
        ),
    ] = BUILD,
) -> None:
    """Watch and drive the machine in a browser, in real time, or replay a result file."""
    require("view", "harvester view")
    from orchestrator.view.server import serve

    swapped = swaps(swap or [])
    chosen = system or _default_system(swapped)
    tell_built(chosen, swapped)
    serve(
        chosen,
        replay,
        pose,
        swapped,
        assignments(set_ or []),
        host=host,
        port=port,
        token=token,
        open_=open_,
        results=results,
    )


def _default_system(swapped: Mapping[str, str]) -> Path:
    """The system with the controller if it exists in `build`, else the one without, else as in the package.

    Raises `Problem` for a swap that only the system without controller accepts.
    """
    if not CONTROL.exists() and SYSTEM.exists():
        return SYSTEM
    control = system_file(None, CONTROL.name)
    if not control.exists():
        return SYSTEM
    other = control.with_name(SYSTEM.name)
    from orchestrator.ssp.load import load
    from orchestrator.ssp.swap import with_swaps

    if swapped:
        try:
            with_swaps(load(control), swapped)
        except Problem as problem:
            if other.exists() and _accepts(other, swapped):
                message = f"{problem}; {other} has no controller and accepts it: harvester view {other}"
                raise Problem(
                    f"{message} {' '.join(f'--swap {n}={f}' for n, f in swapped.items())}"
                ) from None
            raise
    return control


def _accepts(system: Path, swapped: Mapping[str, str]) -> bool:
    from orchestrator.ssp.load import load
    from orchestrator.ssp.swap import with_swaps

    try:
        with_swaps(load(system), swapped)
    except Problem:
        return False
    return True
