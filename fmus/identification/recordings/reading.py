"""Read recordings: `read` one, `read_folder` a folder of experiments, `read_series` a file of plain numbers.

A recording is a data file (.csv, .parquet or .mat) and a meta file of the same name with .toml beside it.
Values become SI by the dimension of their unit. docs/recordings.md describes the format.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from fmus.contract import ModelError
from fmus.identification.recordings.conversion import conditions, seconds, sensor, signal
from fmus.identification.recordings.files import DATA, read_table
from fmus.identification.recordings.meta import Meta, read_meta, unit
from fmus.identification.recordings.recording import Recording
from fmus.identification.recordings.series import read_series
from fmus.identification.recordings.toml import load
from fmus.units import in_si, parse

__all__ = ["left_out", "read", "read_folder", "read_series", "require"]


def read(path: Path | str) -> Recording:
    """One recording, by its data file or its meta file."""
    path = Path(path)
    if path.suffix.lower() not in (*DATA, ".toml"):
        raise ModelError(f"{path}: expected a file that ends in {', '.join((*DATA, '.toml'))}")
    if not path.is_file():
        raise ModelError(f"{path}: expected a recording, found {_what(path)}")
    meta = read_meta(path if path.suffix == ".toml" else path.with_suffix(".toml"))
    data = _data(meta) if path.suffix == ".toml" else path
    clock = meta.time.get("column", "time")
    names = {clock, *(spec.get("column", name) for name, spec in meta.signals.items())}
    table = read_table(data, names, meta.file)
    recording = Recording(
        source=data,
        title=meta.title,
        procedure=meta.procedure,
        use=meta.use,
        conditions=conditions(meta),
        time=seconds(table, clock, meta, data),
        signals={
            name: signal(table.columns[spec.get("column", name)], spec) for name, spec in meta.signals.items()
        },
        units={name: in_si(unit(spec["unit"], name)) for name, spec in meta.signals.items()},
        sensors={name: found for name, spec in meta.signals.items() if (found := sensor(spec))},
        kind=meta.kind,
        told_units={name: spec["unit"] for name, spec in meta.signals.items()},
    )
    return _inside(recording, meta.time.get("start", -math.inf), meta.time.get("stop", math.inf))


def read_folder(folder: Path | str) -> list[Recording]:
    """All recordings of a folder whose meta file has a table [experiment], sorted by the name of the file."""
    folder = Path(folder)
    if not folder.is_dir():
        raise ModelError(f"{folder}: expected a folder of recordings, found {_what(folder)}")
    metas = [path for path in sorted(folder.glob("*.toml")) if "experiment" in load(path)]
    if not metas:
        beside = ", ".join(path.name for path in _data_files(folder)[:3])
        found = f"none, only {beside}" if beside else "none"
        raise ModelError(f"{folder}: expected .toml files with a table [experiment], found {found}")
    return [read(path) for path in metas]


def left_out(folder: Path, recordings: Sequence[Recording]) -> list[str]:
    """Sentences on the data files of a folder that none of its recordings is of."""
    used = {recording.source.name for recording in recordings}
    others = [path for path in _data_files(folder) if path.name not in used]
    return [f"{path.name}: left out, {_why(path.with_suffix('.toml'))}." for path in others]


def _data_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in DATA)


def _why(meta: Path) -> str:
    return f"{meta.name} has no table [experiment]" if meta.is_file() else f"there is no {meta.name}"


def require(recording: Recording, signals: Mapping[str, str]) -> None:
    """Refuse a recording that lacks one of the signals, or has it as another quantity than its SI unit."""
    for name, wanted in signals.items():
        recording[name]
        if parse(recording.units[name]).exponents != parse(wanted).exponents:
            raise ModelError(
                f"{recording.source}: signal {name} is in {recording.unit_in_words(name)}, expected {wanted}"
            )


def _data(meta: Meta) -> Path:
    """The data file that belongs to a meta file."""
    if "csv" in meta.file:
        return meta.path.with_name(meta.file["csv"])
    there = [meta.path.with_suffix(end) for end in DATA if meta.path.with_suffix(end).is_file()]
    if len(there) != 1:
        found = ", ".join(path.name for path in there) or "none"
        raise ModelError(
            f"{meta.path}: expected one data file {meta.path.stem}.csv, .parquet or .mat, found {found}"
        )
    return there[0]


def _inside(recording: Recording, start: float, stop: float) -> Recording:
    """The part from `start` to `stop` [s] that the meta file asks for."""
    kept = (recording.time >= start) & (recording.time <= stop)
    if kept.all():
        return recording
    if kept.sum() < 2:
        raise ModelError(
            f"{recording.source}: expected samples from {start:g} s to {stop:g} s,"
            f" found {recording.time[0]:g} s to {recording.time[-1]:g} s"
        )
    signals = {name: values[kept] for name, values in recording.signals.items()}
    return replace(recording, time=recording.time[kept], signals=signals)


def _what(path: Path) -> str:
    return "a folder" if path.is_dir() else "a file" if path.is_file() else "no such file or folder"
