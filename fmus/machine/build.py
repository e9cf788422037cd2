"""Builds the machine: FMUs of its parts, of operator and controller, systems, and the machine in one FMU."""

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
from fmus.machine.one_block import whole
from fmus.machine.parts import ALL, FAMILIES, SUBSYSTEMS
from fmus.machine.poses import NOMINAL, POSES, pose_set
from fmus.machine.ssp import write_control, write_system
from fmus.machine.work_cycle import WORK_CYCLE_STOP
from fmus.manipulator import MANIPULATOR
from fmus.parameters import ParameterSet, read, read_parameter_set, with_parameters
from fmus.swing import SWING
from orchestrator.base.errors import Problem

STEP = 1e-3  # default communication step [s]
SUBFOLDERS = {2: "", 3: "fmi3"}  # of the files by version of FMI
VARIANTS = "variants"  # the folder in it with every variant of every part, as part_variant.fmu


def data(name: str) -> Path:
    """A file of the project's data."""
    path = project_file(f"data/{name}")
    if path is None:
        raise Problem(f"data/{name} is missing, expected beside or inside the package fmus")
    return path


def build_machine(
    folder: Path,
    versions: Sequence[int] = (2,),
    platforms: Sequence[str] | None = None,
    parameters: Path | None = None,
) -> list[Path]:
    """Write all FMUs, of parts, whole, operator and controller, and both systems; their paths.

    versions    of FMI; the files of 2 go to `folder`, those of 3 to fmi3/ in it
    platforms   names of `fmus.export.compile`; by default the one this runs on
    parameters  a set of numbers (`fmus.parameters`) in place of those of the parts
    """
    own, others = numbered_parts(parameters)
    steering = controller_of(own, parameters)
    subs = [*own.values(), steering, whole({name: own[name] for name in SUBSYSTEMS}), *others]
    folders = {fmi: Path(folder) / SUBFOLDERS[fmi] for fmi in versions}
    under = {sub.name: VARIANTS for sub in others}
    paths: list[Path] = []
    for fmi, built in build_all(subs, folders, STEP, WORK_CYCLE_STOP, platforms, under).items():
        fmus = dict(zip((sub.name for sub in subs), built, strict=True))
        usual = [_copied(fmus[part], next(iter(variants))) for part, variants in FAMILIES.items()]
        arm, oil = own[MANIPULATOR.name], own[BOOM_STICK.name]
        systems = (
            write_system(folders[fmi], fmus, STEP, arm),
            write_control(folders[fmi], fmus, STEP, arm, oil),
        )
        paths += [*built, *systems, *usual]
    return paths


def numbered_parts(parameters: Path | None = None) -> tuple[dict[str, Subsystem], list[Subsystem]]:
    """The usual parts by name, and the other variants, all with the numbers of a set if one is given."""
    others = [s for variants in FAMILIES.values() for s in variants.values() if s.name != s.component]
    if parameters is None:
        return dict(ALL), others
    given = read_parameter_set(parameters, [*ALL.values(), CONTROLLER, *others])
    own, new = (pose_set(POSES[NOMINAL], m) for m in (MANIPULATOR, with_parameters(MANIPULATOR, given)))
    start = {n: value for n, value in new.items() if value != own[n]}  # other masses, other holding forces
    usual = {n: with_parameters(sub, given, start) for n, sub in ALL.items()}
    return usual, [with_parameters(sub, given, start) for sub in others]


def controller_of(own: Mapping[str, Subsystem], parameters: Path | None = None) -> Subsystem:
    """The controller of a machine of these parts, with its gains or `controller.NAME` of a set."""
    made = controller(*(own[name] for name in (SWING.name, BOOM_STICK.name, MANIPULATOR.name)))
    if parameters is None:
        return made
    given = read(parameters)["parameters"]
    mine: ParameterSet = {n: v for n, v in given.items() if n in GAINS or n.startswith(f"{made.name}.")}
    return with_parameters(made, mine)


def _copied(fmu: Path, variant: str) -> Path:
    """The FMU of a part once more among the variants; there is the whole file or the one before."""
    path = fmu.parent / VARIANTS / f"{fmu.stem}_{variant}.fmu"
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        copyfile(fmu, part)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return path
