"""The pictures of docs/fidelity.md."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from fidelity_cases import IN, OUT, SWING, TURN, Trace
from fidelity_measures import BAR, SETTLE, Ripple, return_side
from fidelity_tables import Outcome
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, GRID = "#1c2024", "#dfe2e6"
# colour and line of each case, told apart in print, too
STYLES = (
    {"color": "#9aa3ad", "linewidth": 3.2},
    {"color": "#0b5fa5", "linewidth": 1.3},
    {"color": "#b34700", "linewidth": 1.3, "linestyle": (0, (5, 1.5))},
    {"color": "#00735a", "linewidth": 1.3, "linestyle": (0, (1.2, 1.2))},
    {"color": "#8f3f8f", "linewidth": 1.3, "linestyle": (0, (6, 1.5, 1, 1.5))},
)
Lines = Mapping[str, Trace]


def ripple(out: Lines, back: Lines, spectra: Mapping[str, tuple[Ripple, Ripple]], image: Path) -> None:
    """Return pressure of the stick over time while the lever is held, and its spectrum."""
    figure = Figure(figsize=(10, 6.2), layout="constrained")
    axes = figure.subplots(2, 2, width_ratios=(1.7, 1))
    for row, (test, lines) in enumerate(((OUT, out), (IN, back))):
        move = test.moves()[0]
        words = "out, oil returns from the head side" if row == 0 else "in, oil returns from the rod side"
        for (name, trace), style in zip(lines.items(), STYLES, strict=True):
            axes[row, 0].plot(trace["time"] - move.start, trace[return_side(move)] / BAR, label=name, **style)
        axes[row, 0].set(title=f"stick {words}", xlabel="time since the lever moves [s]", ylabel="[bar]")
        axes[row, 0].set_xlim(move.rise, move.rise + move.hold - 0.01)
        for (_, found), style in zip(spectra.items(), STYLES, strict=True):
            _spectrum(axes[row, 1], found[row], style)
        axes[row, 1].set_title("amplitude, five ramps together")
        axes[row, 1].set(xlabel="frequency [Hz]", ylabel="[bar RMS in half an octave]")
    top = (OUT.moves()[0].rise + SETTLE, OUT.moves()[0].rise + OUT.stroke.hold)
    axes[0, 0].set_ylim(*_limits(out, return_side(OUT.stroke), *(t + OUT.stroke.start for t in top)))
    end = IN.moves()[0].rise + IN.stroke.hold
    axes[1, 0].set_ylim(*_limits(back, return_side(IN.stroke), IN.stroke.start + 0.4, IN.stroke.start + end))
    _finish(axes.flat)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    figure.savefig(image, dpi=120)


def _limits(lines: Lines, name: str, begin: float, end: float) -> tuple[float, float]:
    """What all curves need between two instants."""
    parts = [t[name][(t["time"] >= begin) & (t["time"] <= end)] / BAR for t in lines.values()]
    low, high = min(p.min() for p in parts), max(p.max() for p in parts)
    return low - 0.15 * (high - low), high + 0.15 * (high - low)


def _spectrum(axes: Axes, found: Ripple, style: dict[str, object]) -> None:
    """RMS in bands of half an octave, from 0.35 Hz to 32 Hz."""
    edges = 2.0 ** np.arange(-1.5, 5.01, 0.125)
    width = 2.0**0.25
    bands = [(found.frequency >= f / width) & (found.frequency < f * width) for f in edges]
    axes.plot(edges, [np.sqrt(found.power[band].sum()) for band in bands], **style)
    axes.set(xscale="log", yscale="log", ylim=(1e-3, 6))
    axes.set_xticks([0.5, 1, 2, 4, 8, 16, 32], ["0.5", "1", "2", "4", "8", "16", "32"])
    axes.minorticks_off()


def swing(lines: Lines, outcomes: Mapping[str, Outcome], base: Outcome, image: Path) -> None:
    """Both pressures of the swing over one stroke, and the change of every peak of the work cycle."""
    figure = Figure(figsize=(10, 6.6), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1.25, 1))
    axes = left.subplots(2, 1, sharex=True)
    move = TURN.moves()[2]
    for ax, line, words in zip(axes, "ab", ("driving", "braking"), strict=True):
        for (name, trace), style in zip(lines.items(), STYLES, strict=False):
            values = trace[f"swing.swing_pressure_{line}"] / BAR
            ax.plot(trace["time"] - move.start, values, label=name, **style)
        ax.set(title=f"{words} line, swing alone from rest", ylabel="[bar]")
    axes[-1].set(xlabel="time since the lever moves [s]", xlim=(0, 5))
    left.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    dots = right.subplots(2, 1, sharex=True)
    for side, (ax, words) in enumerate(zip(dots, ("start", "stop"), strict=True)):
        _dots(ax, outcomes, base, side)
        ax.set_title(f"peaks at the {words} of the {len(SWING)} swing strokes")
    dots[-1].set_xlabel("change from the paper's set [%]")
    _finish((*axes, *dots))
    figure.savefig(image, dpi=120)


def _dots(axes: Axes, outcomes: Mapping[str, Outcome], base: Outcome, side: int) -> None:
    for row, one in enumerate(outcomes.values()):
        change = 100 * (one.peaks["cycle"][:, side] / base.peaks["cycle"][:, side] - 1)
        axes.plot(change, np.full(len(change), -row), "o", color="#0b5fa5", markersize=5, alpha=0.6)
        axes.plot([change.mean()] * 2, [-row - 0.3, -row + 0.3], color="#b34700", linewidth=2)
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.set_yticks(-np.arange(len(outcomes)), list(outcomes))


def _finish(axes: object) -> None:
    for ax in axes:  # type: ignore[attr-defined]
        ax.grid(color=GRID, linewidth=0.6)
        ax.spines[["top", "right"]].set_visible(False)
        ax.title.set(fontsize=9, color=INK)
        ax.tick_params(labelsize=8)
