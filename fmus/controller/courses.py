"""Paths that a user gives on the command line: straight from point to point, and where they begin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fmus.contract import ModelError
from fmus.controller.inverse import joints
from fmus.controller.paths import Point, Route, fastest, start, write
from fmus.manipulator import MANIPULATOR
from fmus.parameters import values


def route(texts: Sequence[str], speed: float, folder: Path) -> tuple[Path, float]:
    """Write route.csv, the scenario through the points 'x,y,z' [m] at a speed [m/s].

    Returns its path and the highest speed [m/s], which is lower where the way is short.
    """
    points = tuple(_point(text) for text in texts)
    if len(points) < 2:
        raise ModelError(f"--through {texts[0]}: expected two points or more, got one")
    if not speed > 0:
        raise ModelError(f"--speed {speed:g}: expected more than 0 m/s")
    folder.mkdir(parents=True, exist_ok=True)
    path = Route(points, speed=speed)
    return write(folder, {"route": path})[0], fastest(path)


def _point(text: str) -> Point:
    try:
        x, y, z = (float(number) for number in text.split(","))
    except ValueError:
        raise ModelError(f"--through {text}: expected x,y,z in metres, such as 3.6,-2,1") from None
    return x, y, z


def through(texts: Sequence[str], arm: Mapping[str, float]) -> dict[str, float]:
    """The start angles of `course` at the first of the points 'x,y,z' [m], all of which the arm reaches."""
    each = [course(f"--through {text}", start(Route((_point(text),))), arm) for text in texts]
    return each[0]


def course(label: str, place: Point, arm: Mapping[str, float]) -> dict[str, float]:
    """Start angles [rad] that put the tip to a place, by `component.variable`.

    place (radius, height, angle) [m, m, rad]
    arm   lengths and pivots of the machine, by the names of the manipulator; the usual ones where it has none
    """
    radius, height, angle = place
    try:
        boom, stick = joints(radius, height, {**values(MANIPULATOR).p, **arm})
    except ModelError as error:
        raise ModelError(f"{label}: {error}") from None
    angles = {"swing": angle, "boom": boom, "stick": stick}
    return {f"manipulator.initial_{joint}_angle": value for joint, value in angles.items()}
