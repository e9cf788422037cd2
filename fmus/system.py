"""harvester.ssp: the machine, its supply and its levers as connected FMUs, with poses and programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fmus.contract import Subsystem
from fmus.export.ssp import write_ssp
from fmus.levers import LEVERS
from fmus.machine import COMMAND_WIRES, CONNECTIONS, SUPPLY_WIRES
from fmus.manipulator import MANIPULATOR
from fmus.poses import NOMINAL, POSES, pose_set
from fmus.scenarios import DEFAULT, PROGRAMS, WORK_CYCLE_STOP, program

NAME = "harvester"
# some tools initialise in the order of the file: holding forces and supply pressure come first
ORDER = ("manipulator", "supply", "boom_stick", "swing", "levers")
COLUMNS = (("levers", "supply"), ("boom_stick", "swing"), ("manipulator",))
VERSIONS = {2: "1.0", 3: "2.0"}  # of SSP, by the version of FMI


def write_system(
    folder: Path, fmus: Mapping[str, Path], step: float, fmi: int = 2, manipulator: Subsystem = MANIPULATOR
) -> Path:
    """Write harvester.ssp to `folder` from the .fmu files by component; `step` is the communication step [s].

    manipulator   with the numbers that the poses are for

    Without inputs of the system, which Ecos and libcosim refuse and FMPy passes on a step late.
    """
    return write_ssp(
        Path(folder) / f"{NAME}.ssp",
        NAME,
        {name: fmus[name] for name in ORDER},
        CONNECTIONS + COMMAND_WIRES + SUPPLY_WIRES,
        stop=WORK_CYCLE_STOP,
        step=step,
        sets=parameter_sets(manipulator),
        bound=(NOMINAL, DEFAULT),
        columns=COLUMNS,
        version=VERSIONS[fmi],
    )


def parameter_sets(manipulator: Subsystem = MANIPULATOR) -> dict[str, dict[str, float]]:
    """Poses and programs of the levers by name, each with its values by "component.variable"."""
    sets = {name: pose_set(pose, manipulator) for name, pose in POSES.items()}
    for name, moves in PROGRAMS.items():
        sets[name] = {f"{LEVERS.name}.{p}": value for p, value in program(moves).items()}
    return sets
