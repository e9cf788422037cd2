"""`harvester crane`: a machine of one's own from one file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.options import Kind
from orchestrator.cli.options import command


@command
def crane(
    action: Annotated[Literal["new", "check", "export", "import"], Kind("ACTION", positional=True)],
    file: Annotated[Path, Kind("FILE", positional=True)],
    *,
    drawing: Annotated[Path | None, Kind("FILE")] = None,
    out: Annotated[Path | None, Kind("FILE")] = None,
) -> None:
    """Describe a crane of your own in one file: begin one, or check it.

    `harvester build --crane FILE` then builds its FMUs and its system.

    action    new: write a commented file of a small crane; check: print range, lever, forces, holding
              pressure, speed and first mode of each axis, loads, and the data sheet beside them, or all
              mistakes.
              export: write links and joints as a URDF. import: begin a description from a URDF, and tell
              what is missing.
    file      The description of the crane (.toml); with import a URDF.
    out       With export and import: the file to write; default: FILE with another ending.
    drawing   With check: picture (.png) of the working range, coloured by the load that can be held.
    """
    require("build", "harvester crane")
    from fmus.crane.axes import capacity
    from fmus.crane.check import checked, table
    from fmus.crane.description import new
    from fmus.crane.speeds import full_speeds

    for name, given, actions in (("drawing", drawing, ("check",)), ("out", out, ("export", "import"))):
        if given is not None and action not in actions:
            raise Problem(f"--{name} {given}: expected only with {' or '.join(actions)}, got {action}")
    if action == "new":
        print(new(file))
        return
    if action == "import":
        from fmus.crane.urdf import imported

        print(imported(file, out or file.with_suffix(".toml")))
        return
    description, found = checked(file)
    if action == "export":
        from fmus.crane.urdf import export, left_out
        from orchestrator.base.files import write_whole

        target = out or file.with_suffix(".urdf")
        speeds = full_speeds(description, found, ["lumped"])
        write_whole(target, export(description, found, speeds).encode())
        print("\n".join([f"{target}: {len(description.joints)} links", *left_out(description)]))
        return
    loads = capacity(description, found)
    print(table(description, found, loads, full_speeds(description, found)))
    if drawing is not None:
        from fmus.crane.drawing import drawing as drawn
        from orchestrator.base.files import write_whole
        from orchestrator.pages.plotting import png

        write_whole(drawing, png(drawn(description, loads)))
        print(f"{drawing}: the working range")
