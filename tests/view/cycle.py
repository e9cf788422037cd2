"""A cycle of the training task whose scores are known in closed form."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orchestrator.data.trace import Trace
from orchestrator.view.task.score import Exercise, Target

Array = NDArray[np.float64]
STEP = 0.01
RADIUS, ARC, HEIGHT = 4.0, 1.0, 1.5
T_SWING, T_REST, T_RISE = 4.0, 2.0, 3.0
EXERCISE = Exercise(
    "arc and lift",
    (
        Target("pick", (RADIUS * math.cos(ARC), RADIUS * math.sin(ARC), 0.0)),
        Target("place", (RADIUS * math.cos(ARC), RADIUS * math.sin(ARC), HEIGHT)),
    ),
)


def blend(
    t: NDArray[np.float64], start: float, duration: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """From 0 to 1 as half a cosine, and its rate."""
    phase = np.clip((t - start) / duration, 0, 1) * math.pi
    return (1 - np.cos(phase)) / 2, np.sin(phase) * math.pi / (2 * duration)


def cycle() -> Trace:
    """Swing over an arc, rest, rise by a height (boom and stick together), rest."""
    time = np.arange(0, 12, STEP)
    swung, swing_rate = blend(time, 1.0, T_SWING)
    risen, rise_rate = blend(time, 1.0 + T_SWING + T_REST, T_RISE)
    values = {
        "tip_x": RADIUS * np.cos(ARC * swung),
        "tip_y": RADIUS * np.sin(ARC * swung),
        "tip_height": HEIGHT * risen,
        "tip_radial_velocity": 0 * time,
        "tip_vertical_velocity": HEIGHT * rise_rate,
        "swing_speed": ARC * swing_rate,
        "boom_speed": 0.4 * rise_rate,
        "stick_speed": -0.4 * rise_rate,
        "swing_pressure_a": 1e6 + 5e6 * swing_rate,
        "boom_head_pressure": 8e6 + 0 * time,
        "supply_pressure": 2e7 + 0 * time,
        "supply_flow": 1e-3 * (swing_rate + rise_rate),
    }
    return Trace(time, {f"machine.{name}": value for name, value in values.items()})


def when(share: float, duration: float) -> float:
    """When half a cosine has done this share of its way."""
    return duration * math.acos(1 - 2 * share) / math.pi


def slow_after(rate: float, duration: float) -> float:
    """When the rate of half a cosine has fallen to this."""
    return duration * (1 - math.asin(rate * 2 * duration / math.pi) / math.pi)
