"""The bodies of the processing head: link, rotator, frame with knives, feed rollers and saw box."""

from __future__ import annotations

import math

from orchestrator.view.scene.crane import BODY, DARK, EDGE, STEEL
from orchestrator.view.scene.geometry import Geometry
from orchestrator.view.scene.shapes import Part, Point3, box, pin, plate, plates, post, tube


def parts(g: Geometry) -> list[Part]:
    """Hanging along -z from the end of the stick; the middle of the head lies `head_length` below."""
    middle = -g.head_length
    top, low = middle + 0.40, middle - 0.48
    link = [(-0.07, 0.06), (0.07, 0.06), (0.05, top + 0.22), (-0.05, top + 0.22)]
    frame = [
        (-0.16, top),
        (0.12, top),
        (0.20, top - 0.14),
        (0.20, middle - 0.1),
        (0.12, low + 0.12),
        (0.12, low),
    ]
    frame += [(-0.20, low), (-0.26, middle)]
    return [
        *plates("yoke", [(-0.08, 0.08), (0.08, 0.08), (0.07, -0.16), (-0.07, -0.16)], 0.03, DARK, 0.13),
        plate("head", link, 0.10, STEEL),
        pin("head", 0.0, -0.02, 0.04, 0.30, STEEL),
        post("head", (0.0, 0.0, top + 0.06), (0.12, 0.12), 0.20, DARK),
        post("head", (0.0, 0.0, top - 0.02), (0.17, 0.15), 0.09, STEEL),
        plate("head", frame, 0.26, BODY),
        box("head", (-0.24, -0.20, low - 0.05), (0.10, 0.20, low + 0.10), EDGE),
        box("head", (-0.34, -0.13, middle - 0.22), (-0.22, 0.13, middle + 0.16), DARK),
        *_rollers(middle),
        *(_knife(side, z) for side in (-1, 1) for z in (top - 0.08, low + 0.16)),
    ]


def _rollers(middle: float) -> list[Part]:
    """Two wheels beside the stem that pull it through."""
    found = []
    for side in (-1, 1):
        y = side * 0.27
        found += [
            post("head", (0.14, y, middle - 0.16), (0.13, 0.13), 0.26, DARK),
            post("head", (0.14, y, middle - 0.19), (0.06, 0.06), 0.32, STEEL),
            box("head", (-0.06, y - 0.04, middle + 0.10), (0.18, y + 0.04, middle + 0.17), EDGE),
        ]
    return found


def _knife(side: int, z: float) -> Part:
    """A blade that is curved round the stem."""
    turns = [math.radians(a) for a in (200, 240, 285, 330, 370)]
    path: list[Point3] = [
        (0.20 - 0.24 * math.sin(a) - 0.12, side * (0.24 + 0.24 * math.cos(a)) * 0.86, z) for a in turns
    ]
    return tube("head", path, 0.032, STEEL)
