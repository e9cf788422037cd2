"""`harvester modelica`: write FMUs as a Modelica package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from orchestrator.base.files import VARIANTS
from orchestrator.base.options import Kind
from orchestrator.cli.options import BUILD, Folder, Text, command, system_file

CONSTANT_INPUTS = ("supply_pressure", "tank_pressure", "payload_mass")  # that most models leave constant


@command
def modelica(
    files: Annotated[list[Path] | None, Kind("FILE...", positional=True)] = None,
    out: Folder = BUILD / "modelica",
    name: Text = "Harvester",
    constant: Annotated[list[str] | None, Kind("INPUT")] = None,
) -> None:
    """Write FMUs as a Modelica package: blocks, models with mechanical flanges, connected systems.

    The FMUs are imported for Model Exchange: the solver of the Modelica tool integrates them.

    files      FMUs of FMI 2.0 and systems (.fmu, .ssp); default: build/harvester.ssp, build/harvester.fmu and
               build/variants/*.fmu, else those in the installed package.
    out        Folder of the package; it becomes DIR/NAME/package.mo.
    name       Name of the package.
    constant   Input that becomes a parameter, or a connector if use_INPUT_in is true; default: those of
               supply_pressure, tank_pressure and payload_mass that the FMUs have.
    """
    from orchestrator.modelica import write_package
    from orchestrator.ssp.load import load

    if not files:
        system = system_file(None)
        files = [system, system.with_suffix(".fmu"), *sorted((system.parent / VARIANTS).glob("*.fmu"))]
    inputs = {port.variable for file in files for port in load(file, exchange=True).ports("input")}
    print(write_package(files, out, name, constant or [i for i in CONSTANT_INPUTS if i in inputs]))
