"""The bodies of the drawing: crane, processing head, carrier and trees; `rig.js` turns them into meshes.

The crane follows the geometry of the mechanics: column, boom, stick, cylinders and hoses scale with their
pins. The head has a link, a rotator, a frame with knives, feed rollers and a saw box. The carrier and the
trees have fixed dimensions.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from orchestrator.drive.geometry import GROUND, Geometry

Point = tuple[float, float]
Point3 = tuple[float, float, float]


@dataclass(frozen=True)
class Part:
    """One body, fixed to a node.

    node     a node of `geometry.NODES`, "column", or "site" (fixed)
    kind     box, plate, round or tube
    size     box: lengths along x, y, z; plate: thickness; round: radii at both ends, length; tube: radius [m]
    at       centre of a box, begin of a round, origin of the outline of a plate [m]
    path     outline of a plate in x and z, or points of a tube [m]
    axis     axis of a round: x, y or z
    colour   "#rrggbb"
    channel  the pressure that colours the body instead
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
        """The body as data for the browser, rounded to 0.1 mm."""
        rounded = [[round(v, 4) for v in values] for values in (self.size, self.at, *self.path)]
        return vars(self) | {"size": rounded[0], "at": rounded[1], "path": rounded[2:]}


def box(node: str, low: Point3, high: Point3, colour: str) -> Part:
    """A box between two corners."""
    size = tuple(b - a for a, b in zip(low, high, strict=True))
    middle = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2
    return Part(node, "box", size, middle, colour=colour)


def plate(node: str, path: Sequence[Point], width: float, colour: str, y: float = 0.0) -> Part:
    """A plate of thickness `width`, centred at y, with an outline in x and z."""
    return Part(node, "plate", (width,), (0.0, y, 0.0), tuple(path), colour=colour)


def plates(node: str, path: Sequence[Point], width: float, colour: str, y: float) -> list[Part]:
    """Two plates, left and right."""
    return [plate(node, path, width, colour, side * y) for side in (-1, 1)]


def bar(node: str, begin: Point3, radius: float, length: float, colour: str, channel: str = "") -> Part:
    """A round bar along x."""
    return Part(node, "round", (radius, radius, length), begin, colour=colour, channel=channel)


def pin(node: str, x: float, z: float, radius: float, width: float, colour: str) -> Part:
    """A pin across the arm."""
    return Part(node, "round", (radius, radius, width), (x, -width / 2, z), axis="y", colour=colour)


def post(node: str, foot: Point3, radii: Point, height: float, colour: str) -> Part:
    """An upright round body."""
    return Part(node, "round", (*radii, height), foot, axis="z", colour=colour)


def tube(node: str, path: Sequence[Point3], radius: float, colour: str, channel: str = "") -> Part:
    """A bent pipe or hose through these points."""
    return Part(node, "tube", (radius,), path=tuple(path), colour=colour, channel=channel)


BODY, EDGE, DARK, STEEL, CHROME = "#ecebe6", "#4c6e5b", "#343a40", "#6d757c", "#c9d1d8"
BARREL, ROD, HOSE = 0.078, 0.040, 0.026  # m; radii: bores of 0.12 and 0.115 m with their walls

# outlines relative to the length of the link: along it, across it
BOOM_TOP = (
    *((-0.040, 0.030), (0.02, 0.058), (0.16, 0.092), (0.40, 0.150)),
    *((0.62, 0.156), (1.0, 0.112), (1.03, 0.085)),
)
BOOM_BOTTOM = (
    *((1.03, 0.062), (1.0, 0.040), (0.62, 0.060), (0.40, 0.048)),
    *((0.14, -0.036), (0.0, -0.040), (-0.040, -0.02)),
)
STICK_TOP = ((-0.20, 0.022), (-0.165, 0.045), (-0.03, 0.078), (0.10, 0.062), (0.66, 0.040))
STICK_BOTTOM = ((0.66, -0.040), (0.10, -0.052), (-0.03, -0.058), (-0.165, -0.040), (-0.20, -0.022))


