r"""Reads columns of numbers from text files (CSV), Parquet files and MATLAB files.

A missing sample is a gap, NaN. An incomplete row, such as the last one of a logger that lost power, is an
error. Messages name the file and the line (text) or the row (other files), counted from 1. Columns of a
MATLAB file are vectors, fields of structs ("run.pressure"), columns of a matrix ("data(:,2)") and rows of a
matrix with many columns ("data(2,:)").
"""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location
from orchestrator.base.toml import NOT_NEGATIVE

Array = NDArray[np.float64]
SUFFIXES = (".csv", ".parquet", ".mat")
GAP_MARKS = ("", "nan", "na", "n/a", "null", "none")  # texts that loggers write for a missing sample
CHUNK = 5000  # rows of text converted at once, or cell by cell if one of them has a gap
MAX_LISTED_COLUMNS = 256  # a matrix with more columns is read by rows


@dataclass(frozen=True)
class TextFormat:
    r"""Format of a text file: the table [file] of a description.

    csv          name of the data file, of any format; "": the name of the description
    delimiter    one character, or r"\s+" for any white space; None: a comma
    decimal      a point or a comma; None: a point
    skip_lines   number of lines before the column names
    """

    csv: str = ""
    delimiter: str | None = None
    decimal: str | None = None
    skip_lines: Annotated[int, NOT_NEGATIVE] = 0


@dataclass(frozen=True)
class Columns:
    """Columns of a file by name, each of shape (n,).

    rows       the line or row of each sample, counted from 1
    row_word   "line" or "row", for messages
    units      units that the file contains
    """

    file: str
    values: Mapping[str, Array]
    rows: Sequence[int]
    row_word: str = "row"
    units: Mapping[str, str] = field(default_factory=dict)

    def location(self, sample: int) -> str:
        """File and line or row of a sample, for messages."""
        return f"{self.file}: {self.row_word} {self.rows[sample]}"


def read_columns(
    source: Location | Path,
    names: Collection[str] | None,
    form: TextFormat | None = None,
    named: bool = True,
) -> Columns:
    """Read columns of a Parquet file (.parquet), a MATLAB file (.mat) or a text file (any other suffix).

    names   columns to read; None: all columns of a text or Parquet file, in their order
    form    format of a text file; None: commas and decimal points
    named   True if a text file has a row of names; else its columns are "0", "1", ...
    """
    file = source if isinstance(source, Location) else Location(source)
    if not file.members and not file.path.is_file():
        raise Problem(f"{file}: no such file")
    suffix = Path(str(file)).suffix.lower()
    if suffix == ".parquet":
        columns = _read_parquet(file, names)
    else:
        columns = _read_mat(file, names) if suffix == ".mat" else _read_text(file, names, form, named)
    if len(columns.rows) < (1 if names is None else 2):
        raise Problem(f"{file}: expected two or more rows of numbers, got {len(columns.rows) or 'none'}")
    for name, values in columns.values.items():
        for k in np.flatnonzero(np.isinf(values))[:1]:
            message = f"expected a finite number, got {values[k]:g}"
            raise Problem(f"{columns.location(k)}: column {name!r}: {message}")
    return columns


def _read_text(
    file: Location, names: Collection[str] | None, form: TextFormat | None, named: bool
) -> Columns:
    text = _Text(file, form or TextFormat(), has_description=form is not None)
    lines = text.lines()
    first = text.form.skip_lines + 1
    text.check_marks(lines[0], first)
    header = [name.strip() for name in text.split(lines[0])]
    if not named:
        header = [str(i) for i in range(len(header))]
    indices = _column_indices(header, names, str(file), f"line {first}: ")
    blank = " \t" + (text.mark or "")
    rows = {first + i: lines[i] for i in range(int(named), len(lines)) if lines[i].strip(blank)}
    del lines
    if not rows:
        raise Problem(f"{file}: expected two or more rows of numbers, got none")
    text.check_widths(rows, len(header))
    numbers = list(rows)
    table = np.empty((len(indices), len(rows)))
    for start in range(0, len(rows), CHUNK):
        part = {number: rows[number] for number in numbers[start : start + CHUNK]}
        table[:, start : start + CHUNK] = text.parse_rows(part, indices).T
    return Columns(str(file), dict(zip(indices, table, strict=True)), numbers, "line")


