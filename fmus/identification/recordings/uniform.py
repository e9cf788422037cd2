"""A recording on a uniform clock: at its own rate, or at one that a simulation can follow."""

from __future__ import annotations

import numpy as np

from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.resampling import UNEVEN, period, periods_off, resample

FASTEST = 500.0  # Hz: ten times what oil does in the longest hose; more only takes time to simulate


def evenly(recording: Recording) -> Recording:
    """The recording on a uniform clock at its own rate, itself if it has one; what is missing becomes a gap.

    Commands are interpolated as all else is: a simulation draws straight lines between its samples, and
    holding the sample before would make half of them a period late.
    """
    time = recording.time
    if len(time) < 2 or np.max(periods_off(time)) <= UNEVEN:
        return recording
    return resample(recording, 1 / period(time))


def thinned(recording: Recording, fastest: float = FASTEST) -> Recording:
    """The recording at a rate of at most `fastest` [Hz]; commands are held, all else is filtered before."""
    if len(recording.time) < 2 or period(recording.time) > 0.99 / fastest:
        return recording
    held = [name for name in recording.signals if name.endswith("command")]
    return resample(recording, fastest, hold=held)
