"""Training task: what a machine declares of it. The page follows and scores an attempt (`web/task.js`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from orchestrator.base.toml import Rule


@dataclass(frozen=True)
class Target:
    """A position in space [m]: forward, left, up from the foot of the column.

    load   mass that the head holds from there on [kg]
    """

    name: str
    at: tuple[float, float, float]
    load: float = 0.0


@dataclass(frozen=True)
class Exercise:
    """Targets in order, and the tolerances: radius, start [m], slow [m/s], hold [s]."""

    name: str
    targets: tuple[Target, ...]
    radius: float = 0.3
    slow: float = 0.15
    hold: float = 1.0
    start: float = 0.05


@dataclass(frozen=True)
class Task:
    """A training task, as `[task]` of the view description declares it. Names are signals of any component.

    tip          forward, left, up [m]
    velocities   of the tip, outwards and upwards [m/s]
    turning      speed about the vertical axis [rad/s]
    speeds       of the functions [rad/s]
    pressures    of the lines [Pa]
    supply       pressure [Pa] and flow [m3/s]
    load         input with the mass that the machine is to hold [kg]
    """

    tip: Annotated[tuple[str, ...], Rule("three signals", lambda value: len(value) == 3)]
    velocities: tuple[str, ...]
    turning: str
    speeds: tuple[str, ...]
    exercises: Annotated[tuple[Exercise, ...], Rule("a list that is not empty", bool)]
    pressures: tuple[str, ...] = ()
    supply: Annotated[tuple[str, ...], Rule("pressure and flow", lambda value: len(value) == 2)] = ("", "")
    load: str = ""

    @property
    def needed(self) -> tuple[str, ...]:
        """Signals without which there is no score."""
        return tuple(dict.fromkeys((*self.tip, *self.speeds, *self.velocities, self.turning)))


NO_TASK = Task((), (), "", (), (Exercise("", ()),))  # of a machine that declares none
