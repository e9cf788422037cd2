"""`harvester page`: the machine of a system as an HTML file."""

from __future__ import annotations

from typing import Annotated

from orchestrator.base.options import Kind
from orchestrator.cli.options import BUILD, File, System, command, system_file


@command
def page(
    system: System = None,
    out: File = BUILD / "machine.html",
    title: Annotated[str, Kind("TEXT")] = "Drive the harvester",
) -> None:
    """Write an HTML page on which you can drive the machine, without a server.

    The page contains the whole machine (build/fmi3/harvester.fmu) as WebAssembly. Open the file in a browser.

    out     HTML file to write.
    title   Title of the page.
    """
    from orchestrator.base.files import require_system
    from orchestrator.drive.page import write_page

    path = write_page(out, require_system(system_file(system)), title)
    print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")
