"""Number columns of a file: CSV, Parquet or MATLAB. An empty cell is a gap, NaN; anything else is a number.

Each reader returns raw values, shape (n,), and the number of each row as a person counts it in the file.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow
import pyarrow.parquet
from numpy.typing import NDArray

from fmus.contract import ModelError

Array = NDArray[np.float64]

GAPS = ("", "nan", "na", "n/a", "null", "none")  # what loggers write where there is no sample


class Table(NamedTuple):
    """Columns of one file.

    row     line (text) or row (other files) of each sample, counted from 1
    rows    what that is called in a message
    """

    columns: Mapping[str, Array]
    row: NDArray[np.int64]
    rows: str = "row"


def read_text(
    path: Path,
    names: Collection[str],
    delimiter: str = ",",
    decimal: str = ".",
    skip_lines: int = 0,
    named: bool = True,
) -> Table:
    """Columns of a text file by name.

    named        the first row has the names; else they are "0", "1", ...
    delimiter    one character, or r"\\s+" for any white space
    skip_lines   lines before the names, or before the first numbers
    """
    if decimal not in (".", ",") or delimiter == decimal or (len(delimiter) != 1 and delimiter != r"\s+"):
        raise ModelError(
            f"{path}: expected a one-character delimiter and decimal . or ,, found {delimiter!r}, {decimal!r}"
        )
    cells = _cells(path, delimiter, skip_lines)
    lines = np.arange(skip_lines + 1, skip_lines + 1 + len(cells))
    header = [f"{i}" for i in range(cells.shape[1])]
    if named:
        header = [str(name).strip() for name in cells[0]] if len(cells) else []
        cells, lines = cells[1:], lines[1:]
    written = (cells != "").any(axis=1) if len(cells) else np.zeros(0, dtype=bool)
    cells, lines = cells[written], lines[written]
    places = {name: _place(name, header, path) for name in sorted(names)}
    _whole_rows(cells, lines, path)
    columns = {
        name: _numbers(cells[:, place], lines, decimal, f"{path}: line {{}}: column {name!r}")
        for name, place in places.items()
    }
    return Table(columns, lines, "line")


def read_parquet(path: Path, names: Collection[str]) -> Table:
    """Columns of a Parquet file by name."""
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            header = file.schema_arrow.names
            for name in names:
                _place(name, header, path)
            table = file.read(columns=sorted(names))
    except (pyarrow.ArrowInvalid, OSError) as error:
        raise ModelError(f"{path}: expected a Parquet file, found {_line(error)}") from None
    rows = np.arange(1, table.num_rows + 1)
    columns = {name: _arrow(table.column(name), rows, path, name) for name in sorted(names)}
    return Table(columns, rows)


def _cells(path: Path, delimiter: str, skip_lines: int) -> NDArray[Any]:
    """Cells as text without the space around them, shape (lines, columns); None where a row is too short."""
    try:
        frame = pd.read_csv(
            path,
            sep=delimiter,
            header=None,
            skiprows=skip_lines,
            dtype=str,
            keep_default_na=False,
            skip_blank_lines=False,
            encoding="utf-8-sig",
            encoding_errors="strict",
        )
    except FileNotFoundError:
        raise ModelError(f"{path}: expected a file of numbers, found no such file") from None
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: expected text in UTF-8, found {error}") from None
    except pd.errors.EmptyDataError:
        raise ModelError(f"{path}: expected two or more rows of numbers, found an empty file") from None
    except pd.errors.ParserError as error:
        found = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        if not found:
            raise ModelError(f"{path}: expected a text file of columns, found {_line(error)}") from None
        wanted, line, saw = found.groups()
        raise ModelError(f"{path}: line {line}: expected {wanted} cells, found {saw}") from None
    except OSError as error:
        raise ModelError(f"{path}: expected a file of numbers, found {error.strerror}") from None
    columns = [frame[i].astype(object).where(frame[i].notna(), None) for i in frame]
    return np.array([[c.strip() if c is not None else None for c in column] for column in columns], object).T


def _whole_rows(cells: NDArray[Any], lines: NDArray[np.int64], path: Path) -> None:
    """A row that stops early, such as the last one of a logger that lost power, is an error."""
    short = np.flatnonzero(pd.isna(cells).any(axis=1))
    if len(short):
        there = sum(cell is not None for cell in cells[short[0]])
        raise ModelError(f"{path}: line {lines[short[0]]}: expected {cells.shape[1]} cells, found {there}")
    if len(cells) < 2:
        raise ModelError(f"{path}: expected two or more rows of numbers, found {len(cells)}")


def _numbers(cells: NDArray[Any], rows: NDArray[np.int64], decimal: str, where: str) -> Array:
    """Text as numbers, gaps as NaN; `where` has a place for the row."""
    text = np.where(np.isin(np.char.lower(cells.astype(str)), GAPS), "nan", cells)
    if decimal == ",":
        text = np.array([str(cell).replace(",", ".") for cell in text], dtype=object)
    try:
        values: Array = text.astype(np.float64)
    except ValueError:
        bad = next(k for k, cell in enumerate(text) if not _is_number(cell))
        raise ModelError(f"{where.format(rows[bad])}: expected a number, found {cells[bad]!r}") from None
    return finite(values, rows, where)


def finite(values: Array, rows: NDArray[np.int64], where: str) -> Array:
    """The values, which may be gaps but not infinite."""
    endless = np.flatnonzero(np.isinf(values))
    if len(endless):
        k = endless[0]
        raise ModelError(f"{where.format(rows[k])}: expected a finite number, found {values[k]:g}")
    return values


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _arrow(column: Any, rows: NDArray[np.int64], path: Path, name: str) -> Array:
    """A column of Parquet as numbers; a column of text too if all of it is numbers."""
    where = f"{path}: row {{}}: column {name!r}"
    kind = column.type
    if pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind) or pyarrow.types.is_decimal(kind):
        return finite(column.cast(pyarrow.float64()).to_pandas().to_numpy(np.float64), rows, where)
    if pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind):
        return _numbers(np.array([v or "" for v in column.to_pylist()], object), rows, ".", where)
    raise ModelError(f"{path}: row 1: column {name!r}: expected numbers, found {kind}")


def _place(name: str, header: Sequence[str], path: Path) -> int:
    if list(header).count(name) == 1:
        return list(header).index(name)
    if name in header:
        raise ModelError(f"{path}: column {name!r} expected once, found {list(header).count(name)} times")
    raise ModelError(f"{path}: column {name!r} expected, found {near(name, header)}")


def near(name: str, names: Sequence[str]) -> str:
    """The names that come close to one that is missing, else the first ones."""
    close = get_close_matches(name, names, 3)
    first = [*names[:8], *(["..."] if len(names) > 8 else [])]
    return ", ".join(close or first) or "no names"


def _line(error: Exception) -> str:
    """The first line of a library's message."""
    return str(error).strip().splitlines()[0]
