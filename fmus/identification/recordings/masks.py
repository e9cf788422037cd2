"""Which samples can be used, where a command stands still, averages over such stretches."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import correlate

from fmus.contract import ModelError
from fmus.identification.recordings.flat import clipped, stuck
from fmus.identification.recordings.recording import Array, Mask, Recording

ENOUGH = 0.5  # share of a stretch that has to be good for an average
EARLY = 1e-9  # s: what rounding of stamps may add to a settling time


def good(recording: Recording, name: str) -> Mask:
    """Where a signal is there, not clipped, not stuck and out of its sensor's dead zone, shape (n,)."""
    values, sensor = recording[name], recording.sensor(name)
    there: Mask = np.isfinite(values) & ~clipped(values, sensor)
    return there & ~frozen(recording, name) & ~dead(recording, name)


def frozen(recording: Recording, name: str) -> Mask:
    """Where a signal is stuck; a command may stand still."""
    if name.endswith("command"):
        return np.zeros(len(recording.time), dtype=bool)
    return stuck(recording[name], recording.sensor(name))


def dead(recording: Recording, name: str) -> Mask:
    """Where a signal is in its sensor's dead zone; nowhere if it has none."""
    zone = recording.sensor(name).dead_zone
    inside: Mask = (np.abs(recording[name]) <= zone) & (zone > 0)
    return inside


def good_all(recording: Recording, names: Collection[str]) -> Mask:
    """Where all these signals are good."""
    result: Mask = np.logical_and.reduce([good(recording, name) for name in names])
    return result


def steady(
    recording: Recording,
    command: str,
    settle: float = 0.0,
    shortest: float = 0.0,
    tolerance: float | None = None,
) -> list[slice]:
    """Stretches in which a signal stands still, without the first `settle` seconds of each.

    shortest    what must be left of a stretch [s]
    tolerance   how far a sample may be from the mean of its stretch so far; None: four standard deviations
                of the sensor and one step, so 0 for a command that is known exactly
    """
    values, time, sensor = recording[command], recording.time, recording.sensor(command)
    width = 4 * sensor.sd + sensor.resolution if tolerance is None else tolerance
    edges = _edges(values, width)
    result = []
    for start, stop in pairwise(edges):
        first = int(np.searchsorted(time, time[start] + settle - EARLY))
        if first < stop and time[stop - 1] - time[first] >= shortest - EARLY and np.isfinite(values[start]):
            result.append(slice(max(first, start), stop))
    return result


def _edges(values: Array, width: float) -> list[int]:
    """Where a stretch begins, and the end: a sample is further than `width` from the mean of its stretch."""
    edges, first = [0], 0
    # the mean of equal numbers is that number but for rounding
    width += 1e-9 * float(np.nanmax(np.abs(values), initial=0.0))
    while first < len(values):
        size = _steady_size(values[first:], width)
        first += size
        edges.append(first)
    return edges if len(values) else []


def _steady_size(values: Array, width: float) -> int:
    """Samples from the first on that are within `width` of the mean of those before them, at least one."""
    size = 64
    while True:
        part = values[:size]
        mean = np.cumsum(part[:-1]) / np.arange(1, len(part))
        # a gap compares as False, so it ends a stretch, and a stretch that starts with one is one sample long
        away = np.flatnonzero(~(np.abs(part[1:] - mean) <= width))
        if len(away):
            return int(away[0]) + 1
        if size >= len(values):
            return len(values)
        size *= 2


@dataclass(frozen=True)
class Averages:
    """Means of signals over k stretches, each array of shape (k,).

    mean, error   by signal; standard error of the mean, NaN where too little of a stretch is good
    share         by signal: share of good samples
    time          middle of each stretch [s]
    """

    time: Array
    mean: Mapping[str, Array]
    error: Mapping[str, Array]
    share: Mapping[str, Array]


def averages(recording: Recording, names: Sequence[str], parts: Sequence[slice]) -> Averages:
    """Means over stretches, such as those of `steady`, of the good samples only."""
    if not parts:
        raise ModelError(f"{recording.source}: expected stretches to average over, found none")
    mean: dict[str, Array] = {}
    error: dict[str, Array] = {}
    share: dict[str, Array] = {}
    for name in names:
        values, usable, sensor = recording[name], good(recording, name), recording.sensor(name)
        rows = [_average(values[part], usable[part], sensor.resolution) for part in parts]
        mean[name], error[name], share[name] = (np.array(column) for column in zip(*rows, strict=True))
    middle = np.array([recording.time[part].mean() for part in parts])
    return Averages(middle, mean, error, share)


def _average(values: Array, usable: Mask, resolution: float) -> tuple[float, float, float]:
    share = float(usable.mean())
    if share < ENOUGH:
        return math.nan, math.nan, share
    kept = values[usable]
    return float(kept.mean()), standard_error(kept, resolution), share


def standard_error(values: Array, resolution: float = 0.0) -> float:
    """Standard error of a mean of samples that may be correlated.

    var(mean) = s^2 / n (1 + 2 sum_k rho_k), summed while rho_(2m) + rho_(2m+1) > 0: Geyer, Practical Markov
    chain Monte Carlo, Statistical Science 7 (1992), section 3.3. A signal that stays within one step of its
    converter is not averaged by its own noise: the error is then at least that of the step, step / sqrt(12).
    """
    n = len(values)
    spread = float(values.std(ddof=1)) if n > 1 else math.nan
    if not spread > 0:
        return resolution / math.sqrt(12) if spread == 0 else math.nan
    centred = values - values.mean()
    rho = correlate(centred, centred, method="fft")[n - 1 :] / float(centred @ centred)
    pairs = rho[: 2 * (n // 2)].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    inflation = max(2 * float(pairs[: ends[0] if len(ends) else None].sum()) - 1, 1 / n)
    error = spread * math.sqrt(inflation / n)
    return max(error, resolution / math.sqrt(12)) if spread < resolution / 2 else error
