"""The whole machine at work: monolithic simulation of commands from a pose.

An experiment, simulated, and what the instruments record of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fmus.machine.parts import Wires, parts, wiring
from fmus.machine.poses import JOINTS, Pose, parameter
from fmus.machine.work_cycle import COMMANDS, Move, sample
from fmus.monolith import Monolith, join, simulate
from fmus.rig.benches import TOLERANCE
from fmus.rig.instruments import Instrument, generator, read

Array = NDArray[np.float64]
VARIANTS: Mapping[str, Mapping[str, str]] = {
    "lumped": {},
    "detailed": {
        "swing": "detailed",
        "boom_stick": "detailed",
        "manipulator": "pendulum_friction",
        "supply": "engine_pump",
    },
}


@cache
def _joined(machine: str) -> tuple[Monolith, Wires, Mapping[str, tuple[str, ...]]]:
    chosen = parts(**VARIANTS[machine])
    wires, inputs = wiring(chosen)
    return join(chosen, wires, inputs), wires, inputs


def at_work(machine: str, moves: Sequence[Move], stop: float, pose: Pose) -> tuple[Array, dict[str, Array]]:
    """Time (n,) [s] at 200 Hz and all outputs and inputs (n,), as `component.variable`, SI."""
    model, wires, ends = _joined(machine)
    time, commands = sample(moves, stop)
    inputs = np.tile(model.u, (time.size, 1))
    inputs[:, [model.inputs.index(name) for name in COMMANDS]] = commands
    p, angles = model.p.copy(), {joint: getattr(pose, joint) for joint in (*JOINTS, "swing")}
    for joint, angle in angles.items():
        p[model.parameters.index(f"manipulator.{parameter(joint)}")] = angle
    _, outputs = simulate(model, time, inputs, p, TOLERANCE)
    known = dict(zip(model.output_names, outputs.T, strict=True))
    for column, name in zip(inputs.T, model.inputs, strict=True):
        known |= dict.fromkeys(ends[name], column)
    return time, known | {target: known[source] for source, target in wires}


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
