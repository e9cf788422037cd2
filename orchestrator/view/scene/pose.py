"""Geometry of the machine, read from the FMU of its mechanics, and the pose of its bodies at given angles.

The frame of the column has its origin at the foot of the column: x outwards, y to the left, z upwards; the
column turns about z. Points of a link are along and across that link, from its pivot [m].

Each node except `column` is in the frame of the column at (x, 0, z). It is pitched about y (x-axis up for
positive angles) and then rolled about its own x-axis. Angles are those of the mechanics: boom from the
horizontal, stick from the boom, head from the vertical. A head at zero angle hangs along -z of its frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from orchestrator.base.errors import Problem
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
    raise Problem(
        f"{system.source or system.name}: expected a component with the arm's parameters,"
        f" {needed[0]} to {needed[-1]}, found none in {', '.join(system.components)}"
    )


def geometry(system: System) -> Geometry:
    """Geometry of the machine in a system, with the values of its parameter sets."""
    values = _parameter_values(mechanics(system))
    return Geometry(**{f.name: values[f.name] for f in fields(Geometry) if f.name in values})


def start(system: System, parameters: Sequence[str]) -> Start:
    """Initial angles of a system, from these parameters of its mechanics; zero without any."""
    values = _parameter_values(mechanics(system)) if parameters else {}
    return Start(*(values.get(name, 0.0) for name in parameters))


def _parameter_values(component: Component) -> Mapping[str, float]:
    """Values of the real parameters, as set in the system, else those of the FMU."""
    values = component.real_parameters()
    for name, value in values.items():
        if not math.isfinite(value):
            raise Problem(f"{component.name}.{name}: expected a finite number, got {value}")
    return values


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
    """Angles of the joints [rad]; `head` in the plane of the arm, `side` out of it to the left."""

    swing: float
    boom: float
    stick: float
    head: float = 0.0
    side: float = 0.0


@dataclass(frozen=True)
class NodePose:
    """Position [m], pitch and roll [rad] of a node in the frame of the column."""

    x: float
    z: float
    pitch: float
    roll: float = 0.0

    def to(self, x: float, z: float = 0.0) -> Point:
        """Transform a point of the node's plane y = 0 to the frame of the column."""
        cos, sin = math.cos(self.pitch), math.sin(self.pitch)
        return self.x + x * cos - z * sin, self.z + x * sin + z * cos


@dataclass(frozen=True)
class ScenePose:
    """Pose of all nodes at one instant.

    swing    angle of the column [rad]
    nodes    node -> its pose
    tip      position of the end of the stick in space [m]
    """

    swing: float
    nodes: dict[str, NodePose]
    tip: Point3

    def flat(self) -> list[float]:
        """For the browser: swing, tip, then x, z, pitch, roll of each node, rounded to 0.1 mm, 1e-5 rad."""
        numbers = [round(self.swing, 5), *(round(v, 4) for v in self.tip)]
        for name in NODES:
            p = self.nodes[name]
            numbers += [round(p.x, 4), round(p.z, 4), round(p.pitch, 5), round(p.roll, 5)]
        return numbers

    def space(self, point: Point) -> Point3:
        """Transform a point of the plane of the arm to space."""
        return point[0] * math.cos(self.swing), point[0] * math.sin(self.swing), point[1]


def pose(q: Angles, g: Geometry) -> ScenePose:
    """Pose of all nodes at these angles."""
    boom = NodePose(g.boom_pivot_x, g.boom_pivot_z, q.boom)
    elbow = boom.to(g.stick_pivot_x, g.stick_pivot_z)
    stick = NodePose(*elbow, q.boom + q.stick)
    tip = stick.to(g.stick_length)
    column = NodePose(g.boom_pivot_x, g.boom_pivot_z, 0.0)
    folding = NodePose(*elbow, q.boom)
    nodes = {
        "boom": boom,
        "stick": stick,
        "yoke": NodePose(*tip, q.head),
        "head": NodePose(*tip, q.head, q.side),
    }
    nodes |= _cylinder("boom", column.to(g.boom_base_x, g.boom_base_z), boom.to(g.boom_pin_x, g.boom_pin_z))
    pin = stick.to(g.stick_pin_x, g.stick_pin_z)
    nodes |= _cylinder("stick", folding.to(g.stick_base_x, g.stick_base_z), pin)
    x, y = tip[0] * math.cos(q.swing), tip[0] * math.sin(q.swing)
    return ScenePose(q.swing, nodes, (x, y, tip[1]))


def _cylinder(name: str, base: Point, pin: Point) -> dict[str, NodePose]:
    """Poses of barrel and rod: at base pin and rod pin, both along the line between the pins."""
    along = math.atan2(pin[1] - base[1], pin[0] - base[0])
    return {f"{name}_barrel": NodePose(*base, along), f"{name}_rod": NodePose(*pin, along)}
