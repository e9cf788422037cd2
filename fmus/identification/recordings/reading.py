"""Read recordings: `read` one, `read_folder` a folder of experiments, `read_series` a file of plain numbers.

A recording is a data file (.csv, .parquet or .mat) and a meta file of the same name with .toml beside it.
Values become SI by the dimension of their unit. docs/recordings.md describes the format.

A file of plain numbers without a meta file, such as somebody else's data set.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from fmus.identification.recordings.description import (
    Meta,
    conditions,
    load,
    read_meta,
    seconds,
    sensor,
    signal,
    unit,
)
from fmus.identification.recordings.recording import Array, Recording
from fmus.identification.recordings.table import DATA, GAPS, read_table, read_text
from orchestrator.base.errors import Problem
from orchestrator.base.units import in_si, parse

__all__ = ["left_out", "read", "read_folder", "read_series", "require"]


def read(path: Path | str) -> Recording:
    """One recording, by its data file or its meta file."""
    path = Path(path)
    if path.suffix.lower() not in (*DATA, ".toml"):
        raise Problem(f"{path}: expected a file that ends in {', '.join((*DATA, '.toml'))}")
    if not path.is_file():
        raise Problem(f"{path}: expected a recording, found {_what(path)}")
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
        raise Problem(f"{folder}: expected a folder of recordings, found {_what(folder)}")
    metas = [path for path in sorted(folder.glob("*.toml")) if "experiment" in load(path)]
    if not metas:
        beside = ", ".join(path.name for path in _data_files(folder)[:3])
        found = f"none, only {beside}" if beside else "none"
        raise Problem(f"{folder}: expected .toml files with a table [experiment], found {found}")
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
            raise Problem(
                f"{recording.source}: signal {name} is in {recording.unit_in_words(name)}, expected {wanted}"
            )


def _data(meta: Meta) -> Path:
    """The data file that belongs to a meta file."""
    if "csv" in meta.file:
        return meta.path.with_name(meta.file["csv"])
    there = [meta.path.with_suffix(end) for end in DATA if meta.path.with_suffix(end).is_file()]
    if len(there) != 1:
        found = ", ".join(path.name for path in there) or "none"
        raise Problem(
            f"{meta.path}: expected one data file {meta.path.stem}.csv, .parquet or .mat, found {found}"
        )
    return there[0]


def _inside(recording: Recording, start: float, stop: float) -> Recording:
    """The part from `start` to `stop` [s] that the meta file asks for."""
    kept = (recording.time >= start) & (recording.time <= stop)
    if kept.all():
        return recording
    if kept.sum() < 2:
        raise Problem(
            f"{recording.source}: expected samples from {start:g} s to {stop:g} s,"
            f" found {recording.time[0]:g} s to {recording.time[-1]:g} s"
        )
    signals = {name: values[kept] for name, values in recording.signals.items()}
    return replace(recording, time=recording.time[kept], signals=signals)


def _what(path: Path) -> str:
    return "a folder" if path.is_dir() else "a file" if path.is_file() else "no such file or folder"


FIRST = 50  # lines that are looked at before a file is read
COMMA = re.compile(r"[-+]?\d+(,\d+)?([eE][-+]?\d+)?|nan", re.IGNORECASE)


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
    """A file of plain numbers without a meta file, such as somebody else's data set.

    columns     our name -> place from 0 in a text file without names, or name of a column or MATLAB variable
    rate        samples per second [Hz]
    units       unit of each column; "1" if there is none
    delimiter, decimal   of a text file; None: found in its first lines
    """
    path, units = Path(path), units or {}
    stray = [name for name in units if name not in columns]
    if stray or not columns or rate <= 0:
        found = f"a unit of {stray[0]}" if stray else f"{len(columns)} columns and a rate of {rate:g} Hz"
        raise Problem(f"{path}: expected columns, their units and a rate above 0, found {found}")
    spelling = {name: unit(units.get(name, "1"), f"{path}: {name}") for name in columns}
    raw = _plain(path, columns, delimiter, decimal, skip_lines)
    size = len(next(iter(raw.values())))
    return Recording(
        source=path,
        title=title or path.stem,
        procedure="",
        use="train",
        conditions={},
        time=np.arange(size) / rate,
        signals={name: signal(values, {"unit": spelling[name]}) for name, values in raw.items()},
        units={name: in_si(text) for name, text in spelling.items()},
    )


def _plain(
    path: Path, columns: Mapping[str, int | str], delimiter: str | None, decimal: str | None, skip_lines: int
) -> dict[str, Array]:
    """Columns of a file without meta by name or place."""
    kind, names = path.suffix.lower(), {str(place) for place in columns.values()}
    by_place = [place for place in columns.values() if isinstance(place, int)]
    if by_place and (kind in (".mat", ".parquet") or len(by_place) < len(columns)):
        raise Problem(f"{path}: expected the names of columns, found place {by_place[0]}")
    if kind in (".mat", ".parquet"):
        table = read_table(path, names, {})
    else:
        lines = _first_lines(path, skip_lines)
        point = decimal or ("," if _has_comma(lines) and delimiter != "," else ".")
        split = delimiter or _delimiter(lines, point)
        if by_place and lines:
            _refuse_names(path, lines[0], split, skip_lines + 1)
        table = read_text(path, names, split, point, skip_lines, named=not by_place)
    return {name: table.columns[str(place)] for name, place in columns.items()}


def _first_lines(path: Path, skip_lines: int) -> list[str]:
    """Those that tell how the file is written, the first with names or numbers."""
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise Problem(f"{path}: expected a file of numbers, found {found}")
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        return [line.strip() for line in islice(file, skip_lines, skip_lines + FIRST)]


def _has_comma(lines: Sequence[str]) -> bool:
    """Is a comma the decimal sign? It is if something else separates the cells."""
    cells = [re.split(r"[;\s]+", line.strip(" ;")) for line in lines]
    return any(
        len(row) > 1 and any("," in cell for cell in row) and all(map(COMMA.fullmatch, row)) for row in cells
    )


def _delimiter(lines: Sequence[str], decimal: str) -> str:
    """What separates the columns of the first line: ; or , or white space."""
    line = lines[0] if lines else ""
    return next((mark for mark in ";," if mark in line and mark != decimal), r"\s+")


def _refuse_names(path: Path, line: str, delimiter: str, number: int) -> None:
    """Places count in a file without names: a first row without any number has names."""
    mark = delimiter if len(delimiter) > 1 else re.escape(delimiter)
    cells = [cell.strip(' "') for cell in re.split(mark, line)]
    if all(re.match(r"[^\W\d_]", cell) and cell.lower() not in GAPS for cell in cells):
        raise Problem(
            f"{path}: line {number}: expected numbers, found names: give those of the columns, "
            f"such as {cells[0]!r}, not their places"
        )
