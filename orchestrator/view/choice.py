"""What the user may choose before a start: the system, the pose, the fidelity of each part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from orchestrator.base.errors import Problem, suggest
from orchestrator.realtime.setup import Setup
from orchestrator.ssp import parameter_sets
from orchestrator.ssp.load import load
from orchestrator.ssp.swap import with_swaps
from orchestrator.view.scene.pose import Geometry, Start, geometry, start
from orchestrator.view.view_description import ViewDescription, view_description

USUAL = "usual"  # the FMU that the system brings
VARIANTS = "variants"  # folder beside the system's file


@dataclass(frozen=True)
class MachineChoice:
    """What a user wants.

    swap   component -> name of a variant or path
    pose   name of a parameter set, empty: the system's
    set    start values by name, as of `run`
    """

    system: Path
    pose: str = ""
    swap: Mapping[str, str] = field(default_factory=dict)
    set: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ViewPlan:
    """A choice, worked out: what runs, how it is shown, how large it is, where it begins.

    geometry   None where the system does not describe a drawing
    """

    choice: MachineChoice
    setup: Setup
    description: ViewDescription
    geometry: Geometry | None
    start: Start


def plan(choice: MachineChoice) -> ViewPlan:
    """What a choice means; Problem for one that does not work."""
    loaded = load(choice.system)
    if choice.pose and choice.pose not in poses(choice.system):
        known = poses(choice.system)
        near = suggest(choice.pose, known) or f"; there are {', '.join(known) or 'none'}"
        raise Problem(f"{choice.system}: no pose {choice.pose!r}{near}")
    system = with_swaps(loaded, choice.swap)
    posed = parameter_sets.with_sets(system, [choice.pose] if choice.pose else []).with_start(choice.set)
    description = view_description(loaded)
    scene = description.scene
    setup = Setup(
        system=str(choice.system),
        axes=description.driven(system),
        signals=description.watched(system),
        swap=dict(choice.swap),
        parameters=(choice.pose,) if choice.pose else (),
        set=dict(choice.set),
    )
    sizes = geometry(posed) if scene else None
    return ViewPlan(choice, setup, description, sizes, start(posed, scene.initial if scene else ()))


def poses(system: Path) -> tuple[str, ...]:
    """The parameter sets of a system that tell where its joints begin."""
    loaded = load(system)
    scene = view_description(loaded).scene
    angles = [name.encode() for name in scene.initial] if scene else []
    texts = {name: file.read() for name, file in parameter_sets.names(loaded).items()}
    return tuple(name for name, text in texts.items() if angles and all(angle in text for angle in angles))


def variants(system: Path) -> Mapping[str, Mapping[str, str]]:
    """Component -> name -> text of the variants beside the system's file; only where there is a choice.

    The system's own FMU comes first; where it is one of the variants, it has the name of that one.
    """
    folder = system.parent / VARIANTS
    names = sorted(path.stem for path in folder.glob("*.fmu")) if folder.is_dir() else []
    found = dict[str, Mapping[str, str]]()
    loaded = load(system)
    for component, brought in loaded.components.items():
        own = [n.removeprefix(f"{component}_") for n in names if n.startswith(f"{component}_")]
        if own:
            machines = {n: with_swaps(loaded, {component: n}) for n in own}
            guids = {n: machine.components[component].interface.guid for n, machine in machines.items()}
            same = next((n for n in own if guids[n] == brought.interface.guid), "")
            others = {n: n for n in own if n != same}
            found[component] = {USUAL: f"{same} ({USUAL})" if same else USUAL, **others}
    return found
