"""`harvester build`: FMUs of all parts, operator, controller and whole machine, and the systems (SSP)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

from fmus.contract import Subsystem, quantities
from fmus.controller import controller
from fmus.export.build import build_all
from fmus.machine.machine import ARM, Machine
from fmus.machine.one_block import harvester_block
from fmus.machine.parts import feric
from fmus.machine.poses import NOMINAL, controlled_poses, controller_set, outputs_at_start, parameter_sets
from fmus.machine.ssp import SystemPlan, with_partners, write_systems
from fmus.operator_input.work_cycle import DEFAULT, WORK_CYCLE_STOP
from fmus.package_files import SUBFOLDERS, data
from fmus.parameters import not_shipped, numbers, read_parameter_set, with_parameters
from orchestrator.base.errors import Problem
from orchestrator.base.files import VARIANTS, tell_once, write_whole
from orchestrator.base.units import doubt

__all__ = ["Build", "data", "harvester", "harvester_machine", "with_values"]

STEP = 1e-3  # default communication step [s]
CONTROL_STOP = 20.0  # s
VIEW = Path(__file__).parent / "harvester" / "view.toml"  # displays and controls of `harvester view`
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


@dataclass(frozen=True)
class Build:
    """A machine, and what is built of it besides its parts.

    whole        the machine in one FMU
    operated     of the systems with the operator; its stop time is that of the FMUs
    controlled   of the systems with the controller
    resources    files of the systems
    notes        a subsystem -> sentences about its connections, for its page
    wasm         whether the machine in one FMU of FMI 3.0 always has the WebAssembly module: pages need it
    note         for the user
    """

    machine: Machine
    whole: Subsystem
    operated: SystemPlan
    controlled: SystemPlan
    resources: Mapping[str, bytes]
    notes: Callable[[Subsystem], tuple[str, ...]] = lambda _: ()
    wasm: bool = False
    note: str = ""

    def write(
        self,
        folder: Path,
        versions: Sequence[int] = (2,),
        platforms: Sequence[str] | None = None,
        only: Sequence[str] = ("*",),
        progress: Callable[[str], None] = lambda _: None,
    ) -> list[Path]:
        """Write the FMUs of all parts, drivers and the whole machine, and the systems; their files.

        versions    versions of FMI; FMUs of version 2 go to `folder`, those of version 3 to its sub-folder
                    fmi3
        platforms   names of `fmus.export.compile`; default: the platform of this computer
        only        patterns of the names of FMUs; systems are written if all of their FMUs are
        progress    called with what is done now
        """
        machine, families = self.machine, self.machine.families
        others = [s for family in families.values() for s in family.values() if s.name != s.component]
        # load-sensing supply, the largest, is the last variant: compiled first, it keeps no core waiting
        subs = [*reversed(others), *machine.drivers, self.whole, *machine.components.values()]
        names = [sub.name for sub in subs]
        subs = [sub for sub in subs if any(fnmatchcase(sub.name, pattern) for pattern in only)]
        if not subs:
            raise Problem(f"--only {only[0]}: expected the name of an FMU; there are {', '.join(names)}")
        subs = [replace(with_partners(machine, sub), notes=self.notes(sub)) for sub in subs]
        folders = {fmi: Path(folder) / SUBFOLDERS[fmi] for fmi in versions}
        built_fmus = build_all(
            subs,
            folders,
            STEP,
            self.operated.stop,
            platforms,
            subfolders={sub.name: VARIANTS for sub in others},
            wasm=[machine.name] if self.wasm else [],
            progress=progress,
        )
        paths = list[Path]()
        for fmi, built in built_fmus.items():
            fmus = dict(zip((sub.name for sub in subs), built, strict=True))
            default = [_copied(fmus[part], next(iter(v))) for part, v in families.items() if part in fmus]
            plans = self.operated, self.controlled
            systems = write_systems(machine, folders[fmi], fmus, STEP, *plans, self.resources)
            paths += [*built, *systems, *default]
        return paths


def harvester_machine(parameters: Path | None = None, faults: bool = False) -> Machine:
    """The harvester with the values of a parameter set; faults: whether its parts have faults as inputs."""
    return with_values(feric(faults), parameters, lambda m: controller(*m.subsystems.values()))


def harvester(parameters: Path | None = None, faults: bool = False) -> Build:
    """What is built of the harvester.

    parameters  file of a parameter set (`fmus.parameters`) that replaces values of the parts
    faults      whether the FMUs have faults as inputs
    """
    machine = harvester_machine(parameters, faults)
    _, boom_stick, arm = machine.subsystems.values()
    own = {name: controller_set(pose, arm, boom_stick) for name, pose in controlled_poses(arm).items()}
    operated = SystemPlan(WORK_CYCLE_STOP, parameter_sets(arm), (NOMINAL, DEFAULT))
    controlled, files = SystemPlan(CONTROL_STOP, own, (NOMINAL,)), {VIEW.name: VIEW.read_bytes()}
    costs = {**dict.fromkeys(machine.subsystems, (HELD,)), machine.name: (HELD_COMMAND,)}

    def notes(sub: Subsystem) -> tuple[str, ...]:
        held = costs.get(sub.component, ())
        return (UNPOWERED, *held) if held and "supply_pressure" in quantities(sub.inputs) else held

    return Build(machine, harvester_block(machine), operated, controlled, files, notes, wasm=True)


def with_values(
    machine: Machine, parameters: Path | None, steering: Callable[[Machine], Subsystem]
) -> Machine:
    """The machine with the values of a parameter set.

    steering   machine -> its controller, which has values of the parts
    """
    if parameters is None:
        return machine
    families = machine.families
    variants = [sub for family in families.values() for sub in family.values()]
    drivers = filter(None, (machine.operator, machine.actuation, machine.controller))
    given = read_parameter_set(parameters, [*variants, *drivers])
    arm = machine.subsystems[ARM]
    old, new = (_held(machine, sub) for sub in (arm, with_parameters(arm, given)))
    start = {n: value for n, value in new.items() if value != old[n]}  # holding forces depend on masses
    made = {p: {v: with_parameters(s, given, start) for v, s in of.items()} for p, of in families.items()}
    for sub in (sub for family in made.values() for sub in family.values()):
        for n, number in not_shipped(sub).items():
            usual = number.shipped or quantities(sub.parameters)[n].nominal
            if told := doubt(f"{parameters}: {n}", number.value, number.unit, [usual]):
                tell_once(f"warning: {told}")
    machine = replace(
        machine,
        parts={part: made[part] for part in machine.parts},
        supplies={part: made[part] for part in machine.supplies},
        operator=machine.operator and with_parameters(machine.operator, given),
        actuation=machine.actuation and with_parameters(machine.actuation, given),
    )
    if machine.controller is None:
        return machine
    default, known = steering(machine), {n for sub in variants for n in quantities(sub.parameters)}
    own = {n: x for n, x in given.items() if n not in known}  # the controller has the others from the parts
    return replace(machine, controller=with_parameters(default, own))


def _held(machine: Machine, arm: Subsystem) -> dict[str, float]:
    """Start values of connected inputs by `component.variable`: the manipulator is held in its start pose."""
    y, found = outputs_at_start(arm), dict[str, float]()
    for wire in machine.connections:
        part, _, name = wire[0].partition(".")
        if part == ARM and wire not in machine.rates:
            found[wire[1]] = y[name]
    return found | {f"{ARM}.{n}": y[n.replace("force", "holding_force")] for n in numbers(arm)["start"]}


def _copied(fmu: Path, variant: str) -> Path:
    """Copy the FMU of a part to the folder of variants."""
    path = fmu.parent / VARIANTS / f"{fmu.stem}_{variant}.fmu"
    write_whole(path, fmu.read_bytes())
    return path
