"""The names of lines, each beside the end of its line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from orchestrator.convergence.lines import Line

APART = 0.034  # of the height of the picture, between two names
LETTER = 0.0062  # width of a letter of a name, of the width of the picture
LEADER: dict[str, Any] = {"arrowstyle": "-", "linewidth": 0.6, "alpha": 0.6, "shrinkA": 1.0, "shrinkB": 3.0}


def room(lines: Sequence[Line]) -> float:
    """For the names, as a share of the width of what is drawn beside them."""
    width = 0.05 + LETTER * max((len(line.name) for line in lines), default=0)
    return width / (1 - width)


def name(axes: Axes, ends: Mapping[Line, tuple[float, float]], left: bool) -> None:
    """The name of each line beside its end, moved up or down where names would touch."""
    to_axes = (axes.transData + axes.transAxes.inverted()).transform
    at = {line: to_axes(end) for line, end in ends.items()}
    lines = sorted(at, key=lambda line: float(at[line][1]))
    heights = _apart([float(at[line][1]) for line in lines])
    edge = (
        min((float(x) for x, _ in at.values()), default=0.0)
        if left
        else max((float(x) for x, _ in at.values()), default=0.0)
    )
    x = edge - 0.03 if left else edge + 0.03
    for line, height in zip(lines, heights, strict=True):
        axes.annotate(
            line.name,
            tuple(at[line]),
            (x, height),
            xycoords="axes fraction",
            textcoords="axes fraction",
            ha="right" if left else "left",
            va="center",
            fontsize=8,
            color=line.colour,
            arrowprops=LEADER | {"color": line.colour, "relpos": (1.0 if left else 0.0, 0.5)},
        )


def _apart(heights: Sequence[float]) -> list[float]:
    """Increasing heights, moved as little as needed to stand apart and inside the picture."""
    found = np.array(heights)
    for _ in range(400):
        for i in range(len(found) - 1):
            short = APART - (found[i + 1] - found[i])
            if short > 0:
                found[i] -= short / 2
                found[i + 1] += short / 2
        found = np.clip(found, 0.02 + APART * np.arange(len(found)), None)
        found = np.clip(found, None, 0.98 - APART * np.arange(len(found))[::-1])
    return [float(height) for height in found]
