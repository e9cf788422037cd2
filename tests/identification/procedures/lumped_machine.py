"""The lumped machine moved joint by joint, integrated tightly, and what instruments make of it."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from fmus.identification.procedures.momentum_balance import ALL_PRESSURES, ANGLES
from fmus.machine.parts import CONNECTIONS, INPUTS, SUBSYSTEMS
from fmus.monolith import join, simulate
from fmus.parameters import complete
from orchestrator.data.recording import Recording, Sensor

STEP, REST = 0.005, 1.0  # 200 Hz as the paper's, at rest at first
KNOWN = {f"{s.name}.{n}": v for s in SUBSYSTEMS.values() for n, v in complete(s)["parameters"].items()}
ENCODER = Sensor("encoder of 65536 counts", 0.0, 2 * np.pi / 65536)
PRESSURE = Sensor("pressure transducer", 1e4, 4e7 / 4096, 0.0, 4e7)
UNITS = dict.fromkeys(ANGLES, "rad") | dict.fromkeys(ALL_PRESSURES, "Pa")
# lever strokes: (start [s], length [s], volts)
STROKES = {
    "swing": ((1.0, 3.0, 4.0), (5.0, 3.0, -5.0), (9.0, 2.5, 6.0), (12.5, 3.0, -5.0)),
    "boom": ((1.0, 2.5, 3.0), (4.5, 2.5, -3.0), (8.0, 1.5, 5.0), (10.5, 1.5, -4.5)),
    "stick": ((1.0, 2.5, 3.5), (4.5, 2.5, -3.5), (8.0, 1.5, 5.0), (10.5, 1.5, -5.0)),
}


def stroke_samples(time, strokes, rise=0.6):
    """A lever's volts: trapezes with ramps of `rise` seconds."""
    volts = np.zeros_like(time)
    for start, length, height in strokes:
        corners = start + np.array([0.0, rise, length - rise, length])
        volts += height * np.interp(time, corners, [0.0, 1.0, 1.0, 0.0])
    return volts


@lru_cache
def motion_of(*joints, length=16.0):
    """Signals by name, without noise, while these joints are moved."""
    model = join(SUBSYSTEMS, CONNECTIONS, INPUTS)
    time = np.arange(round(length / STEP) + 1) * STEP
    inputs = np.tile(model.u, (time.size, 1))
    for j in joints:
        inputs[:, model.inputs.index(f"{j}_command")] = stroke_samples(time, STROKES[j])
    _, y = simulate(model, time, inputs, tolerance=1e-8)
    found = dict(zip(model.output_names, y.T, strict=True))
    return time, {n: found[n] for n in (*ANGLES, *ALL_PRESSURES)}


def measured(samples, sensor, rng):
    """Noise, then the converter and its range."""
    noisy = samples + sensor.noise * rng.standard_normal(samples.size)
    read = np.round(noisy / sensor.resolution) * sensor.resolution if sensor.resolution else noisy
    return np.clip(read, sensor.low, sensor.high)


def recording(*joints, seed=None, encoder=ENCODER, pressure=PRESSURE, length=16.0):
    """A recording of the machine; without a seed the instruments are perfect."""
    time, signals = motion_of(*joints, length=length)
    sensors = {n: encoder if n in ANGLES else pressure for n in signals}
    if seed is not None:
        rng = np.random.default_rng(seed)
        signals = {n: measured(x, sensors[n], rng) for n, x in signals.items()}
    return Recording(
        source=Path(f"damping_{joints[0]}.csv"),
        title=" and ".join(joints),
        procedure="damping" if len(joints) == 1 else "machine",
        use="train",
        conditions={"joint": joints[0]},
        time=time,
        signals=signals,
        units=UNITS,
        sensors=sensors if seed is not None else {},
    )
