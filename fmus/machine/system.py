"""harvester.ssp: the machine, its supply and its operator as connected FMUs, with poses and programs.

harvester_control.ssp: the controller in the place of the operator, with poses and starts of paths.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem
from fmus.export.ssp import write_ssp
from fmus.machine.parts import COMMAND_WIRES, CONNECTIONS, CONTROL_WIRES, SUPPLY_WIRES
from fmus.machine.poses import NOMINAL, POSES, controlled_poses, controller_set, pose_set
from fmus.machine.scenarios import DEFAULT, PROGRAMS, WORK_CYCLE_STOP, program
from fmus.manipulator import MANIPULATOR
from fmus.operator.model import OPERATOR

NAME = "harvester"
# some tools initialise in the order of the file: holding forces and supply pressure come first
ORDER = ("manipulator", "supply", "boom_stick", "swing", "operator")
COLUMNS = (("operator", "supply"), ("boom_stick", "swing"), ("manipulator",))
CONTROL = "harvester_control"
CONTROL_STOP = 20.0  # s
CONTROL_ORDER = (*ORDER[:-1], "controller")
CONTROL_COLUMNS = (("controller", "supply"), *COLUMNS[1:])
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


def write_control(
    folder: Path,
    fmus: Mapping[str, Path],
    step: float,
    fmi: int = 2,
    manipulator: Subsystem = MANIPULATOR,
    boom_stick: Subsystem = BOOM_STICK,
) -> Path:
    """Write harvester_control.ssp, as `write_system`; it stands until the controller is driven."""
    return write_ssp(
        Path(folder) / f"{CONTROL}.ssp",
        CONTROL,
        {name: fmus[name] for name in CONTROL_ORDER},
        CONNECTIONS + CONTROL_WIRES + SUPPLY_WIRES,
        stop=CONTROL_STOP,
        step=step,
        sets={
            name: controller_set(pose, manipulator, boom_stick)
            for name, pose in controlled_poses(manipulator).items()
        },
        bound=(NOMINAL,),
        columns=CONTROL_COLUMNS,
        version=VERSIONS[fmi],
    )


def parameter_sets(manipulator: Subsystem = MANIPULATOR) -> dict[str, dict[str, float]]:
    """Poses and programs of the operator by name, each with its values by "component.variable"."""
    sets = {name: pose_set(pose, manipulator) for name, pose in POSES.items()}
    for name, moves in PROGRAMS.items():
        sets[name] = {f"{OPERATOR.name}.{p}": value for p, value in program(moves).items()}
    return sets
