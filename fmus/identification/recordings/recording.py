"""A recording: signals over one clock, the instruments that took them, what holds during the experiment.

Parts of a recording and signals added to it; all else (units, sensors, conditions) stays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Sensor:
    """The instrument of one signal, numbers in the signal's SI unit.

    text         what it is
    noise        standard deviation of one sample, 0 if not told
    resolution   step of the converter, 0 if not told
    low, high    range; a value at an end is clipped
    dead_zone    magnitude below which it reads nothing useful, such as the slowest flow of a turbine
    """

    text: str = ""
    noise: float = 0.0
    resolution: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    dead_zone: float = 0.0

    @property
    def sd(self) -> float:
        """Standard deviation of one sample with the converter's: noise, and a step's width over sqrt(12)."""
        return math.hypot(self.noise, self.resolution / math.sqrt(12))


@dataclass(frozen=True)
class Recording:
    """Signals in SI units.

    source       the file
    procedure    which experiment it is: "valve", "hose_resistance", ..., "machine"
    use          "train" or "test": what is fitted, what is held out
    conditions   what holds during the experiment: numbers in SI units, or words
    time         shape (n,) [s], increasing
    signals      each of shape (n,); NaN where there is no sample
    units        SI unit of each signal
    sensors      instrument of each signal, where told
    told_units   unit of each signal as the file has it, for messages
    kind         where it comes from: "measurement", "simulation" or "published", as [reference] says
    """

    source: Path
    title: str
    procedure: str
    use: str
    conditions: Mapping[str, float | str]
    time: Array
    signals: Mapping[str, Array]
    units: Mapping[str, str]
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    kind: str = "measurement"
    told_units: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        """One signal, shape (n,)."""
        if name not in self.signals:
            there = ", ".join(self.signals)
            raise Problem(
                f"{self.source}: signal {name} is missing, expected for {self.procedure}; has {there}"
            )
        return self.signals[name]

    def sensor(self, name: str) -> Sensor:
        """The instrument of a signal; one that knows nothing if none is told."""
        return self.sensors.get(name, Sensor())

    def unit_in_words(self, name: str) -> str:
        """The unit of a signal as its file has it, and what it is in SI."""
        unit = self.units[name]
        told = self.told_units.get(name, unit)
        return unit if told == unit else f"{told} ({unit})"

    def number(self, name: str) -> float:
        """A condition that is a number, in SI units."""
        value = self.conditions.get(name)
        if not isinstance(value, float):
            found = "nothing" if value is None else repr(value)
            raise Problem(f"{self.source}: [experiment] {name} is {found}, expected a number with its unit")
        return value

    def word(self, name: str) -> str:
        """A condition that is a word."""
        value = self.conditions.get(name)
        if not isinstance(value, str):
            found = "nothing" if value is None else repr(value)
            raise Problem(f"{self.source}: [experiment] {name} is {found}, expected a word")
        return value


def take(recording: Recording, samples: slice | Mask | NDArray[np.int64]) -> Recording:
    """Some samples of a recording, by a slice, a mask or their numbers."""
    signals = {name: values[samples] for name, values in recording.signals.items()}
    return replace(recording, time=recording.time[samples], signals=signals)


def window(recording: Recording, start: float = -np.inf, stop: float = np.inf) -> Recording:
    """The samples from `start` to before `stop` [s]."""
    part = take(recording, (recording.time >= start) & (recording.time < stop))
    if not len(part.time):
        there = f"{recording.time[0]:g} s to {recording.time[-1]:g} s"
        raise Problem(f"{recording.source}: no samples from {start:g} s to {stop:g} s, found {there}")
    return part


def split(recording: Recording, at: float) -> tuple[Recording, Recording]:
    """Two recordings, before and from the time `at` [s]: one to fit, one to hold out."""
    return window(recording, stop=at), window(recording, start=at)


def add(recording: Recording, name: str, values: Array, unit: str, sensor: Sensor | None = None) -> Recording:
    """The recording with one signal more (or another one in its place), such as a speed from an angle.

    unit   SI
    """
    if values.shape != recording.time.shape:
        raise Problem(
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
