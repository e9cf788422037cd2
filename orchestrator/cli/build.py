"""`harvester build`, `crane`, `modelica`: FMUs of a machine, a machine from one file, a Modelica package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from orchestrator.base.errors import Problem
from orchestrator.base.extras import EXTRAS, require
from orchestrator.base.files import VARIANTS, make_folder, write_whole
from orchestrator.base.options import Kind, Patterns
from orchestrator.cli.options import BUILD, File, Folder, Text, command, system_file


@command
def build(
    model: Annotated[str | None, Kind("MODEL", positional=True)] = None,
    out: Folder = BUILD,
    fmi: Annotated[str, Kind("VERSION")] = "both",
    platform: Annotated[list[str] | None, Kind("NAME")] = None,
    parameters: File | None = None,
    only: Patterns | None = None,
    crane: File | None = None,
    faults: bool = False,
    shipped: bool = False,
) -> None:
    """Build the FMUs of the machine, or one FMU from a model in Python.

    The machine: all variants of its parts, the whole machine as one FMU, the controller, and the systems that
    connect them.

    model        Build only this model, as an FMU whose code is Python: a file with your own model, such as
                 my_actuator.py; default: the machine.
    out          Folder of the FMUs; those of FMI 3.0 go to the subfolder fmi3, FMUs whose code is Python to
                 the subfolder python.
    fmi          FMI version: 2, 3 or both.
    platform     Platform of the binaries: host (this computer, the default), x86_64-linux, aarch64-linux,
                 x86_64-windows, x86_64-darwin, aarch64-darwin, all (these five), or wasm (adds a WebAssembly
                 module for browsers; harvester.fmu of FMI 3.0 always has one).
    parameters   Parameter values that replace those of the parts (.toml), as written by identify; default:
                 none.
    only         Build only the FMUs whose names match, such as 'swing*'; default: all.
    crane        Build the machine that this file (.toml) describes instead, see `harvester crane`.
    faults       Build FMUs that have faults as inputs, such as boom_head_leak; a part is healthy while its
                 inputs are 0. They have the same names, so choose another folder with --out.
    shipped      Copy the FMUs and systems from the installed package instead of building them; they are for
                 all platforms, and no compiler is needed.
    """
    from fmus.package_files import BUILT, copy_shipped

    versions = {"2": (2,), "3": (3,), "both": (2, 3)}
    if fmi not in versions:
        raise Problem(f"--fmi {fmi}: expected {', '.join(versions)}")
    if shipped and (model or platform or parameters or only or crane or faults):
        others = "--platform, --parameters, --only, --crane or --faults"
        raise Problem(f"--shipped: expected no MODEL, {others}, which need a build")
    if faults and model:
        raise Problem(f"--faults: expected none with MODEL {model}, which has its own inputs")
    if crane and model:
        raise Problem(f"--crane {crane}: expected no MODEL, got {model}")
    if shipped:
        make_folder(out)
        _tell(copy_shipped(out, versions[fmi]))
        return
    copying = "; harvester build --shipped copies the FMUs in the package" if BUILT.is_file() else ""
    require("build", "harvester build", *EXTRAS["build"], advice="" if model else copying)
    from fmus.export.compile import WASM, select

    platforms = select(platform or ["host"])
    make_folder(out)
    if model is not None:
        from fmus.export.python.build import SUBFOLDER, build_user
        from fmus.package_files import SUBFOLDERS

        if not model.endswith(".py"):
            raise Problem(
                f"{model}: expected a file such as my_actuator.py; fmus.build(...) builds one of equations, "
                "--crane a machine from the description of a crane (.toml)"
            )
        if parameters is not None:
            raise Problem(f"--parameters {parameters}: expected none with MODEL, which has its own values")
        if WASM in platforms:
            raise Problem(
                f"--platform {WASM}: expected another one with MODEL: a browser has no Python for {model}"
            )
        # in a subfolder, so that no FMU with C code of the same name is overwritten
        for version in versions[fmi]:
            print(build_user(Path(model), out / SUBFOLDERS[version] / SUBFOLDER, platforms, version))
        return
    from fmus.machine.build import harvester
    from orchestrator.base.progress import doing

    description = None
    if crane is not None:
        from fmus.crane.check import checked
        from fmus.crane.machine import crane_build

        description, _ = checked(crane)
    with doing("building FMUs") as line:
        made = crane_build(description, parameters, faults) if description else harvester(parameters, faults)
        _tell(made.write(out, versions[fmi], platforms, only or ("*",), line.update))
    if made.note:
        print(f"note: {made.note}")


def _tell(paths: list[Path]) -> None:
    for path in paths:
        print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")


@command
def crane(
    action: Annotated[Literal["new", "check", "export", "import"], Kind("ACTION", positional=True)],
    file: Annotated[Path, Kind("FILE", positional=True)],
    *,
    drawing: File | None = None,
    out: File | None = None,
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

        target = out or file.with_suffix(".urdf")
        speeds = full_speeds(description, found, ["lumped"])
        write_whole(target, export(description, found, speeds).encode())
        print("\n".join([f"{target}: {len(description.joints)} links", *left_out(description)]))
        return
    loads = capacity(description, found)
    print(table(description, found, loads, full_speeds(description, found)))
    if drawing is not None:
        from fmus.crane.drawing import drawing as drawn
        from orchestrator.pages.plotting import png

        write_whole(drawing, png(drawn(description, loads)))
        print(f"{drawing}: the working range")


MODELICA_NEXT = """\
next, in OpenModelica:
  loadModel(Modelica, {{"4.0.0"}}); loadFile("{package}");"""
MODELICA_EXAMPLE = """\
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
    print(f"{package}\n{MODELICA_NEXT.format(package=package.as_posix())}")
    machines = (f for f in files if f.suffix == ".fmu" and inputs[f].issuperset(LEVERS))
    if machine := next(machines, None):
        print(MODELICA_EXAMPLE.format(block=f"{name}.FMUs.{class_name(machine.stem)}", lever=LEVERS[0]))
