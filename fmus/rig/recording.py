"""An experiment, simulated, and what the instruments record of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fmus.rig.instruments import Instrument, generator, read

Array = NDArray[np.float64]
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
