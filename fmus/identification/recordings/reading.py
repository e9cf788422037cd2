"""Read recordings for identification (one or a folder), and select or replace samples.

A recording is a data file and the TOML file of the same name that describes it, see docs/recordings.md and
`orchestrator.data.recording`. `take` and `split` select samples, as `Recording.window` does, `add` adds or
replaces a signal with its unit and sensor. All return a new recording with the same conditions.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.signals import rms
from orchestrator.base.text import first_names
from orchestrator.base.units import doubts, factor_and_offset, parse_unit
from orchestrator.data.recording import Mask, Recording, Sensor, read_recording
from orchestrator.data.table import READABLE, Array

MACHINE, REST, NOTE = "machine", "rest", "note"
TEMPERATURE = "oil_temperature"  # an optional signal of all recordings [K]
MACHINE_SIGNALS = (MACHINE, "damping", "weighing")  # procedures whose signals are those of the machine
# of tables.toml: what procedures read, words and units of conditions, quantities, words of loggers
TABLES: Mapping[str, Any] = toml.read(
    Path("tables.toml"), files(__package__).joinpath("tables.toml").read_bytes()
).data
CONDITIONS: Mapping[str, Sequence[str]] = TABLES["conditions"]
CHOICES: Mapping[str, Sequence[str]] = TABLES["choices"]


def read(path: Path | str) -> Recording:
    """The samples of a recording inside its time window; `path` is its data file or its description."""
    recording = read_recording(path)
    if recording.procedure not in ("", *CONDITIONS):
        expected = f"expected one of {', '.join(CONDITIONS)}, got {recording.procedure!r}"
        raise Problem(f"{recording.source}: experiment: procedure: {expected}")
    inside = (recording.time >= recording.start) & (recording.time <= recording.stop)
    if inside.sum() < 2:
        raise Problem(
            f"{recording.source}: expected samples from {recording.start:g} s to {recording.stop:g} s,"
            f" got {recording.time[0]:g} s to {recording.time[-1]:g} s"
        )
    return recording if inside.all() else take(recording, inside)


def read_folder(folder: Path | str) -> list[Recording]:
    """The recordings in a folder, those whose descriptions have a table [experiment], sorted by file name."""
    folder = Path(folder)
    if not folder.is_dir():
        got = "a file" if folder.is_file() else "no such file or folder"
        raise Problem(f"{folder}: expected a folder of recordings, got {got}")
    descriptions = sorted(folder.glob("*.toml"))
    experiments = [path for path in descriptions if "experiment" in toml.read_file(path).data]
    if not experiments:
        others = first_names((path.name for path in _data_files(folder)), 3)
        got = f"none, only {others}" if others else "none"
        raise Problem(f"{folder}: expected .toml files with a table [experiment], got {got}")
    return [read(path) for path in experiments]


BOOM, STICK, LEVER = "manipulator.boom_angle", "manipulator.stick_angle", "boom_stick.stick_command"
SPARSE = 20  # rows between samples of these, in which angles change by more than their noise
AT_REST = 0.02  # of its largest value: a lever
FOLLOWS = 0.5  # of the boom's motion: half way between an angle to the boom and one to the horizon
LEAST_MOTION = 2e-3  # [rad] per `SPARSE` rows, ten times the noise of an encoder
LONGEST = 1e4  # [s]; a longer recording is in milliseconds


def doubtful(recordings: Iterable[Recording]) -> list[str]:
    """Signals and times a factor 1000 from usual, with the unit that may be meant, and faults of loggers."""
    told: list[str] = []
    for r in recordings:
        rows = []
        # not of a fault, such as an error code, nor at rest, where a sensor reads its zero
        for name in (n for n in r.signals if not r.faults.get(n) and r.procedure != REST):
            unit = r.units[name]
            factor, offset = factor_and_offset(unit, r.file_units.get(name, unit), name)
            sizes = TABLES["quantities"].get(unit, {}).get("usual", ())
            usual = [factor * size + offset for size in sizes]  # in the unit of the file
            rows.append((f"{r.source}: {name}", *r.peak(name), usual))
        told += [*doubts(rows), *r.log_faults()]
        if (end := float(r.time[-1] - r.time[0])) >= LONGEST:
            told.append(f"{r.source}: {end:.6g} s; did you mean ms?")
        if r.procedure in MACHINE_SIGNALS and abs(slope := _stick_over_boom(r)) > FOLLOWS:
            of = f"{r.source}: {STICK} moves by {slope:.2g} of {BOOM} while the stick's lever is at rest"
            told.append(f"{of}: is it the pitch of an inertial sensor? Subtract that of the boom")
    return told


def _stick_over_boom(recording: Recording) -> float:
    """Change of the stick's angle over that of the boom's, while its lever is at rest; 0 if unknown."""
    if not {BOOM, STICK, LEVER} <= recording.signals.keys():
        return 0.0
    boom, stick, lever = (recording.interpolated(n)[::SPARSE] for n in (BOOM, STICK, LEVER))
    rest = np.abs(lever) <= AT_REST * np.abs(lever).max()
    moved, followed = (np.diff(angle)[rest[1:] & rest[:-1]] for angle in (boom, stick))
    return float(moved @ followed / (moved @ moved)) if rms(moved) > LEAST_MOTION else 0.0


def unused_files(folder: Path, recordings: Sequence[Recording]) -> list[str]:
    """A sentence for each data file of a folder that belongs to none of its recordings."""
    used = {recording.source.name for recording in recordings}
    unused = [(path, path.with_suffix(".toml")) for path in _data_files(folder) if path.name not in used]
    return [
        f"{path.name}: left out, {description.name} "
        f"{'has no table [experiment]' if description.is_file() else 'is missing'}."
        for path, description in unused
    ]


def _data_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in READABLE)


def require(recording: Recording, signals: Mapping[str, str]) -> None:
    """Raise Problem if a recording lacks one of the signals, or gives it in a unit of another dimension.

    signals   signal -> its SI unit
    """
    for name, unit in signals.items():
        recording[name]  # raises Problem if the signal is missing
        if parse_unit(recording.units[name]).exponents != parse_unit(unit).exponents:
            raise Problem(
                f"{recording.source}: signal {name} is in {recording.unit_label(name)}, expected {unit}"
            )


def take(recording: Recording, samples: slice | Mask | NDArray[np.int64]) -> Recording:
    """Samples of a recording selected by a slice, a mask or indices."""
    signals = {name: values[samples] for name, values in recording.signals.items()}
    return replace(recording, time=recording.time[samples], signals=signals)


def split(recording: Recording, at: float) -> tuple[Recording, Recording]:
    """The recording before and from the time `at` [s], such as one part to fit and one to hold out."""
    before = recording.time < at
    if before.all() or not before.any():
        got = f"{recording.time[0]:g} s to {recording.time[-1]:g} s"
        raise Problem(f"{recording.source}: expected samples before and from {at:g} s, got {got}")
    return take(recording, before), take(recording, ~before)


def add(recording: Recording, name: str, values: Array, unit: str, sensor: Sensor | None = None) -> Recording:
    """The recording with a signal added or replaced, such as a speed from an angle; `unit` is SI."""
    if values.shape != recording.time.shape:
        raise Problem(
            f"{recording.source}: signal {name}: expected shape {recording.time.shape}, got {values.shape}"
        )
    sensors = {key: s for key, s in recording.sensors.items() if key != name}
    return replace(
        recording,
        signals={**recording.signals, name: values},
        units={**recording.units, name: unit},
        file_units={key: u for key, u in recording.file_units.items() if key != name},
        sensors=sensors if sensor is None else {**sensors, name: sensor},
    )
