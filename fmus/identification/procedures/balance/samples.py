"""Angles, speeds and pressures of one recording, smoothed, as the equation of motion takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.procedures.balance import modulation
from fmus.identification.procedures.balance.modulation import SMOOTHING, WINDOW, Filters
from fmus.identification.procedures.balance.motion import ALL_PRESSURES, ANGLES, PARAMETERS, PRESSURES, motion
from fmus.identification.procedures.shared.given import filled, noise_of, tank_pressure
from fmus.identification.recordings.masks import good_all
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.resampling import uniform_rate
from fmus.parameters import Number

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
STOP_MARGIN = 2e-3  # m from the ends of a stroke, beyond which the stops are said to touch


@dataclass(frozen=True)
class Samples:
    """One recording, smoothed: arrays (rows, n); `good` (n - bump + 1,) where the filtered equation holds.

    angle_noise, pressure_noise   standard deviation of one sample of each sensor
    touched                       samples left out since a piston was at the end of its stroke
    """

    time: Array
    q: Array
    w: Array
    pressures: Array
    tank: float
    filters: Filters
    good: Mask
    angle_noise: Array
    pressure_noise: Array
    touched: int

    @property
    def known(self) -> tuple[Array, Array, Array, float]:
        """The first arguments of the functions of `motion`."""
        return self.q, self.w, self.pressures, self.tank

    @property
    def middle(self) -> slice:
        """The smoothed samples at which the filtered equation stands."""
        half = self.filters.bump.size // 2
        return slice(half, self.q.shape[1] - half)


def samples(
    recording: Recording,
    joints: Sequence[str],
    p: Array,
    smoothing: float = SMOOTHING,
    window: float = WINDOW,
    every: int = 1,
) -> Samples:
    """A recording made ready for the balance of these joints; the rest as in `modulation.filters`."""
    kernels = modulation.filters(uniform_rate(recording), smoothing, window, every)
    needed = [n for j in joints for n in PRESSURES[j]]
    if recording.time.size < 2 * kernels.loss + 10:
        raise ModelError(
            f"{recording.source}: {recording.time.size} samples, expected {2 * kernels.loss + 10} or more: "
            "the filters take them"
        )
    zero = np.zeros(recording.time.size)
    raw = np.array([filled(recording[n]) for n in ANGLES])
    q, w = kernels.smoothed(raw), kernels.slopes(raw)
    measured = [filled(recording[n]) if n in needed else zero for n in ALL_PRESSURES]
    smooth = kernels.smoothed(np.array(measured))
    bad = ~good_all(recording, (*ANGLES, *needed))
    ends = _at_ends(q, p)
    unusable = ~modulation.spread(bad, kernels.smooth.size)[::every]
    half = kernels.smooth.size // 2
    good = modulation.spread(unusable | ends, kernels.bump.size)
    if not good.any():
        raise ModelError(
            f"{recording.source}: expected {2 * kernels.loss * kernels.step / every:.2g} s without a gap or "
            f"clipped sample in {', '.join((*ANGLES, *needed))}, found none"
        )
    return Samples(
        time=recording.time[half : recording.time.size - half : every],
        q=q,
        w=w,
        pressures=smooth,
        tank=tank_pressure(recording),
        filters=kernels,
        good=good,
        angle_noise=np.array([noise_of(recording, n) for n in ANGLES]),
        pressure_noise=np.array([noise_of(recording, n) if n in needed else 0.0 for n in ALL_PRESSURES]),
        touched=int(ends.sum()),
    )


def _at_ends(q: Array, p: Array) -> Mask:
    position: Array = np.array(motion(()).pistons(q, p)[0].full())
    strokes = np.array([p[PARAMETERS.index(f"manipulator.{j}_stroke")] for j in ("boom", "stick")])[:, None]
    touched: Mask = np.any((position < STOP_MARGIN) | (position > strokes - STOP_MARGIN), axis=0)
    return touched


def numbers(known: Mapping[str, Number]) -> Array:
    """The machine's parameters in the order of `motion.PARAMETERS`."""
    missing = [n for n in PARAMETERS if n not in known]
    if missing:
        raise ModelError(f"known parameters: {missing[0]} is missing, expected all of the lumped machine")
    return np.array([known[n].value for n in PARAMETERS])
