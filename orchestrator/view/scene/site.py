"""What the crane stands on and between: the carrier, and trees far enough away."""

from __future__ import annotations

import math

from orchestrator.view.scene.crane import DARK, STEEL
from orchestrator.view.scene.geometry import GROUND
from orchestrator.view.scene.shapes import Part, box, pin, plate, plates, post

GREEN, LEAF, GLASS, TYRE = "#3c5a4a", "#4c6e5b", "#26333a", "#24282b"
WHEEL = 0.68  # m; radius
AXLES = (0.42, -1.08, -3.45)  # m
GOLDEN = math.pi * (3 - math.sqrt(5))  # rad; spreads points evenly


def parts() -> list[Part]:
    """A wheeled carrier: the crane in front, then the cab, then the engine."""
    axle = GROUND + WHEEL
    hood = [(-4.6, -0.55), (-2.42, -0.55), (-2.42, 0.55), (-4.1, 0.42), (-4.6, 0.1)]
    cab = [(-2.35, -0.5), (-0.98, -0.5), (-0.86, 0.25), (-1.08, 1.34), (-2.2, 1.40), (-2.35, 1.2)]
    window = [(-2.18, 0.18), (-1.02, 0.18), (-1.18, 1.18), (-2.12, 1.22)]
    frame = [(-4.5, -1.1), (0.6, -1.1), (0.85, -0.75), (0.75, -0.5), (-4.5, -0.5)]
    return [
        plate("site", frame, 1.0, DARK),
        post("site", (0.0, 0.0, -0.55), (0.62, 0.52), 0.35, STEEL),
        plate("site", hood, 1.7, GREEN),
        plate("site", cab, 1.45, LEAF),
        *plates("site", window, 0.02, GLASS, 0.73),
        box("site", (-0.99, -0.62, 0.2), (-0.90, 0.62, 1.15), GLASS),
        box("site", (-2.40, -0.78, 1.36), (-1.0, 0.78, 1.46), DARK),
        post("site", (-3.0, 0.62, 0.4), (0.06, 0.06), 0.75, STEEL),
        *plates(
            "site",
            [(-1.85, axle - 0.15), (1.2, axle - 0.15), (0.6, axle + 0.35), (-1.3, axle + 0.35)],
            0.2,
            DARK,
            0.72,
        ),
        *(part for x in AXLES for side in (-1, 1) for part in _wheel(x, side, axle)),
    ]


def _wheel(x: float, side: int, axle: float) -> list[Part]:
    """Tyre and rim."""
    y = side * 1.18
    tyre, rim, hub = (
        pin("site", x, axle, *size) for size in ((WHEEL, 0.62, TYRE), (0.36, 0.64, LEAF), (0.12, 0.70, DARK))
    )
    return [
        Part(p.node, p.kind, p.size, (x, p.at[1] + y, axle), axis="y", colour=p.colour)
        for p in (tyre, rim, hub)
    ]


def trees(count: int = 46) -> list[list[float]]:
    """Spruces round the site: x, y, height, radius [m], between 13 and 32 m away."""
    found = []
    for k in range(count):
        angle, away = k * GOLDEN, 13.0 + 19.0 * math.sqrt((k + 0.5) / count)
        size = 0.75 + 0.5 * ((k * 7) % 11) / 10
        x, y = away * math.cos(angle), away * math.sin(angle)
        found.append([round(v, 2) for v in (x, y, 7.5 * size, 1.5 * size)])
    return found
