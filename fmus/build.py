"""Builds the machine: FMUs of its parts and levers, their system `harvester.ssp`, and all in one FMU."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fmus.contract import ModelError
from fmus.export.build import build_all
from fmus.files import shipped
from fmus.harvester import HARVESTER
from fmus.machine import ALL
from fmus.scenarios import WORK_CYCLE_STOP
from fmus.system import write_system

STEP = 1e-3  # default communication step [s]
SUBFOLDERS = {2: "", 3: "fmi3"}  # of the files by version of FMI


def data(name: str) -> Path:
    """A file of the project's data."""
    path = shipped(f"data/{name}")
    if path is None:
        raise ModelError(f"data/{name} is missing, expected beside or inside the package fmus")
    return path


def build_machine(
    folder: Path, versions: Sequence[int] = (2,), platforms: Sequence[str] | None = None
) -> list[Path]:
    """Write the FMUs of the machine, its levers and the whole, and harvester.ssp; their paths.

    versions    of FMI; the files of 2 go to `folder`, those of 3 to fmi3/ in it
    platforms   names of `fmus.export.platforms`; by default the one this runs on
    """
    subs = [*ALL.values(), HARVESTER]
    folders = {fmi: Path(folder) / SUBFOLDERS[fmi] for fmi in versions}
    paths: list[Path] = []
    for fmi, built in build_all(subs, folders, STEP, WORK_CYCLE_STOP, platforms).items():
        fmus = dict(zip((sub.name for sub in subs), built, strict=True))
        paths += [*built, write_system(folders[fmi], fmus, STEP, fmi)]
    return paths
