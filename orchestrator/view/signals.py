"""Signals by their bare names: which of a system the page shows, and where they stand in its frames."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

from orchestrator.realtime.setup import Frame, Machine
from orchestrator.ssp.system import System
from orchestrator.view.scene.canvas import colour
from orchestrator.view.scene.pose import ANGLES, Angles, Geometry, ScenePose, Start, pose

PRESSURES = (
    "boom_head_pressure",
    "boom_rod_pressure",
    "stick_head_pressure",
    "stick_rod_pressure",
    "swing_pressure_a",
    "swing_pressure_b",
)
SHOWN = (
    *ANGLES,
    *PRESSURES,
    *("supply_pressure", "pump_1_pressure", "pump_2_pressure", "tank_pressure"),
    *("swing_speed", "boom_speed", "stick_speed", "boom_velocity", "stick_velocity"),
    *("boom_position", "stick_position", "boom_stop_force", "stick_stop_force"),
    *("tip_x", "tip_y", "tip_height", "tip_radius", "tip_radial_velocity", "tip_vertical_velocity"),
    *("head_x", "head_y", "head_height", "head_side_speed", "head_speed"),
    *("supply_flow", "hydraulic_power", "engine_power", "engine_speed", "engine_torque"),
    *("pump_1_stroke", "pump_2_stroke", "pump_1_flow", "pump_2_flow", "relief_flow"),
    *("swing_command", "boom_command", "stick_command"),
    *("reference_radius", "reference_height", "reference_angle", "tip_error"),
    *("speed_use", "stroke_use", "reference_share"),
)


def watched(system: System, driven: Collection[str] = ()) -> tuple[str, ...]:
    """`component.variable` of the outputs that are shown, as far as the system has them.

    driven   inputs that a hand drives: what else would drive them, such as a program of levers, is not shown
    """
    found = by_bare_name(str(port) for port in system.ports("output"))
    return tuple(dict.fromkeys(found[name] for name in SHOWN if name in found and name not in driven))


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


FULL = 25e6  # Pa; of the scale: the usual supply has 20.7 MPa
CHANNELS = tuple(name.replace("_pressure", "") for name in PRESSURES)  # as the parts of the crane say


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

    def pose(self, frame: Frame, geometry: Geometry, start: Start) -> ScenePose:
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
