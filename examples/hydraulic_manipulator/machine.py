"""The machine: the two subsystems and their wires."""

from __future__ import annotations

from collections.abc import Mapping

from arm import ARM
from hydraulics import HYDRAULICS

from fmus.contract import Subsystem

SUBSYSTEMS: Mapping[str, Subsystem] = {s.name: s for s in (HYDRAULICS, ARM)}

# the power port: force one way, motion the other
SIGNALS: tuple[tuple[str, str], ...] = (
    ("hydraulics.force", "arm.force"),
    ("arm.s1", "hydraulics.s1"),
    ("arm.s1_dot", "hydraulics.s1_dot"),
)

# rate ports: the exact time derivatives of force and velocity, optional
RATES: tuple[tuple[str, str], ...] = (
    ("hydraulics.force_rate", "arm.force_rate"),
    ("arm.s1_ddot", "hydraulics.s1_ddot"),
)

# used only to initialise: pressures that hold the arm
HOLDING: tuple[tuple[str, str], ...] = (("arm.holding_force", "hydraulics.holding_force"),)

INPUTS: Mapping[str, tuple[str, ...]] = {"kappa": ("hydraulics.kappa",)}
