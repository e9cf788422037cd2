"""Means of drop and flow over the steps of a test, with standard errors, and which of them are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.recordings.masks import averages, dead
from fmus.identification.recordings.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SETTLE = 0.5  # s, left out at the beginning of each step
SHORTEST = 0.3  # s that must remain of it


@dataclass(frozen=True)
class StepMeans:
    """One entry per step; arrays of shape (n,).

    drop, flow   means [Pa], [m3/s] and their standard errors
    dead         the flow meter is in its dead zone, if only at times: a mean of what it shows would be wrong
    good         measured: every sample is there, none dead, none clipped
    """

    drop: Array
    drop_error: Array
    flow: Array
    flow_error: Array
    dead: Mask
    good: Mask

    def where(self, mask: Mask) -> StepMeans:
        """The steps of a mask."""
        return StepMeans(**{name: array[mask] for name, array in vars(self).items()})

    @property
    def measured(self) -> StepMeans:
        """The steps that are measured."""
        return self.where(self.good)


def step_means(recording: Recording, parts: Sequence[slice]) -> StepMeans:
    """Means of pressure_in - pressure_out and of flow over stretches."""
    if not parts:
        raise ModelError(
            f"{recording.source}: expected steps that last {SETTLE + SHORTEST:g} s or longer, found none"
        )
    names = ("pressure_in", "pressure_out", "flow")
    found = averages(recording, names, parts)
    asleep = dead(recording, "flow")
    flow = [float(np.nanmean(recording["flow"][part])) for part in parts]  # also where it is masked: shown
    return StepMeans(
        drop=found.mean["pressure_in"] - found.mean["pressure_out"],
        drop_error=np.hypot(found.error["pressure_in"], found.error["pressure_out"]),
        flow=np.array(flow),
        flow_error=found.error["flow"],
        dead=np.array([bool(asleep[part].any()) for part in parts]),
        good=np.logical_and.reduce([found.share[name] == 1.0 for name in names]),
    )
