"""What a report shows, as data: figures and moving points by signal name, from a TOML file.

title = "My machine"
[[figure]]
title = "Boom"
panels = [{ label = "Angle", signals = ["arm.boom_angle"] }]
[motion]
angle = "arm.swing_angle"      # turns the plane of the arm about the vertical; left out: a planar machine
points = [{ label = "tip", radius = "arm.tip_radius", height = 1.2 }]     # signals or numbers [m]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base import toml
from orchestrator.base.errors import Problem, UnknownSignal
from orchestrator.data.trace import Trace
from orchestrator.results.motion import Motion


@dataclass(frozen=True)
class PanelSpec:
    """One row of a figure: signals of one quantity over time; `names` tells two of them apart."""

    label: str
    signals: tuple[str, ...]
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class FigureSpec:
    """A figure: its rows from top to bottom."""

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
        """The signals that move it."""
        return tuple(v for v in (self.radius, self.height) if isinstance(v, str))


@dataclass(frozen=True)
class Layout:
    """Title, figures and moving points of a report; `source` is the file it comes from."""

    title: str = ""
    figures: tuple[FigureSpec, ...] = ()
    points: tuple[MovingPoint, ...] = ()
    angle: str = ""
    tip: str = ""
    lines: tuple[tuple[str, ...], ...] = ()
    ground: float = 0.0
    source: str = "layout"

    @property
    def signals(self) -> tuple[tuple[str, str], ...]:
        """All signals with the places where they are used, (place, signal)."""
        used = [(f"figure {f.title!r}", s) for f in self.figures for p in f.panels for s in p.signals]
        used += [(f"[motion] point {p.label!r}", s) for p in self.points for s in p.signals]
        return tuple(used + ([("[motion] angle", self.angle)] if self.angle else []))

    def check(self, trace: Trace) -> None:
        """Refuse a layout with a signal that the run does not have."""
        for where, signal in self.signals:
            if signal not in trace.signals:
                raise UnknownSignal(signal, trace.signals, f"{self.source}: {where}: ")

    def within(self, trace: Trace) -> Layout:
        """The layout without what the trace lacks: signals, rows and figures left empty, the motion."""
        figures = tuple(replace(f, panels=_known(f.panels, trace)) for f in self.figures)
        kept = replace(self, figures=tuple(f for f in figures if f.panels))
        return kept if self.motion(trace) else replace(kept, points=(), angle="", lines=(), tip="")

    def motion(self, trace: Trace) -> Motion | None:
        """The moving points over time; None when the layout has none or the trace lacks a signal of them."""
        needed = {s for p in self.points for s in p.signals} | ({self.angle} - {""})
        if not self.points or needed - set(trace.signals):
            return None
        turn = trace[self.angle] if self.angle else np.zeros_like(trace.time)

        def values(of: str | float) -> NDArray[np.float64]:
            return trace[of] if isinstance(of, str) else np.full(trace.time.shape, float(of))

        points = {
            p.label: np.column_stack(
                (values(p.radius) * np.cos(turn), values(p.radius) * np.sin(turn), values(p.height))
            )
            for p in self.points
        }
        return Motion(trace.time, points, self.lines, self.tip, bool(self.angle), self.ground)


def _known(panels: Sequence[PanelSpec], trace: Trace) -> tuple[PanelSpec, ...]:
    """The panels with only the signals that the trace has, and only those that have any."""
    kept = []
    for panel in panels:
        places = [k for k, signal in enumerate(panel.signals) if signal in trace.signals]
        signals = tuple(panel.signals[k] for k in places)
        names = tuple(panel.names[k] for k in places if k < len(panel.names))
        kept += [replace(panel, signals=signals, names=names)] if places else []
    return tuple(kept)


@dataclass(frozen=True)
class _Motion:
    """The table [motion] of the file."""

    angle: str = ""
    tip: str = ""
    points: tuple[MovingPoint, ...] = ()
    lines: tuple[tuple[str, ...], ...] = ()
    ground: float = 0.0


@dataclass(frozen=True)
class _File:
    """The keys of the file."""

    title: str = ""
    figure: tuple[FigureSpec, ...] = ()
    motion: _Motion = _Motion()


def read_layout(path: Path) -> Layout:
    """Read a layout; a key that is unknown, missing or of the wrong type is a Problem."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise Problem(f"{path}: no such file") from None
    except OSError as error:
        raise Problem(f"{path}: cannot be read: {error.strerror}") from None
    file = toml.read_dataclass(_File, toml.read(path, data))
    for figure in file.figure:
        if not figure.panels:
            raise Problem(f"{path}: figure {figure.title!r}: panels: expected at least one, got none")
    labels = [point.label for point in file.motion.points]
    for label in (*(label for line in file.motion.lines for label in line), file.motion.tip):
        if label and label not in labels:
            expected = f"one of the points {', '.join(labels)}"
            raise Problem(f"{path}: motion: expected {expected}, got {label!r}")
    return Layout(file.title, file.figure, **vars(file.motion), source=str(path))
