"""Number columns of a file, whichever kind it is: a sample that is not there is a gap, NaN.

Number columns of a text file as people and loggers write them. An empty cell is a gap.

Columns of a MATLAB file: vectors, fields of structs ("run.pressure"), of a matrix "data(:,2)".

Versions 4 to 7.2 are read by scipy, version 7.3 is an HDF5 file and read by h5py.

Number columns of a Parquet file. A null is a gap.

The columns of a data file, whichever kind it is.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from difflib import get_close_matches
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pandas as pd
import pyarrow
import pyarrow.parquet
import scipy.io
from numpy.typing import NDArray

from fmus.identification.recordings.recording import Array
from orchestrator.base.errors import Problem


class Table(NamedTuple):
    """Columns of one file.

    row     line (text) or row (other files) of each sample, counted from 1
    rows    what that is called in a message
    """

    columns: Mapping[str, Array]
    row: NDArray[np.int64]
    rows: str = "row"


def finite(values: Array, rows: NDArray[np.int64], where: str) -> Array:
    """The values, which may be gaps but not infinite."""
    endless = np.flatnonzero(np.isinf(values))
    if len(endless):
        k = endless[0]
        raise Problem(f"{where.format(rows[k])}: expected a finite number, found {values[k]:g}")
    return values


def place(name: str, header: Sequence[str], path: Path) -> int:
    """Where a column stands; it must be there once."""
    if list(header).count(name) == 1:
        return list(header).index(name)
    if name in header:
        raise Problem(f"{path}: column {name!r} expected once, found {list(header).count(name)} times")
    raise Problem(f"{path}: column {name!r} expected, found {near(name, header)}")


def near(name: str, names: Sequence[str]) -> str:
    """The names that come close to one that is missing, else the first ones."""
    close = get_close_matches(name, names, 3)
    first = [*names[:8], *(["..."] if len(names) > 8 else [])]
    return ", ".join(close or first) or "no names"


def first_line(error: Exception) -> str:
    """The first line of a library's message."""
    return str(error).strip().splitlines()[0]


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
        raise Problem(f"{path}: expected a file of numbers, found no such file") from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        found = error.object[error.start]
        raise Problem(f"{path}: line {line}: expected text in UTF-8, found the byte 0x{found:02x}") from None
    except OSError as error:
        raise Problem(f"{path}: expected a file of numbers, found {error.strerror}") from None


def _marks(path: Path, delimiter: str, decimal: str, origin: str) -> None:
    """Refuse marks that cannot be, or that cannot be told apart; origin: where the delimiter is from."""
    if decimal not in (".", ","):
        raise Problem(f"{path}: [file] decimal is {decimal!r}, expected '.' or ','")
    if len(delimiter) != 1 and delimiter != r"\s+":
        raise Problem(f"{path}: [file] delimiter is {delimiter!r}, expected one character such as ';'")
    if delimiter == decimal:
        raise Problem(
            f"{path}: [file] decimal is {decimal!r}, expected another delimiter than it,"
            f' found {delimiter!r} ({origin}): set delimiter = ";"'
        )


