"""Draws docs/images/crane_keys.png, the keys of a joint at the loader: `python docs/crane_keys.py`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.axes import Axes

from fmus.components.linkage import FourBar
from fmus.crane.description import JointDescription, read
from fmus.crane.manipulator import manipulator
from fmus.joints import Mechanics
from fmus.parameters import parameters
from orchestrator.pages.figures import PALETTE
from orchestrator.pages.plotting import new_figure, png

ROOT = Path(__file__).parent
LINK, FIXED = 7.0, "#8a8a8a"
BARREL, BAR = PALETTE.colour(0), PALETTE.colour(1)
Point = Sequence[float]


def _line(axes: Axes, a: Point, b: Point, colour: str, width: float = 2.0) -> None:
    axes.plot([a[0], b[0]], [a[1], b[1]], color=colour, linewidth=width, solid_capstyle="round", zorder=1)


def _pin(axes: Axes, at: Point, text: str, away: Point) -> None:
    axes.plot(*at, "o", color=PALETTE.ink, markersize=5, zorder=3)
    line = {"arrowstyle": "-", "color": PALETTE.faint, "linewidth": 0.8}
    axes.annotate(text, at, away, textcoords="offset points", ha="center", fontsize=9, arrowprops=line)


def _along(axes: Axes, a: Point, b: Point, text: str, colour: str, away: Point) -> None:
    middle = (a[0] + b[0]) / 2, (a[1] + b[1]) / 2
    axes.annotate(text, middle, away, textcoords="offset points", ha="center", fontsize=9, color=colour)


def _frame(axes: Axes) -> None:
    """Axes of the parent, at the joint."""
    for end, name in (((0.32, 0), "x"), ((0, 0.32), "z")):
        axes.annotate("", end, (0, 0), arrowprops={"arrowstyle": "->", "color": FIXED})
        axes.annotate(name, end, (3, 1), textcoords="offset points", fontsize=9, color=FIXED)


def draw() -> bytes:
    """Boom with its cylinder, and jib with its linkage, at the start pose."""
    crane = read(ROOT.parent / "examples" / "cranes" / "loader.toml")
    sub = manipulator(crane)
    own, p, figure = sub.model, parameters(sub), new_figure(11, 4.6, w_pad=0.1)
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
    for axes, name in ((left, "boom"), (right, "jib")):
        _joint(axes, own, crane.joint(name), p)
        axes.set_aspect("equal")
        axes.axis("off")
    left.set_title('[boom]   drive = "cylinder"', loc="left", fontsize=10)
    right.set_title('[jib]   drive = "four-bar"', loc="left", fontsize=10)
    return png(figure)


def _joint(axes: Axes, own: Mechanics, j: JointDescription, p: object) -> None:
    """A joint at the origin, in the frame of its parent; the moving link turned by the start angle."""
    q = j.start.value
    turn = np.array([[np.cos(q), -np.sin(q)], [np.sin(q), np.cos(q)]])
    base, joint = np.array([j["base_x"], j["base_z"]]), np.zeros(2)
    fixed = [base] if j.drive == "cylinder" else [base, np.array([j["pivot_x"], j["pivot_z"]])]
    for pin in fixed:
        _line(axes, joint, pin, FIXED, 1.0)
    _line(axes, joint, turn @ [0.85, 0], "#c9cfd4", LINK)
    axes.annotate("the link", turn @ [0.85, 0], xytext=(8, -6), textcoords="offset points", fontsize=9)
    _frame(axes)
    _pin(axes, joint, "joint, at", (-46, 12) if j.drive == "cylinder" else (44, -18))
    if j.drive == "cylinder":
        rod = turn @ [j["pin_x"], j["pin_z"]]
        _line(axes, joint, rod, "#c9cfd4", 4.0)
        _pin(axes, rod, "cylinder.pin", (38, 14))
    else:
        pivot, link = fixed[1], turn @ [j["link_x"], j["link_z"]]
        linkage = own.joint(j.name).drive(p)
        assert isinstance(linkage, FourBar)
        rod = np.array(ca.evalf(ca.vertcat(*linkage.rocker_end(q)))).ravel()
        for a, b, text, away in ((pivot, rod, "rocker", (-24, 4)), (rod, link, "coupler", (26, 12))):
            _line(axes, a, b, BAR, 3.0)
            _along(axes, a, b, text, BAR, away)
        _line(axes, joint, link, "#c9cfd4", 4.0)
        _pin(axes, pivot, "four_bar.pivot", (-20, -34))
        _pin(axes, link, "four_bar.pin", (52, 14))
        _pin(axes, rod, "", (0, 0))
    _line(axes, base, rod, BARREL, 4.0)
    _along(axes, base, rod, "closed + position", BARREL, (44, -6) if j.drive == "cylinder" else (0, 16))
    _pin(axes, base, "cylinder.base", (0, -20))


def main() -> None:
    """Write the picture."""
    (ROOT / "images" / "crane_keys.png").write_bytes(draw())


if __name__ == "__main__":
    main()
