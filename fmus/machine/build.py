"""`harvester build`: FMUs of all parts, operator, controller and whole machine, and the systems (SSP)."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from shutil import copyfile

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem
from fmus.controller import CONTROLLER, controller
from fmus.controller.values import GAINS
from fmus.export.build import build_all
from fmus.export.documentation import project_file
from fmus.machine.one_block import composed_machine
from fmus.machine.parts import ALL, FAMILIES, SUBSYSTEMS
from fmus.machine.poses import NOMINAL, POSES, pose_set
from fmus.machine.ssp import NAME, write_control, write_system
from fmus.machine.work_cycle import WORK_CYCLE_STOP
from fmus.manipulator import MANIPULATOR
from fmus.parameters import ParameterSet, read, read_parameter_set, with_parameters
from fmus.swing import SWING
from orchestrator.base.errors import Problem

STEP = 1e-3  # default communication step [s]
SUBFOLDERS = {2: "", 3: "fmi3"}  # version of FMI -> folder of the FMUs
VARIANTS = "variants"  # sub-folder with every variant of every part, as part_variant.fmu


def data(name: str) -> Path:
    """A file in the folder data of the project."""
    path = project_file(f"data/{name}")
    if path is None:
        raise Problem(f"data/{name} is missing, expected next to or inside the package fmus")
    return path


def build_machine(
    folder: Path,
    versions: Sequence[int] = (2,),
    platforms: Sequence[str] | None = None,
    parameters: Path | None = None,
) -> list[Path]:
    """Write the FMUs of parts, operator, controller and composed machine, and both systems; their files.

    versions    versions of FMI; FMUs of version 2 go to `folder`, those of version 3 to its sub-folder fmi3
    platforms   names of `fmus.export.compile`; default: the platform of this computer. The composed machine
                in FMI 3.0 always has the WebAssembly module, too: pages need it
    parameters  file of a parameter set (`fmus.parameters`) that replaces values of the parts
    """
    parts, others = parts_with_parameters(parameters)
    steering = controller_of(parts, parameters)
    subs = [*parts.values(), steering, composed_machine({name: parts[name] for name in SUBSYSTEMS}), *others]
    folders = {fmi: Path(folder) / SUBFOLDERS[fmi] for fmi in versions}
    subfolders = {sub.name: VARIANTS for sub in others}
    paths: list[Path] = []
    for fmi, built in build_all(
        subs, folders, STEP, WORK_CYCLE_STOP, platforms, subfolders, wasm=[NAME]
    ).items():
        fmus = dict(zip((sub.name for sub in subs), built, strict=True))
        default = [_copied(fmus[part], next(iter(variants))) for part, variants in FAMILIES.items()]
        manipulator, boom_stick = parts[MANIPULATOR.name], parts[BOOM_STICK.name]
        systems = (
            write_system(folders[fmi], fmus, STEP, manipulator),
            write_control(folders[fmi], fmus, STEP, manipulator, boom_stick),
        )
        paths += [*built, *systems, *default]
    return paths


def parts_with_parameters(parameters: Path | None = None) -> tuple[dict[str, Subsystem], list[Subsystem]]:
    """Default parts by name, and all other variants, with the values of a parameter set if given."""
    others = [s for variants in FAMILIES.values() for s in variants.values() if s.name != s.component]
    if parameters is None:
        return dict(ALL), others
    parameter_set = read_parameter_set(parameters, [*ALL.values(), CONTROLLER, *others])
    old, new = (
        pose_set(POSES[NOMINAL], m) for m in (MANIPULATOR, with_parameters(MANIPULATOR, parameter_set))
    )
    start = {n: value for n, value in new.items() if value != old[n]}  # holding forces depend on masses
    default = {n: with_parameters(sub, parameter_set, start) for n, sub in ALL.items()}
    return default, [with_parameters(sub, parameter_set, start) for sub in others]


def controller_of(parts: Mapping[str, Subsystem], parameters: Path | None = None) -> Subsystem:
    """The controller of a machine of these parts, with gains and `controller.NAME` of a parameter set."""
    default = controller(*(parts[name] for name in (SWING.name, BOOM_STICK.name, MANIPULATOR.name)))
    if parameters is None:
        return default
    values = read(parameters)["parameters"]
    prefix = f"{default.name}."
    own: ParameterSet = {n: v for n, v in values.items() if n in GAINS or n.startswith(prefix)}
    return with_parameters(default, own)


def _copied(fmu: Path, variant: str) -> Path:
    """Copy the FMU of a part to the folder of variants; replaces an existing file in one step."""
    path = fmu.parent / VARIANTS / f"{fmu.stem}_{variant}.fmu"
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        copyfile(fmu, temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return path
