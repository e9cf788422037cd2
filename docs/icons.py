"""Draws the icons of the FMUs, fmus/**/icon.png: `python docs/icons.py`.

All in one style, on a square of 100 by 100: the machine dark, what the FMU is about in orange.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import atan2, cos, hypot, pi, sin
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Arc, Circle, FancyBboxPatch, Polygon

FMUS = Path(__file__).parents[1] / "fmus"
SIZE = 256  # pixels
DARK, ORANGE, GREEN, TILE, EDGE = "#22313a", "#e87d1a", "#3b7d4f", "#f4f6f5", "#b9c4c2"
Point = tuple[float, float]


def line(axes: Axes, points: Sequence[Point], color: str = DARK, width: float = 7.0) -> None:
    """A thick line with round ends; the width in units of the square."""
    x, y = zip(*points, strict=True)
    axes.plot(x, y, color=color, lw=width * 1.28, solid_capstyle="round", solid_joinstyle="round")


def disc(axes: Axes, centre: Point, radius: float, color: str = DARK, hole: float = 0.0) -> None:
    axes.add_patch(Circle(centre, radius, color=color, lw=0, zorder=3))
    if hole:
        axes.add_patch(Circle(centre, hole, color=TILE, lw=0, zorder=3))


def area(axes: Axes, points: Sequence[Point], color: str = DARK) -> None:
    axes.add_patch(Polygon(points, color=color, lw=1.5, joinstyle="round", zorder=2.5))


def cylinder(axes: Axes, foot: Point, eye: Point, bore: float = 11.0, color: str = ORANGE) -> None:
    """A hydraulic cylinder from foot to eye, its rod half out."""
    length, angle = hypot(eye[0] - foot[0], eye[1] - foot[1]), atan2(eye[1] - foot[1], eye[0] - foot[0])

    def at(along: float, across: float = 0.0) -> Point:
        return (
            foot[0] + along * cos(angle) - across * sin(angle),
            foot[1] + along * sin(angle) + across * cos(angle),
        )

    line(axes, [at(0.5 * length), at(length)], color, bore * 0.36)
    area(
        axes,
        [at(0, -bore / 2), at(0.6 * length, -bore / 2), at(0.6 * length, bore / 2), at(0, bore / 2)],
        color,
    )
    disc(axes, at(0), bore * 0.5, DARK, bore * 0.2)
    disc(axes, at(length), bore * 0.5, DARK, bore * 0.2)


def arrow(axes: Axes, centre: Point, radius: float, start: float, end: float, color: str = ORANGE) -> None:
    """A round arrow, counter-clockwise from one angle to the other [deg]."""
    axes.add_patch(Arc(centre, 2 * radius, 2 * radius, theta1=start, theta2=end, color=color, lw=7.5))
    a = end * pi / 180

    def at(r: float, ahead: float) -> Point:
        return centre[0] + r * cos(a) - ahead * sin(a), centre[1] + r * sin(a) + ahead * cos(a)

    area(axes, [at(radius - 9, -1), at(radius + 9, -1), at(radius, 14)], color)


def arm(axes: Axes, foot: Point, size: float, color: str) -> tuple[Point, Point, Point]:
    """Column, boom, stick and head; returns boom pivot, stick pivot and stick end."""

    def at(x: float, y: float) -> Point:
        return foot[0] + size * x, foot[1] + size * y

    pivot, elbow, end = at(0, 26), at(38, 58), at(66, 26)
    line(axes, [foot, pivot], color, 9 * size)
    line(axes, [pivot, at(16, 50), elbow], color, 8 * size)
    line(axes, [elbow, end], color, 6.5 * size)
    head = [at(59, 22), at(73, 22), at(76, 6), at(70, 9), at(66, 6), at(62, 9), at(56, 6)]
    area(axes, head, color)
    for joint in (pivot, elbow, end):
        disc(axes, joint, 5.2 * size, color, 2.2 * size)
    return pivot, elbow, end


def swing(axes: Axes) -> None:
    """The slewing ring from above with the motor's symbol in it."""
    arrow(axes, (50, 50), 35, 20, 135)
    arrow(axes, (50, 50), 35, 200, 315)
    axes.add_patch(Circle((50, 50), 21, fill=False, ec=DARK, lw=6.5))
    area(axes, [(50, 56), (41, 66.5), (59, 66.5)])
    area(axes, [(50, 44), (41, 33.5), (59, 33.5)])


def boom_stick(axes: Axes) -> None:
    """Two cylinders at work on the arm."""
    line(axes, [(20, 12), (20, 46), (40, 70), (62, 72)], DARK, 6)
    line(axes, [(20, 20), (38, 20)], DARK, 6)
    line(axes, [(55, 84), (62, 72), (84, 32)], DARK, 6)
    cylinder(axes, (38, 20), (46, 66), 12)
    cylinder(axes, (20, 74), (55, 86), 11)
    line(axes, [(20, 74), (36, 68)], DARK, 4)
    disc(axes, (62, 72), 5, DARK, 2.2)


