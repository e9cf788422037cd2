"""A correlation matrix as a heat map: blue is negative, red positive, numbers where they matter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from fmus.identification.finding import Array
from fmus.identification.report.style import PALETTE

TOLD = 0.3  # magnitude from which a correlation is told as a number


def draw(names: Sequence[str], correlation: Array) -> Figure:
    """The lower triangle; names of parameters, correlation (n, n)."""
    count = len(names)
    size = 2.9 + 0.30 * count
    figure = Figure(figsize=(min(size + 1.0, 11), min(size, 10.4)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    shown = np.where(np.tri(count, k=-1, dtype=bool), correlation, np.nan)[1:, :-1]
    cells = np.argwhere(np.isfinite(shown))
    squares = [Rectangle((float(j), float(i)), 1, 1) for i, j in cells]
    image = PatchCollection(squares, cmap="RdBu_r", edgecolor=PALETTE.grid, linewidth=0.6)
    image.set_array(shown[cells[:, 0], cells[:, 1]])
    image.set_clim(-1, 1)
    axes.add_collection(image)
    axes.set(xlim=(0, count - 1), ylim=(count - 1, 0))
    axes.set_aspect("equal")
    axes.spines[:].set_visible(False)
    ticks = np.arange(count - 1) + 0.5
    axes.set_xticks(ticks, names[:-1], rotation=55, ha="right", rotation_mode="anchor", fontsize=7.5)
    axes.set_yticks(ticks, names[1:], fontsize=7.5)
    axes.tick_params(length=0, colors=PALETTE.ink)
    for i, j in zip(*np.nonzero(np.abs(np.nan_to_num(shown)) >= TOLD), strict=True):
        value = shown[i, j]
        colour = "#ffffff" if abs(value) > 0.65 else "#000000"
        text = f"{value:.1f}".replace("-", "\N{MINUS SIGN}")
        axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=6.5, color=colour)
    bar = figure.colorbar(image, ax=axes, shrink=0.5, aspect=25, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=8, colors=PALETTE.ink, length=2)
    return figure
