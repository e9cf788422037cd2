"""What a procedure is given: its recordings, and the numbers that are known before it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from fmus.contract import ModelError
from fmus.identification.recordings.noise import noise
from fmus.identification.recordings.recording import Recording
from fmus.parameters import Number


def training(recordings: Sequence[Recording], procedure: str) -> tuple[Recording, ...]:
    """The recordings of one procedure that are not held out; at least one."""
    own = tuple(r for r in recordings if r.procedure == procedure and r.use == "train")
    if not own:
        there = ", ".join(sorted({r.procedure for r in recordings})) or "no recording"
        raise ModelError(
            f"{procedure}: expected a recording with this procedure to train with, found {there}"
        )
    return own


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
