"""Means of a signal over steady stretches, with standard errors that hold for instruments as they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fmus.identification.recordings.recording import Recording, Sensor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CLEAR = 5.0  # a mean this many standard deviations above a dead zone has no sample in it


@dataclass(frozen=True)
class Levels:
    """Means over stretches, their standard errors; where the instrument is in its dead zone or at its end.

    Means at the lower end of a pressure transducer are corrected (see `_censored`) and remain useful.
    """

    mean: Array
    error: Array
    dead: Mask
    clipped: Mask

    @property
    def useful(self) -> Mask:
        """Where the mean is a measurement."""
        return ~(self.dead | self.clipped)

    def __sub__(self, other: Levels) -> Levels:
        """Difference of two instruments."""
        error = np.hypot(self.error, other.error)
        return Levels(self.mean - other.mean, error, self.dead | other.dead, self.clipped | other.clipped)


def levels(recording: Recording, name: str, stretches: Sequence[slice]) -> Levels:
    """Mean of a signal over each of the stretches."""
    sensor, signal = recording.sensor(name), recording[name]
    rows = [_level(signal[one][np.isfinite(signal[one])], sensor) for one in stretches]
    mean, error, dead, clipped = zip(*rows, strict=True) if rows else ((), (), (), ())
    return Levels(np.array(mean), np.array(error), np.array(dead, bool), np.array(clipped, bool))


def _level(x: Array, sensor: Sensor) -> tuple[float, float, bool, bool]:
    if len(x) < 3:
        return math.nan, math.inf, False, True
    spread = max(float(np.std(x, ddof=1)), 0.0)
    dead = bool(sensor.dead_zone > 0 and abs(x.mean()) < sensor.dead_zone + CLEAR * max(spread, sensor.sd))
    half = sensor.resolution / 2
    low, high = x <= sensor.low + half, x >= sensor.high - half
    if high.any() or (low.all() and sensor.noise > half):
        return float(x.mean()), math.inf, dead, True
    if low.any() and np.count_nonzero(~low) > 2:
        return *_censored(x[~low], int(low.sum()), sensor.low + half), dead, False
    return float(x.mean()), standard_error(x, sensor.resolution), dead, False


def standard_error(x: Array, resolution: float = 0.0) -> float:
    """Standard error of a mean: s / sqrt(n), more if samples are correlated or the converter is too coarse.

    Neighbours with a correlation r that is not by chance (above 3 / sqrt(n)) make it larger by
    sqrt((1 + r)/(1 - r)). Noise of standard deviation s below a step q of the converter does not average its
    error out: q exp(-2 pi^2 s^2 / q^2) / sqrt(12) remains (Widrow's condition; none from s = q/2 up).
    """
    n, centred = len(x), x - x.mean()
    power = float(centred @ centred)
    if power == 0:
        return resolution / math.sqrt(12)
    r = float(centred[1:] @ centred[:-1]) / power
    longer = math.sqrt((1 + r) / (1 - r)) if r > 3 / math.sqrt(n) else 1.0
    variance = power / (n - 1)
    left = 0.0
    if resolution > 0:
        own = max(variance - resolution**2 / 12, 0.0)
        left = resolution / math.sqrt(12) * math.exp(-2 * math.pi**2 * own / resolution**2)
    return math.hypot(longer * math.sqrt(variance / n), left)


def _censored(seen: Array, hidden: int, low: float) -> tuple[float, float]:
    """Mean and standard error of normal samples of which `hidden` lie below `low`: a transducer at zero.

    The error follows from the Fisher information of mean and deviation together.
    """
    data = stats.CensoredData(uncensored=seen, left=np.full(hidden, low))
    mean, spread = (float(x) for x in stats.norm.fit(data))
    t = (low - mean) / spread
    above, density, below = stats.norm.sf(t), stats.norm.pdf(t), max(stats.norm.cdf(t), 1e-300)
    tail = density**2 / below
    of_mean = above + t * density + tail
    of_both = (t**2 + 1) * density + t * tail
    of_spread = 2 * above + (t**3 + t) * density + t**2 * tail
    variance = of_spread / (of_mean * of_spread - of_both**2) / (len(seen) + hidden)
    return mean, spread * math.sqrt(variance)
