"""`harvester modelica`: write FMUs as a Modelica package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from orchestrator.base.files import VARIANTS
from orchestrator.base.options import Kind
from orchestrator.cli.options import BUILD, Folder, Text, command, system_file

NEXT = """\
next, in OpenModelica:
  loadModel(Modelica, {{"4.0.0"}}); loadFile("{package}");"""
MINE = """\
  loadFile("Mine.mo"); simulate(Mine, stopTime = 8);
with a file Mine.mo, such as
  model Mine
    {block} machine;
    Modelica.Blocks.Sources.Sine lever(amplitude = 3, f = 0.3, startTime = 1);
  equation
    connect(lever.y, machine.{lever});  // levers without connection or modifier are 0
  end Mine;"""


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
               supply_pressure, tank_pressure, oil_temperature and payload_mass that the FMUs have.
    """
    from fmus.machine import CONSTANT_INPUTS, LEVERS
    from orchestrator.modelica import write_package
    from orchestrator.modelica.syntax import class_name
    from orchestrator.ssp.load import load

    if not files:
        system = system_file(None)
        files = [system, system.with_suffix(".fmu"), *sorted((system.parent / VARIANTS).glob("*.fmu"))]
    inputs = {file: {port.variable for port in load(file).ports("input")} for file in files}
    default = [known for known in CONSTANT_INPUTS if known in set().union(*inputs.values())]
    package = write_package(files, out, name, constant or default, LEVERS)
    print(f"{package}\n{NEXT.format(package=package.as_posix())}")
    machines = (f for f in files if f.suffix == ".fmu" and inputs[f].issuperset(LEVERS))
    if machine := next(machines, None):
        print(MINE.format(block=f"{name}.FMUs.{class_name(machine.stem)}", lever=LEVERS[0]))
