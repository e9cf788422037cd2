"""Experiments with their true signals, and instruments: readings of a signal with noise and quantisation.

    reading = clip(resolution round((true + noise) / resolution)),      0 if |true| is in the dead zone

The noise is white and Gaussian and is added before the converter. In its dead zone a turbine meter stands
still: this depends on the true flow, and its reading has no noise. A 12-bit converter has 4096 codes, one of
them for zero, so the highest value is one code below the end of the range. There is no filter; the sampling
rate is 200 Hz.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256

import numpy as np

from orchestrator.base.units import parse_unit
from orchestrator.data.description import Condition, SignalDescription
from orchestrator.data.table import Array


def _converter(
    text: str, unit: str, span: tuple[float, float], noise: float, dead_zone: float = 0.0
) -> SignalDescription:
    """An instrument with a 12-bit converter; its dead zone is where the reading is 0."""
    low, end = span
    step = (end - low) / 2**12
    return SignalDescription(
        unit, sensor=text, noise=noise, resolution=step, span=(low, end - step), dead_zone=dead_zone
    )


PRESSURE = _converter("pressure transducer 0-400 bar, 12 bit", "bar", (0.0, 400.0), 0.1)
# noise as a share of the range as above
RETURN = _converter("pressure transducer -1 to 25 bar, 12 bit", "bar", (-1.0, 25.0), 0.0065)
FLOW = _converter("turbine flow meter +-300 L/min, 12 bit", "L/min", (-300.0, 300.0), 0.3, 10.0)
LEAKAGE = _converter("gear flow meter +-5 L/min, 12 bit", "L/min", (-5.0, 5.0), 0.005)
ANGLE = SignalDescription("deg", sensor="encoder, 65536 counts per turn", resolution=360 / 2**16)
POSITION = SignalDescription(
    "m", sensor="string potentiometer 0-1 m, 16 bit", noise=2e-6, resolution=2**-16, span=(0.0, 1.0)
)
COMMAND = SignalDescription("V")  # known exactly, because the computer sends it


def generator(seed: int, file: str, signal: str) -> np.random.Generator:
    """Random numbers for one signal of one file; they do not depend on other files and signals."""
    name = sha256(f"{file}/{signal}".encode()).digest()
    return np.random.default_rng([seed, int.from_bytes(name[:8], "little")])


def read(instrument: SignalDescription, true: Array, random: np.random.Generator) -> Array:
    """Readings, shape (n,), in the instrument's unit, of a true signal in SI.

    Of the instrument: `noise`, standard deviation of one sample; `resolution`, step of the converter, 0
    without one; `span`, its lowest and highest reading; `dead_zone`, true magnitude below which it reads 0.
    """
    value = true / parse_unit(instrument.unit).factor
    in_dead_zone = np.abs(value) < instrument.dead_zone
    if instrument.noise:
        value = value + random.normal(0.0, instrument.noise, value.size)
    if instrument.resolution:
        value = instrument.resolution * np.round(value / instrument.resolution)
    value = np.clip(value, *(instrument.span or (-math.inf, math.inf)))  # multiples of the resolution
    return np.where(in_dead_zone, 0.0, value)


# ---- experiments -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Experiment:
    """One experiment on one machine, with its true signals.

    time         shape (n,) [s], 200 Hz
    signals      true signals that are recorded, in SI units, each of shape (n,)
    instruments  instrument of each signal
    conditions   constant quantities of the experiment and its text conditions
    unrecorded   true signals that are not recorded, in SI units; for tests
    use          "train" for identification, "test" for validation
    name         of its files, without suffix
    machine      "lumped" or "detailed"
    """

    procedure: str
    title: str
    time: Array
    signals: Mapping[str, Array]
    instruments: Mapping[str, SignalDescription]
    conditions: Mapping[str, str | Condition] = field(default_factory=dict)
    unrecorded: Mapping[str, Array] = field(default_factory=dict)
    use: str = "train"
    name: str = ""
    machine: str = ""


def record(experiment: Experiment, seed: int) -> dict[str, Array]:
    """Readings of each signal, shape (n,), in the unit of its instrument."""
    return {
        name: read(experiment.instruments[name], true, generator(seed, experiment.name, name))
        for name, true in experiment.signals.items()
    }
