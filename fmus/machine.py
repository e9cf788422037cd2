"""The machine: which subsystems there are, how they are wired, where the arm works."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from fmus.boom_stick import BOOM_STICK
from fmus.contract import Subsystem
from fmus.levers import LEVERS
from fmus.manipulator import MANIPULATOR
from fmus.swing import SWING

# the machine; and what is built: the machine and its levers
SUBSYSTEMS: Mapping[str, Subsystem] = {s.name: s for s in (SWING, BOOM_STICK, MANIPULATOR)}
ALL: Mapping[str, Subsystem] = {**SUBSYSTEMS, LEVERS.name: LEVERS}

# power ports: what flows over each port and back
SIGNALS: tuple[tuple[str, str], ...] = (
    ("swing.swing_torque", "manipulator.swing_torque"),
    ("manipulator.swing_speed", "swing.swing_speed"),
    ("boom_stick.boom_force", "manipulator.boom_force"),
    ("manipulator.boom_position", "boom_stick.boom_position"),
    ("manipulator.boom_velocity", "boom_stick.boom_velocity"),
    ("boom_stick.stick_force", "manipulator.stick_force"),
    ("manipulator.stick_position", "boom_stick.stick_position"),
    ("manipulator.stick_velocity", "boom_stick.stick_velocity"),
)

# rate ports: the exact time derivatives of those signals, optional
RATES: tuple[tuple[str, str], ...] = (
    ("swing.swing_torque_rate", "manipulator.swing_torque_rate"),
    ("manipulator.swing_acceleration", "swing.swing_acceleration"),
    ("boom_stick.boom_force_rate", "manipulator.boom_force_rate"),
    ("manipulator.boom_acceleration", "boom_stick.boom_acceleration"),
    ("boom_stick.stick_force_rate", "manipulator.stick_force_rate"),
    ("manipulator.stick_acceleration", "boom_stick.stick_acceleration"),
)

# used only to initialise: pressures that hold the pose
HOLDING: tuple[tuple[str, str], ...] = (
    ("manipulator.boom_holding_force", "boom_stick.boom_holding_force"),
    ("manipulator.stick_holding_force", "boom_stick.stick_holding_force"),
)

CONNECTIONS = SIGNALS + RATES + HOLDING

# from the levers, each with its rate
COMMAND_WIRES: tuple[tuple[str, str], ...] = tuple(
    (f"levers.{lever}_command{suffix}", f"{part}.{lever}_command{suffix}")
    for lever, part in (("swing", "swing"), ("boom", "boom_stick"), ("stick", "boom_stick"))
    for suffix in ("", "_rate")
)

# inputs of the machine without levers and the component inputs they feed
INPUTS: Mapping[str, tuple[str, ...]] = {
    **{end.split(".")[1]: (end,) for _, end in COMMAND_WIRES},
    "supply_pressure": ("swing.supply_pressure", "boom_stick.supply_pressure"),
    "supply_pressure_rate": ("swing.supply_pressure_rate", "boom_stick.supply_pressure_rate"),
    "tank_pressure": ("swing.tank_pressure", "boom_stick.tank_pressure"),
}

# joint angles [rad] between which the arm works; the strokes reach a little further
WORK_SPACE: Mapping[str, tuple[float, float]] = {"boom_angle": (-0.45, 1.0), "stick_angle": (-2.15, -0.6)}


def poses(count: int = 9) -> Iterator[tuple[float, float]]:
    """A grid of count x count poses (boom angle, stick angle) [rad] over the work space."""
    for boom in np.linspace(*WORK_SPACE["boom_angle"], count):
        for stick in np.linspace(*WORK_SPACE["stick_angle"], count):
            yield float(boom), float(stick)
