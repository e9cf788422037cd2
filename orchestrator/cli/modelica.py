"""`harvester modelica`: FMUs as a Modelica package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.options import BUILD, SYSTEM, app


@app.command()
def modelica(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FILE...",
            help="FMUs and systems (.fmu, .ssp), FMI 2.0; by default harvester.ssp, harvester.fmu and all"
            " variants of build/.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="The folder that the package goes into, as NAME/package.mo.")
    ] = BUILD / "modelica",
    name: Annotated[str, typer.Option(metavar="NAME", help="Of the package.")] = "Harvester",
    constant: Annotated[
        list[str] | None,
        typer.Option(
            metavar="INPUT",
            help="An input that is a parameter unless use_INPUT_in is set; repeatable."
            " By default supply_pressure and tank_pressure.",
        ),
    ] = None,
) -> None:
    """Write FMUs as a Modelica package: blocks, models with mechanical flanges, connected systems.

    The FMUs take part by Model Exchange: the Modelica tool's solver integrates them.
    """
    from orchestrator.modelica import write_package

    held = ("supply_pressure", "tank_pressure") if constant is None else constant
    usual = [SYSTEM, BUILD / "harvester.fmu", *sorted((BUILD / "variants").glob("*.fmu"))]
    print(write_package(files or usual, out, name, held))
