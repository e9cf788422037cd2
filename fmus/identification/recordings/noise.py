"""Noise and quantisation step of a signal, estimated from the signal alone."""

from __future__ import annotations

import math

import numpy as np

from fmus.identification.recordings.recording import Array, Sensor

ORDER = 6  # of the difference: passes white noise, and 1e-3 of an oscillation at a twentieth of the rate
MAD = 0.6744897501960817  # median of |x| over the sd of a normal x
LEVELS = 8  # fewer different values are no converter's steps
MOVES = 0.02  # share of samples that differ from the one before, below which steps are those of a command


def noise(values: Array, sensor: Sensor | None = None) -> float:
    """Standard deviation of the white noise of one sample; NaN if there are too few samples.

    The median of the sixth difference: it does not see a smooth signal, nor what less than half of the
    recording does. Samples in the dead zone are left out.
    """
    difference = np.abs(np.diff(_out_of_dead_zone(values, sensor), ORDER))
    difference = difference[np.isfinite(difference)]
    if len(difference) < 4 * ORDER:
        return math.nan
    found = _spread(difference, ORDER)
    # below this it is rounding of the numbers, not noise
    floor = 1e-12 * float(np.nanmax(np.abs(values)))
    return found if found > floor else 0.0


def noise_in_motion(values: Array, sensor: Sensor | None = None, order: int = ORDER) -> float:
    """The noise where a signal is not held: a stuck stretch, however long, or an encoder at rest has none.

    NaN if there are too few such samples.
    """
    kept = _out_of_dead_zone(values, sensor)
    difference = np.abs(np.diff(kept, order))
    difference = difference[np.isfinite(difference) & (difference > 0)]
    if len(difference) < 4 * order:
        return math.nan
    return _spread(difference, order)


def _out_of_dead_zone(values: Array, sensor: Sensor | None) -> Array:
    if sensor is None or not sensor.dead_zone > 0:
        return values
    return np.where(np.abs(values) <= sensor.dead_zone, np.nan, values)


def _spread(difference: Array, order: int) -> float:
    return float(np.median(difference)) / (MAD * math.sqrt(math.comb(2 * order, order)))


def step(values: Array) -> float:
    """Quantisation step of a signal, 0 if its values are not multiples of one.

    The smallest gap between two values is the first guess; it is made exact by a line through all values
    over their number of steps.
    """
    kept = values[np.isfinite(values)]
    levels = np.unique(kept)
    if len(levels) < LEVELS or np.mean(np.diff(kept) != 0) < MOVES:
        return 0.0
    span = levels[-1] - levels[0]
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * span]  # closer: the same level, rounded twice
    if len(gaps) < LEVELS - 1:
        return 0.0
    first = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    number = np.concatenate(([0.0], np.cumsum(np.round(gaps / first))))
    place = np.concatenate(([0.0], np.cumsum(gaps)))
    found = float(np.polyfit(number, place, 1)[0])
    residual = place - np.polyval(np.polyfit(number, place, 1), number)
    # values that are no multiples of anything leave 1 / sqrt(12) = 0.29 of a step
    return found if float(np.sqrt(np.mean(residual**2))) < 0.15 * found else 0.0
