"""A crane as `harvester track` knows it: apart from the machine, because paths need pictures and runs."""

from __future__ import annotations

from pathlib import Path

from fmus.crane.controller import controlled
from fmus.crane.description import read
from fmus.crane.machine import SOURCE, crane_machine
from fmus.crane.manipulator import NAME
from fmus.machine.feasible import Mechanics
from fmus.machine.path_following import TrackedMachine
from fmus.machine.ssp import CONTROLLED, SENSED
from orchestrator.ssp.system import System


def tracked(system: System) -> tuple[TrackedMachine, Mechanics] | None:
    """Names and mechanics of a crane that follows paths; None: the system is none of a crane."""
    if (file := system.resources.get(SOURCE)) is None:
        return None
    crane = read(Path(str(file)), file.read())
    controlled(crane)  # tells why the machine has no controller
    machine, name = crane_machine(crane), system.name.removesuffix(CONTROLLED).removesuffix(SENSED)
    tip = ("crane_tip_radius", "crane_tip_height", "crane_tip_angle")
    own = TrackedMachine(
        example=f"{name}{CONTROLLED}.ssp",
        alone="drives=lumped",
        tip=tuple(f"{NAME}.{n}" for n in tip),
    )
    assert machine.controller is not None
    return own, Mechanics(machine.controller, machine.parts[NAME])
