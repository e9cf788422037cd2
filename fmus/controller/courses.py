"""Paths that a user gives on the command line: straight from point to point, and where they begin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fmus.contract import ModelError
from fmus.controller.inverse import joints
from fmus.controller.paths import Point, Route, write
from fmus.manipulator import MANIPULATOR
from fmus.parameters import values


def route(texts: Sequence[str], speed: float, folder: Path) -> Path:
    """Write route.csv, the scenario through the points 'x,y,z' [m] at a speed [m/s]; returns its path."""
    if len(texts) < 2:
        raise ModelError(f"--through {texts[0]}: expected two points or more, got one")
    if not speed > 0:
        raise ModelError(f"--speed {speed:g}: expected more than 0 m/s")
    points = tuple(_point(text) for text in texts)
    folder.mkdir(parents=True, exist_ok=True)
    return write(folder, {"route": Route(points, speed=speed)})[0]


def _point(text: str) -> Point:
    try:
        x, y, z = (float(number) for number in text.split(","))
    except ValueError:
        raise ModelError(f"--through {text}: expected x,y,z in metres, such as 3.6,-2,1") from None
    return x, y, z


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
