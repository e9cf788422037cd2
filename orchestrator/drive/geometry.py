"""Geometry of the machine, read from the FMU of its mechanics; `pose` of `rig.js` places the bodies with it.

The frame of the column has its origin at the foot of the column: x outwards, y to the left, z upwards; the
column turns about z. Points of a link are along and across that link, from its pivot [m].

Each node except `column` is in the frame of the column at (x, 0, z). It is pitched about y (x-axis up for
positive angles) and then rolled about its own x-axis. Angles are those of the mechanics: boom from the
horizontal, stick from the boom, head from the vertical. A head at zero angle hangs along -z of its frame.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from orchestrator.base.errors import Problem
from orchestrator.ssp.parameter_sets import parameter_sets
from orchestrator.ssp.system import Component, System

GROUND = -2.0  # m; the foot of the column stands on the carrier
HANGING = 1.0  # m; default of head_length, from the end of the stick to the middle of the head


@dataclass(frozen=True)
class Geometry:
    """Positions of pins, and lengths [m], by the names of the parameters of the mechanics."""

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
    """Initial angles of the joints [rad], shown until the first frame."""

    swing: float = 0.0
    boom: float = 0.0
    stick: float = 0.0


def mechanics(system: System) -> Component:
    """The component with the parameters of the arm. Raises `Problem` if there is none."""
    needed = [f.name for f in fields(Geometry) if f.name != "head_length"]
    for component in system.components.values():
        if all(name in component.interface.variables for name in needed):
            return component
    expected = f"expected a component with the arm's parameters, {needed[0]} to {needed[-1]}"
    raise Problem(f"{system.source or system.name}: {expected}, found none in {', '.join(system.components)}")


def geometry(system: System) -> Geometry:
    """Geometry of the machine in a system, with the values of its parameter sets."""
    values = _parameter_values(mechanics(system))
    return Geometry(**{f.name: values[f.name] for f in fields(Geometry) if f.name in values})


def start(system: System, parameters: Sequence[str]) -> Start:
    """Initial angles of a system, from these parameters of its mechanics; zero without any."""
    values = _parameter_values(mechanics(system)) if parameters else {}
    return Start(*(values.get(name, 0.0) for name in parameters))


def pose_names(system: System, initial: Sequence[str]) -> tuple[str, ...]:
    """Names of the parameter sets that set these initial angles of the joints."""
    angles = [name.encode() for name in initial]
    texts = {name: file.read() for name, file in parameter_sets(system).items()}
    return tuple(name for name, text in texts.items() if angles and all(angle in text for angle in angles))


def _parameter_values(component: Component) -> Mapping[str, float]:
    """Values of the real parameters, as set in the system, else those of the FMU."""
    values = component.real_parameters()
    for name, value in values.items():
        if not math.isfinite(value):
            raise Problem(f"{component.name}.{name}: expected a finite number, got {value}")
    return values


NODES = ("boom", "stick", "yoke", "head", "boom_barrel", "boom_rod", "stick_barrel", "stick_rod")
