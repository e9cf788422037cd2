"""The bodies of column, boom, stick and cylinders, in the proportions of the pins they hang on."""

from __future__ import annotations

from orchestrator.view.scene.geometry import Geometry
from orchestrator.view.scene.shapes import Part, Point, bar, box, pin, plate, plates, post, tube

BODY, EDGE, DARK, STEEL, CHROME = "#ecebe6", "#4c6e5b", "#343a40", "#6d757c", "#c9d1d8"
BARREL, ROD, HOSE = 0.078, 0.040, 0.026  # m; radii: bores of 0.12 and 0.115 m with their walls

# outlines as shares of the length of their link: along it, across it
BOOM_TOP = (
    (-0.040, 0.030),
    (0.02, 0.058),
    (0.16, 0.092),
    (0.40, 0.150),
    (0.62, 0.156),
    (1.0, 0.112),
    (1.03, 0.085),
)
BOOM_BOTTOM = (
    (1.03, 0.062),
    (1.0, 0.040),
    (0.62, 0.060),
    (0.40, 0.048),
    (0.14, -0.036),
    (0.0, -0.040),
    (-0.040, -0.02),
)
STICK_TOP = ((-0.20, 0.022), (-0.165, 0.045), (-0.03, 0.078), (0.10, 0.062), (0.66, 0.040))
STICK_BOTTOM = ((0.66, -0.040), (0.10, -0.052), (-0.03, -0.058), (-0.165, -0.040), (-0.20, -0.022))


def parts(g: Geometry) -> list[Part]:
    """All of the crane but its head."""
    return [*_column(g), *_boom(g), *_stick(g), *_cylinders(g), *_hoses(g)]


def _column(g: Geometry) -> list[Part]:
    """Slewing gear, post, and the cheeks that hold the boom and the foot of its cylinder."""
    x, z = g.boom_pivot_x, g.boom_pivot_z
    foot_x, foot_z = x + g.boom_base_x, z + g.boom_base_z
    top = 0.62 * z
    lower = [
        (x - 0.26, 0.04),
        (foot_x - 0.10, 0.04),
        (foot_x - 0.12, top - 0.1),
        (x + 0.1, top),
        (x - 0.2, top),
    ]
    cheek = [(x - 0.22, 0.04), (x + 0.12, 0.30), (x + 0.15, z), (x + 0.08, z + 0.13), (x - 0.08, z + 0.13)]
    cheek += [(x - 0.16, z)]
    lug = [
        (x + 0.1, 0.02),
        (foot_x + 0.14, 0.02),
        (foot_x + 0.12, foot_z + 0.1),
        (foot_x - 0.1, foot_z + 0.13),
    ]
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
    ear = [
        (length - 0.32, rise - 0.11),
        (length + 0.08, rise - 0.12),
        (length + 0.13, rise),
        (length + 0.05, rise + 0.13),
    ]
    ear += [(length - 0.32, rise + 0.14)]
    return [
        plate("boom", outline, 0.24, BODY),
        *plates(
            "boom",
            [(u * length, 0.012 + v * length * 0.93) for u, v in (*BOOM_TOP[3:5], *BOOM_BOTTOM[2:4])],
            0.02,
            EDGE,
            0.125,
        ),
        *plates("boom", bracket, 0.04, DARK, 0.11),
        *plates("boom", ear, 0.05, BODY, 0.145),
        pin("boom", base_x, base_z, 0.042, 0.30, STEEL),
        pin("boom", g.boom_pin_x, g.boom_pin_z, 0.045, 0.30, STEEL),
        pin("boom", length, rise, 0.060, 0.42, STEEL),
        box("boom", (0.56 * length, -0.14, 0.075 * length), (0.62 * length, 0.14, 0.135 * length), DARK),
    ]


def _stick(g: Geometry) -> list[Part]:
    """A girder with a lever behind its pivot and an extension that runs in it."""
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
    """Barrels that hold the pressure of the head side, a collar at their end with that of the rod side."""
    found: list[Part] = []
    for name, closed, stroke in (
        ("boom", g.boom_closed_length, g.boom_stroke),
        ("stick", g.stick_closed_length, g.stick_stroke),
    ):
        barrel, rod = f"{name}_barrel", f"{name}_rod"
        length = closed - 0.13  # what is left is the eye of the rod
        split = 0.62 * length
        found += [
            pin(barrel, 0.0, 0.0, 0.075, 0.15, DARK),
            bar(barrel, (0.05, 0.0, 0.0), BARREL, split - 0.05, STEEL, f"{name}_head"),
            bar(barrel, (split, 0.0, 0.0), BARREL + 0.006, 0.035, DARK),
            bar(barrel, (split + 0.035, 0.0, 0.0), BARREL, length - split - 0.035, STEEL, f"{name}_rod"),
            bar(barrel, (length - 0.05, 0.0, 0.0), BARREL + 0.009, 0.06, DARK),
            bar(rod, (-(stroke + 0.2), 0.0, 0.0), ROD, stroke + 0.2, CHROME),
            pin(rod, 0.0, 0.0, 0.068, 0.15, DARK),
        ]
    return found


def _hoses(g: Geometry) -> list[Part]:
    """Pipes of the stick cylinder along the boom, of the swing motor at the column."""
    length, rise = g.stick_pivot_x, g.stick_pivot_z
    base: Point = (length + g.stick_base_x, rise + g.stick_base_z)
    found: list[Part] = []
    for y, channel in ((0.15, "stick_head"), (-0.15, "stick_rod")):
        far = base[0] + (0.12 if channel == "stick_head" else 0.55)
        along = [(0.02, 0.0), (0.14, 0.02), (0.30, 0.075), (0.42, 0.115)]
        points = [(u * length, y, v * length) for u, v in along]
        points += [(far - 0.2, y, base[1] - 0.14), (far, y * 0.9, base[1] + 0.02)]
        found.append(tube("boom", points, HOSE, DARK, channel))
    x, z = g.boom_pivot_x, g.boom_pivot_z
    for y, channel in ((0.22, "boom_head"), (-0.22, "boom_rod"), (0.27, "swing_a"), (-0.27, "swing_b")):
        outer = channel.startswith("swing")
        top = 0.32 if outer else z - 0.25
        bend = [(x - 0.30, y, 0.02), (x - 0.30, y, top - 0.12), (x - 0.18, y, top), (x + 0.05, y, top - 0.06)]
        end = [(x + 0.20, y, 0.14), (x + 0.26, y, 0.02)] if outer else [(x + 0.22, y * 0.8, z - 0.5)]
        found.append(tube("column", [*bend, *end], HOSE, DARK, channel))
    return found
