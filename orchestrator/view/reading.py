"""The values of a frame by bare names, whatever machine it is of."""

from __future__ import annotations

import math

from orchestrator.live.setup import Frame, Machine
from orchestrator.view.scene.colours import colour
from orchestrator.view.scene.geometry import Geometry, Start
from orchestrator.view.scene.pose import Angles, Pose, pose
from orchestrator.view.signals import PRESSURES, columns

FULL = 25e6  # Pa; of the scale: the usual supply has 20.7 MPa
CHANNELS = tuple(name.replace("_pressure", "") for name in PRESSURES)  # as the parts of the crane say


class Reading:
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

    def pose(self, frame: Frame, geometry: Geometry, start: Start) -> Pose:
        """The machine at this frame; a joint that tells nothing stands where it began."""
        usual = (start.swing, start.boom, start.stick, 0.0, 0.0)
        names = ("swing_angle", "boom_angle", "stick_angle", "head_angle", "head_side_angle")
        told = [self.value(frame, name) for name in names]
        angles = [t if math.isfinite(t) else u for t, u in zip(told, usual, strict=True)]
        return pose(Angles(*angles), geometry)

    def colours(self, frame: Frame) -> dict[str, str]:
        """Channel -> the colour of its pressure."""
        values = (self.value(frame, name) for name in PRESSURES)
        return {channel: colour(value, FULL) for channel, value in zip(CHANNELS, values, strict=True)}
