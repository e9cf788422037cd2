"""`harvester modelica`: write FMUs as a Modelica package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.base.files import VARIANTS
from orchestrator.cli.options import BUILD, app, system_file


@app.command()
def modelica(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FILE...",
            help="FMUs of FMI 2.0 and systems (.fmu, .ssp); default: build/harvester.ssp,"
            " build/harvester.fmu and build/variants/*.fmu, else those in the installed package.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the package; it becomes DIR/NAME/package.mo.")
    ] = BUILD / "modelica",
    name: Annotated[str, typer.Option(metavar="NAME", help="Name of the package.")] = "Harvester",
    constant: Annotated[
        list[str] | None,
        typer.Option(
            metavar="INPUT",
            help="Input that becomes a parameter, or a connector if use_INPUT_in is true; repeatable;"
            " default: supply_pressure, tank_pressure and payload_mass.",
        ),
    ] = None,
) -> None:
    """Write FMUs as a Modelica package: blocks, models with mechanical flanges, connected systems.

    The FMUs are imported for Model Exchange: the solver of the Modelica tool integrates them.
    """
    from orchestrator.modelica import write_package

    constants = ("supply_pressure", "tank_pressure", "payload_mass") if constant is None else constant
    if not files:
        system = system_file(None)
        files = [system, system.with_suffix(".fmu"), *sorted((system.parent / VARIANTS).glob("*.fmu"))]
    print(write_package(files, out, name, constants))
