"""`harvester page`: the machine of a system as an HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import BUILD, System, app, system_file


@app.command()
def page(
    system: System = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="HTML file to write.")] = BUILD / "machine.html",
    title: Annotated[str, typer.Option(metavar="TEXT", help="Title of the page.")] = "Drive the harvester",
) -> None:
    """Write an HTML page on which you can drive the machine, without a server.

    The page contains the whole machine (build/fmi3/harvester.fmu) as WebAssembly. Open the file in a browser.
    """
    from orchestrator.base.files import require_system
    from orchestrator.scene.live_page import write_page

    path = write_page(out, require_system(system_file(system)), title)
    print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")
