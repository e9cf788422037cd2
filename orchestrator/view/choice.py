"""What the user may choose before a start: the system, the pose, the fidelity of each part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from orchestrator.base.errors import Problem, suggest
from orchestrator.realtime.setup import Axis, Setup
from orchestrator.ssp import parameter_sets
from orchestrator.ssp.load import load
from orchestrator.ssp.swap import with_swaps
from orchestrator.ssp.system import System
from orchestrator.view.scene.pose import Geometry, Start, geometry, start
from orchestrator.view.signals import watched

USUAL = "usual"  # the FMU that the system brings
VARIANTS = "variants"  # folder beside the system's file
VOLTS = 10.0  # V
# V/s, ramps of the amplifier: a lever that is let go stops even the arm that is stretched out with less than
# the supply's pressure (docs/controls.md); the swing takes longest, as its valve brakes the whole arm
VOLTS_RATES = {"swing": 3.0, "boom": 10.0, "stick": 10.0}
TIP, TIP_RATE = 1.2, 2.5  # m/s, m/s2: wanted velocity of the tip
TURN, TURN_RATE = 0.6, 0.6  # rad/s, rad/s2
SWITCH_RATE = 1e3  # 1/s: from off to on within a frame
BRAKING = 3.0  # s: the controller brakes what it moves, by ramps of 1 s at most, and what swings after that
VELOCITIES = (("radial_velocity", TIP, TIP_RATE), ("vertical_velocity", TIP, TIP_RATE))


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
    """A choice, worked out: what runs, how large it is, where it begins."""

    choice: MachineChoice
    setup: Setup
    geometry: Geometry
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
    driven = axes(system)
    setup = Setup(
        system=str(choice.system),
        axes=driven,
        signals=watched(system, [axis.name for axis in driven]),
        swap=dict(choice.swap),
        parameters=(choice.pose,) if choice.pose else (),
        set=dict(choice.set),
    )
    return ViewPlan(choice, setup, geometry(posed), start(posed))


def axes(system: System) -> tuple[Axis, ...]:
    """What a hand may drive: the valves, or a controller in front of them."""
    inputs = {port.variable for port in system.ports("input")}
    lever = "lever" if "engaged" in inputs else "command"
    found = [Axis(f"{joint}_{lever}", VOLTS, rate) for joint, rate in VOLTS_RATES.items()]
    if "engaged" in inputs:
        found += [Axis(*values) for values in (*VELOCITIES, ("swing_velocity", TURN, TURN_RATE))]
        found += [Axis("engaged", 1.0, SWITCH_RATE, rest_delay=BRAKING)]
    there = tuple(axis for axis in found if axis.name in inputs)
    if not there:
        raise Problem(
            f"{system.source or system.name}: expected an input to drive, such as"
            f" {found[0].name}, found {', '.join(sorted(inputs)[:6]) or 'none'}"
        )
    return there


def poses(system: Path) -> tuple[str, ...]:
    """The parameter sets of a system that tell where its joints begin."""
    loaded = load(system)
    found = []
    for name, file in parameter_sets.names(loaded).items():
        text = file.read()
        if b"initial_boom_angle" in text and b"_command" not in text:
            found.append(name)
    return tuple(found)


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
