"""Stretches of equal values: what is clipped, what is stuck.

Two samples in a row of a noisy signal are equal by chance with the probability

    P = step / (2 sqrt(pi) sd)

step: resolution of the converter; sd: noise; for sd above the step. A run of equal values that chance does
not explain is a fault: clipped if it is at the signal's own extreme, stuck elsewhere. A signal that has no
noise to be seen (a command, an encoder) may stand still, so it is not judged.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fmus.identification.recordings.noise import ORDER, noise, noise_in_motion, step
from fmus.identification.recordings.recording import Array, Mask, Sensor

CHANCE = 1e-3  # of a false alarm in one recording
LEAST = 1e-3  # least probability of two equal samples, for what a logger does that we do not know
TOO_LARGE = 3.0  # times the noise seen, from which the noise told is not believed
WHITE = 0.7  # of the fourth difference's noise: what the sixth one has left of it
NOISY = 0.5  # P above which equal samples tell nothing; a slow encoder looks like 0.6


def clipped(values: Array, sensor: Sensor) -> Mask:
    """Where a signal is at an end of its sensor's range, or stays at an extreme of its own."""
    return at_ends(values, sensor) | (_long_runs(values, sensor, at_extreme=True) & ~_idle(values, sensor))


def at_ends(values: Array, sensor: Sensor) -> Mask:
    """Where a signal is within half a step of an end of its sensor's range."""
    width = sensor.high - sensor.low
    margin = max(sensor.resolution / 2, 1e-9 * width) if math.isfinite(width) else sensor.resolution / 2
    result: Mask = (values >= sensor.high - margin) | (values <= sensor.low + margin)
    return result


def stuck(values: Array, sensor: Sensor) -> Mask:
    """Where a signal keeps a value longer than its noise lets it, apart from its ends and its dead zone."""
    flat = _long_runs(values, sensor, at_extreme=False)
    result: Mask = flat & ~clipped(values, sensor) & ~_idle(values, sensor)
    return result


def equal_by_chance(values: Array, sensor: Sensor) -> float:
    """P of the module's docstring; 1 where it cannot be told."""
    width, sd = step_and_noise(values, sensor)
    if not sd > 0:
        return 1.0
    return min(width / (2 * math.sqrt(math.pi) * sd), 1.0)


def step_and_noise(values: Array, sensor: Sensor) -> tuple[float, float]:
    """Step of the converter and noise before it, told or else seen in the data; 0 if neither."""
    width = sensor.resolution or step(values)
    seen = noise(values, sensor)
    own = math.sqrt(max(seen**2 - width**2 / 12, 0.0)) if seen > 0 else 0.0
    if overstated(values, sensor):
        return width, own
    if not sensor.noise > 0 and not _white(values, sensor):
        return width, 0.0
    return width, max(sensor.noise, own)


def overstated(values: Array, sensor: Sensor) -> bool:
    """Is the noise told much larger than any that the signal shows where it is not held?

    A step of the converter hides noise of up to half of it.
    """
    moving = noise_in_motion(values, sensor)
    if math.isnan(moving):
        return False
    return sensor.noise > TOO_LARGE * math.hypot(moving, sensor.resolution / 2)


def _white(values: Array, sensor: Sensor) -> bool:
    """Is what looks like noise white? A smooth signal, such as a command, leaves less to each difference."""
    high, low = (noise_in_motion(values, sensor, order) for order in (ORDER, ORDER - 2))
    return high > WHITE * low


def _idle(values: Array, sensor: Sensor) -> Mask:
    """In the dead zone, where a meter may well stand still."""
    result: Mask = (np.abs(values) <= sensor.dead_zone) & (sensor.dead_zone > 0)
    return result


def _long_runs(values: Array, sensor: Sensor, at_extreme: bool) -> Mask:
    """Samples of runs of equal values that are too long for chance, at the extremes or anywhere."""
    result = np.zeros(len(values), dtype=bool)
    chance = max(equal_by_chance(values, sensor), LEAST)
    if chance > NOISY or not np.isfinite(values).any():
        return result
    longest = 1 + math.ceil(math.log(CHANCE / len(values)) / math.log(chance))
    extremes = (np.nanmin(values), np.nanmax(values))
    starts, stops = runs(values)
    for start, stop in zip(starts[stops - starts > longest], stops[stops - starts > longest], strict=True):
        if not at_extreme or values[start] in extremes:
            result[start:stop] = True
    return result


def runs(values: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First sample and end of each run of equal values; each gap is a run of its own."""
    edges = np.flatnonzero(~(np.diff(values) == 0)) + 1
    return np.concatenate(([0], edges)), np.concatenate((edges, [len(values)]))
