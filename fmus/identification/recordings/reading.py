"""Recordings for identification: one, a folder of experiments, a file of plain numbers; and parts of them.

A recording is a data file and the TOML file of the same name that describes it, see docs/recordings.md and
`orchestrator.data.recording`. `read_series` needs no description: it reads somebody else's data set. `take`,
`window`, `split`, `add` and `blank` change samples; all else (units, sensors, conditions) stays.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.units import parse, si_unit
from orchestrator.data.recording import Mask, Recording, Sensor, read_recording
from orchestrator.data.table import GAP_MARKS, SUFFIXES, Array, TextFormat, read_columns

PROCEDURES = ("valve", "hose_resistance", "hose_dynamics", "motor_leakage", "damping", "machine")
FIRST = 50  # lines that are looked at before a file is read
COMMA = re.compile(r"[-+]?\d+(,\d+)?([eE][-+]?\d+)?|nan", re.IGNORECASE)


def read(path: Path | str) -> Recording:
    """The part of a recording that counts, by its data file or its description."""
    whole = read_recording(path)
    if whole.procedure not in ("", *PROCEDURES):
        expected = f"one of {', '.join(PROCEDURES)}"
        raise Problem(f"{whole.source}: experiment: procedure: expected {expected}, got {whole.procedure!r}")
    inside = (whole.time >= whole.start) & (whole.time <= whole.stop)
    if inside.sum() < 2:
        raise Problem(
            f"{whole.source}: expected samples from {whole.start:g} s to {whole.stop:g} s,"
            f" got {whole.time[0]:g} s to {whole.time[-1]:g} s"
        )
    return whole if inside.all() else take(whole, inside)


def read_folder(folder: Path | str) -> list[Recording]:
    """The recordings of a folder whose description has a table [experiment], sorted by file name."""
    folder = Path(folder)
    if not folder.is_dir():
        found = "a file" if folder.is_file() else "no such file or folder"
        raise Problem(f"{folder}: expected a folder of recordings, got {found}")
    described = sorted(folder.glob("*.toml"))
    experiments = [path for path in described if "experiment" in toml.read(path, path.read_bytes()).data]
    if not experiments:
        others = ", ".join(path.name for path in _data_files(folder)[:3])
        found = f"none, only {others}" if others else "none"
        raise Problem(f"{folder}: expected .toml files with a table [experiment], got {found}")
    return [read(path) for path in experiments]


def left_out(folder: Path, recordings: Sequence[Recording]) -> list[str]:
    """Sentences on the data files of a folder that none of its recordings is of."""
    used = {recording.source.name for recording in recordings}
    sentences = []
    for path in _data_files(folder):
        described = path.with_suffix(".toml")
        lacks = "has no table [experiment]" if described.is_file() else ""
        reason = f"{described.name} {lacks}" if lacks else f"there is no {described.name}"
        if path.name not in used:
            sentences.append(f"{path.name}: left out, {reason}.")
    return sentences


def _data_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)


def require(recording: Recording, signals: Mapping[str, str]) -> None:
    """Refuse a recording that lacks one of the signals, or has it as another quantity than its SI unit."""
    for name, wanted in signals.items():
        recording[name]
        if parse(recording.units[name]).exponents != parse(wanted).exponents:
            raise Problem(
                f"{recording.source}: signal {name} is in {recording.unit_label(name)}, expected {wanted}"
            )


def take(recording: Recording, samples: slice | Mask | NDArray[np.int64]) -> Recording:
    """Some samples of a recording, by a slice, a mask or their numbers."""
    signals = {name: values[samples] for name, values in recording.signals.items()}
    return replace(recording, time=recording.time[samples], signals=signals)


def window(recording: Recording, start: float = -np.inf, stop: float = np.inf) -> Recording:
    """The samples from `start` to before `stop` [s]."""
    part = take(recording, (recording.time >= start) & (recording.time < stop))
    if not len(part.time):
        there = f"{recording.time[0]:g} s to {recording.time[-1]:g} s"
        raise Problem(f"{recording.source}: no samples from {start:g} s to {stop:g} s, got {there}")
    return part


def split(recording: Recording, at: float) -> tuple[Recording, Recording]:
    """Two recordings, before and from the time `at` [s]: one to fit, one to hold out."""
    return window(recording, stop=at), window(recording, start=at)


def add(recording: Recording, name: str, values: Array, unit: str, sensor: Sensor | None = None) -> Recording:
    """The recording with one signal more (or another one in its place), such as a speed from an angle.

    unit   SI
    """
    if values.shape != recording.time.shape:
        raise Problem(
            f"{recording.source}: signal {name}: expected shape {recording.time.shape}, got {values.shape}"
        )
    sensors = {key: known for key, known in recording.sensors.items() if key != name}
    return replace(
        recording,
        signals={**recording.signals, name: values},
        units={**recording.units, name: unit},
        file_units={key: own for key, own in recording.file_units.items() if key != name},
        sensors=sensors if sensor is None else {**sensors, name: sensor},
    )


def blank(recording: Recording, name: str, bad: Mask) -> Recording:
    """The recording with gaps (NaN) in one signal where `bad`."""
    values = np.where(bad, np.nan, recording[name])
    return replace(recording, signals={**recording.signals, name: values})


def read_series(
    path: Path | str,
    columns: Mapping[str, int | str],
    *,
    rate: float = 1.0,
    units: Mapping[str, str] | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    skip_lines: int = 0,
    title: str = "",
) -> Recording:
    """A file of plain numbers without a description, such as somebody else's data set.

    columns     our name -> place from 0 in a text file without names, or name of a column or MATLAB variable
    rate        samples per second [Hz]
    units       unit of each column; "1" if there is none
    delimiter, decimal   of a text file; None: found in its first lines
    """
    path, units = Path(path), units or {}
    stray = [name for name in units if name not in columns]
    if stray or not columns or rate <= 0:
        found = f"a unit of {stray[0]}" if stray else f"{len(columns)} columns and a rate of {rate:g} Hz"
        raise Problem(f"{path}: expected columns, their units and a rate above 0, got {found}")
    scales = {name: parse(units.get(name, "1"), f"{path}: {name}") for name in columns}
    by_place = [place for place in columns.values() if isinstance(place, int)]
    plain_text = path.suffix.lower() not in (".mat", ".parquet")
    if by_place and (len(by_place) < len(columns) or not plain_text):
        raise Problem(f"{path}: expected the names of columns, got place {by_place[0]}")
    form = _detected(path, delimiter, decimal, skip_lines, bool(by_place)) if plain_text else None
    found_columns = read_columns(path, {str(place) for place in columns.values()}, form, named=not by_place)
    raw = {name: found_columns.values[str(place)] for name, place in columns.items()}
    return Recording(
        source=path,
        time=np.arange(len(found_columns.rows)) / rate,
        signals={name: scales[name].factor * values + scales[name].offset for name, values in raw.items()},
        units={name: si_unit(units.get(name, "1")) for name in columns},
        title=title or path.stem,
    )


def _detected(
    path: Path, delimiter: str | None, decimal: str | None, skip_lines: int, by_place: bool
) -> TextFormat:
    """How a text file is written, from its first lines where nobody says.

    A comma between digits is decimal if something else separates the cells.
    """
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise Problem(f"{path}: expected a file of numbers, got {found}")
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = [line.strip() for line in islice(file, skip_lines, skip_lines + FIRST)]
    rows = [re.split(r"[;\s]+", line.strip(" ;")) for line in lines]
    comma = any(len(r) > 1 and any("," in cell for cell in r) and all(map(COMMA.fullmatch, r)) for r in rows)
    point = decimal or ("," if comma and delimiter != "," else ".")
    first = lines[0] if lines else ""
    mark = delimiter or next((mark for mark in ";," if mark in first and mark != point), r"\s+")
    cells = [cell.strip(' "') for cell in re.split(mark if len(mark) > 1 else re.escape(mark), first)]
    if by_place and all(re.match(r"[^\W\d_]", cell) and cell.lower() not in GAP_MARKS for cell in cells):
        raise Problem(
            f"{path}: line {skip_lines + 1}: expected numbers, got names: give those of the columns, "
            f"such as {cells[0]!r}, not their places"
        )
    return TextFormat(delimiter=mark, decimal=point, skip_lines=skip_lines)
