"""A crane as a machine: manipulator, drives by part, a supply, an operator with a lever for each drive.

The hydraulics are those of the paper's machine (`fmus.drives`, `fmus.supply`), one axis for each driven joint
with a valve of its own. Numbers that the description does not have are those of the paper's boom and swing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from fmus import boom_stick, ports, swing
from fmus.composition import compose
from fmus.contract import Quantity, Subsystem, family, make_group, quantities
from fmus.controller.paths import Pose
from fmus.crane.check import outputs_at_start
from fmus.crane.controller import controlled, controller, start_pose
from fmus.crane.description import CraneDescription, JointDescription, read
from fmus.crane.manipulator import NAME, manipulator
from fmus.crane.view import page_files
from fmus.drives import cylinder, motor
from fmus.drives.cylinder import CYLINDER
from fmus.drives.drive import Axis, Fidelity, part
from fmus.drives.lumped import LUMPED
from fmus.drives.motor import MOTOR
from fmus.drives.quasistatic import QUASISTATIC
from fmus.export.build import build_all
from fmus.machine.machine import Connections, Machine
from fmus.machine.path_following import TrackedMachine
from fmus.operator_input.model import OperatorOutputs, operator
from fmus.package_files import SUBFOLDERS
from fmus.parameters import Number, numbers
from fmus.supply import supply
from fmus.valve_actuation import actuation
from orchestrator.base.errors import Problem
from orchestrator.base.files import VARIANTS
from orchestrator.ssp.load import assemble
from orchestrator.ssp.system import System
from orchestrator.ssp.write import write_ssp

FIDELITIES: Mapping[str, tuple[Fidelity, str, str]] = {
    "lumped": (
        LUMPED,
        "spool valves, hoses, cylinders and motors",
        "below the first mode of the longest hose",
    ),
    "quasistatic": (QUASISTATIC, "without line dynamics", "motions below about 10 Hz"),
}
RENAMED = {"line_length": "hose_length", "line_bore": "hose_bore"}  # lines of a motor
STEP, STOP = 1e-3, 20.0  # communication step and stop time of the system [s]
FIRST, APART = 1.0, 2.5  # s: begin of the first stroke of the program, and between two joints
STROKE = {"command": 3.0, "rise": 0.5, "hold": 0.5, "fall": 0.5}  # V, s; the next one goes back
HELD = 1e6  # s, for which a payload of the description is held
SOURCE = "crane.toml"  # the description, in the resources of a system
TOTALS = ("supply_flow", "return_flow", "stored_energy", "dissipated_power")


def crane_machine(crane: CraneDescription) -> Machine:
    """The machine of a description."""
    parts = {NAME: {"rigid": manipulator(crane)}}
    names, pose = list(dict.fromkeys(j.part for j in crane.driven)), outputs_at_start(parts[NAME]["rigid"])
    for name in names:
        joints = [j for j in crane.driven if j.part == name]
        made = {v: _drives(crane, name, joints, pose, *f) for v, f in FIDELITIES.items()}
        parts = {name: family(name, **made), **parts}
    supplies = {v: _with(sub, crane.numbers["supply"]) for v, sub in supply(names).items()}
    machine = Machine(parts=parts, supplies={"supply": supplies}, operator=_operator(crane))
    try:
        levers = {
            j.name: ("turns left" if j.drive == "motor" else "extends the rod", j.part)
            for j in controlled(crane)
        }
    except Problem:
        return machine  # an arm that its controller does not know; `build_crane` tells why
    return replace(machine, controller=controller(crane, machine), actuation=actuation(levers))


def _with(sub: Subsystem, own: Mapping[str, Number]) -> Subsystem:
    """The subsystem with these values of its parameters, as far as it has them."""
    tables = numbers(sub)
    found = {n: own.get(n, number) for n, number in tables["parameters"].items()}
    return replace(sub, numbers={**tables, "parameters": found})


def _drives(
    crane: CraneDescription,
    name: str,
    joints: Sequence[JointDescription],
    pose: Mapping[str, float],
    fidelity: Fidelity,
    text: str,
    validity: str,
) -> Subsystem:
    """The hydraulics of some joints."""
    axes = [
        Axis(j.name, MOTOR, motor.Inputs, own_valve=True)
        if j.drive == "motor"
        else Axis(j.name, CYLINDER, cylinder.Inputs, own_valve=True)
        for j in joints
    ]
    of = ", ".join(j.name for j in joints)
    sub = part(name, axes, fidelity, text=f"Hydraulic drives of {of}: {text}", validity=validity)
    variant = next(v for v, f in FIDELITIES.items() if f[0] is fidelity)
    shipped = {
        s.name: numbers(s)["parameters"] for s in (boom_stick.VARIANTS[variant], swing.VARIANTS[variant])
    }
    hydraulic, rotary = shipped.values()
    found = dict[str, Number]()
    for full in quantities(sub.parameters):
        joint = next((j for j in joints if full.startswith(f"{j.name}_")), None)
        if joint is None:
            found[full] = crane.numbers["oil"].get(full) or hydraulic.get(full) or rotary[full]
            continue
        short = full.removeprefix(f"{joint.name}_")
        own = joint.numbers.get(RENAMED.get(short, short))
        known = (rotary, short), (rotary, f"swing_{short}"), (hydraulic, f"boom_{short}"), (hydraulic, short)
        found[full] = own or next(table[n] for table, n in known if n in table)
    # of an FMU alone, whose inputs are not connected: the start pose, the pressure of the supply, warm oil
    start = {"supply_pressure": crane.numbers["supply"]["pressure_setting"]}
    start["oil_temperature"] = numbers(boom_stick.BOOM_STICK)["start"]["oil_temperature"]
    for n, x in quantities(sub.inputs).items():
        if pose.get(n):
            start[n] = Number(pose[n], x.unit, "derived", "of the manipulator at the start")
    return replace(sub, numbers={"parameters": found, "start": start})


def _operator(crane: CraneDescription) -> Subsystem:
    """Each lever in turn, to and fro."""
    levers = tuple(j.name for j in crane.driven)
    members = {f"{n}_command": Quantity("V", f"Command to the {n} valve", 10.0) for n in levers}
    members |= {f"{n}_command_rate": ports.rate_output(f"{n}_command", "V/s", 10.0) for n in levers}
    members["payload_mass"] = quantities(OperatorOutputs)["payload_mass"]
    made = operator(levers, make_group("Outputs", members))
    values = dict.fromkeys(quantities(made.parameters), 0.0)
    for k, lever in enumerate(levers):
        for number, sign in ((1, 1.0), (2, -1.0)):
            start = FIRST + APART * (2 * k + number - 1)
            own = {**STROKE, "command": sign * STROKE["command"], "start": start}
            values |= {f"{lever}_{number}_{n}": value for n, value in own.items()}
    values |= {"payload_1_mass": crane.numbers["payload"]["payload_mass"].value, "payload_1_hold": HELD}
    declared = quantities(made.parameters)
    found = {n: Number(x, declared[n].unit, "assumed", "program of a crane") for n, x in values.items()}
    return replace(made, numbers={"parameters": found, "start": {}})


def one_block(crane: CraneDescription, machine: Machine) -> Subsystem:
    """The machine as one FMU."""
    hidden = [source for source, _ in machine.rates + machine.holding if not source.endswith("acceleration")]
    hidden += [f"{n}.{n}_load_pressure_rate" for n in machine.subsystems if n != NAME]
    return compose(
        name=crane.file.stem,
        text=f"Crane as one block: {crane.title}",
        subsystems=machine.subsystems,
        connections=machine.connections,
        inputs=machine.inputs,
        hidden=hidden,
        totals=TOTALS,
        terminals=(
            *(ports.lever(j.name) for j in crane.driven),
            *(ports.grip(), ports.supply_line(), ports.return_line()),
        ),
    )


def build_crane(
    crane: CraneDescription,
    folder: Path,
    versions: Sequence[int] = (2,),
    platforms: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Write the FMUs of all parts and variants, the machine as one FMU, and its system (SSP); their files."""
    machine = crane_machine(crane)
    others = [s for v in machine.families.values() for s in v.values() if s.name != s.component]
    driver = (machine.controller, machine.actuation)
    subs = [*others, one_block(crane, machine), *machine.components.values(), *filter(None, driver)]
    folders = {fmi: folder / SUBFOLDERS[fmi] for fmi in versions}
    built = build_all(
        subs, folders, STEP, STOP, platforms, {s.name: VARIANTS for s in others}, progress=progress
    )
    paths = list[Path]()
    for fmi, files in built.items():
        fmus = dict(zip((s.name for s in subs), files, strict=True))
        files_of = {**page_files(crane), SOURCE: crane.file.read_bytes()}
        paths += files
        for name, drivers, wires in _systems(crane, machine):
            system = assemble(
                {n: fmus[n] for n in (*_order(machine), *drivers)},
                machine.connections + wires + machine.supply_wires,
                name=name,
                stop=STOP,
                step=STEP,
            )
            paths.append(write_ssp(system, folders[fmi] / f"{name}.ssp", resources=files_of))
    return paths


