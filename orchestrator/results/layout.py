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

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, UnknownSignal
from orchestrator.data.trace import Trace
from orchestrator.results.figures import FigureSpec, Panel
from orchestrator.results.motion import Motion

_NUMBER = (int, float)
_KEYS: Mapping[str, Mapping[str, Any]] = {
    "": {"title": str, "figure": list, "motion": dict},
    "figure": {"title": str, "caption": str, "panels": list},
    "panel": {"label": str, "signals": list, "names": list},
    "motion": {"angle": str, "tip": str, "points": list, "lines": list, "ground": _NUMBER},
    "point": {"label": str, "radius": (str, *_NUMBER), "height": (str, *_NUMBER)},
}
_KINDS = {
    _NUMBER: "a number",
    str: "text",
    list: "a list",
    dict: "a table",
    (str, *_NUMBER): "a signal or a number",
}


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
    def named(self) -> tuple[tuple[str, str], ...]:
        """All signals with the places where they are named, (place, signal)."""
        named = [(f"figure {f.title!r}", s) for f in self.figures for p in f.panels for s in p.signals]
        named += [(f"[motion] point {p.label!r}", s) for p in self.points for s in p.signals]
        return tuple(named + ([("[motion] angle", self.angle)] if self.angle else []))

    def check(self, trace: Trace) -> None:
        """Refuse a layout that names a signal the run does not have."""
        for where, signal in self.named:
            if signal not in trace.signals:
                raise UnknownSignal(signal, trace.signals, f"{self.source}: {where}: ")

    def within(self, trace: Trace) -> Layout:
        """The layout without what the trace lacks: signals, rows and figures left empty, the motion."""
        figures = tuple(replace(f, panels=_shown(f.panels, trace)) for f in self.figures)
        kept = replace(self, figures=tuple(f for f in figures if f.panels))
        return kept if self.motion(trace) else replace(kept, points=(), angle="", lines=(), tip="")

    def motion(self, trace: Trace) -> Motion | None:
        """The moving points over time; None when the layout has none or the trace lacks a signal of them."""
        named = {s for p in self.points for s in p.signals} | ({self.angle} - {""})
        if not self.points or named - set(trace.signals):
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


def read_layout(path: Path) -> Layout:
    """Read a layout; a key that is unknown, missing or of the wrong type is a Problem."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise Problem(f"{path}: no such file") from None
    except OSError as error:
        raise Problem(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise Problem(f"{path}: expected TOML, got {error}") from None
    _check(tables, "", f"{path}")
    motion = tables.get("motion", {})
    where = f"{path}: [motion]"
    _check(motion, "motion", where)
    points = motion.get("points", [])
    for point in points:
        _check(point, "point", f"{where} points", required=("label", "radius", "height"))
    labels = [point["label"] for point in points]
    lines = tuple(_texts(line, f"{where} lines") for line in motion.get("lines", []))
    for label in (*(label for line in lines for label in line), motion.get("tip", "")):
        if label and label not in labels:
            raise Problem(f"{where}: expected one of the points {', '.join(labels)}, got {label!r}")
    return Layout(
        title=tables.get("title", ""),
        figures=tuple(_figure(entry, path) for entry in tables.get("figure", [])),
        points=tuple(MovingPoint(**point) for point in points),
        angle=motion.get("angle", ""),
        tip=motion.get("tip", ""),
        ground=float(motion.get("ground", 0.0)),
        lines=lines,
        source=str(path),
    )


def _shown(panels: Sequence[Panel], trace: Trace) -> tuple[Panel, ...]:
    """The panels with only the signals that the trace has, and only those that have any."""
    kept = []
    for panel in panels:
        places = [k for k, signal in enumerate(panel.signals) if signal in trace.signals]
        signals = tuple(panel.signals[k] for k in places)
        names = tuple(panel.names[k] for k in places if k < len(panel.names))
        kept += [replace(panel, signals=signals, names=names)] if places else []
    return tuple(kept)


def _figure(entry: Mapping[str, Any], path: Path) -> FigureSpec:
    where = f"{path}: [[figure]]"
    _check(entry, "figure", where, required=("title", "panels"))
    panels = tuple(_panel(panel, f"{where} {entry['title']!r} panels") for panel in entry["panels"])
    if not panels:
        raise Problem(f"{where} {entry['title']!r}: expected at least one panel, got none")
    return FigureSpec(entry["title"], panels, entry.get("caption", ""))


def _panel(entry: Mapping[str, Any], where: str) -> Panel:
    _check(entry, "panel", where, required=("label", "signals"))
    texts = (_texts(entry.get(key, []), f"{where} {entry['label']!r} {key}") for key in ("signals", "names"))
    return Panel(entry["label"], *texts)


def _check(table: Any, kind: str, where: str, required: Sequence[str] = ()) -> None:
    """Refuse what is not a table, an unknown or missing key and a value of the wrong type."""
    if not isinstance(table, dict):
        raise Problem(f"{where}: expected a table, got {table!r}")
    known = _KEYS[kind]
    for key, value in table.items():
        if key not in known:
            raise Problem(f"{where}: unknown key {key!r}, expected one of {', '.join(known)}")
        if not isinstance(value, known[key]) or isinstance(value, bool):
            raise Problem(f"{where}: {key} is {value!r}, expected {_KINDS[known[key]]}")
    if missing := [key for key in required if key not in table]:
        raise Problem(f"{where}: {missing[0]} is missing")


def _texts(values: Any, where: str) -> tuple[str, ...]:
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise Problem(f"{where}: expected a list of names, got {values!r}")
    return tuple(values)
