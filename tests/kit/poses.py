"""Poses all over the work space of the arm."""

from collections.abc import Iterator, Mapping

import numpy as np

# range of joint angles [rad] of the work space; the strokes allow slightly more
WORK_SPACE: Mapping[str, tuple[float, float]] = {"boom_angle": (-0.45, 1.0), "stick_angle": (-2.15, -0.6)}


def pose_grid(count: int = 9) -> Iterator[tuple[float, float]]:
    """A grid of count x count poses (boom angle, stick angle) [rad] over the work space."""
    for boom in np.linspace(*WORK_SPACE["boom_angle"], count):
        for stick in np.linspace(*WORK_SPACE["stick_angle"], count):
            yield float(boom), float(stick)
