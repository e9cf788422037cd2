"""Signals by their bare names: which of a system the page shows, and where they stand in its frames."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

from orchestrator.realtime.setup import Frame, Machine
from orchestrator.ssp.system import System
from orchestrator.view.scene.canvas import colour
from orchestrator.view.scene.pose import Angles, Geometry, ScenePose, Start, pose


def watched(system: System, shown: Sequence[str], driven: Collection[str] = ()) -> tuple[str, ...]:
    """`component.variable` of the outputs with these bare names, as far as the system has them.

    driven   inputs that a hand drives: what else would drive them, such as a program of levers, is not shown
    """
    found = by_bare_name(str(port) for port in system.ports("output"))
    return tuple(dict.fromkeys(found[name] for name in shown if name in found and name not in driven))


def by_bare_name(names: Iterable[str]) -> Mapping[str, str]:
    """Bare name -> full name. Where several have it, the component that the name begins with is meant:
    `supply_flow` is that of `supply`, not what one drive takes."""
    found = dict[str, str]()
    for name in names:
        component, _, bare = name.rpartition(".")
        if bare not in found or (component and bare.startswith(component.rpartition(".")[2])):
            found[bare] = name
    return found


def columns(names: Sequence[str]) -> Mapping[str, int]:
    """Bare name -> place among the names."""
    place = {name: k for k, name in enumerate(names)}
    return {bare: place[full] for bare, full in by_bare_name(names).items()}


class SignalIndex:
    """Where each value stands in the frames of one machine; what is not there is not a number."""

    def __init__(self, machine: Machine) -> None:
        self._signals, self._axes = columns(machine.signals), columns(machine.axes)

    def knows(self, name: str) -> bool:
        """Is there such a signal or axis?"""
        return name in self._signals or name in self._axes

    def value(self, frame: Frame, name: str) -> float:
        """A signal by its bare name; what drives the machine comes first."""
        if name in self._axes:
            return float(frame.axes[self._axes[name]])
        if name in self._signals:
            return float(frame.values[self._signals[name]])
        return math.nan

    def column(self, name: str) -> tuple[str, int] | None:
        """Where a bare name stands: among the "axes" or among the "values"."""
        if name in self._axes:
            return "axes", self._axes[name]
        return ("values", self._signals[name]) if name in self._signals else None

    def pose(self, frame: Frame, joints: Sequence[str], geometry: Geometry, start: Start) -> ScenePose:
        """The machine at this frame; a joint whose angle is not known stays as at the start."""
        usual = (start.swing, start.boom, start.stick, 0.0, 0.0)
        values = [self.value(frame, name) for name in joints]
        angles = [v if math.isfinite(v) else u for v, u in zip(values, usual, strict=True)]
        return pose(Angles(*angles), geometry)

    def colours(self, frame: Frame, pressures: Mapping[str, str], full: float) -> dict[str, str]:
        """Part of the drawing -> the colour of its pressure, on a scale to `full` [Pa]."""
        return {part: colour(self.value(frame, name), full) for part, name in pressures.items()}
