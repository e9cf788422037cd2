"""The paper's (13) as printed: B = (x'^T x')^-1 x'^T a, with a = tau - M q'' - V - G at every sample.

One Savitzky-Golay filter for all: angles, their first and second derivatives, and pressures. The noise v of
the speed q' is in x' = J q' and takes off B what it adds to the denominator; in a it is with df/dq':

    B = (sum x' a - sd(v)^2 sum df/dq') / (sum x'^2 - sd(v)^2 sum J^2)        corrected

(Fuller 1987, Measurement Error Models, section 1.2). The noise of q'' is not correlated with v: one kernel
is even, the other odd. J = 1 for the swing, whose x' is its speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.procedures.balance import modulation
from fmus.identification.procedures.balance.modulation import ORDER
from fmus.identification.procedures.balance.motion import (
    ALL_PRESSURES,
    ANGLES,
    JOINTS,
    PARAMETERS,
    PRESSURES,
    motion,
)
from fmus.identification.procedures.shared.given import filled, noise_of, tank_pressure
from fmus.identification.recordings.derivatives import SavitzkyGolay
from fmus.identification.recordings.masks import good_all
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.resampling import uniform_rate

Array = NDArray[np.float64]
SIZES = (ORDER + 1, 9, 21)  # samples of the derivative filter to compare


@dataclass(frozen=True)
class Plain:
    """B by (13) with a filter of `window` [s], as it is and with the noise of the speed taken off."""

    window: float
    value: float
    corrected: float


def levers(joint: str, q: Array, p: Array) -> Array:
    """x' over the joint's speed at angles q (3, n): 1 or the moment arm of the cylinder [m], shape (n,)."""
    if joint == "swing":
        return np.ones(q.shape[1])
    arms: Array = np.array(motion(()).pistons(q, p)[1].full())
    return np.array(arms[JOINTS.index(joint) - 1])


def least_squares(recordings: Sequence[Recording], joint: str, theta: str, p: Array) -> list[Plain]:
    """(13) over all recordings, for filters from the shortest to a long one; theta is the damping."""
    at, step = p.copy(), 1 / uniform_rate(recordings[0])
    at[PARAMETERS.index(theta)] = 0.0
    return [_solved(size * step, [_sums(r, joint, at, size) for r in recordings]) for size in SIZES]


def _solved(window: float, sums: Sequence[Array]) -> Plain:
    product, square, of_product, of_square = np.sum(sums, axis=0)
    return Plain(window, product / square, (product - of_product) / (square - of_square))


def _sums(recording: Recording, joint: str, p: Array, size: int) -> Array:
    """Sums of x' a and x'^2, and what the noise adds to them in the mean."""
    row, rate = JOINTS.index(joint), uniform_rate(recording)
    kernel = SavitzkyGolay(rate, (size - 1) / rate, ORDER)
    there = modulation.spread(~good_all(recording, (*ANGLES, *PRESSURES[joint])), size)
    value, slope, curve = (weights[::-1] for weights in kernel.weights)
    raw = np.array([filled(recording[n]) for n in ANGLES])
    q, w, bend = (modulation.apply(k, raw)[:, there] for k in (value, slope, curve))
    zero, needed = np.zeros(recording.time.size), PRESSURES[joint]
    measured = [filled(recording[n]) if n in needed else zero for n in ALL_PRESSURES]
    pressures = modulation.apply(value, np.array(measured))[:, there]
    f, tank = motion(()), tank_pressure(recording)
    error, by_speed, arm = (x.full()[row] for x in f.printed(q, w, bend, pressures, tank, p))
    v = kernel.gain(1) * noise_of(recording, ANGLES[row])
    product, square = w[row] @ error, np.sum((arm * w[row]) ** 2)
    return np.array([product, square, v**2 * by_speed.sum(), v**2 * np.sum(arm**2)])
