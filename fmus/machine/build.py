"""`harvester build`: FMUs of all parts, operator, controller and whole machine, and the systems (SSP)."""

from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem, quantities
from fmus.controller import CONTROLLER, controller
from fmus.controller.model import GAINS
from fmus.export.build import build_all
from fmus.machine.machine import Machine
from fmus.machine.one_block import composed_machine
from fmus.machine.parts import FAMILIES, FERIC, with_faults
from fmus.machine.poses import NOMINAL, POSES, pose_set
from fmus.machine.ssp import NAME, VIEW, harvester_plans, with_partners, write_systems
from fmus.machine.work_cycle import WORK_CYCLE_STOP
from fmus.manipulator import MANIPULATOR
from fmus.package_files import SUBFOLDERS, data
from fmus.parameters import ParameterSet, not_shipped, read, read_parameter_set, with_parameters
from fmus.swing import SWING
from fmus.valve_actuation import ACTUATION
from orchestrator.base.errors import Problem
from orchestrator.base.files import VARIANTS, tell_once, write_whole
from orchestrator.base.units import doubt

__all__ = ["build_machine", "controller_of", "data", "parts_with_parameters"]

STEP = 1e-3  # default communication step [s]


def build_machine(
    folder: Path,
    versions: Sequence[int] = (2,),
    platforms: Sequence[str] | None = None,
    parameters: Path | None = None,
    only: Sequence[str] = ("*",),
    progress: Callable[[str], None] = lambda _: None,
    faults: bool = False,
) -> list[Path]:
    """Write the FMUs of parts, operator, controller and composed machine, and both systems; their files.

    versions    versions of FMI; FMUs of version 2 go to `folder`, those of version 3 to its sub-folder fmi3
    platforms   names of `fmus.export.compile`; default: the platform of this computer. The composed machine
                in FMI 3.0 always has the WebAssembly module, too: pages need it
    parameters  file of a parameter set (`fmus.parameters`) that replaces values of the parts
    only        patterns of the names of FMUs; systems are written if all of their FMUs are
    progress    called with what is done now
    faults      whether the FMUs have faults as inputs
    """
    machine = with_faults() if faults else FERIC
    parts, others = parts_with_parameters(parameters, machine)
    steering = controller_of(parts, parameters)
    # load-sensing supply, the largest, is the last variant: compiled first, it does not keep one core waiting
    whole = composed_machine({name: parts[name] for name in FERIC.subsystems})
    head = machine.actuation or ACTUATION
    head = with_parameters(head, read(parameters)["parameters"]) if parameters else head
    readers = [sub for sub in (machine.sensors, machine.diagnosis) if sub]
    subs = [*reversed(others), steering, head, *readers, whole, *parts.values()]
    names = [sub.name for sub in subs]
    subs = [with_partners(sub) for sub in subs if any(fnmatchcase(sub.name, pattern) for pattern in only)]
    if not subs:
        raise Problem(f"--only {only[0]}: expected the name of an FMU; there are {', '.join(names)}")
    folders = {fmi: Path(folder) / SUBFOLDERS[fmi] for fmi in versions}
    subfolders = {sub.name: VARIANTS for sub in others}
    paths: list[Path] = []
    plans = harvester_plans(machine, parts[MANIPULATOR.name], parts[BOOM_STICK.name])
    built_fmus = build_all(
        subs, folders, STEP, WORK_CYCLE_STOP, platforms, subfolders, wasm=[NAME], progress=progress
    )
    for fmi, built in built_fmus.items():
        fmus = dict(zip((sub.name for sub in subs), built, strict=True))
        default = [_copied(fmus[part], next(iter(v))) for part, v in FAMILIES.items() if part in fmus]
        files = {VIEW.name: VIEW.read_bytes()}
        paths += [*built, *write_systems(machine, NAME, folders[fmi], fmus, STEP, plans, files), *default]
    return paths


def parts_with_parameters(
    parameters: Path | None = None, machine: Machine = FERIC
) -> tuple[dict[str, Subsystem], list[Subsystem]]:
    """Default parts by name, and all other variants, with the values of a parameter set if given."""
    families, components = machine.families, machine.components
    others = [s for variants in families.values() for s in variants.values() if s.name != s.component]
    if parameters is None:
        return dict(components), others
    parameter_set = read_parameter_set(parameters, [*components.values(), ACTUATION, CONTROLLER, *others])
    old, new = (
        pose_set(POSES[NOMINAL], m) for m in (MANIPULATOR, with_parameters(MANIPULATOR, parameter_set))
    )
    start = {n: value for n, value in new.items() if value != old[n]}  # holding forces depend on masses
    default = {n: with_parameters(sub, parameter_set, start) for n, sub in components.items()}
    others = [with_parameters(sub, parameter_set, start) for sub in others]
    for sub in (*default.values(), *others):
        for n, number in not_shipped(sub).items():
            usual = number.shipped or quantities(sub.parameters)[n].nominal
            if told := doubt(f"{parameters}: {n}", number.value, number.unit, [usual]):
                tell_once(f"warning: {told}")
    return default, others


def controller_of(parts: Mapping[str, Subsystem], parameters: Path | None = None) -> Subsystem:
    """The controller of a machine of these parts, with gains and `controller.NAME` of a parameter set."""
    default = controller(*(parts[name] for name in (SWING.name, BOOM_STICK.name, MANIPULATOR.name)))
    if parameters is None:
        return default
    values = read(parameters)["parameters"]
    prefix = f"{default.name}."
    own: ParameterSet = {n: v for n, v in values.items() if n in GAINS or n.startswith(prefix)}
    return with_parameters(default, own)


def _copied(fmu: Path, variant: str) -> Path:
    """Copy the FMU of a part to the folder of variants."""
    path = fmu.parent / VARIANTS / f"{fmu.stem}_{variant}.fmu"
    write_whole(path, fmu.read_bytes())
    return path
