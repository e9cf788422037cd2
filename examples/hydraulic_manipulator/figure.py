"""The pictures: one run with its error, and runs at several steps beside those of the benchmark's authors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orchestrator.data.recording import Recording
from orchestrator.data.trace import Trace

BLUE, ORANGE, GREY = "#06406b", "#c25a00", "#8a9099"


def draw(trace: Trace, truth: Trace, reference: Recording | None, path: Path) -> Path:
    """Write a picture of the run over the published solution and of its error from the joined ODE."""
    figure = Figure(figsize=(8, 8), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    command, length, pressure, error = figure.subplots(4, 1, sharex=True, height_ratios=(1, 2, 2, 2))
    command.plot(trace.time, trace["hydraulics.kappa"], color=BLUE)
    command.set_ylabel("valve $\\kappa$ [1]")
    curves = ((length, "arm.s1", "s1", 1.0, BLUE), (pressure, "hydraulics.p_1", "p_1", 1e-5, BLUE))
    for axes, name, label, factor, colour in (*curves, (pressure, "hydraulics.p_2", "p_2", 1e-5, ORANGE)):
        if reference:
            published = factor * reference[name]
            axes.plot(reference.time, published, color=GREY, lw=4, alpha=0.5, label=f"{label}, published")
        axes.plot(trace.time, factor * trace[name], color=colour, lw=1.2, label=f"{label}, two FMUs")
    length.set_ylabel("length [m]")
    pressure.set_ylabel("pressure [bar]")
    for name, label, colour in (("arm.s1", "s1", BLUE), ("hydraulics.p_1", "p_1", ORANGE)):
        share = np.abs(trace[name] - truth[name]) / np.max(np.abs(truth[name]))
        error.semilogy(trace.time, np.maximum(share, 1e-12), color=colour, lw=0.8, label=label)
    error.set_ylabel("error from the ODE\nof the largest value [1]")
    error.set_xlabel("time [s]")
    for axes in (command, length, pressure, error):
        axes.grid(color="#dfe2e6")
    for axes, place in ((length, "lower center"), (pressure, "center right"), (error, "lower right")):
        axes.legend(loc=place, fontsize="small", ncols=2)
    figure.savefig(path)
    return path


def draw_steps(
    runs: Mapping[str, Trace], published: Mapping[str, Recording], truth: Trace, path: Path
) -> Path:
    """Write a picture of the errors in s1 of runs (top) and of published co-simulations (bottom)."""
    figure = Figure(figsize=(8, 5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    own, theirs = figure.subplots(2, 1, sharex=True)
    for label, trace in runs.items():
        own.plot(trace.time, 1e3 * (trace["arm.s1"] - truth.at(trace.time)["arm.s1"]), lw=1, label=label)
    for (label, reference), colour in zip(published.items(), (ORANGE, BLUE), strict=True):
        time = reference.time[reference.time <= truth.time[-1]]
        values = reference["arm.s1"][: len(time)]
        theirs.plot(time, 1e3 * (values - truth.at(time)["arm.s1"]), color=colour, lw=1, label=label)
    own.set_ylabel("error of s1 [mm]\nthis project")
    theirs.set_ylabel("error of s1 [mm]\nits authors")
    theirs.set_xlabel("time [s]")
    for axes in (own, theirs):
        axes.grid(color="#dfe2e6")
        axes.legend(loc="upper left", fontsize="small")
    figure.savefig(path)
    return path
