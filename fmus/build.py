"""Builds the machine: its three FMUs and the system that connects them, `harvester.ssp`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fmus.contract import ModelError
from fmus.export.build import build_all
from fmus.export.ssp import write_ssp
from fmus.machine import CONNECTIONS, INPUTS, SUBSYSTEMS
from fmus.scenarios import WORK_CYCLE_STOP

STEP = 1e-3  # default communication step [s]
SCENARIO = "scenarios/work_cycle.csv"


def data(name: str) -> Path:
    """A file of the project's data: beside the packages in a checkout, inside the package when installed."""
    package = Path(__file__).parent
    for folder in (package.parent / "data", package / "data"):
        if (folder / name).is_file():
            return folder / name
    raise ModelError(f"data/{name} is missing, expected beside or inside the package fmus")


def build_machine(folder: Path) -> list[Path]:
    """Write swing.fmu, boom_stick.fmu, manipulator.fmu and two systems of them; returns the five paths.

    harvester.ssp              with inputs of the system: commands, supply and tank pressure
    harvester_components.ssp   without, for tools that refuse them (Ecos, libcosim)
    """
    fmus = dict(
        zip(SUBSYSTEMS, build_all(list(SUBSYSTEMS.values()), folder, STEP, WORK_CYCLE_STOP), strict=True)
    )
    # some tools initialise in the order of the file: the manipulator's holding forces come first
    ordered = {name: fmus[name] for name in ("manipulator", "boom_stick", "swing")}
    systems = []
    for name, inputs in (("harvester", INPUTS), ("harvester_components", {})):
        path = Path(folder) / f"{name}.ssp"
        resources = {Path(SCENARIO).name: scenario(inputs)}
        write_ssp(path, "harvester", ordered, CONNECTIONS, inputs, None, WORK_CYCLE_STOP, resources, STEP)
        systems.append(path)
    return [*fmus.values(), *systems]


def scenario(inputs: Mapping[str, Sequence[str]]) -> bytes:
    """The work cycle for a system with these inputs; a column it lacks names the component's."""
    header, rows = data(SCENARIO).read_text(encoding="utf-8").split("\n", 1)
    columns = [name if name == "time" or name in inputs else INPUTS[name][0] for name in header.split(",")]
    return f"{','.join(columns)}\n{rows}".encode()
