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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.trace import Trace
from orchestrator.validation.figures import FigureSpec, Panel
from orchestrator.validation.motion import Motion

_KEYS = {
    "": {"title", "figure", "motion"},
    "figure": {"title", "caption", "panels"},
    "panel": {"label", "signals", "names"},
    "motion": {"angle", "tip", "points", "lines"},
    "point": {"label", "radius", "height"},
}


@dataclass(frozen=True)
class MovingPoint:
    """One point in the plane of the arm; radius and height are signal names or numbers [m]."""

    label: str
    radius: str | float
    height: str | float


@dataclass(frozen=True)
class Layout:
    """Title, figures and moving points of a report."""

    title: str = ""
    figures: tuple[FigureSpec, ...] = ()
    points: tuple[MovingPoint, ...] = ()
    angle: str = ""
    tip: str = ""
    lines: tuple[tuple[str, ...], ...] = ()

    def motion(self, trace: Trace) -> Motion | None:
        """The moving points during a run; None when the layout has none or the run lacks a signal of them."""
        named = {v for p in self.points for v in (p.radius, p.height, self.angle) if isinstance(v, str) and v}
        if not self.points or named - set(trace.signals):
            return None
        turn = trace[self.angle] if self.angle else np.zeros_like(trace.time)

        def values(of: str | float) -> NDArray[np.float64]:
            return trace[of] if isinstance(of, str) else np.full(trace.time.shape, of)

        points = {
            p.label: np.column_stack(
                (values(p.radius) * np.cos(turn), values(p.radius) * np.sin(turn), values(p.height))
            )
            for p in self.points
        }
        return Motion(trace.time, points, self.lines, self.tip, turning=bool(self.angle))


def read_layout(path: Path) -> Layout:
    """Read a layout; an unknown or missing key is a Problem."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise Problem(f"{path}: no such file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise Problem(f"{path}: expected TOML: {error}") from None
    _check(tables, "", f"{path}")
    motion = tables.get("motion", {})
    _check(motion, "motion", f"{path}: [motion]")
    points = motion.get("points", [])
    for point in points:
        _check(point, "point", f"{path}: [motion] points", required=("label", "radius", "height"))
    return Layout(
        title=tables.get("title", ""),
        figures=tuple(_figure(entry, path) for entry in tables.get("figure", [])),
        points=tuple(MovingPoint(**point) for point in points),
        angle=motion.get("angle", ""),
        tip=motion.get("tip", ""),
        lines=tuple(tuple(line) for line in motion.get("lines", [])),
    )


def _figure(entry: Mapping[str, Any], path: Path) -> FigureSpec:
    where = f"{path}: [[figure]]"
    _check(entry, "figure", where, required=("title", "panels"))
    for panel in entry["panels"]:
        _check(panel, "panel", f"{where} {entry['title']!r}", required=("label", "signals"))
    panels = tuple(Panel(p["label"], tuple(p["signals"]), tuple(p.get("names", ()))) for p in entry["panels"])
    return FigureSpec(entry["title"], panels, entry.get("caption", ""))


def _check(table: Any, kind: str, where: str, required: Sequence[str] = ()) -> None:
    if not isinstance(table, dict):
        raise Problem(f"{where}: expected a table, got {table!r}")
    if unknown := sorted(set(table) - _KEYS[kind]):
        raise Problem(f"{where}: unknown key {unknown[0]!r}, expected {', '.join(sorted(_KEYS[kind]))}")
    if missing := [key for key in required if key not in table]:
        raise Problem(f"{where}: {missing[0]} is missing")