def crane_parts(g: Geometry) -> list[Part]:
    """The crane without its head."""
    return [*_column(g), *_boom(g), *_stick(g), *_cylinders(g), *_hoses(g)]


def _column(g: Geometry) -> list[Part]:
    """Slewing gear, column, and the cheeks that hold the boom and the base of its cylinder."""
    x, z = g.boom_pivot_x, g.boom_pivot_z
    foot_x, foot_z = x + g.boom_base_x, z + g.boom_base_z
    top = 0.62 * z
    lower = [(x - 0.26, 0.04), (foot_x - 0.10, 0.04), (foot_x - 0.12, top - 0.1)]
    lower += [(x + 0.1, top), (x - 0.2, top)]
    cheek = [(x - 0.22, 0.04), (x + 0.12, 0.30), (x + 0.15, z), (x + 0.08, z + 0.13), (x - 0.08, z + 0.13)]
    cheek += [(x - 0.16, z)]
    lug = [(x + 0.1, 0.02), (foot_x + 0.14, 0.02), (foot_x + 0.12, foot_z + 0.1)]
    lug += [(foot_x - 0.1, foot_z + 0.13)]
    return [
        post("column", (0.0, 0.0, -0.22), (0.46, 0.44), 0.26, DARK),
        plate("column", lower, 0.30, BODY),
        *plates("column", cheek, 0.045, BODY, 0.175),
        *plates("column", lug, 0.04, DARK, 0.115),
        pin("column", x, z, 0.065, 0.44, STEEL),
        pin("column", foot_x, foot_z, 0.045, 0.29, STEEL),
        box("column", (x - 0.34, -0.17, 0.06), (x - 0.20, 0.17, 0.5), DARK),
    ]


def _boom(g: Geometry) -> list[Part]:
    """A bent girder with the bracket of the stick cylinder on its back."""
    length, rise = g.stick_pivot_x, g.stick_pivot_z
    outline = [(u * length, v * length) for u, v in (*BOOM_TOP, *BOOM_BOTTOM)]
    base_x, base_z = length + g.stick_base_x, rise + g.stick_base_z
    bracket = [(base_x - 0.22, base_z - 0.12), (base_x + 0.2, base_z - 0.12), (base_x + 0.05, base_z + 0.07)]
    bracket += [(base_x - 0.06, base_z + 0.07)]
    ear = [(length - 0.32, rise - 0.11), (length + 0.08, rise - 0.12), (length + 0.13, rise)]
    ear += [(length + 0.05, rise + 0.13), (length - 0.32, rise + 0.14)]
    side = [(u * length, 0.012 + v * length * 0.93) for u, v in (*BOOM_TOP[3:5], *BOOM_BOTTOM[2:4])]
    return [
        plate("boom", outline, 0.24, BODY),
        *plates("boom", side, 0.02, EDGE, 0.125),
        *plates("boom", bracket, 0.04, DARK, 0.11),
        *plates("boom", ear, 0.05, BODY, 0.145),
        pin("boom", base_x, base_z, 0.042, 0.30, STEEL),
        pin("boom", g.boom_pin_x, g.boom_pin_z, 0.045, 0.30, STEEL),
        pin("boom", length, rise, 0.060, 0.42, STEEL),
        box("boom", (0.56 * length, -0.14, 0.075 * length), (0.62 * length, 0.14, 0.135 * length), DARK),
    ]


def _stick(g: Geometry) -> list[Part]:
    """A girder with a lever behind its pivot, and a telescopic extension."""
    length = g.stick_length
    outline = [(u * length, v * length) for u, v in (*STICK_TOP, *STICK_BOTTOM)]
    inner = [(0.6 * length, 0.085), (length - 0.05, 0.075), (length + 0.05, 0.03), (length + 0.05, -0.05)]
    inner += [(length - 0.06, -0.085), (0.6 * length, -0.085)]
    return [
        plate("stick", outline, 0.22, BODY),
        plate("stick", inner, 0.15, EDGE),
        box("stick", (0.63 * length, -0.13, -0.135), (0.665 * length, 0.13, 0.135), DARK),
        pin("stick", g.stick_pin_x, g.stick_pin_z, 0.042, 0.30, STEEL),
        pin("stick", length, 0.0, 0.05, 0.24, STEEL),
        bar("stick", (0.2 * length, -0.06, -0.165), 0.035, 0.42 * length, CHROME),
    ]


