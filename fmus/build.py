"""Builds the machine: FMUs of its parts and operator, their system `harvester.ssp`, and all in one FMU."""

from __future__ import annotations

from pathlib import Path

from fmus.contract import ModelError
from fmus.export.build import build_all
from fmus.harvester import HARVESTER
from fmus.machine import ALL
from fmus.scenarios import WORK_CYCLE_STOP
from fmus.system import write_system

STEP = 1e-3  # default communication step [s]


def data(name: str) -> Path:
    """A file of the project's data: beside the packages in a checkout, inside the package when installed."""
    package = Path(__file__).parent
    for folder in (package.parent / "data", package / "data"):
        if (folder / name).is_file():
            return folder / name
    raise ModelError(f"data/{name} is missing, expected beside or inside the package fmus")


def build_machine(folder: Path) -> list[Path]:
    """Write the FMUs of the machine, its operator and the whole, and harvester.ssp; their paths."""
    subs = [*ALL.values(), HARVESTER]
    built = build_all(subs, {2: folder}, STEP, WORK_CYCLE_STOP)[2]
    fmus = dict(zip((sub.name for sub in subs), built, strict=True))
    return [*fmus.values(), write_system(folder, fmus, STEP)]
