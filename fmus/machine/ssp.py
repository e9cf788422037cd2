"""Systems of a machine as SSP files, those of the harvester, and which ports of its FMUs belong together.

harvester.ssp            machine, supply and operator; parameter sets: poses, programs, `winter_oil`
harvester_actuation.ssp  the same with the electrical actuation of the valves
harvester_sensors.ssp    as harvester_control.ssp, the controller behind sensors; only with faults
harvester_control.ssp    machine, supply, actuation and controller; parameter sets: poses, starts of paths,
                         `compensated`: section flows that the controller needs with compensated drives,
                         `winter_oil`
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from fmus.contract import Subsystem, quantities
from fmus.machine.machine import Connections, Machine
from fmus.machine.parts import DRIVES, FERIC
from fmus.machine.poses import NOMINAL, POSES, controlled_poses, controller_set, pose_set
from fmus.machine.work_cycle import DEFAULT, PROGRAMS, WORK_CYCLE_STOP, program
from fmus.manipulator import MANIPULATOR
from fmus.operator_input.model import OPERATOR
from fmus.parameters import values
from fmus.supply import SUPPLY
from orchestrator.ssp.load import assemble
from orchestrator.ssp.write import write_ssp

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


NAME = "harvester"
ACTUATED, CONTROLLED, SENSED = "_actuation", "_control", "_sensors"  # ends of the names of systems
VIEW = Path(__file__).parent / NAME / "view.toml"  # displays and controls of `harvester view`
COMPENSATED = "compensated"  # variant of the drives, parameter set of the controller
CONTROL_STOP = 20.0  # s
WINTER, WINTER_GRADE = "winter_oil", {"oil_viscosity_40": 46e-6, "oil_viscosity_100": 8.2e-6}  # HVLP 46, m2/s


@dataclass(frozen=True)
class SystemPlan:
    """What the systems of a kind are besides their components: stop time [s], parameter sets, those bound."""

    stop: float
    sets: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    bound: tuple[str, ...] = ()


def systems(machine: Machine) -> Iterator[tuple[str, tuple[Subsystem, ...], Connections]]:
    """End of the name, what gives the commands or reads, and its connections.

    Those with the operator have no inputs: Ecos and libcosim reject them, and FMPy delays them by one step.
    The machine with the controller is at rest without inputs.
    """
    operator, controller, head = machine.operator, machine.controller, machine.actuation
    if operator:
        yield "", (operator,), machine.operator_wires
    if operator and head:
        yield ACTUATED, (head, operator), machine.actuated(machine.operator_wires, operator)
    if controller and head:
        wires = machine.actuated(machine.controller_wires, controller)
        yield CONTROLLED, (head, controller), wires
        if machine.sensors and machine.diagnosis:
            drivers = (machine.sensors, head, controller, machine.diagnosis)
            yield SENSED, drivers, machine.sensed(wires)


def write_systems(
    machine: Machine,
    name: str,
    folder: Path,
    fmus: Mapping[str, Path],
    step: float,
    plans: Mapping[str, SystemPlan],
    resources: Mapping[str, bytes],
) -> list[Path]:
    """Write the systems to `folder` of which all components have an FMU.

    fmus        .fmu files by component
    step        communication step [s]
    plans       by the end of the system's name
    resources   files of the systems
    """
    found, parts = list[Path](), [n for n in reversed(machine.subsystems) if n != MANIPULATOR.name]
    for end, subs, wires in systems(machine):
        drivers = [sub.name for sub in subs]
        # some tools initialise in the order of the file: sources of holding forces and pressures are first
        order, plan = (MANIPULATOR.name, *machine.feeding, *parts, *drivers), plans[end]
        if fmus.keys() >= {*order}:
            system = assemble(
                {n: fmus[n] for n in order},
                machine.connections + wires + machine.supply_wires,
                name=f"{name}{end}",
                stop=plan.stop,
                step=step,
                shared=machine.shared,
                common=machine.oil,
            )
            columns = ((*reversed(drivers), *machine.feeding), parts, (MANIPULATOR.name,))
            path = Path(folder) / f"{name}{end}.ssp"
            found.append(write_ssp(system, path, plan.sets, plan.bound, resources=resources, columns=columns))
    return found


def harvester_plans(machine: Machine, manipulator: Subsystem, boom_stick: Subsystem) -> dict[str, SystemPlan]:
    """Of the harvester's systems; poses and start values are calculated for these parts."""
    poses = controlled_poses(manipulator).items()
    own = {name: controller_set(pose, manipulator, boom_stick) for name, pose in poses}
    own |= {WINTER: winter_oil()}
    flows = {COMPENSATED: section_flows(machine, machine.controller)}
    told = {COMPENSATED: section_flows(machine, machine.controller, machine.diagnosis)}
    operated = SystemPlan(WORK_CYCLE_STOP, parameter_sets(manipulator), (NOMINAL, DEFAULT))
    return {
        "": operated,
        ACTUATED: operated,
        CONTROLLED: SystemPlan(CONTROL_STOP, own | flows, (NOMINAL,)),
        SENSED: SystemPlan(CONTROL_STOP, own | told, (NOMINAL,)),
    }


def section_flows(machine: Machine, *readers: Subsystem | None) -> dict[str, float]:
    """Flows of the compensated sections, for the controller and the diagnosis."""
    found, drives = dict[str, float](), [v[COMPENSATED] for v in machine.parts.values() if COMPENSATED in v]
    for sub in filter(None, readers):
        known = quantities(sub.parameters)
        flows = ((n, x) for s in drives for n, x in values(s).p.items() if n in known)
        found |= {f"{sub.name}.{n}": x for n, x in flows if n.endswith("_section_flow")}
    return found


def winter_oil() -> dict[str, float]:
    """Viscosities of a hydraulic oil of index 150, for all parts that contain oil."""
    return {f"{part}.{n}": v for part in (*DRIVES, SUPPLY.name) for n, v in WINTER_GRADE.items()}


def parameter_sets(manipulator: Subsystem = MANIPULATOR) -> dict[str, dict[str, float]]:
    """Parameter sets by name, values by "component.variable": poses, programs of the operator, oil."""
    sets = {name: pose_set(pose, manipulator) for name, pose in POSES.items()}
    for name, moves in PROGRAMS.items():
        sets[name] = {f"{OPERATOR.name}.{p}": value for p, value in program(moves).items()}
    return sets | {WINTER: winter_oil()}


WIRES = tuple(dict.fromkeys((*FERIC.wires, *(wire for *_, wires in systems(FERIC) for wire in wires))))


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
