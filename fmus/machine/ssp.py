"""Systems of the machine as SSP files, with poses and programs as parameter sets.

harvester.ssp           machine, supply and operator; parameter sets: poses, programs
harvester_control.ssp   machine, supply and controller; parameter sets: poses, starts of paths, and
                        `compensated`, the section flows that the controller needs with compensated drives
"""

from collections.abc import Mapping
from pathlib import Path

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem
from fmus.controller import CONTROLLER
from fmus.machine.parts import (
    COMMAND_WIRES,
    CONNECTIONS,
    CONTROL_WIRES,
    DRIVES,
    FAMILIES,
    SHARED,
    SUPPLY_WIRES,
)
from fmus.machine.poses import NOMINAL, POSES, controlled_poses, controller_set, pose_set
from fmus.machine.work_cycle import DEFAULT, PROGRAMS, WORK_CYCLE_STOP, program
from fmus.manipulator import MANIPULATOR
from fmus.operator_input.model import OPERATOR
from fmus.parameters import values
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

NAME, CONTROL = "harvester", "harvester_control"
VIEW = Path(__file__).parent / NAME / "view.toml"  # displays and controls of `harvester view`
COMPENSATED = "compensated"  # variant of the drives, parameter set of the controller
CONTROL_STOP = 20.0  # s
# some tools initialise in the order of the file, so sources of holding forces and supply pressure are first
ORDER = ("manipulator", "supply", "boom_stick", "swing")


def write_system(
    folder: Path, fmus: Mapping[str, Path], step: float, manipulator: Subsystem = MANIPULATOR
) -> Path:
    """Write harvester.ssp to `folder` from the .fmu files by component; `step` is the communication step [s].

    manipulator   manipulator for which the poses are calculated

    The system has no inputs: Ecos and libcosim reject them, and FMPy delays them by one step.
    """
    wires, files = CONNECTIONS + COMMAND_WIRES + SUPPLY_WIRES, {n: fmus[n] for n in (*ORDER, OPERATOR.name)}
    return write_ssp(
        assemble(files, wires, name=NAME, stop=WORK_CYCLE_STOP, step=step, shared=SHARED),
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
    """Write harvester_control.ssp like `write_system`; the machine is at rest without inputs."""
    wires, files = CONNECTIONS + CONTROL_WIRES + SUPPLY_WIRES, {n: fmus[n] for n in (*ORDER, "controller")}
    sets = {
        name: controller_set(pose, manipulator, boom_stick)
        for name, pose in controlled_poses(manipulator).items()
    }
    return write_ssp(
        assemble(files, wires, name=CONTROL, stop=CONTROL_STOP, step=step, shared=SHARED),
        Path(folder) / f"{CONTROL}.ssp",
        sets=sets | {COMPENSATED: section_flows()},
        bound=(NOMINAL,),
        resources={VIEW.name: VIEW.read_bytes()},
        columns=(("controller", "supply"), ("boom_stick", "swing"), ("manipulator",)),
    )


def section_flows() -> dict[str, float]:
    """Flows of the compensated sections, for the controller."""
    drives = (FAMILIES[part][COMPENSATED] for part in DRIVES)
    flows = {n: v for sub in drives for n, v in values(sub).p.items() if n.endswith("_section_flow")}
    return {f"{CONTROLLER.name}.{n}": v for n, v in flows.items()}


def parameter_sets(manipulator: Subsystem = MANIPULATOR) -> dict[str, dict[str, float]]:
    """Parameter sets by name, values by "component.variable": poses, and programs of the operator."""
    sets = {name: pose_set(pose, manipulator) for name, pose in POSES.items()}
    for name, moves in PROGRAMS.items():
        sets[name] = {f"{OPERATOR.name}.{p}": value for p, value in program(moves).items()}
    return sets
