"""What a procedure is given: its recordings, and the numbers that are known before it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.recordings.noise import noise
from fmus.identification.recordings.reading import require
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.uniform import evenly
from fmus.parameters import Number

Array = NDArray[np.float64]
ALIKE = 1e-3  # relative difference of two tape measures of one hose


def training(
    recordings: Sequence[Recording], procedure: str, signals: Mapping[str, str]
) -> tuple[Recording, ...]:
    """The recordings of one procedure that are not held out, at least one, with these signals in SI units."""
    own = tuple(r for r in recordings if r.procedure == procedure and r.use == "train")
    if not own:
        there = ", ".join(sorted({r.procedure for r in recordings})) or "no recording"
        raise ModelError(
            f"{procedure}: expected a recording with this procedure to train with, found {there}"
        )
    for recording in own:
        require(recording, signals)
    return tuple(map(evenly, own))


def filled(row: Array) -> Array:
    """A signal with straight lines over its gaps, zero if there is nothing else."""
    there = np.isfinite(row)
    if not there.any():
        return np.zeros_like(row)
    index = np.arange(row.size)
    return np.interp(index, index[there], row[there])


def hose_size(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Length and inside diameter [m] of the hose that was tested; the same in all recordings."""
    first = recordings[0]
    for name in ("length", "diameter"):
        size = first.number(name)
        for other in recordings[1:]:
            if abs(other.number(name) / size - 1) > ALIKE:
                raise ModelError(
                    f"{other.source}: [experiment] {name} is {other.number(name):g} m, expected {size:g} m "
                    f"as in {first.source.name}: identify one hose at a time"
                )
    return first.number("length"), first.number("diameter")


def denser(recordings: Sequence[Recording], known: Mapping[str, Number]) -> float:
    """Density of the machine's oil over that of the test's oil; 1 where the test does not tell it."""
    tested = recordings[0]
    return (
        value(known, "boom_stick.density") / tested.number("density") if "density" in tested.conditions else 1
    )


def number(known: Mapping[str, Number], name: str) -> Number:
    """A number that is known."""
    if name not in known:
        raise ModelError(f"{name} is needed to identify, expected among the known parameters, found nothing")
    return known[name]


def value(known: Mapping[str, Number], name: str) -> float:
    """Its value, in SI units."""
    return number(known, name).value


def tank_pressure(recording: Recording) -> float:
    """Gauge pressure of the tank [Pa], 0 if it is not told."""
    return recording.number("tank_pressure") if "tank_pressure" in recording.conditions else 0.0


def noise_of(recording: Recording, name: str) -> float:
    """Standard deviation of one sample: as told, else as seen."""
    sensor = recording.sensor(name)
    seen = sensor.sd or noise(recording[name], sensor)
    return seen if math.isfinite(seen) else 0.0
