"""The picture: Figs. 6 to 9 with the paper's estimates, ours and the truth; (13) over its filter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from as_printed import Known, Printed, named, over_filters
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fmus.identification.procedures.momentum_balance import JOINTS
from fmus.identification.results import Estimate, coverage_factor
from orchestrator.data.recording import Recording

COLUMNS = 3
POINTS = 1500  # drawn of the samples of a line
BLUE, ORANGE, GREY, BLACK = "#06406b", "#c25a00", "#8a9099", "#000000"
Pairs = Sequence[tuple[Printed, Estimate, float]]


def draw(pairs: Pairs, recordings: Sequence[Recording], known: Known, path: Path) -> Path:
    """Write a picture with a panel for each parameter, and one of (13) if there are recordings of joints."""
    names = [one.by_samples.name for one, _, _ in pairs]
    joints = [joint for joint in JOINTS if named(joint) in names]
    count = len(pairs) + bool(joints)
    rows = -(-count // COLUMNS)
    figure = Figure(figsize=(12, 3.1 * rows), dpi=75, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, (one, own, true) in zip(panels, pairs, strict=False):
        (samples if one.x.size else groups)(axes, one, own, true)
        axes.set_title(f"Fig. {one.figure}: {one.by_samples.name.rpartition('.')[2]}", fontsize="medium")
        axes.set_xlabel(one.labels[0])
        axes.set_ylabel(one.labels[1])
    if joints:
        filters(panels[len(pairs)], joints, recordings, known)
    for axes in panels[:count]:
        axes.grid(color="#dfe2e6")
        axes.legend(loc="upper left", fontsize="x-small", ncols=2, columnspacing=1.0)
    for axes in panels[count:]:
        axes.set_visible(False)
    figure.savefig(path)
    return path


def samples(axes: Axes, one: Printed, own: Estimate, true: float) -> None:
    """The samples of a line, with three slopes."""
    step = max(1, one.x.size // POINTS)
    axes.plot(one.x[::step], one.y[::step], ".", color=GREY, ms=2, label="samples")
    ends = np.array([min(one.x.min(), 0.0), max(one.x.max(), 0.0)])
    axes.plot(ends, true * ends, color=BLACK, lw=3, alpha=0.4, label="true")
    axes.plot(ends, one.by_samples.value * ends, color=ORANGE, label="as printed")
    axes.plot(ends, own.value * ends, "--", color=BLUE, label="ours")


def groups(axes: Axes, one: Printed, own: Estimate, true: float) -> None:
    """Means of recordings with their intervals by samples, over the truth; on the right, all and ours."""
    number = np.arange(1, len(one.groups) + 1)
    mean, sd = one.groups.T / true
    axes.axhline(1.0, color=BLACK, lw=3, alpha=0.4, label="true")
    axes.errorbar(number, mean, coverage_factor() * sd, fmt="o", color=GREY, capsize=3, label="means")
    last = len(number)
    for x, e, colour, mark, label in (
        (last + 1.0, one.by_samples, ORANGE, "o", "printed, by samples"),
        (last + 1.3, one.by_groups, ORANGE, "s", "printed, by groups"),
        (last + 1.6, own, BLUE, "D", "ours"),
    ):
        if np.isfinite(e.sd):
            width = (e.high - e.low) / 2 / true
            axes.errorbar(x, e.value / true, width, fmt=mark, color=colour, capsize=3, label=label)
    axes.set_xticks(number)
    axes.margins(y=0.5)


def filters(axes: Axes, joints: Sequence[str], recordings: Sequence[Recording], known: Known) -> None:
    """B of (13) over the length of its filter, as printed and corrected for the noise of the speed."""
    for joint, colour in zip(joints, (BLUE, ORANGE, GREY), strict=False):
        sets = [r for r in recordings if r.procedure == "damping" and r.conditions["joint"] == joint]
        length, plain, corrected = over_filters(joint, sets, known).T
        true = known[named(joint)].value
        axes.plot(1e3 * length, plain / true, "o-", color=colour, label=joint)
        axes.plot(
            1e3 * length,
            corrected / true,
            "x:",
            color=colour,
            label="corrected" if joint == joints[-1] else None,
        )
    axes.set_title("Fig. 9: (13) over the length of its filter", fontsize="medium")
    axes.set_xlabel("length of the filter [ms]")
    axes.set_ylabel("B, over the true one")
    axes.margins(y=0.5)
