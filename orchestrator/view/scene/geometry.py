"""The sizes of the machine, read from the FMU that holds its mechanics.

x away from the swing axis, z upwards, from the foot of the column [m]; what belongs to a link counts along
and across that link from its pivot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from orchestrator.errors import Problem
from orchestrator.system.system import Component, System

GROUND = -2.0  # m; the foot of the column stands on the carrier
HANGING = 1.0  # m; from the end of the stick to the middle of a head that does not tell


@dataclass(frozen=True)
class Geometry:
    """Pins and lengths, named like the parameters of the mechanics [m]."""

    boom_pivot_x: float
    boom_pivot_z: float
    stick_pivot_x: float
    stick_pivot_z: float
    stick_length: float
    boom_base_x: float
    boom_base_z: float
    boom_pin_x: float
    boom_pin_z: float
    boom_closed_length: float
    boom_stroke: float
    stick_base_x: float
    stick_base_z: float
    stick_pin_x: float
    stick_pin_z: float
    stick_closed_length: float
    stick_stroke: float
    head_length: float = HANGING


@dataclass(frozen=True)
class Start:
    """Angles of the joints at the start [rad]: shown until the machine tells its own."""

    swing: float = 0.0
    boom: float = 0.0
    stick: float = 0.0


def mechanics(system: System) -> Component:
    """The component that holds the mechanics: the one with the parameters of the arm."""
    needed = [f.name for f in fields(Geometry) if f.name != "head_length"]
    for component in system.components.values():
        if all(name in component.interface.variables for name in needed):
            return component
    raise Problem(
        f"{system.source or system.name}: expected a component with the arm's parameters,"
        f" {needed[0]} to {needed[-1]}, found none in {', '.join(system.components)}"
    )


def geometry(system: System) -> Geometry:
    """The sizes of the machine in a system, with the values that its parameter sets give."""
    known = _numbers(mechanics(system))
    return Geometry(**{f.name: known[f.name] for f in fields(Geometry) if f.name in known})


def start(system: System) -> Start:
    """The pose in which a system begins."""
    known = _numbers(mechanics(system))
    return Start(*(known.get(f"initial_{joint}_angle", 0.0) for joint in ("swing", "boom", "stick")))


def _numbers(component: Component) -> Mapping[str, float]:
    """Values of the real parameters: set in the system, else those of the FMU."""
    found = component.numbers()
    wrong = [name for name, value in found.items() if not math.isfinite(value)]
    if wrong:
        raise Problem(f"{component.name}.{wrong[0]}: expected a finite number, got {found[wrong[0]]}")
    return found
