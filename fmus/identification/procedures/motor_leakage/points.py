"""Steady points of a motor with a locked shaft: means of pressures and flows where both pressures stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.procedures.shared.given import tank_pressure
from fmus.identification.procedures.shared.standing import NEEDED, standing
from fmus.identification.recordings.masks import averages
from fmus.identification.recordings.recording import Recording

Array = NDArray[np.float64]
SIGNALS = {"pressure_a": "Pa", "pressure_b": "Pa", "flow_a": "m3/s", "drain_flow": "m3/s"}
PRESSURES = ("pressure_a", "pressure_b")


@dataclass(frozen=True)
class Points:
    """One entry per stretch, shape (n,): gauge pressures above the tank [Pa], flows [m3/s], standard errors.

    source   number of the recording
    """

    pressure_a: Array
    pressure_b: Array
    flow_a: Array
    drain: Array
    pressure_a_error: Array
    pressure_b_error: Array
    flow_a_error: Array
    drain_error: Array
    source: Array

    @property
    def difference(self) -> Array:
        """P_1 - P_2, over which the internal leakage flows."""
        return self.pressure_a - self.pressure_b

    @property
    def total(self) -> Array:
        """P_1 + P_2 above the tank, over which both external leakages flow."""
        return self.pressure_a + self.pressure_b


def points(recordings: Sequence[Recording]) -> Points:
    """All steady points of these recordings; at least three."""
    table = np.concatenate([_points(r, k) for k, r in enumerate(recordings)])
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < 3:
        raise ModelError(
            f"{recordings[0].source}: {len(table)} stretches with steady pressures, expected 3 or more of "
            f"{NEEDED:g} s"
        )
    return Points(*(table[:, i] for i, _ in enumerate(fields(Points))))


def _points(recording: Recording, number: int) -> Array:
    """(n, 9) in the order of `Points`."""
    if recording.conditions.get("shaft", "locked") != "locked":
        raise ModelError(
            f"{recording.source}: [experiment] shaft is {recording.conditions['shaft']!r}, expected 'locked'"
        )
    parts = standing(recording, PRESSURES)
    if not parts:
        return np.empty((0, len(fields(Points))))
    found = averages(recording, list(SIGNALS), parts)
    means, errors = (np.column_stack([one[n] for n in SIGNALS]) for one in (found.mean, found.error))
    means[:, :2] -= tank_pressure(recording)
    return np.column_stack([means, errors, np.full(len(parts), number)])
