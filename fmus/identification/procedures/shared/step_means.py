"""Means of drop and flow over the steps of a test, with standard errors, and which of them are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.recordings.masks import averages, dead, good
from fmus.identification.recordings.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SETTLE = 0.5  # s, left out at the beginning of each step
SHORTEST = 0.3  # s that must remain of it
FINEST = 1e-6  # of a mean: no instrument is better, whatever a noise-free signal says
NAMES = ("pressure_in", "pressure_out", "flow")


@dataclass(frozen=True)
class StepMeans:
    """One entry per step; arrays of shape (n,).

    drop, flow   means [Pa], [m3/s] and their standard errors
    dead         the flow meter is in its dead zone, if only at times: a mean of what it shows would be wrong
    clipped      an instrument is at an end of its range, if only at times
    good         measured: not dead, not clipped, half of the samples there
    """

    drop: Array
    drop_error: Array
    flow: Array
    flow_error: Array
    dead: Mask
    clipped: Mask
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
            f"{recording.source}: expected steps that stand for {SETTLE + SHORTEST:g} s or longer, found none"
        )
    found = averages(recording, NAMES, parts)
    asleep = dead(recording, "flow")
    # a gap takes nothing but its sample; what is read, but wrong, bends the mean
    wrong = np.logical_or.reduce([np.isfinite(recording[n]) & ~good(recording, n) for n in NAMES]) & ~asleep
    error = {n: np.maximum(found.error[n], FINEST * np.abs(found.mean[n])) for n in NAMES}
    drop = found.mean["pressure_in"] - found.mean["pressure_out"]
    in_dead, clipped = (np.array([bool(mask[part].any()) for part in parts]) for mask in (asleep, wrong))
    return StepMeans(
        drop=drop,
        drop_error=np.hypot(error["pressure_in"], error["pressure_out"]),
        flow=np.array([_mean(recording["flow"][part]) for part in parts]),  # also where it is masked: shown
        flow_error=error["flow"],
        dead=in_dead,
        clipped=clipped & ~in_dead,
        good=~in_dead & ~clipped & np.isfinite(drop + found.mean["flow"]),
    )


def _mean(values: Array) -> float:
    there = values[np.isfinite(values)]
    return float(there.mean()) if there.size else float("nan")


def left_out(dead: Mask, clipped: Mask, good: Mask) -> str:
    """How many steps are not measured and why, in words; empty if all are."""
    rest = ~(dead | clipped | good)
    counts = (
        (dead, "in the dead zone of the flow meter"),
        (clipped, "with an instrument at an end of its range"),
        (rest, "without enough samples or without flow"),
    )
    return ", ".join(f"{np.count_nonzero(mask)} {words}" for mask, words in counts if mask.any())