def _systems(crane: CraneDescription, machine: Machine) -> Iterator[tuple[str, tuple[str, ...], Connections]]:
    """Name, what gives the commands, and its connections: with the operator, with the controller."""
    if machine.operator:
        yield crane.file.stem, (machine.operator.name,), machine.operator_wires
    if machine.controller and machine.actuation:
        wires = machine.actuated(machine.controller_wires, machine.controller)
        yield f"{crane.file.stem}_control", (machine.actuation.name, machine.controller.name), wires


def tracked(system: System, names: TrackedMachine) -> tuple[TrackedMachine, Pose] | None:
    """Names and start poses of a crane that follows paths; None: the system is not one of a crane.

    names   of the harvester
    """
    if (file := system.resources.get(SOURCE)) is None:
        return None
    crane = read(Path(str(file)), file.read())
    controlled(crane)  # tells why the machine has no controller
    tip = ("crane_tip_radius", "crane_tip_height", crane.joints[0].coordinate)
    own = replace(names, alone="drives=lumped", tip=tuple(f"{NAME}.{n}" for n in tip))
    return own, partial(start_pose, controller(crane, crane_machine(crane)))


def _order(machine: Machine) -> Iterator[str]:
    """Sources of holding forces and of pressures first: some tools initialise in the order of the file."""
    yield NAME
    yield from machine.feeding
    yield from (n for n in machine.subsystems if n != NAME)
