"""The few kinds of bodies that the machine is drawn with; `rig.js` makes meshes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

Point = tuple[float, float]
Point3 = tuple[float, float, float]


@dataclass(frozen=True)
class Part:
    """One body, fixed to a node.

    node     of `pose.NODES`, "column" or "site", which stands still
    kind     box, plate, round or tube
    size     box: lengths along x, y, z; plate: thickness; round: radii at its begin and end, length;
             tube: radius
    at       middle of a box, begin of a round, zero of the outline of a plate [m]
    path     outline of a plate in x and z, points of a tube
    axis     along which a round lies: x, y or z
    colour   "#rrggbb"
    channel  the pressure that colours it instead
    """

    node: str
    kind: str
    size: tuple[float, ...]
    at: Point3 = (0.0, 0.0, 0.0)
    path: tuple[tuple[float, ...], ...] = ()
    axis: str = "x"
    colour: str = "#888888"
    channel: str = ""

    def data(self) -> dict[str, Any]:
        """As the browser gets it."""
        rounded = {"size": self.size, "at": self.at}
        numbers = {name: [round(v, 4) for v in values] for name, values in rounded.items()}
        path = [[round(v, 4) for v in point] for point in self.path]
        own = {"node": self.node, "kind": self.kind, "axis": self.axis, "channel": self.channel}
        return {**own, **numbers, "path": path, "colour": self.colour}


def box(node: str, low: Point3, high: Point3, colour: str) -> Part:
    """A block between two corners."""
    size = tuple(b - a for a, b in zip(low, high, strict=True))
    middle = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2
    return Part(node, "box", size, middle, colour=colour)


def plate(node: str, path: Sequence[Point], width: float, colour: str, y: float = 0.0) -> Part:
    """An outline in x and z, as thick as `width`, its middle at y."""
    return Part(node, "plate", (width,), (0.0, y, 0.0), tuple(path), colour=colour)


def plates(node: str, path: Sequence[Point], width: float, colour: str, y: float) -> list[Part]:
    """Two of them, left and right."""
    return [plate(node, path, width, colour, side * y) for side in (-1, 1)]


def bar(node: str, begin: Point3, radius: float, length: float, colour: str, channel: str = "") -> Part:
    """A round bar along x."""
    return Part(node, "round", (radius, radius, length), begin, colour=colour, channel=channel)


def pin(node: str, x: float, z: float, radius: float, width: float, colour: str) -> Part:
    """A bolt across the arm."""
    return Part(node, "round", (radius, radius, width), (x, -width / 2, z), axis="y", colour=colour)


def post(node: str, foot: Point3, radii: Point, height: float, colour: str) -> Part:
    """A round body that stands upright."""
    return Part(node, "round", (*radii, height), foot, axis="z", colour=colour)


def tube(node: str, path: Sequence[Point3], radius: float, colour: str, channel: str = "") -> Part:
    """A bent pipe or hose through points."""
    return Part(node, "tube", (radius,), path=tuple(path), colour=colour, channel=channel)
