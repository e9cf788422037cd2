"""`harvester view` and `page`: watch and drive the machine in a browser, with or without a server."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import require_system
from orchestrator.base.options import Faults, Kind, Swaps, Values
from orchestrator.cli import options
from orchestrator.cli.options import BUILD, SYSTEM, File, Folder, System, Text, command, system_file

CONTROL = BUILD / "harvester_control.ssp"


@command
def view(
    system: System = None,
    replay: File | None = None,
    pose: Text = "",
    swap: Swaps | None = None,
    set_: Values | None = None,
    fault: Faults | None = None,
    port: Annotated[int, Kind("N", least=0, most=65535)] = 8080,
    host: Annotated[str, Kind("HOST")] = "127.0.0.1",
    token: Annotated[str, Kind("TEXT")] = "",
    open_: bool = True,
    results: Folder = BUILD,
) -> None:
    """Watch and drive the machine in a browser, in real time, or replay a result file.

    system    An .ssp or .fmu file; default: build/harvester_control.ssp, in which the joysticks can also move
              the tip; else build/harvester.ssp, else the one in the installed package.
    replay    Open the replay of this result file (.csv, .parquet, .mat); default: none.
    pose      Parameter set with the initial pose, such as reach; default: the pose in the system.
    fault     Input that takes a value at a simulated time, such as boom_head_leak=2mm2@20s of a machine that
              was built with faults.
    port      TCP port; 0 selects a free one.
    host      Name or address to listen on, such as 0.0.0.0 for all; any other than a loopback address
              requires a token.
    token     Token that the page requires, at least 16 characters; default: none for a loopback address, else
              a random one.
    open      Open the page in a browser.
    results   Folder of the results that can be replayed, and of recorded sessions.
    """
    require("view", "harvester view")
    from orchestrator.view.choice import MachineChoice
    from orchestrator.view.server import serve

    swapped = {name: str(file) for name, file in (swap or {}).items()}
    starts = {name: str(value) for name, value in (set_ or {}).items()}
    chosen = require_system(system or _default_system(swapped))
    options.tell_built(chosen, swapped)
    serve(
        MachineChoice(chosen, pose, swapped, starts, {n: str(value) for n, value in (fault or {}).items()}),
        replay,
        host=host,
        port=port,
        token=token,
        open_=open_,
        results=results,
        tell=partial(print, flush=True),
        tell_failure=lambda text: print(f"harvester: {text}", file=sys.stderr, flush=True),
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
    if swapped:
        from orchestrator.ssp.load import configured

        try:
            configured(control, swap=swapped)
        except Problem as problem:
            other, words = control.with_name(SYSTEM.name), (f"--swap {n}={f}" for n, f in swapped.items())
            with suppress(Problem):
                configured(other, swap=swapped)
                advice = f"{other} has no controller and accepts it: harvester view {other}"
                problem = Problem(f"{problem}; {advice} {' '.join(words)}")
            raise problem from None
    return control


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
    from orchestrator.drive.page import write_page

    path = write_page(out, require_system(system_file(system)), title)
    print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")
