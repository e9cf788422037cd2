"""Builds the machine and its operator: FMUs and the system that connects them, `harvester.ssp`."""

from __future__ import annotations

from pathlib import Path

from fmus.contract import ModelError
from fmus.export.build import build_all
from fmus.export.ssp import write_ssp
from fmus.machine import ALL, COMMAND_WIRES, CONNECTIONS
from fmus.scenarios import WORK_CYCLE_STOP

STEP = 1e-3  # default communication step [s]


def data(name: str) -> Path:
    """A file of the project's data: beside the packages in a checkout, inside the package when installed."""
    package = Path(__file__).parent
    for folder in (package.parent / "data", package / "data"):
        if (folder / name).is_file():
            return folder / name
    raise ModelError(f"data/{name} is missing, expected beside or inside the package fmus")


def build_machine(folder: Path) -> list[Path]:
    """Write the FMUs of the machine and its operator and harvester.ssp, which connects them; their paths."""
    fmus = dict(zip(ALL, build_all(list(ALL.values()), {2: folder}, STEP, WORK_CYCLE_STOP)[2], strict=True))
    # some tools initialise in the order of the file: the manipulator's holding forces come first
    ordered = {name: fmus[name] for name in ("manipulator", "boom_stick", "swing", "operator")}
    path = Path(folder) / "harvester.ssp"
    write_ssp(path, "harvester", ordered, CONNECTIONS + COMMAND_WIRES, stop=WORK_CYCLE_STOP, step=STEP)
    return [*fmus.values(), path]
