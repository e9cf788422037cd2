"""What an operator may want of the tip, for experiments with the controller alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def spells(time: Array) -> dict[str, Array]:
    """Inputs by name over time [s]: engaged twice, the second time along a path, else at the levers."""
    half = np.round(np.sin(np.pi * time), 3)  # few digits: they go into a file
    first, second = (time >= 2) & (time < 4), (time >= 6) & (time < 7.5)
    wanted = {
        "engaged": first | second,
        "follow": second,
        "radial_velocity": 0.3 * half,
        "vertical_velocity": 0.2 * half,
        "swing_velocity": 0.1 * half,
        "path_radius": 4.5 + 0.1 * half,
        "path_height": 0.2 * half,
        "path_angle": 0.4 + 0.05 * half,
    }
    return {n: np.round(samples.astype(np.float64), 6) for n, samples in wanted.items()}