def _cylinders(g: Geometry) -> list[Part]:
    """Cylinders: a barrel shows the head pressure in its lower part, the rod pressure in its upper part."""
    parts: list[Part] = []
    for name, closed, stroke in (
        ("boom", g.boom_closed_length, g.boom_stroke),
        ("stick", g.stick_closed_length, g.stick_stroke),
    ):
        barrel, rod = f"{name}_barrel", f"{name}_rod"
        length = closed - 0.13  # the remainder is the eye of the rod
        split = 0.62 * length
        parts += [
            pin(barrel, 0.0, 0.0, 0.075, 0.15, DARK),
            bar(barrel, (0.05, 0.0, 0.0), BARREL, split - 0.05, STEEL, f"{name}_head"),
            bar(barrel, (split, 0.0, 0.0), BARREL + 0.006, 0.035, DARK),
            bar(barrel, (split + 0.035, 0.0, 0.0), BARREL, length - split - 0.035, STEEL, f"{name}_rod"),
            bar(barrel, (length - 0.05, 0.0, 0.0), BARREL + 0.009, 0.06, DARK),
            bar(rod, (-(stroke + 0.2), 0.0, 0.0), ROD, stroke + 0.2, CHROME),
            pin(rod, 0.0, 0.0, 0.068, 0.15, DARK),
        ]
    return parts


def _hoses(g: Geometry) -> list[Part]:
    """Hoses of the stick cylinder along the boom; of boom cylinder and swing motor at the column."""
    length, rise = g.stick_pivot_x, g.stick_pivot_z
    base: Point = (length + g.stick_base_x, rise + g.stick_base_z)
    parts: list[Part] = []
    for y, channel in ((0.15, "stick_head"), (-0.15, "stick_rod")):
        far = base[0] + (0.12 if channel == "stick_head" else 0.55)
        along = [(0.02, 0.0), (0.14, 0.02), (0.30, 0.075), (0.42, 0.115)]
        points = [(u * length, y, v * length) for u, v in along]
        points += [(far - 0.2, y, base[1] - 0.14), (far, y * 0.9, base[1] + 0.02)]
        parts.append(tube("boom", points, HOSE, DARK, channel))
    x, z = g.boom_pivot_x, g.boom_pivot_z
    for y, channel in ((0.22, "boom_head"), (-0.22, "boom_rod"), (0.27, "swing_a"), (-0.27, "swing_b")):
        outer = channel.startswith("swing")
        top = 0.32 if outer else z - 0.25
        bend = [(x - 0.30, y, 0.02), (x - 0.30, y, top - 0.12), (x - 0.18, y, top), (x + 0.05, y, top - 0.06)]
        end = [(x + 0.20, y, 0.14), (x + 0.26, y, 0.02)] if outer else [(x + 0.22, y * 0.8, z - 0.5)]
        parts.append(tube("column", [*bend, *end], HOSE, DARK, channel))
    return parts


def head_parts(g: Geometry) -> list[Part]:
    """The head, along -z from the end of the stick; its middle is `head_length` below."""
    middle = -g.head_length
    top, low = middle + 0.40, middle - 0.48
    link = [(-0.07, 0.06), (0.07, 0.06), (0.05, top + 0.22), (-0.05, top + 0.22)]
    frame = [(-0.16, top), (0.12, top), (0.20, top - 0.14), (0.20, middle - 0.1)]
    frame += [(0.12, low + 0.12), (0.12, low), (-0.20, low), (-0.26, middle)]
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
    """Two feed rollers beside the stem."""
    parts = []
    for side in (-1, 1):
        y = side * 0.27
        parts += [
            post("head", (0.14, y, middle - 0.16), (0.13, 0.13), 0.26, DARK),
            post("head", (0.14, y, middle - 0.19), (0.06, 0.06), 0.32, STEEL),
            box("head", (-0.06, y - 0.04, middle + 0.10), (0.18, y + 0.04, middle + 0.17), EDGE),
        ]
    return parts


