"""The picture: measured runs over the prediction and its 95 % band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from prediction import Band

from orchestrator.data.recording import Recording

ROWS = {
    "position": ("position [m]", 1.0),
    "head_pressure": ("head pressure [MPa]", 1e-6),
    "rod_pressure": ("rod pressure [MPa]", 1e-6),
}
BLUE, ORANGE, GREY = "#06406b", "#c25a00", "#8a9099"


def draw(
    steps: Mapping[int, tuple[Band, Sequence[Recording]]], noise: Mapping[str, float], path: Path
) -> Path:
    """Write a picture with a column for each step [V]."""
    figure = Figure(figsize=(11, 8), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(ROWS), len(steps), sharex="col", sharey="row", squeeze=False)
    for column, (volts, (band, runs)) in enumerate(steps.items()):
        for row, (output, (label, factor)) in enumerate(ROWS.items()):
            axes = panels[row, column]
            for run in runs:
                if output in run.signals:
                    axes.plot(run.time, factor * run[output], color=GREY, lw=0.5)
            count = len(band.time)
            low, high = (factor * limit for limit in band.limits(output, noise[output], count))
            axes.fill_between(band.time, low, high, color=ORANGE, alpha=0.3, lw=0, label="95 % band")
            axes.plot(band.time, factor * band.curve[output], color=BLUE, lw=1, label="FMU")
            axes.grid(color="#dfe2e6")
            if column == 0:
                axes.set_ylabel(label)
        panels[0, column].set_title(f"+-{volts} V, held out")
        panels[-1, column].set_xlabel("time [s]")
    panels[0, 0].plot([], [], color=GREY, lw=0.5, label="measured runs")
    panels[0, 0].legend(loc="lower center", fontsize="small")
    for axes in panels[1:].flat:
        axes.set_ylim(bottom=min(0.0, float(np.min(axes.get_ylim()))))
    figure.savefig(path)
    return path