@dataclass(frozen=True)
class _Text:
    """Reader of a text file.

    has_description   True if a description exists, in which the user can set the format
    """

    file: Location
    form: TextFormat
    has_description: bool

    @property
    def delimiter(self) -> str:
        return self.form.delimiter or ","

    @property
    def mark(self) -> str | None:
        """The delimiter, None for any white space."""
        return self.delimiter if len(self.delimiter) == 1 else None

    @property
    def decimal(self) -> str:
        return self.form.decimal or "."

    def lines(self) -> list[str]:
        """The lines from the row of names on."""
        try:
            text = self.file.read().decode("utf-8-sig")
        except UnicodeDecodeError as error:
            line, byte = error.object[: error.start].count(b"\n") + 1, error.object[error.start]
            got = f"got the byte 0x{byte:02x}"
            raise Problem(f"{self.file}: line {line}: expected text in UTF-8, {got}") from None
        text = text.replace("\r\n", "\n").replace("\r", "\n")
        lines = text.rstrip("\n").split("\n")[self.form.skip_lines :]
        if not lines or not text.strip():
            raise Problem(f"{self.file}: expected two or more rows of numbers, got an empty file")
        return lines

    def split(self, line: str) -> list[str]:
        """The cells of a line."""
        return next(csv.reader([line], delimiter=self.mark), []) if self.mark else line.split()

    def check_marks(self, line: str, number: int) -> None:
        """Refuse an invalid delimiter or decimal mark, and a delimiter that is not in the row of names."""
        origin = "the default" if self.form.delimiter is None else "as set"
        if self.decimal not in (".", ","):
            raise Problem(f"{self.file}: [file] decimal: expected '.' or ',', got {self.decimal!r}")
        if not self.mark and self.delimiter != r"\s+":
            expected = "expected one character such as ';'"
            raise Problem(f"{self.file}: [file] delimiter: {expected}, got {self.delimiter!r}")
        if self.delimiter == self.decimal:
            raise Problem(
                f"{self.file}: [file] delimiter: expected another character than the decimal mark,"
                f' got {self.delimiter!r} ({origin}): set delimiter = ";" in [file]'
            )
        other = next((mark for mark in ";\t," if mark in line), "")
        if self.mark and self.mark not in line and other:
            escaped = other.replace("\t", r"\t")
            hint = f': set delimiter = "{escaped}" in [file]' if self.has_description else ""
            raise Problem(
                f"{self.file}: line {number}: expected cells separated by {self.delimiter!r} ({origin}),"
                f" got {other!r}{hint}"
            )

    def check_widths(self, rows: Mapping[int, str], width: int) -> None:
        """Refuse a row with fewer or more cells than the row of names."""
        for number, row in rows.items():
            if self.mark and row.count(self.mark) == width - 1 and '"' not in row:
                continue
            if (cells := len(self.split(row))) != width:
                raise Problem(f"{self.file}: line {number}: expected {width} cells, got {cells}")

    def parse_rows(self, rows: Mapping[int, str], indices: Mapping[str, int]) -> Array:
        """Convert the columns `indices` of rows (line number -> text); shape (rows, columns)."""
        plain = [row.replace(",", ".") if self.decimal == "," else row for row in rows.values()]
        usecols = list(indices.values())
        try:
            return np.loadtxt(
                plain, delimiter=self.mark, usecols=usecols, comments=None, quotechar='"', ndmin=2
            )
        except ValueError:  # a gap, or a cell that is not a number
            table = np.empty((len(rows), len(indices)))
        for i, (number, row) in enumerate(rows.items()):
            cells = self.split(row) if '"' in row else row.split(self.mark)
            for j, (name, index) in enumerate(indices.items()):
                table[i, j] = self.parse_cell(cells[index], number, name)
        return table

    def parse_cell(self, cell: str, line: int, column: str) -> float:
        """The number in a cell, NaN for a gap."""
        with_point = cell.replace(",", ".")
        value = _number(with_point if self.decimal == "," else cell)
        if value is None:
            comma = self.has_description and self.decimal == "." and _number(with_point) is not None
            got = f"{cell.strip()!r}" + (': set decimal = "," in [file]' if comma else "")
            raise Problem(f"{self.file}: line {line}: column {column!r}: expected a number, got {got}")
        return value


def _column_indices(
    header: Sequence[str], names: Collection[str] | None, file: str, where: str = ""
) -> dict[str, int]:
    """Index of each requested column (None: all columns), which must occur exactly once."""
    if names is None and "" in header:
        raise Problem(f"{file}: {where}column {list(header).index('') + 1} has no name")
    for name in header if names is None else sorted(names):
        count = list(header).count(name)
        if count > 1:
            raise Problem(f"{file}: column {name!r} expected once, got {count} times")
        if not count:
            raise Problem(
                f"{file}: column {name!r} expected, got {_name_list(header)}{suggest(name, header)}"
            )
    return {name: list(header).index(name) for name in (header if names is None else sorted(names))}


def _name_list(names: Sequence[str]) -> str:
    return ", ".join([*names[:8], *(["..."] if len(names) > 8 else [])]) or "no names"


def _number(cell: str) -> float | None:
    """The number in a cell, NaN for a gap, None for any other text."""
    try:
        return float(cell)
    except ValueError:
        return math.nan if cell.strip().lower() in GAP_MARKS else None


