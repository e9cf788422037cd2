"""Signals that a simulation needs at every sample, such as commands: short gaps are bridged."""

from __future__ import annotations

import numpy as np

from fmus.contract import ModelError
from fmus.identification.recordings.recording import Array, Recording
from fmus.identification.recordings.resampling import stretches

LONGEST = 0.1  # s: a hand takes longer from one position of a lever to another


def bridged(recording: Recording, name: str, longest: float = LONGEST) -> Array:
    """A signal with straight lines over its gaps, of which none may be longer than `longest` [s].

    Before its first sample and after its last one it keeps that value.
    """
    values, time = recording[name], recording.time
    there = np.isfinite(values)
    if not there.any():
        raise ModelError(f"{recording.source}: {name} has no sample, expected one to simulate with")
    for gap in stretches(~there):
        first, last = max(gap.start - 1, 0), min(gap.stop, len(time) - 1)
        if time[last] - time[first] > longest:
            raise ModelError(
                f"{recording.source}: {name} has no sample from {time[gap.start]:.6g} s to"
                f" {time[gap.stop - 1]:.6g} s, expected gaps of at most {longest:g} s:"
                " leave that part out with start or stop of [time]"
            )
    return np.interp(time, time[there], values[there])
