"""Experiments, and what a logger stores of a true signal: a function of signal, instrument and seed.

    reading = clip(step round((true + noise) / step))      0 where |true| is below the dead zone

The noise is white and normal, before the converter. Below its dead zone a turbine stands: the flow itself
decides that, not the reading, and what stands has no noise. A 12-bit converter has 4096 codes, one of them
for zero, so the highest value is one step below the end of its range. No filter: 200 Hz is the raw rate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.units import parse

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Instrument:
    """One instrument, numbers in `unit`, which is that of its column too.

    noise       standard deviation of one sample
    step        of the converter; 0: the value is known exactly
    low, high   smallest and largest reading, infinite if there is none
    dead_zone   true magnitude below which it reads 0, such as the slowest flow that turns a turbine
    """

    text: str
    unit: str
    noise: float = 0.0
    step: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    dead_zone: float = 0.0


def _converter(
    text: str, unit: str, ends: tuple[float, float], noise: float, dead: float = 0.0
) -> Instrument:
    """An instrument with a 12-bit converter between two ends."""
    step = (ends[1] - ends[0]) / 2**12
    return Instrument(text, unit, noise, step, ends[0], ends[1] - step, dead)


PRESSURE = _converter("pressure transducer 0-400 bar, 12 bit", "bar", (0.0, 400.0), 0.1)
FLOW = _converter("turbine flow meter +-300 L/min, 12 bit", "L/min", (-300.0, 300.0), 0.3, 10.0)
LEAKAGE = _converter("gear flow meter +-5 L/min, 12 bit", "L/min", (-5.0, 5.0), 0.005)
ANGLE = Instrument("encoder, 65536 counts per turn", "deg", step=360 / 2**16)
COMMAND = Instrument("", "V")  # what the computer sends: known


def generator(seed: int, file: str, signal: str) -> np.random.Generator:
    """Noise of one signal of one file: another file or signal more changes no other."""
    name = sha256(f"{file}/{signal}".encode()).digest()
    return np.random.default_rng([seed, int.from_bytes(name[:8], "little")])


def read(instrument: Instrument, true: Array, random: np.random.Generator) -> Array:
    """Readings, shape (n,), in the instrument's unit, of a true signal in SI."""
    value = true / parse(instrument.unit).factor
    still = np.abs(value) < instrument.dead_zone
    if instrument.noise:
        value = value + random.normal(0.0, instrument.noise, value.size)
    if instrument.step:
        value = instrument.step * np.round(value / instrument.step)
    value = np.clip(value, instrument.low, instrument.high)  # both are whole steps
    return np.where(still, 0.0, value)


# ---- experiments -----------------------------------------------------------------------------------

Condition = str | tuple[float, str]  # a word, or a number with its unit


@dataclass(frozen=True)
class Experiment:
    """One experiment on one machine: the true signals.

    name         of its files
    use          "train", or "test": held out
    machine      "lumped" or "detailed"
    conditions   what holds during the experiment; goes into the file
    time         shape (n,) [s], 200 Hz
    signals      true signals that are recorded, SI, each of shape (n,)
    instruments  of each signal
    unseen       what no instrument sees, SI: for tests and judges, never written
    """

    name: str
    title: str
    procedure: str
    use: str
    machine: str
    conditions: Mapping[str, Condition]
    time: Array
    signals: Mapping[str, Array]
    instruments: Mapping[str, Instrument]
    unseen: Mapping[str, Array] = field(default_factory=dict)


def record(experiment: Experiment, seed: int) -> dict[str, Array]:
    """Readings of each signal, shape (n,), in the unit of its instrument."""
    return {
        name: read(experiment.instruments[name], true, generator(seed, experiment.name, name))
        for name, true in experiment.signals.items()
    }
