"""The rating of ISO/TS 18571 for two curves, by the package objective-rating-metrics of TU Graz.

    R = 0.4 Z + 0.2 (E_P + E_M + E_S)        each from 0 to 1, corridor, phase, magnitude and slope

The standard is made for crash pulses: it compares shapes, and has no meaning for a constant reference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.base.signals import moves
from orchestrator.data.table import Array

RATING = "the rating of ISO/TS 18571"
# The 10 kHz of the standard are meant for crash pulses of 0.1 s, which also have 1000 samples.
SAMPLES = 1000
FEWEST = 30  # samples of a signal
PARTS = ("overall", "corridor", "phase", "magnitude", "slope")
GRADES = ((0.94, "excellent"), (0.80, "good"), (0.58, "fair"))  # above


@dataclass(frozen=True)
class Rating:
    """Overall rating, its parts and its grade; all None, and a reason, if there is none."""

    overall: float | None = None
    corridor: float | None = None
    phase: float | None = None
    magnitude: float | None = None
    slope: float | None = None
    grade: str = "not rated"
    reason: str = ""


def rate(time: Array, simulation: Array, reference: Array) -> Rating:
    """Rating of a simulation, shape (n,) each, at equal steps of its time; or why there is none."""
    if not moves(reference):
        return Rating(reason="the reference is constant")
    if len(time) < FEWEST:
        return Rating(reason=f"{len(time)} samples are fewer than {FEWEST}")
    if np.array_equal(simulation, reference):
        return Rating(1.0, 1.0, 1.0, 1.0, 1.0, "excellent")
    from objective_rating_metrics.rating import ISO18571  # compiles for 10 s in each process

    even = np.linspace(time[0], time[-1], SAMPLES)
    curves = (np.column_stack((even, np.interp(even, time, y))) for y in (reference, simulation))
    with np.errstate(all="ignore"):  # a part of a signal may be constant: 0 divided by 0
        rated = ISO18571(*curves, dt=even[1] - even[0])
        parts = [float(getattr(rated, f"{part}_rating")(-1)) for part in PARTS]
    if not np.isfinite(parts).all():
        return Rating(reason="the shifted reference is constant, its slope cannot be rated")
    overall, corridor, phase, magnitude, slope = parts
    grade = next((grade for limit, grade in GRADES if overall > limit), "poor")
    return Rating(overall, corridor, phase, magnitude, slope, grade)
