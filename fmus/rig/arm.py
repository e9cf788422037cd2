"""The whole machine at work: monolithic simulation of commands from a pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fmus.machine import Wires, parts, wiring
from fmus.monolith import Monolith, join, simulate
from fmus.poses import JOINTS, Pose, parameter
from fmus.rig.benches.bench import TOLERANCE
from fmus.scenarios import COMMANDS, Move, sample

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
