"""`harvester view`: watch and drive the machine in a browser."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.base.errors import Problem
from orchestrator.cli.options import BUILD, SYSTEM, Set, Swap, app, assignments, swaps

CONTROL = BUILD / "harvester_control.ssp"


@app.command()
def view(
    system: Annotated[
        Path | None,
        typer.Argument(
            metavar="SYSTEM",
            help="An .ssp or .fmu file; default: build/harvester_control.ssp, which also drives the tip, else"
            " build/harvester.ssp.",
        ),
    ] = None,
    replay: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Show a result file (.csv, .parquet) first.")
    ] = None,
    pose: Annotated[
        str, typer.Option(metavar="NAME", help="Pose to start from, such as reach; default: the system's.")
    ] = "",
    swap: Swap = None,
    set_: Set = None,
    port: Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="0 takes a free one.")] = 8080,
    host: Annotated[
        str,
        typer.Option(
            metavar="H", help="Address to listen on; another one than this computer's own needs a token."
        ),
    ] = "127.0.0.1",
    token: Annotated[
        str, typer.Option(metavar="TEXT", help="The token, 16 characters or more; default: a fresh one.")
    ] = "",
    open_: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
    results: Annotated[
        Path, typer.Option(metavar="DIR", help="Where result files to replay lie, and sessions go.")
    ] = BUILD,
) -> None:
    """Watch and drive the machine in a browser, in real time; or replay a result file."""
    from orchestrator.view.server import serve

    swapped = swaps(swap or [])
    serve(
        system or _usual(swapped),
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


def _usual(swapped: Mapping[str, str]) -> Path:
    """The system with the controller, else the one without; refuses a swap that only the latter takes."""
    if not CONTROL.exists():
        return SYSTEM
    from orchestrator.ssp.load import load
    from orchestrator.ssp.swap import with_swaps

    if swapped:
        try:
            with_swaps(load(CONTROL), swapped)
        except Problem as problem:
            if SYSTEM.exists() and _takes(SYSTEM, swapped):
                text = f"{problem}; {SYSTEM} has no controller and takes it: harvester view {SYSTEM}"
                raise Problem(f"{text} {' '.join(f'--swap {n}={f}' for n, f in swapped.items())}") from None
            raise
    return CONTROL


def _takes(system: Path, swapped: Mapping[str, str]) -> bool:
    from orchestrator.ssp.load import load
    from orchestrator.ssp.swap import with_swaps

    try:
        with_swaps(load(system), swapped)
    except Problem:
        return False
    return True
