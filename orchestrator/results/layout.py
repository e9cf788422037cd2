"""Layout of a report: its figures and moving points by signal name, read from a TOML file.

title = "My machine"
[[figure]]
title = "Boom"
panels = [{ label = "Angle", signals = ["arm.boom_angle"] }]
[motion]
angle = "arm.swing_angle"      # rotates the plane of the arm about the vertical; default: planar
points = [{ label = "tip", radius = "arm.tip_radius", height = 1.2 }]     # signals or numbers [m]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base import toml
from orchestrator.base.errors import Problem, UnknownSignal
from orchestrator.data.trace import Trace
from orchestrator.results.motion import MachineMotion


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
class MovingPoint:
    """One point in the plane of the arm; radius and height are signal names or numbers [m]."""

    label: str
    radius: str | float
    height: str | float

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals of radius and height."""
        return tuple(v for v in (self.radius, self.height) if isinstance(v, str))


@dataclass(frozen=True)
class _MotionTable:
    """The table [motion] of the file."""

    angle: str = ""
    tip: str = ""
    points: tuple[MovingPoint, ...] = ()
    lines: tuple[tuple[str, ...], ...] = ()
    ground: float = 0.0


@dataclass(frozen=True)
class Layout(_MotionTable):
    """Title, figures and moving points of a report; `source` is the file of the layout, for messages."""

    title: str = ""
    figures: tuple[FigureSpec, ...] = ()
    source: str = "layout"

    @property
    def signals(self) -> tuple[tuple[str, str], ...]:
        """All signals with the part of the layout that uses them, (part, signal)."""
        used = [(f"figure {f.title!r}", s) for f in self.figures for p in f.panels for s in p.signals]
        used += [(f"[motion] point {p.label!r}", s) for p in self.points for s in p.signals]
        return tuple(used + ([("[motion] angle", self.angle)] if self.angle else []))

    def check(self, trace: Trace) -> None:
        """Refuse a signal that the run lacks."""
        for where, signal in self.signals:
            if signal not in trace.signals:
                raise UnknownSignal(signal, trace.signals, f"{self.source}: {where}: ")

    def within(self, trace: Trace) -> Layout:
        """The layout without the signals that the trace lacks; empty rows and figures are left out."""
        figures = tuple(replace(f, panels=_available(f.panels, trace)) for f in self.figures)
        layout = replace(self, figures=tuple(f for f in figures if f.panels))
        return layout if self.motion(trace) else replace(layout, points=(), angle="", lines=(), tip="")

    def motion(self, trace: Trace) -> MachineMotion | None:
        """The moving points over time; None if there are none, or if the trace lacks one of their signals."""
        required = {s for p in self.points for s in p.signals} | ({self.angle} - {""})
        if not self.points or required - set(trace.signals):
            return None
        angle = trace[self.angle] if self.angle else np.zeros_like(trace.time)

        def values(source: str | float) -> NDArray[np.float64]:
            return trace[source] if isinstance(source, str) else np.full(trace.time.shape, float(source))

        points = {}
        for p in self.points:
            radius = values(p.radius)
            points[p.label] = np.column_stack(
                (radius * np.cos(angle), radius * np.sin(angle), values(p.height))
            )
        return MachineMotion(trace.time, points, self.lines, self.tip, bool(self.angle), self.ground)


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
    motion: _MotionTable = _MotionTable()


def read_layout(path: Path) -> Layout:
    """Read a layout; raises a Problem if a key is unknown, missing or of the wrong type."""
    file = toml.read_dataclass(_File, toml.read_file(path))
    for figure in file.figure:
        if not figure.panels:
            raise Problem(f"{path}: figure {figure.title!r}: panels: expected at least one, got none")
    labels = [point.label for point in file.motion.points]
    for label in (*(label for line in file.motion.lines for label in line), file.motion.tip):
        if label and label not in labels:
            expected = f"one of the points {', '.join(labels)}"
            raise Problem(f"{path}: motion: expected {expected}, got {label!r}")
    return Layout(**vars(file.motion), title=file.title, figures=file.figure, source=str(path))
