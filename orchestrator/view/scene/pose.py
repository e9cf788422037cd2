"""The sizes of the machine, read from the FMU that holds its mechanics.

x away from the swing axis, z upwards, from the foot of the column [m]; what belongs to a link counts along
and across that link from its pivot.

Where everything that moves is, from the angles of the joints.

All nodes but `column` stand in the frame of the column: x outwards, y to the left, z upwards; the column
turns about z. A node lies at (x, 0, z), is pitched about y, its x-axis up for positive angles, and then
rolled about its own x-axis. Angles count as those of the mechanics: boom from the horizontal, stick from
the boom, head from the vertical; a head at zero hangs along -z of its own frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from orchestrator.base.errors import Problem
from orchestrator.ssp.system import Component, System

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


def start(system: System, parameters: Sequence[str]) -> Start:
    """The pose in which a system begins, from these parameters of its mechanics; zero without any."""
    known = _numbers(mechanics(system)) if parameters else {}
    return Start(*(known.get(name, 0.0) for name in parameters))


def _numbers(component: Component) -> Mapping[str, float]:
    """Values of the real parameters: set in the system, else those of the FMU."""
    found = component.numbers()
    wrong = [name for name, value in found.items() if not math.isfinite(value)]
    if wrong:
        raise Problem(f"{component.name}.{wrong[0]}: expected a finite number, got {found[wrong[0]]}")
    return found


Point = tuple[float, float]
Point3 = tuple[float, float, float]

NODES = (
    "boom",
    "stick",
    "yoke",
    "head",
    "boom_barrel",
    "boom_rod",
    "stick_barrel",
    "stick_rod",
)


@dataclass(frozen=True)
class Angles:
    """Of the joints [rad]; `head` in the plane of the arm, `side` out of it to the left."""

    swing: float
    boom: float
    stick: float
    head: float = 0.0
    side: float = 0.0


@dataclass(frozen=True)
class Place:
    """A node's position [m], pitch and roll [rad] in the frame of the column."""

    x: float
    z: float
    pitch: float
    roll: float = 0.0

    def to(self, x: float, z: float = 0.0) -> Point:
        """A point of the node's own plane y = 0, in the frame of the column."""
        cos, sin = math.cos(self.pitch), math.sin(self.pitch)
        return self.x + x * cos - z * sin, self.z + x * sin + z * cos


@dataclass(frozen=True)
class ScenePose:
    """All nodes at one instant.

    swing    angle of the column [rad]
    places   node -> where it is
    tip      the end of the stick, in space [m]
    """

    swing: float
    places: dict[str, Place]
    tip: Point3

    def flat(self) -> list[float]:
        """Numbers for the browser: swing, tip, then x, z, pitch, roll of each node; to 0.1 mm, 1e-5 rad."""
        numbers = [round(self.swing, 5), *(round(v, 4) for v in self.tip)]
        for name in NODES:
            p = self.places[name]
            numbers += [round(p.x, 4), round(p.z, 4), round(p.pitch, 5), round(p.roll, 5)]
        return numbers

    def space(self, point: Point) -> Point3:
        """A point of the plane of the arm, in space."""
        return point[0] * math.cos(self.swing), point[0] * math.sin(self.swing), point[1]


def pose(q: Angles, g: Geometry) -> ScenePose:
    """Where everything is at these angles."""
    boom = Place(g.boom_pivot_x, g.boom_pivot_z, q.boom)
    elbow = boom.to(g.stick_pivot_x, g.stick_pivot_z)
    stick = Place(*elbow, q.boom + q.stick)
    tip = stick.to(g.stick_length)
    column = Place(g.boom_pivot_x, g.boom_pivot_z, 0.0)
    folding = Place(*elbow, q.boom)
    places = {"boom": boom, "stick": stick, "yoke": Place(*tip, q.head), "head": Place(*tip, q.head, q.side)}
    places |= _cylinder("boom", column.to(g.boom_base_x, g.boom_base_z), boom.to(g.boom_pin_x, g.boom_pin_z))
    pin = stick.to(g.stick_pin_x, g.stick_pin_z)
    places |= _cylinder("stick", folding.to(g.stick_base_x, g.stick_base_z), pin)
    x, y = tip[0] * math.cos(q.swing), tip[0] * math.sin(q.swing)
    return ScenePose(q.swing, places, (x, y, tip[1]))


def _cylinder(name: str, base: Point, pin: Point) -> dict[str, Place]:
    """Barrel and rod: at the base pin and at the rod pin, both along the line between them."""
    along = math.atan2(pin[1] - base[1], pin[0] - base[0])
    return {f"{name}_barrel": Place(*base, along), f"{name}_rod": Place(*pin, along)}
