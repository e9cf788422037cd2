"""Systems of the machine as SSP files, and which ports of its FMUs belong together.

harvester.ssp            machine, supply and operator; parameter sets: poses, programs, `winter_oil`
harvester_actuation.ssp  the same with the electrical actuation of the valves
harvester_sensors.ssp    as harvester_control.ssp, the controller behind sensors; only with faults
harvester_control.ssp    machine, supply, actuation and controller; parameter sets: poses, starts of paths,
                         `compensated`: section flows that the controller needs with compensated drives,
                         `winter_oil`
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from fmus.contract import Subsystem, quantities
from fmus.controller import CONTROLLER
from fmus.diagnosis import NAME as DIAGNOSIS
from fmus.machine.machine import Machine
from fmus.machine.parts import DRIVES, FAMILIES, FERIC
from fmus.machine.poses import NOMINAL, POSES, controlled_poses, controller_set, pose_set
from fmus.machine.work_cycle import DEFAULT, PROGRAMS, WORK_CYCLE_STOP, program
from fmus.manipulator import MANIPULATOR
from fmus.operator_input.model import OPERATOR
from fmus.parameters import values
from fmus.sensors import NAME as NAME_OF_SENSORS
from fmus.supply import SUPPLY
from fmus.valve_actuation import ACTUATION
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

ACTUATED = FERIC.actuated(FERIC.operator_wires, OPERATOR)
CONTROLLED = FERIC.actuated(FERIC.controller_wires, CONTROLLER)
WIRES = tuple(dict.fromkeys((*FERIC.wires, *ACTUATED, *CONTROLLED)))
UNPOWERED = (
    "While supply_pressure is 0, no command turns the swing, and each command lets boom or stick sink."
)
HELD = (
    "What held inputs cost, as the error of the worst joint speed over 42 s in Ecos, a Jacobi master: with "
    "rate ports 0.0082 % at a step of 1 ms; without them 0.071 % at 0.1 ms, and at 1 ms the run diverges. "
    "Measured by “python docs/rate_ports.py” in the repository of harvester-cosim."
)
HELD_COMMAND = (
    "What a held command costs with an open rate port, as the error of what moves: 0.34 % if the command is "
    "set every 1 ms, 3.2 % if every 10 ms. Measured by “make matrix” in the repository of harvester-cosim."
)


NAME, ACTUATED_NAME, CONTROL = "harvester", "harvester_actuation", "harvester_control"
VIEW = Path(__file__).parent / NAME / "view.toml"  # displays and controls of `harvester view`
COMPENSATED = "compensated"  # variant of the drives, parameter set of the controller
SENSED = "harvester_sensors"
CONTROL_STOP = 20.0  # s
WINTER, WINTER_GRADE = "winter_oil", {"oil_viscosity_40": 46e-6, "oil_viscosity_100": 8.2e-6}  # HVLP 46, m2/s
# some tools initialise in the order of the file, so sources of holding forces and supply pressure are first
ORDER = ("manipulator", "supply", "boom_stick", "swing")


def write_systems(
    folder: Path,
    fmus: Mapping[str, Path],
    step: float,
    manipulator: Subsystem,
    boom_stick: Subsystem,
    machine: Machine = FERIC,
) -> list[Path]:
    """Write the systems to `folder` whose operator or controller, and actuation, have an FMU.

    fmus                      .fmu files by component
    step                      communication step [s]
    manipulator, boom_stick   for which poses and start values are calculated

    Those with the operator have no inputs: Ecos and libcosim reject them, and FMPy delays them by one step.
    The machine with the controller is at rest without inputs.
    """
    poses = controlled_poses(manipulator).items()
    controlled = {name: controller_set(pose, manipulator, boom_stick) for name, pose in poses}
    own = controlled | {COMPENSATED: section_flows(), WINTER: winter_oil()}
    told = own | {COMPENSATED: section_flows() | section_flows(DIAGNOSIS)}
    operated = parameter_sets(manipulator)
    lever, head = (OPERATOR.name,), ACTUATION.name
    behind = (DIAGNOSIS, CONTROLLER.name, head, NAME_OF_SENSORS)
    systems = (
        (NAME, lever, FERIC.operator_wires, WORK_CYCLE_STOP, operated, (NOMINAL, DEFAULT)),
        (ACTUATED_NAME, (*lever, head), ACTUATED, WORK_CYCLE_STOP, operated, (NOMINAL, DEFAULT)),
        (CONTROL, (CONTROLLER.name, head), CONTROLLED, CONTROL_STOP, own, (NOMINAL,)),
        (SENSED, behind, machine.sensed(CONTROLLED), CONTROL_STOP, told, (NOMINAL,)),
    )
    return [
        write_ssp(
            assemble(
                {n: fmus[n] for n in (*ORDER, *reversed(drivers))},
                FERIC.connections + wires + FERIC.supply_wires,
                name=name,
                stop=stop,
                step=step,
                shared=FERIC.shared,
                common=FERIC.oil,
            ),
            Path(folder) / f"{name}.ssp",
            sets=sets,
            bound=bound,
            resources={VIEW.name: VIEW.read_bytes()},
            columns=((*drivers, "supply"), ("boom_stick", "swing"), ("manipulator",)),
        )
        for name, drivers, wires, stop, sets, bound in systems
        if fmus.keys() >= {*drivers}
    ]


def section_flows(component: str = CONTROLLER.name) -> dict[str, float]:
    """Flows of the compensated sections, for the controller or the diagnosis."""
    drives = (FAMILIES[part][COMPENSATED] for part in DRIVES)
    flows = {n: v for sub in drives for n, v in values(sub).p.items() if n.endswith("_section_flow")}
    return {f"{component}.{n}": v for n, v in flows.items()}


def winter_oil() -> dict[str, float]:
    """Viscosities of a hydraulic oil of index 150, for all parts that contain oil."""
    return {f"{part}.{n}": v for part in (*DRIVES, SUPPLY.name) for n, v in WINTER_GRADE.items()}


def parameter_sets(manipulator: Subsystem = MANIPULATOR) -> dict[str, dict[str, float]]:
    """Parameter sets by name, values by "component.variable": poses, programs of the operator, oil."""
    sets = {name: pose_set(pose, manipulator) for name, pose in POSES.items()}
    for name, moves in PROGRAMS.items():
        sets[name] = {f"{OPERATOR.name}.{p}": value for p, value in program(moves).items()}
    return sets | {WINTER: winter_oil()}


def wired_ports() -> Iterator[tuple[str, str, str, str, str]]:
    """FMU, port, other FMU, its port, the rate port in both; without rates of the same name in both."""
    for start, end in WIRES:
        (source, output), (target, name) = start.split("."), end.split(".")
        rate = FERIC.rate_of.get(name, "")
        wired = (f"{source}.{rate}", f"{target}.{rate}") in WIRES
        if name in FERIC.rate_of or name not in FERIC.rate_of.values() or name != output:
            yield source, output, target, name, rate if wired else ""


def with_partners(sub: Subsystem) -> Subsystem:
    """The subsystem with its connections to other FMUs of the machine."""
    own = FERIC.subsystems if sub.component == NAME else (sub.component,)
    ends: dict[str, tuple[list[str], set[str]]] = {}
    for source, output, target, name, rate in wired_ports():
        for part, port, other, its in ((source, output, target, name), (target, name, source, output)):
            # the supply needs the flow into each drive, which the machine in one FMU does not have
            if part in own and other not in own and (sub.component, other) != (NAME, SUPPLY.name):
                others, rates = ends.setdefault(port, ([], set()))
                others.append(other if its == port else f"{other}.{its}")
                rates.add(rate)
    rows = [(port, tuple(others), max(rates)) for port, (others, rates) in ends.items()]
    held = {**dict.fromkeys(FERIC.subsystems, (HELD,)), NAME: (HELD_COMMAND,)}.get(sub.component, ())
    notes = (UNPOWERED, *held) if held and "supply_pressure" in quantities(sub.inputs) else held
    return replace(sub, connections=tuple(rows), notes=notes)


def connection_list() -> str:
    """All connections of the parts as plain text."""
    return "\n".join(
        f"  {source}.{output} to {target}.{name}{rate and ', rate port '}{rate}"
        for source, output, target, name, rate in wired_ports()
    )