def _knife(side: int, z: float) -> Part:
    """A delimbing knife, curved round the stem."""
    turns = [math.radians(a) for a in (200, 240, 285, 330, 370)]
    path: list[Point3] = [
        (0.20 - 0.24 * math.sin(a) - 0.12, side * (0.24 + 0.24 * math.cos(a)) * 0.86, z) for a in turns
    ]
    return tube("head", path, 0.032, STEEL)


GREEN, LEAF, GLASS, TYRE = "#3c5a4a", "#4c6e5b", "#26333a", "#24282b"
WHEEL = 0.68  # m; radius
TREES = 46
AXLES = (0.42, -1.08, -3.45)  # m
GOLDEN = math.pi * (3 - math.sqrt(5))  # rad; the golden angle spreads points evenly


def site_parts() -> list[Part]:
    """The carrier: crane in front, then cab, then engine."""
    axle = GROUND + WHEEL
    hood = [(-4.6, -0.55), (-2.42, -0.55), (-2.42, 0.55), (-4.1, 0.42), (-4.6, 0.1)]
    cab = [(-2.35, -0.5), (-0.98, -0.5), (-0.86, 0.25), (-1.08, 1.34), (-2.2, 1.40), (-2.35, 1.2)]
    window = [(-2.18, 0.18), (-1.02, 0.18), (-1.18, 1.18), (-2.12, 1.22)]
    frame = [(-4.5, -1.1), (0.6, -1.1), (0.85, -0.75), (0.75, -0.5), (-4.5, -0.5)]
    bogie = [(-1.85, axle - 0.15), (1.2, axle - 0.15), (0.6, axle + 0.35), (-1.3, axle + 0.35)]
    return [
        plate("site", frame, 1.0, DARK),
        post("site", (0.0, 0.0, -0.55), (0.62, 0.52), 0.35, STEEL),
        plate("site", hood, 1.7, GREEN),
        plate("site", cab, 1.45, LEAF),
        *plates("site", window, 0.02, GLASS, 0.73),
        box("site", (-0.99, -0.62, 0.2), (-0.90, 0.62, 1.15), GLASS),
        box("site", (-2.40, -0.78, 1.36), (-1.0, 0.78, 1.46), DARK),
        post("site", (-3.0, 0.62, 0.4), (0.06, 0.06), 0.75, STEEL),
        *plates("site", bogie, 0.2, DARK, 0.72),
        *(part for x in AXLES for side in (-1, 1) for part in _wheel(x, side, axle)),
    ]


def _wheel(x: float, side: int, axle: float) -> list[Part]:
    """Tyre, rim and hub."""
    sizes = (WHEEL, 0.62, TYRE), (0.36, 0.64, LEAF), (0.12, 0.70, DARK)
    parts = (pin("site", x, axle, *size) for size in sizes)
    return [replace(part, at=(x, part.at[1] + side * 1.18, axle)) for part in parts]


def trees() -> list[list[float]]:
    """Trees around the machine: x, y, height, radius [m], between 13 and 32 m away."""
    rows = []
    for k in range(TREES):
        angle, away = k * GOLDEN, 13.0 + 19.0 * math.sqrt((k + 0.5) / TREES)
        size = 0.75 + 0.5 * ((k * 7) % 11) / 10
        x, y = away * math.cos(angle), away * math.sin(angle)
        rows.append([round(v, 2) for v in (x, y, 7.5 * size, 1.5 * size)])
    return rows
