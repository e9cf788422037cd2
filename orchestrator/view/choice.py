"""The choices before a start: the system, the pose, and the variant of each component."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import VARIANTS
from orchestrator.drive.findings import RESET, Finding, findings
from orchestrator.drive.scene import Values, parameters, pose_names
from orchestrator.drive.view_description import ViewDescription, view_description
from orchestrator.realtime.setup import Axis, Setup
from orchestrator.ssp.load import configured, load

USUAL = "usual"  # label of the FMU in the system


@dataclass(frozen=True)
class MachineChoice:
    """The choices of a user.

    swap   component -> name of a variant or path
    pose   name of a parameter set; empty: the pose of the system
    set    start values by name, as for `run`
    fault  inputs that take values at times, as for `run`
    """

    system: Path
    pose: str = ""
    swap: Mapping[str, str] = field(default_factory=dict)
    set: Mapping[str, str] = field(default_factory=dict)
    fault: Mapping[str, str] = field(default_factory=dict)

    def command(self, scenario: str) -> str:
        """The command that repeats a drive whose commands are in this file."""
        pose = ["--pose", self.pose] if self.pose else []
        swaps = [part for name, variant in self.swap.items() for part in ("--swap", f"{name}={variant}")]
        sets = [part for name, value in self.set.items() for part in ("--set", f"{name}={value}")]
        faults = [part for name, value in self.fault.items() for part in ("--fault", f"{name}={value}")]
        begin = ["harvester", "run", str(self.system), "--scenario", scenario]
        return shlex.join([*begin, *pose, *swaps, *sets, *faults])


@dataclass(frozen=True)
class ViewPlan:
    """The setup that follows from a choice, its view description and parameters.

    parameters   of the drawn machine; None if the system does not describe a drawing
    begin        time at the start [s]
    findings     of a diagnosis in the system; an input that forgets them is among the axes
    """

    choice: MachineChoice
    setup: Setup
    description: ViewDescription
    parameters: Values | None
    begin: float = 0.0
    findings: tuple[Finding, ...] = ()


def plan(choice: MachineChoice) -> ViewPlan:
    """Load the chosen system. Raises `Problem` for a choice that does not work."""
    loaded, names = load(choice.system), poses(choice.system) if choice.pose else ()
    if choice.pose and choice.pose not in names:
        hint = suggest(choice.pose, names) or f"; there are {', '.join(names) or 'none'}"
        raise Problem(f"{choice.system}: no pose {choice.pose!r}{hint}")
    sets = (choice.pose,) if choice.pose else ()
    system = configured(loaded, swap=choice.swap, parameters=sets, set=choice.set)
    description = view_description(loaded)
    scene = description.scene
    driven, (found, resets) = description.driven(system), findings(system)
    axes = tuple(Axis(name, a.limit, a.rate, a.rest, a.rest_delay) for name, a in driven.items())
    axes += tuple(Axis(name, limit=1.0, rate=100.0) for name in resets if RESET not in driven)
    watched = (*description.watched(system), *(name for one in found for name in one.signals))
    setup = Setup(
        str(choice.system), axes, tuple(dict.fromkeys(watched)), choice.swap, sets, choice.set, choice.fault
    )
    drawn = parameters(scene, system) if scene else None
    return ViewPlan(choice, setup, description, drawn, loaded.start or 0.0, found)


def poses(system: Path) -> tuple[str, ...]:
    """Names of the parameter sets that set the initial values of the joints."""
    loaded = load(system)
    return pose_names(view_description(loaded).scene, loaded)


def variants(system: Path) -> Mapping[str, list[str]]:
    """Component -> names of its variants next to the system's file, after the FMU in the system itself."""
    folder = system.parent / VARIANTS
    names = sorted(path.stem for path in folder.glob("*.fmu")) if folder.is_dir() else []
    offered = dict[str, list[str]]()
    for component in load(system).components:
        if own := [n.removeprefix(f"{component}_") for n in names if n.startswith(f"{component}_")]:
            offered[component] = [USUAL, *own]
    return offered