def manipulator(axes: Axes) -> None:
    """The arm with its three axes."""
    line(axes, [(8, 14), (34, 14)], DARK, 7)
    for joint in arm(axes, (19, 18), 1.0, DARK):
        disc(axes, joint, 6.2, ORANGE, 2.6)


def supply(axes: Axes) -> None:
    """The symbol of a pump that can be adjusted, its line and its tank."""
    line(axes, [(24, 14), (24, 8), (76, 8), (76, 14)], DARK, 6)
    line(axes, [(50, 8), (50, 22)], DARK, 6)
    axes.add_patch(Circle((50, 45), 23, fill=False, ec=DARK, lw=6.5))
    area(axes, [(50, 65), (40, 50), (60, 50)])
    line(axes, [(50, 70), (50, 90), (82, 90)], ORANGE, 7)
    line(axes, [(22, 20), (72, 70)], ORANGE, 5.5)
    area(axes, [(84, 82), (66, 76), (78, 64)], ORANGE)


def operator_input(axes: Axes) -> None:
    """A joystick and the two ways it goes."""
    area(axes, [(22, 12), (78, 12), (70, 28), (30, 28)])
    axes.add_patch(Arc((50, 28), 38, 24, theta1=0, theta2=180, color=DARK, lw=6))
    line(axes, [(50, 28), (50, 58)], DARK, 7)
    line(axes, [(50, 60), (50, 80)], ORANGE, 16)
    for side in (-1, 1):
        line(axes, [(50 + 17 * side, 69), (50 + 28 * side, 69)], DARK, 5)
        area(axes, [(50 + 28 * side, 61), (50 + 28 * side, 77), (50 + 40 * side, 69)])


def valve_actuation(axes: Axes) -> None:
    """The loop of a spool over its command."""
    line(axes, [(14, 16), (14, 84)], DARK, 5)
    line(axes, [(14, 16), (86, 16)], DARK, 5)
    line(axes, [(24, 26), (44, 26), (84, 78), (64, 78), (24, 26)], ORANGE, 6.5)
    area(axes, [(73, 50), (57, 54), (68, 63)], ORANGE)
    area(axes, [(35, 54), (51, 50), (40, 41)], ORANGE)


def controller(axes: Axes) -> None:
    """The stick end on its path."""
    line(axes, [(14, 12), (14, 40), (38, 74), (70, 46)], DARK, 6.5)
    for joint in ((14, 40), (38, 74)):
        disc(axes, joint, 5.5, DARK, 2.4)
    line(axes, [(42, 18), (66, 18)], ORANGE, 5)
    area(axes, [(62, 9), (62, 27), (80, 18)], ORANGE)
    line(axes, [(70, 46), (70, 36)], DARK, 4)
    disc(axes, (70, 46), 9, ORANGE, 4)
    for x in (24, 33):
        disc(axes, (x, 18), 2.6, ORANGE)


def harvester(axes: Axes) -> None:
    """The machine at a tree."""
    line(axes, [(85, 10), (85, 70)], GREEN, 6)
    area(axes, [(85, 95), (74, 66), (96, 66)], GREEN)
    arm(axes, (34, 30), 0.76, ORANGE)
    area(axes, [(6, 26), (56, 26), (56, 36), (30, 36), (30, 56), (12, 56), (6, 42)])
    area(axes, [(14, 51), (26, 51), (26, 40), (11, 40)], TILE)
    for x in (17, 45):
        disc(axes, (x, 22), 11.5, DARK, 4.5)


ICONS: Mapping[str, Callable[[Axes], None]] = {
    f.__name__: f
    for f in (swing, boom_stick, manipulator, supply, operator_input, valve_actuation, controller, harvester)
}


def draw(icon: Callable[[Axes], None], path: Path) -> None:
    """One icon as a PNG file."""
    figure = plt.figure(figsize=(SIZE / 100, SIZE / 100), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, 100), ylim=(0, 100), aspect="equal")
    axes.axis("off")
    tile = FancyBboxPatch(
        (5, 5), 90, 90, "round,pad=3.5,rounding_size=12", fc=TILE, ec=EDGE, lw=1.5, zorder=0
    )
    axes.add_patch(tile)
    icon(axes)
    for artist in (*axes.patches[1:], *axes.lines):
        artist.set_clip_path(tile)
    figure.savefig(path, transparent=True, metadata={"Software": None})
    plt.close(figure)


def main() -> None:
    """Draw them all."""
    for name, icon in ICONS.items():
        (path,) = FMUS.glob(f"**/{name}/icon.png")
        draw(icon, path)


if __name__ == "__main__":
    main()
