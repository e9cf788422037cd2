"""The systems of the machine as SSPs, with poses and programs as parameter sets.

harvester.ssp           the machine, its supply and its operator
harvester_control.ssp   the controller in the place of the operator; its sets are poses and starts of paths
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem
from fmus.machine.parts import COMMAND_WIRES, CONNECTIONS, CONTROL_WIRES, SUPPLY_WIRES
from fmus.machine.poses import NOMINAL, POSES, controlled_poses, controller_set, pose_set
from fmus.machine.work_cycle import DEFAULT, PROGRAMS, WORK_CYCLE_STOP, program
from fmus.manipulator import MANIPULATOR
from fmus.operator_input.model import OPERATOR
from orchestrator.ssp.assembly import assemble
from orchestrator.ssp.write import write_ssp

NAME, CONTROL = "harvester", "harvester_control"
VIEW = Path(__file__).parent / NAME / "view.toml"  # what `harvester view` shows and drives
CONTROL_STOP = 20.0  # s
# some tools initialise in the order of the file: holding forces and supply pressure come first
ORDER = ("manipulator", "supply", "boom_stick", "swing")


def write_system(
    folder: Path, fmus: Mapping[str, Path], step: float, manipulator: Subsystem = MANIPULATOR
) -> Path:
    """Write harvester.ssp to `folder` from the .fmu files by component; `step` is the communication step [s].

    manipulator   with the numbers that the poses are for

    Without inputs of the system, which Ecos and libcosim refuse and FMPy passes on a step late.
    """
    wires, files = CONNECTIONS + COMMAND_WIRES + SUPPLY_WIRES, {n: fmus[n] for n in (*ORDER, OPERATOR.name)}
    return write_ssp(
        assemble(files, wires, name=NAME, stop=WORK_CYCLE_STOP, step=step),
        Path(folder) / f"{NAME}.ssp",
        sets=parameter_sets(manipulator),
        bound=(NOMINAL, DEFAULT),
        resources={VIEW.name: VIEW.read_bytes()},
        columns=((OPERATOR.name, "supply"), ("boom_stick", "swing"), ("manipulator",)),
    )


def write_control(
    folder: Path,
    fmus: Mapping[str, Path],
    step: float,
    manipulator: Subsystem = MANIPULATOR,
    boom_stick: Subsystem = BOOM_STICK,
) -> Path:
    """Write harvester_control.ssp, as `write_system`; it stands still until the controller is driven."""
    wires, files = CONNECTIONS + CONTROL_WIRES + SUPPLY_WIRES, {n: fmus[n] for n in (*ORDER, "controller")}
    poses = controlled_poses(manipulator).items()
    return write_ssp(
        assemble(files, wires, name=CONTROL, stop=CONTROL_STOP, step=step),
        Path(folder) / f"{CONTROL}.ssp",
        sets={name: controller_set(pose, manipulator, boom_stick) for name, pose in poses},
        bound=(NOMINAL,),
        resources={VIEW.name: VIEW.read_bytes()},
        columns=(("controller", "supply"), ("boom_stick", "swing"), ("manipulator",)),
    )


def parameter_sets(manipulator: Subsystem = MANIPULATOR) -> dict[str, dict[str, float]]:
    """Poses and programs of the operator by name, each with its values by "component.variable"."""
    sets = {name: pose_set(pose, manipulator) for name, pose in POSES.items()}
    for name, moves in PROGRAMS.items():
        sets[name] = {f"{OPERATOR.name}.{p}": value for p, value in program(moves).items()}
    return sets