def _separated(text: str, path: Path, delimiter: str, skip_lines: int, origin: str) -> None:
    """Refuse a first row without the delimiter that has another one."""
    row = next(iter(text.splitlines()[skip_lines : skip_lines + 1]), "")
    found = next((mark for mark in ";\t," if mark in row), None)
    if found and len(delimiter) == 1 and delimiter not in row:
        shown = found.replace("\t", r"\t")
        raise Problem(
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
        raise Problem(f"{path}: expected two or more rows of numbers, found an empty file") from None
    except pd.errors.ParserError as error:
        found = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        if not found:
            raise Problem(f"{path}: expected a text file of columns, found {first_line(error)}") from None
        wanted, line, saw = found.groups()
        raise Problem(f"{path}: line {line}: expected {wanted} cells, found {saw}") from None


def _whole_rows(text: str, frame: pd.DataFrame, lines: NDArray[np.int64], delimiter: str, path: Path) -> None:
    """A row that stops early, such as the last one of a logger that lost power, is an error, not a gap."""
    rows, columns = frame.shape
    if rows < 2:
        raise Problem(f"{path}: expected two or more rows of numbers, found {rows}")
    written = text.split("\n")
    for line in lines[(frame[columns - 1] == "").to_numpy()]:
        row = written[line - 1]
        there = len(row.split()) if len(delimiter) > 1 else len(next(csv.reader([row], delimiter=delimiter)))
        if there < columns:
            raise Problem(f"{path}: line {line}: expected {columns} cells, found {there}")


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
        raise Problem(f"{where.format(rows[bad])}: expected a number, found {found}")
    return finite(np.array(values, dtype=np.float64), rows, where)


def _number(cell: str) -> float | None:
    """A number, NaN for a gap, None for what is neither."""
    if cell.strip().lower() in GAPS:
        return math.nan
    try:
        return float(cell)
    except ValueError:
        return None


MOST_COLUMNS = 256  # of a matrix that are listed one by one


def read_mat(path: Path, names: Collection[str]) -> Table:
    """Columns of a MATLAB file by name, all of one length."""
    there = dict(_flat("", _variables(path)))
    for name in names:
        if name not in there:
            raise Problem(f"{path}: column {name!r} expected, found {near(name, list(there))}")
    columns = {name: _numbers(there[name], path, name) for name in sorted(names)}
    sizes = {name: len(values) for name, values in columns.items()}
    if len(set(sizes.values())) > 1:
        found = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise Problem(f"{path}: expected columns of one length, found {found}")
    if min(sizes.values()) < 2:
        raise Problem(f"{path}: expected two or more samples, found {min(sizes.values())}")
    rows = np.arange(1, 1 + min(sizes.values()))
    for name, values in columns.items():
        finite(values, rows, f"{path}: row {{}}: column {name!r}")
    return Table(columns, rows)


def _variables(path: Path) -> dict[str, Any]:
    """Arrays by name, structs as dictionaries, whichever version."""
    if not path.is_file():
        raise Problem(f"{path}: expected a MATLAB file, found no such file")
    try:
        if h5py.is_hdf5(path):
            with h5py.File(path, "r") as file:
                return _group(file)
        return dict(scipy.io.loadmat(path, simplify_cells=True))
    except (ValueError, TypeError, OSError, NotImplementedError, scipy.io.matlab.MatReadError) as error:
        first = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise Problem(f"{path}: expected a MATLAB file, found {first}") from None


def _group(group: Any) -> dict[str, Any]:
    """A group of HDF5, which is a struct; text becomes a string, references (cells, objects) are left out."""
    result: dict[str, Any] = {}
    for name, item in group.items():
        if name.startswith("#"):
            continue
        if isinstance(item, h5py.Group):
            result[name] = _group(item)
        elif item.attrs.get("MATLAB_class") == b"char":
            result[name] = "".join(map(chr, np.asarray(item).T.ravel()))
        elif item.dtype.kind in "fiub" and not item.attrs.get("MATLAB_empty", 0):
            result[name] = np.asarray(item).T  # HDF5 counts dimensions the other way round
    return result


def _flat(prefix: str, struct: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and contents of what could be a column."""
    for key, item in struct.items():
        name = f"{prefix}{key}"
        if name.startswith("__"):
            continue
        if isinstance(item, dict):
            yield from _flat(f"{name}.", item)
        elif isinstance(item, str):
            yield name, item
        else:
            yield from _columns(name, np.asarray(item))


def _columns(name: str, array: NDArray[Any]) -> Iterator[tuple[str, Any]]:
    """A vector by its name, a matrix by "name(:,1)", "name(:,2)", ...; a wide one by "name(1,:)", ..."""
    array = np.squeeze(array)
    if array.ndim < 2:
        yield name, np.atleast_1d(array)
    elif array.ndim == 2 and array.shape[1] <= MOST_COLUMNS:
        for i in range(array.shape[1]):
            yield f"{name}(:,{i + 1})", array[:, i]
    elif array.ndim == 2 and array.shape[0] <= MOST_COLUMNS:  # one signal per row, as is usual for data sets
        for i in range(array.shape[0]):
            yield f"{name}({i + 1},:)", array[i]


def _numbers(values: Any, path: Path, name: str) -> NDArray[np.float64]:
    """Real numbers; text and complex numbers are refused."""
    if isinstance(values, str) or values.dtype.kind not in "fiub":
        found = repr(values[:40]) if isinstance(values, str) else f"{values.dtype} such as {values[0]!r}"
        raise Problem(f"{path}: row 1: column {name!r}: expected numbers, found {found}")
    numbers: NDArray[np.float64] = values.astype(np.float64)
    return numbers


def read_parquet(path: Path, names: Collection[str]) -> Table:
    """Columns of a Parquet file by name."""
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            header = file.schema_arrow.names
            for name in names:
                place(name, header, path)
            table = file.read(columns=sorted(names))
    except (pyarrow.ArrowInvalid, OSError) as error:
        raise Problem(f"{path}: expected a Parquet file, found {first_line(error)}") from None
    rows = np.arange(1, table.num_rows + 1)
    columns = {name: _arrow(table.column(name), rows, path, name) for name in sorted(names)}
    return Table(columns, rows)


def _arrow(column: Any, rows: NDArray[np.int64], path: Path, name: str) -> Array:
    """A column of Parquet as numbers; a column of text too if all of it is numbers."""
    where = f"{path}: row {{}}: column {name!r}"
    kind = column.type
    if pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind) or pyarrow.types.is_decimal(kind):
        return finite(column.cast(pyarrow.float64()).to_pandas().to_numpy(np.float64), rows, where)
    if pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind):
        return numbers(np.array([v or "" for v in column.to_pylist()], object), rows, ".", where)
    raise Problem(f"{path}: row 1: column {name!r}: expected numbers, found {kind}")


DATA = (".csv", ".parquet", ".mat")


def read_table(data: Path, names: Collection[str], file: Mapping[str, Any]) -> Table:
    """Columns by name; `file` is the table [file] of the meta file, for text."""
    kind = data.suffix.lower()
    if kind == ".parquet":
        return read_parquet(data, names)
    if kind == ".mat":
        return read_mat(data, names)
    return read_text(data, names, file.get("delimiter"), file.get("decimal"), file.get("skip_lines", 0))
