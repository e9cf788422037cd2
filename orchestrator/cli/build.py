"""`harvester build`: build the FMUs of the machine, or one FMU whose code is Python."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from orchestrator.base.errors import Problem
from orchestrator.base.extras import EXTRAS, require
from orchestrator.base.options import Kind, Patterns
from orchestrator.cli.options import BUILD, File, Folder, command


@command
def build(
    model: Annotated[str | None, Kind("MODEL", positional=True)] = None,
    out: Folder = BUILD,
    fmi: Annotated[str, Kind("VERSION")] = "both",
    platform: Annotated[list[str] | None, Kind("NAME")] = None,
    parameters: File | None = None,
    only: Patterns = None,
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
    from orchestrator.base.files import make_folder

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
