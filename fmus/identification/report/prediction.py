"""What the machine does with given numbers, commands and variants of its parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fmus.identification.recordings.derivatives import filter_for
from fmus.machine.parts import INPUTS, parts, wiring
from fmus.monolith import join, simulate
from fmus.parameters import Values, values
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, fill_gaps

Array = NDArray[np.float64]
Signals = Mapping[str, Array]
COMMANDS = {name: INPUTS[name][0] for name in ("swing_command", "boom_command", "stick_command")}
JOINTS = ("swing", "boom", "stick")
SUPPLY = "swing.supply_pressure"
SMOOTH = 0.05  # s: over which its noise is averaged; the pumps are slower
STEADY = 5e4  # Pa: a supply that is off by this moves flows by 0.1 %
STRAIGHT = 1e-4  # V: a command that is off by this opens a valve by 0.001 %
TOLERANCE = 1e-8  # of CVODES: far below what sensors see; dry friction needs it to be this small


@dataclass(frozen=True)
class Excitation:
    """What the machine is driven by: commands [V] (n,) over time (n,) [s], the pose [rad] it starts from.

    supply_pressure   samples (n,) [Pa], or None for the constant one of the parameter file
    """

    time: Array
    commands: Mapping[str, Array]
    pose: Mapping[str, float]
    supply_pressure: Array | None = None


def drive(recording: Recording, rest: float = 0.5) -> Excitation:
    """What a recording of the machine tells of its drive; it stands still in its first `rest` seconds."""
    pose = {joint: _at_rest(recording, f"manipulator.{joint}_angle", rest) for joint in JOINTS}
    raw = np.column_stack([fill_gaps(recording, signal) for signal in COMMANDS.values()])
    commands = dict(zip(COMMANDS, straight(recording.time, raw).T, strict=True))
    return Excitation(recording.time, commands, pose, _supply(recording))


def _at_rest(recording: Recording, name: str, rest: float) -> float:
    """Mean of a signal over the first `rest` seconds."""
    values = recording[name][recording.time <= recording.time[0] + rest]
    known = values[np.isfinite(values)]
    if not known.size:
        raise Problem(f"{recording.source}: {name} has no sample in its first {rest:g} s, expected the pose")
    return float(known.mean())


def _supply(recording: Recording) -> Array | None:
    """The measured supply pressure, without the noise of its sensor."""
    if SUPPLY not in recording.signals:
        return None
    time = recording.time
    smooth = filter_for(recording, SMOOTH).apply(fill_gaps(recording, SUPPLY))
    full = np.isfinite(smooth)
    smooth = np.interp(time, time[full], smooth[full])
    return straight(time, smooth[:, None], STEADY)[:, 0]


def straight(time: Array, samples: Array, tolerance: float = STRAIGHT) -> Array:
    """Samples (n, m) as straight lines between as few of them as `tolerance` allows [Douglas, Peucker 1973].

    The solver starts anew at every corner, and rounding in a file makes a corner of every sample.
    """
    kept, left = {0, len(time) - 1}, [(0, len(time) - 1)]
    while left:
        first, last = left.pop()
        part = slice(first, last + 1)
        share = ((time[part] - time[first]) / (time[last] - time[first]))[:, None]
        off = np.abs(samples[part] - samples[first] - share * (samples[last] - samples[first])).max(axis=1)
        worst = first + int(np.argmax(off))
        if off.max() > tolerance:
            kept.add(worst)
            left += [(a, b) for a, b in ((first, worst), (worst, last)) if b - a > 1]
    corners = sorted(kept)
    lines = [np.interp(time, time[corners], column[corners]) for column in samples.T]
    return np.column_stack(lines)


def predict(
    given: Excitation, numbers: Mapping[str, float], variants: Mapping[str, str] | None = None
) -> Signals:
    """All outputs of the machine, `part.name`, shape (n,) each, and the commands.

    numbers    parameters by `name`, for every part that declares it, or by `part.name`; others as in files
    variants   of parts that are not the usual ones
    """
    machine = parts(**(variants or {}))
    wires, inputs = wiring(machine)
    pose = {f"manipulator.initial_{joint}_angle": angle for joint, angle in given.pose.items()}
    known = {part: values(sub) for part, sub in machine.items()}
    model = join(machine, wires, inputs, _set(known, {**numbers, **pose}, any_part=bool(variants)))
    u = np.tile(model.u, (given.time.size, 1))
    driven = {**given.commands}
    if given.supply_pressure is not None and "supply_pressure" in model.inputs:
        driven["supply_pressure"] = given.supply_pressure
    for name, samples in driven.items():
        u[:, model.inputs.index(name)] = samples
    try:
        _, y = simulate(model, given.time, u, tolerance=TOLERANCE)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise Problem(f"machine with {dict(variants or {})}: the solver gave up: {reason}") from None
    found = dict(zip(model.output_names, y.T, strict=True))
    return found | {signal: given.commands[name] for name, signal in COMMANDS.items()}


def _set(known: Mapping[str, Values], numbers: Mapping[str, float], *, any_part: bool) -> dict[str, Values]:
    """Values with parameters replaced; a number that no part has is refused, but where a variant is used."""
    found, used = {}, set[str]()
    for part, own in known.items():
        # `part.name` counts more than `name`
        given = {name: [k for k in (f"{part}.{name}", name) if k in numbers] for name in own.p}
        used.update(*given.values())
        p = {name: numbers[given[name][0]] if given[name] else value for name, value in own.p.items()}
        found[part] = replace(own, p=p)
    unknown = sorted(set(numbers) - used)
    if unknown and not any_part:
        raise Problem(f"{unknown[0]} is given, expected a parameter of the machine")
    return found
