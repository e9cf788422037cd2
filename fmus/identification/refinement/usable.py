"""Which samples of a signal count, whether it moves as a recording begins, how far it ranges."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from fmus.identification.recordings.masks import good
from fmus.identification.recordings.recording import Recording
from fmus.identification.refinement.guess import REST

Array = NDArray[np.float64]

_AROUND = 10  # samples about one that is clipped, stuck or dead that do not count either
_MOVES = 5.0  # standard deviations of a slope, of a dozen signals: by chance once in 10^5 recordings


def usable_samples(recording: Recording, name: str) -> NDArray[np.bool_]:
    """Samples that the instrument can have read, and all about them too: no gap, not clipped, stuck or dead.

    Near an end of the range noise decides which samples are good, and those left would be too high.
    Where its neighbours are asked as well, it is hardly a sample's own noise that decides.
    """
    usable = good(recording, name)
    lost = np.isfinite(recording[name]) & ~usable
    return np.asarray(usable & ~binary_dilation(lost, iterations=_AROUND))


def changes(recording: Recording, name: str) -> bool:
    """Is the slope of a signal over the first moments more than its noise makes?"""
    first = recording.time - recording.time[0] <= REST
    usable = first & usable_samples(recording, name)
    count, noise = int(usable.sum()), recording.sensor(name).sd
    if count < 3:
        return False
    time = recording.time[usable] - recording.time[usable].mean()
    spread = float(time @ time)
    slope = float(time @ recording[name][usable]) / spread
    return abs(slope) > _MOVES * noise / math.sqrt(spread)


def span_of(values: Array) -> float:
    """What the NRMSE divides by: the range; the magnitude of what stands still."""
    if not values.size:
        return 1.0
    span = float(np.ptp(values))
    return span or float(np.max(np.abs(values))) or 1.0
