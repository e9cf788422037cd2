"""Number columns of a text file as people and loggers write them. An empty cell is a gap."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Collection
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.recordings.columns import Table, finite, first_line, place
from fmus.identification.recordings.recording import Array

GAPS = ("", "nan", "na", "n/a", "null", "none")  # what loggers write where there is no sample


def read_text(
    path: Path,
    names: Collection[str],
    delimiter: str | None = None,
    decimal: str | None = None,
    skip_lines: int = 0,
    named: bool = True,
) -> Table:
    """Columns of a text file by name.

    named        the first row has the names; else they are "0", "1", ...
    delimiter    one character, or r"\\s+" for any white space; by default a comma
    decimal      a point or a comma; by default a point
    skip_lines   lines before the names, or before the first numbers
    """
    origin = "the default" if delimiter is None else "as told"
    delimiter = "," if delimiter is None else delimiter
    decimal = "." if decimal is None else decimal
    _marks(path, delimiter, decimal, origin)
    text = _text(path)
    _separated(text, path, delimiter, skip_lines, origin)
    frame = _cells(text, path, delimiter, skip_lines)
    header = [f"{i}" for i in frame]
    if named:
        header, frame = [str(name).strip() for name in frame.iloc[0]], frame.iloc[1:]
    empty = frame[0] == ""
    frame = frame[~empty | (frame != "").any(axis=1)]
    places = {name: place(name, header, path) for name in sorted(names)}
    lines = frame.index.to_numpy() + skip_lines + 1
    _whole_rows(text, frame, lines, delimiter, path)
    columns = {
        name: numbers(frame[i].to_numpy(object), lines, decimal, f"{path}: line {{}}: column {name!r}")
        for name, i in places.items()
    }
    return Table(columns, lines, "line")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ModelError(f"{path}: expected a file of numbers, found no such file") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        found = error.object[error.start]
        raise ModelError(
            f"{path}: line {line}: expected text in UTF-8, found the byte 0x{found:02x}"
        ) from None
    except OSError as error:
        raise ModelError(f"{path}: expected a file of numbers, found {error.strerror}") from None


def _marks(path: Path, delimiter: str, decimal: str, origin: str) -> None:
    """Refuse marks that cannot be, or that cannot be told apart; origin: where the delimiter is from."""
    if decimal not in (".", ","):
        raise ModelError(f"{path}: [file] decimal is {decimal!r}, expected '.' or ','")
    if len(delimiter) != 1 and delimiter != r"\s+":
        raise ModelError(f"{path}: [file] delimiter is {delimiter!r}, expected one character such as ';'")
    if delimiter == decimal:
        raise ModelError(
            f"{path}: [file] decimal is {decimal!r}, expected another delimiter than it,"
            f' found {delimiter!r} ({origin}): set delimiter = ";"'
        )


def _separated(text: str, path: Path, delimiter: str, skip_lines: int, origin: str) -> None:
    """Refuse a first row without the delimiter that has another one."""
    row = next(iter(text.splitlines()[skip_lines : skip_lines + 1]), "")
    found = next((mark for mark in ";\t," if mark in row), None)
    if found and len(delimiter) == 1 and delimiter not in row:
        shown = found.replace("\t", r"\t")
        raise ModelError(
            f"{path}: line {skip_lines + 1}: expected cells separated by {delimiter!r} ({origin}),"
            f' found {found!r}: set delimiter = "{shown}" in [file]'
        )


def _cells(text: str, path: Path, delimiter: str, skip_lines: int) -> pd.DataFrame:
    """Cells as text, one row for each line, blank ones included."""
    try:
        return pd.read_csv(
            StringIO(text),
            sep=delimiter,
            header=None,
            skiprows=skip_lines,
            dtype=str,
            keep_default_na=False,
            skip_blank_lines=False,
        )
    except pd.errors.EmptyDataError:
        raise ModelError(f"{path}: expected two or more rows of numbers, found an empty file") from None
    except pd.errors.ParserError as error:
        found = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        if not found:
            raise ModelError(f"{path}: expected a text file of columns, found {first_line(error)}") from None
        wanted, line, saw = found.groups()
        raise ModelError(f"{path}: line {line}: expected {wanted} cells, found {saw}") from None


def _whole_rows(text: str, frame: pd.DataFrame, lines: NDArray[np.int64], delimiter: str, path: Path) -> None:
    """A row that stops early, such as the last one of a logger that lost power, is an error, not a gap."""
    rows, columns = frame.shape
    if rows < 2:
        raise ModelError(f"{path}: expected two or more rows of numbers, found {rows}")
    written = text.split("\n")
    for line in lines[(frame[columns - 1] == "").to_numpy()]:
        row = written[line - 1]
        there = len(row.split()) if len(delimiter) > 1 else len(next(csv.reader([row], delimiter=delimiter)))
        if there < columns:
            raise ModelError(f"{path}: line {line}: expected {columns} cells, found {there}")


def numbers(cells: NDArray[Any], rows: NDArray[np.int64], decimal: str, where: str) -> Array:
    """Text as numbers, gaps as NaN; `where` has a place for the row."""
    plain = [cell.replace(",", ".") for cell in cells] if decimal == "," else cells
    try:
        return finite(np.array(plain, dtype=object).astype(np.float64), rows, where)
    except ValueError:
        # slower: there are gaps, or something that is no number
        values = [_number(cell) for cell in plain]
    if None in values:
        bad = values.index(None)
        found = repr(cells[bad].strip())
        if decimal == "." and _number(cells[bad].replace(",", ".")) is not None:
            found += ': set decimal = "," in [file]'
        raise ModelError(f"{where.format(rows[bad])}: expected a number, found {found}")
    return finite(np.array(values, dtype=np.float64), rows, where)


def _number(cell: str) -> float | None:
    """A number, NaN for a gap, None for what is neither."""
    if cell.strip().lower() in GAPS:
        return math.nan
    try:
        return float(cell)
    except ValueError:
        return None