def _read_parquet(file: Location, names: Collection[str] | None) -> Columns:
    """Columns of a Parquet file with units from the metadata of the fields. A null is a gap."""
    import pyarrow
    import pyarrow.parquet

    try:
        with pyarrow.parquet.ParquetFile(BytesIO(file.read()) if file.members else file.path) as opened:
            schema = opened.schema_arrow
            selected = list(_column_indices(schema.names, names, str(file)))
            table = opened.read(columns=selected)
    except (pyarrow.ArrowInvalid, OSError) as error:
        raise Problem(f"{file}: expected a Parquet file, got {_first_line(error)}") from None
    values = {name: _arrow_values(table.column(name), f"{file}: row", name) for name in selected}
    metadata = {name: schema.field(name).metadata or {} for name in selected}
    units = {name: data[b"unit"].decode() for name, data in metadata.items() if b"unit" in data}
    return Columns(str(file), values, range(1, table.num_rows + 1), units=units)


def _arrow_values(column: Any, where: str, name: str) -> Array:
    """The values of a Parquet column of numbers, or of texts that are all numbers."""
    import pyarrow

    column_type, types = column.type, pyarrow.types
    if types.is_integer(column_type) or types.is_floating(column_type) or types.is_decimal(column_type):
        values: Array = np.array(column.cast(pyarrow.float64()).to_numpy(), dtype=np.float64)
        return values
    if types.is_string(column_type) or types.is_large_string(column_type):
        cells = [text or "" for text in column.to_pylist()]
        numbers = [_number(cell) for cell in cells]
        if None in numbers:
            bad = numbers.index(None)
            raise Problem(f"{where} {bad + 1}: column {name!r}: expected a number, got {cells[bad]!r}")
        return np.array(numbers, dtype=np.float64)
    raise Problem(f"{where} 1: column {name!r}: expected numbers, got {column_type}")


def _first_line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _read_mat(file: Location, names: Collection[str] | None) -> Columns:
    """Columns of a MATLAB file, which must have the same length."""
    candidates = dict(_flat_columns("", _variables(file)))
    values = {}
    for name in _column_indices(list(candidates), names, str(file)):
        column = candidates[name]
        if isinstance(column, str) or column.dtype.kind not in "fiub":
            got = repr(column[:40]) if isinstance(column, str) else f"{column.dtype} such as {column[0]!r}"
            raise Problem(f"{file}: row 1: column {name!r}: expected numbers, got {got}")
        values[name] = column.astype(np.float64)
    lengths = {name: len(column) for name, column in values.items()}
    if len(set(lengths.values())) > 1:
        got = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise Problem(f"{file}: expected columns of one length, got {got}")
    return Columns(str(file), values, range(1, 1 + min(lengths.values(), default=0)))


def _variables(file: Location) -> dict[str, Any]:
    """Arrays by name, structs as dictionaries. Version 7.3 is HDF5, SciPy reads earlier versions."""
    import h5py
    import scipy.io

    source = BytesIO(file.read()) if file.members else file.path
    try:
        if file.members or not h5py.is_hdf5(source):
            return dict(scipy.io.loadmat(source, simplify_cells=True))
        with h5py.File(source, "r") as opened:
            return _group(opened)
    except (ValueError, TypeError, OSError, NotImplementedError, scipy.io.matlab.MatReadError) as error:
        raise Problem(f"{file}: expected a MATLAB file, got {_first_line(error)}") from None


def _group(group: Any) -> dict[str, Any]:
    """An HDF5 group (a struct) as a dictionary; text as str, without references (cells, objects)."""
    import h5py

    result: dict[str, Any] = {}
    for name, item in group.items():
        if name.startswith("#"):
            continue
        if isinstance(item, h5py.Group):
            result[name] = _group(item)
        elif item.attrs.get("MATLAB_class") == b"char":
            result[name] = "".join(map(chr, np.asarray(item).T.ravel()))
        elif item.dtype.kind in "fiub" and not item.attrs.get("MATLAB_empty", 0):
            result[name] = np.asarray(item).T  # HDF5 has the dimensions in reverse order
    return result


def _flat_columns(prefix: str, struct: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and contents of possible columns: vectors, columns of a matrix, rows of a wide matrix."""
    for key, item in struct.items():
        name = f"{prefix}{key}"
        if name.startswith("__"):
            continue
        if isinstance(item, dict):
            yield from _flat_columns(f"{name}.", item)
        elif isinstance(item, str):
            yield name, item
        elif (array := np.squeeze(np.asarray(item))).ndim < 2:
            yield name, np.atleast_1d(array)
        elif array.ndim == 2 and array.shape[1] <= MAX_LISTED_COLUMNS:
            yield from ((f"{name}(:,{i + 1})", column) for i, column in enumerate(array.T))
        elif array.ndim == 2 and array.shape[0] <= MAX_LISTED_COLUMNS:
            yield from ((f"{name}({i + 1},:)", row) for i, row in enumerate(array))
