"""Prediction of a recording: the machine simulated with its commands, parameter values and variants."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fmus.identification.machine import COMMANDS
from fmus.identification.procedures.momentum_balance import JOINTS
from fmus.identification.recordings.clock import filter_for
from fmus.machine.parts import parts, wiring
from fmus.monolith import join, simulate
from fmus.parameters import Values, values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, fill_gaps
from orchestrator.data.table import Array

Signals = Mapping[str, Array]
LINES = ("supply_pressure", "tank_pressure")  # inputs of the machine that a recording may have measured
REST = 0.5  # s at the beginning of a recording, over which the initial pose is averaged
SMOOTHING = 0.05  # s, filter against the noise of the pressures of the lines; the pumps are slower
LINE_TOLERANCE = 5e4  # Pa, error of the supply pressure that changes flows by 0.1 %
COMMAND_TOLERANCE = 1e-4  # V, error of a command that changes the opening of a valve by 0.001 %
TOLERANCE = 1e-8  # of CVODES, far below the resolution of sensors; dry friction requires it


@dataclass(frozen=True)
class Excitation:
    """Inputs of the machine: commands [V] (n,) over time (n,) [s], and the initial pose [rad].

    lines   measured pressures of supply and return line (n,) [Pa]; the others have their constant value
    """

    time: Array
    commands: Mapping[str, Array]
    pose: Mapping[str, float]
    lines: Mapping[str, Array] = field(default_factory=dict)


def excitation(recording: Recording) -> Excitation:
    """The excitation during a recording of the machine, which is at rest in its first `REST` seconds."""
    pose = {joint: _initial_mean(recording, f"manipulator.{joint}_angle") for joint in JOINTS}
    samples = np.column_stack([fill_gaps(recording, signal) for signal in COMMANDS.values()])
    commands = dict(zip(COMMANDS, simplify(recording.time, samples).T, strict=True))
    lines = {name: signal for name in LINES if (signal := f"swing.{name}") in recording.signals}
    return Excitation(recording.time, commands, pose, {n: _smooth(recording, s) for n, s in lines.items()})


def _initial_mean(recording: Recording, name: str) -> float:
    """Mean of a signal over the first `REST` seconds."""
    values = recording[name][recording.time <= recording.time[0] + REST]
    valid = values[np.isfinite(values)]
    if not valid.size:
        raise Problem(f"{recording.source}: {name}: expected a sample in the first {REST:g} s, got none")
    return float(valid.mean())


def _smooth(recording: Recording, signal: str) -> Array:
    """The measured pressure of a line, smoothed."""
    time = recording.time
    smooth = filter_for(recording, SMOOTHING).apply(fill_gaps(recording, signal))
    valid = np.isfinite(smooth)
    smooth = np.interp(time, time[valid], smooth[valid])
    return simplify(time, smooth[:, None], LINE_TOLERANCE)[:, 0]


def simplify(time: Array, samples: Array, tolerance: float = COMMAND_TOLERANCE) -> Array:
    """Samples (n, m) on straight lines between as few of them as possible [Douglas, Peucker 1973].

    The solver restarts at every corner of an input, and rounding in a file makes every sample a corner.
    """
    kept, pending = {0, len(time) - 1}, [(0, len(time) - 1)]
    while pending:
        first, last = pending.pop()
        part = slice(first, last + 1)
        fraction = ((time[part] - time[first]) / (time[last] - time[first]))[:, None]
        line = samples[first] + fraction * (samples[last] - samples[first])
        error = np.abs(samples[part] - line).max(axis=1)
        worst = first + int(np.argmax(error))
        if error.max() > tolerance:
            kept.add(worst)
            pending += [(a, b) for a, b in ((first, worst), (worst, last)) if b - a > 1]
    corners = sorted(kept)
    lines = [np.interp(time, time[corners], column[corners]) for column in samples.T]
    return np.column_stack(lines)


def predict(
    excitation: Excitation, parameters: Mapping[str, float], variants: Mapping[str, str] | None = None
) -> Signals:
    """All outputs of the machine, `part.name`, shape (n,) each, and the commands.

    parameters   values by `part.name`, or by `name` for every part that has it; others are those of the files
    variants     part -> its variant, for parts that are not the default ones
    """
    machine = parts(**(variants or {}))
    wires, inputs = wiring(machine)
    pose = {f"manipulator.initial_{joint}_angle": angle for joint, angle in excitation.pose.items()}
    defaults = {part: values(sub) for part, sub in machine.items()}
    replaced = _with_values(defaults, {**parameters, **pose}, allow_unused=bool(variants))
    model = join(machine, wires, inputs, replaced)
    u = np.tile(model.u, (excitation.time.size, 1))
    for name, samples in {**excitation.commands, **excitation.lines}.items():
        if name in model.inputs:  # a variant with a supply computes the pressures of its lines
            u[:, model.inputs.index(name)] = samples
    try:
        _, y = simulate(model, excitation.time, u, tolerance=TOLERANCE)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise Problem(f"machine with variants {dict(variants or {})}: the solver failed: {reason}") from None
    outputs = dict(zip(model.output_names, y.T, strict=True))
    return outputs | {signal: excitation.commands[name] for name, signal in COMMANDS.items()}


def _with_values(
    defaults: Mapping[str, Values], parameters: Mapping[str, float], *, allow_unused: bool
) -> dict[str, Values]:
    """Values with parameters replaced. Raises Problem for a name that no part has, unless that is allowed."""
    result, used = {}, set[str]()
    for part, known in defaults.items():
        # `part.name` has precedence over `name`
        keys = {name: [k for k in (f"{part}.{name}", name) if k in parameters] for name in known.p}
        used.update(*keys.values())
        p = {name: parameters[keys[name][0]] if keys[name] else value for name, value in known.p.items()}
        result[part] = replace(known, p=p)
    unknown = sorted(set(parameters) - used)
    if unknown and not allow_unused:
        raise Problem(f"parameters: expected parameters of the machine, got {unknown[0]}")
    return result
