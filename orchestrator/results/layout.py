"""Layout of a report: its figures by signal name, read from a TOML file.

title = "My machine"
[[figure]]
title = "Boom"
panels = [{ label = "Angle", signals = ["arm.boom_angle"] }]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

from orchestrator.base import toml
from orchestrator.base.errors import Problem, UnknownSignal
from orchestrator.data.trace import Trace


@dataclass(frozen=True)
class PanelSpec:
    """One row of a figure: signals of one quantity over time; `names` are their labels."""

    label: str
    signals: tuple[str, ...]
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class FigureSpec:
    """A figure with its rows from top to bottom."""

    title: str
    panels: tuple[PanelSpec, ...]
    caption: str = ""


@dataclass(frozen=True)
class Layout:
    """Title and figures of a report; `source` is the file of the layout, for messages."""

    title: str = ""
    figures: tuple[FigureSpec, ...] = ()
    source: str = "layout"

    @property
    def signals(self) -> tuple[tuple[str, str], ...]:
        """All signals with the figure that uses them, (figure, signal)."""
        return tuple((f"figure {f.title!r}", s) for f in self.figures for p in f.panels for s in p.signals)

    def check(self, trace: Trace) -> None:
        """Refuse a signal that the run lacks."""
        for where, signal in self.signals:
            if signal not in trace.signals:
                raise UnknownSignal(signal, trace.signals, f"{self.source}: {where}: ")

    def within(self, trace: Trace) -> Layout:
        """The layout without the signals that the trace lacks; empty rows and figures are left out."""
        figures = tuple(replace(f, panels=_available(f.panels, trace)) for f in self.figures)
        return replace(self, figures=tuple(f for f in figures if f.panels))


def _available(panels: Sequence[PanelSpec], trace: Trace) -> tuple[PanelSpec, ...]:
    """The panels with the signals that the trace has; panels without signals are left out."""
    available = []
    for panel in panels:
        kept = [signal in trace.signals for signal in panel.signals]
        signals, names = (tuple(compress(texts, kept)) for texts in (panel.signals, panel.names))
        available += [replace(panel, signals=signals, names=names)] if signals else []
    return tuple(available)


@dataclass(frozen=True)
class _File:
    """The keys of the file."""

    title: str = ""
    figure: tuple[FigureSpec, ...] = ()


def read_layout(path: Path) -> Layout:
    """Read a layout; raises a Problem if a key is unknown, missing or of the wrong type."""
    file = toml.read_dataclass(_File, toml.read_file(path))
    for figure in file.figure:
        if not figure.panels:
            raise Problem(f"{path}: figure {figure.title!r}: panels: expected at least one, got none")
    return Layout(file.title, file.figure, str(path))
