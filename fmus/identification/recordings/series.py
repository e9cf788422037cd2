"""A file of plain numbers without a meta file, such as somebody else's data set."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from fmus.contract import ModelError
from fmus.identification.recordings.conversion import signal
from fmus.identification.recordings.files import read_table
from fmus.identification.recordings.meta import unit
from fmus.identification.recordings.recording import Array, Recording
from fmus.identification.recordings.text import GAPS, read_text
from fmus.units import in_si

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
        raise ModelError(f"{path}: expected columns, their units and a rate above 0, found {found}")
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
        raise ModelError(f"{path}: expected the names of columns, found place {by_place[0]}")
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
        raise ModelError(f"{path}: expected a file of numbers, found {found}")
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
        raise ModelError(
            f"{path}: line {number}: expected numbers, found names: give those of the columns, "
            f"such as {cells[0]!r}, not their places"
        )
