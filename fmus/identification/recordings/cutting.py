"""Parts of a recording and signals added to it; all else (units, sensors, conditions) stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.recordings.recording import Array, Mask, Recording, Sensor


def take(recording: Recording, samples: slice | Mask | NDArray[np.int64]) -> Recording:
    """Some samples of a recording, by a slice, a mask or their numbers."""
    signals = {name: values[samples] for name, values in recording.signals.items()}
    return replace(recording, time=recording.time[samples], signals=signals)


def window(recording: Recording, start: float = -np.inf, stop: float = np.inf) -> Recording:
    """The samples from `start` to before `stop` [s]."""
    part = take(recording, (recording.time >= start) & (recording.time < stop))
    if not len(part.time):
        there = f"{recording.time[0]:g} s to {recording.time[-1]:g} s"
        raise ModelError(f"{recording.source}: no samples from {start:g} s to {stop:g} s, found {there}")
    return part


def split(recording: Recording, at: float) -> tuple[Recording, Recording]:
    """Two recordings, before and from the time `at` [s]: one to fit, one to hold out."""
    return window(recording, stop=at), window(recording, start=at)


def add(recording: Recording, name: str, values: Array, unit: str, sensor: Sensor | None = None) -> Recording:
    """The recording with one signal more (or another one in its place), such as a speed from an angle.

    unit   SI
    """
    if values.shape != recording.time.shape:
        raise ModelError(
            f"{recording.source}: signal {name} has shape {values.shape}, expected {recording.time.shape}"
        )
    sensors = {key: known for key, known in recording.sensors.items() if key != name}
    return replace(
        recording,
        signals={**recording.signals, name: values},
        units={**recording.units, name: unit},
        told_units={key: told for key, told in recording.told_units.items() if key != name},
        sensors=sensors if sensor is None else {**sensors, name: sensor},
    )


def blank(recording: Recording, name: str, bad: Mask) -> Recording:
    """The recording with gaps (NaN) in one signal where `bad`."""
    values = np.where(bad, np.nan, recording[name])
    return replace(recording, signals={**recording.signals, name: values})
