"""Commands about models and FMUs: build, variants, parameters, signals, check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.app import BUILD, SYSTEM, app
from orchestrator.commands.options import Swap, System
from orchestrator.commands.texts import swaps
from orchestrator.errors import Problem


@app.command()
def build(
    model: Annotated[
        str | None,
        typer.Argument(
            metavar="MODEL",
            help="For an FMU whose code is Python: a file with a model of your own, such as my_actuator.py,"
            " or a subsystem, such as fmus.boom_stick:VARIANTS.lumped.",
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Where the files go; those of FMI 3.0 to fmi3/ in it, those in Python to python/.",
        ),
    ] = BUILD,
    fmi: Annotated[
        str, typer.Option(metavar="VERSION", help="2, 3 or both; of a model in Python 2.")
    ] = "both",
    platform: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="host (the default), all, or one such as x86_64-windows or aarch64-linux; repeatable.",
        ),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Numbers in place of those of the parts (.toml), such as harvester identify writes.",
        ),
    ] = None,
) -> None:
    """Build the FMUs of the machine, or one of a model in Python.

    Of the machine: the parts in all variants, the whole, the controller, and the systems that connect them.
    """
    from fmus.export.platforms import select
    from orchestrator.commands import commands

    versions = {"2": (2,), "3": (3,), "both": (2, 3)}
    if fmi not in versions:
        raise Problem(f"--fmi {fmi}: expected {', '.join(versions)}")
    platforms = select(platform or ["host"])
    commands.folder(out)
    if model is not None:
        from fmus.export.python.build import build_model

        if 2 not in versions[fmi]:
            raise Problem(f"--fmi {fmi}: expected 2, an FMU whose code is Python is one of FMI 2.0")
        if parameters is not None:
            raise Problem(f"--parameters {parameters}: a model of your own has its own numbers")
        print(build_model(model, out, platforms))
        return
    from fmus.build import build_machine

    for path in build_machine(out, versions[fmi], platforms, parameters):
        print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")


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


@app.command()
def variants(
    system: Annotated[
        Path, typer.Argument(metavar="SYSTEM", help="The built system, to measure costs in.")
    ] = SYSTEM,
    combinations: Annotated[
        bool, typer.Option("--combinations", help="Run the work cycle with every combination of variants.")
    ] = False,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Where the table of combinations goes (.csv).")
    ] = BUILD / "combinations.csv",
) -> None:
    """List the variants of each part, and what they cost here.

    With states, inputs and range of validity.
    """
    from fmus.machine import FAMILIES
    from fmus.variants import lines, names
    from orchestrator.variety import command

    if combinations:
        joints = [f"manipulator.{joint}_speed" for joint in ("swing", "boom", "stick")]
        if not command.table(system, {part: list(family) for part, family in FAMILIES.items()}, joints, out):
            raise typer.Exit(1)
        return
    print("\n".join(lines(command.costs(system, names()) if system.exists() else {})))
    if not system.exists():
        print(f"{system} is not built: no costs measured; make it with: harvester build")


@app.command()
def parameters(
    subsystem: Annotated[
        str | None,
        typer.Argument(
            help="A part or a variant of it, such as swing or swing_detailed; default: the machine"
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(metavar="WORD", help="Only numbers with this source, such as paper or assumed."),
    ] = None,
) -> None:
    """Print the numbers of the model with unit and source."""
    from fmus.provenance import show

    show(subsystem, source)


@app.command()
def signals(
    system: System = SYSTEM,
    kind: Annotated[str | None, typer.Option(metavar="KIND", help="Only input, output or parameter.")] = None,
    swap: Swap = None,
) -> None:
    """List the variables of a system with unit and meaning."""
    from orchestrator.commands import commands

    commands.signals(system, kind, swaps(swap or []))


@app.command()
def check(
    fmu: Annotated[Path | None, typer.Argument(metavar="FILE", help="Any .fmu file.")] = None,
    for_: Annotated[
        str,
        typer.Option(
            "--for", metavar="TOOL", help="simulink, dymola, openmodelica, amesim, another, or any."
        ),
    ] = "any",
    json: Annotated[
        Path | None, typer.Option(metavar="OUT", help="Write the findings to a file, for programs.")
    ] = None,
    static: Annotated[bool, typer.Option("--static", help="Run nothing of the FMU.")] = False,
    timeout: Annotated[
        float, typer.Option(metavar="SECONDS", help="A call into the FMU that takes longer is a hang.")
    ] = 10.0,
    rules: Annotated[bool, typer.Option("--rules", help="Print the table of rules.")] = False,
) -> None:
    """Tell what is wrong with an FMU, and for which tool.

    Exit status 1 if there are errors.
    """
    from orchestrator.check import command

    if not command.run(fmu, for_, json, rules, static, timeout):
        raise typer.Exit(1)
