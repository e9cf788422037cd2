"""`harvester crane check --drawing`: side view of a crane with its working range and loads."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from fmus.crane.axes import Capacity, Start
from fmus.crane.description import CraneDescription
from orchestrator.data.table import Array
from orchestrator.pages.plotting import new_figure, style_axes

CELL = 0.2  # m


def drawing(crane: CraneDescription, loads: Capacity) -> Figure:
    """Side view: the working range of the tip, coloured by the load that can be held; the start pose."""
    start = Start.of(crane)
    of, p = start.mechanics, start.p
    chain, load, q = of.chain(p), of.payload(0, p), of.at_rest(start.q, 0, p)
    frames = [np.array(ca.evalf(f.origin)).ravel() for f in chain.frames(q)]
    points = {j.name: frames[k] for k, j in enumerate(crane.joints)} | {"": np.zeros(3)}
    cells, ends = _cells(loads)
    figure = new_figure(1.6 + 5.0 * np.ptp(ends[0]) / np.ptp(ends[1]), 5.2)
    axes = figure.add_subplot()
    style_axes(axes, "reach [m]", "height [m]")
    shown = axes.pcolormesh(*ends, cells.T, cmap="viridis", vmin=0, vmax=np.nanquantile(cells, 0.95))
    figure.colorbar(shown, ax=axes, label="load that can be held [kg]", extend="max")
    tip = np.array(ca.evalf(chain.position(q, load.link, load.at))).ravel()
    bars = [(points[j.parent], points[j.name]) for j in crane.joints] + [(points[crane.payload_on], tip)]
    drawn: Mapping[str, Sequence[Sequence[Array]]] = {"-": bars, "o": [[x] for x in points.values()]}
    for style, lines in drawn.items():
        for line in lines:
            reach = [math.copysign(math.hypot(x, y), x) for x, y, _ in line]
            axes.plot(reach, [x[2] for x in line], style, color="black", lw=2.5, ms=4)
    axes.set_aspect("equal")
    return figure


def _cells(loads: Capacity) -> tuple[Array, tuple[Array, Array]]:
    """Largest load in each square of the plane, NaN where no tip is; the edges of the squares [m]."""
    *places, load = loads.values.reshape(3, -1)
    ends = [np.arange(x.min(), x.max() + 2 * CELL, CELL) for x in places]
    x, z = (np.digitize(place, edges) - 1 for place, edges in zip(places, ends, strict=True))
    cells = np.full((ends[0].size - 1, ends[1].size - 1), -1.0)
    np.maximum.at(cells, (x, z), load)
    return np.where(cells < 0, np.nan, cells), (ends[0], ends[1])
