r"""Columns of numbers of a file, whichever kind it is: text (CSV), Parquet or MATLAB.

A sample that is missing is a gap, NaN. A row that stops early, such as the last one of a logger that lost
power, is an error and not a gap. Messages name the file and the line (of text) or the row (of other files),
counted from 1. Columns of a MATLAB file are its vectors, fields of structs ("run.pressure"), columns of a
matrix ("data(:,2)") and rows of a wide one ("data(2,:)").
"""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.files import Location

Array = NDArray[np.float64]
DATA = (".csv", ".parquet", ".mat")
GAPS = ("", "nan", "na", "n/a", "null", "none")  # what loggers write where there is no sample
MOST_COLUMNS = 256  # of a matrix that are listed one by one
SETTING = {"delimiter": 'set delimiter = "{}" in [file]', "decimal": 'set decimal = "," in [file]'}


@dataclass(frozen=True)
class TextFormat:
    r"""How a text file is written: the table [file] of a description.

    csv          name of the data file, of whichever kind; "": that of the description
    delimiter    one character, or r"\s+" for any white space; None: a comma
    decimal      a point or a comma; None: a point
    skip_lines   lines before the names
    """

    csv: str = ""
    delimiter: str | None = None
    decimal: str | None = None
    skip_lines: int = 0


@dataclass(frozen=True)
class Columns:
    """Columns of a file by name, each of shape (n,).

    rows    the line or row of each sample, counted from 1
    row     which of the two that is
    units   where the file tells them
    """

    file: str
    values: Mapping[str, Array]
    rows: Sequence[int]
    row: str = "row"
    units: Mapping[str, str] = field(default_factory=dict)

    def place(self, sample: int) -> str:
        """Where a sample stands, for the beginning of a message."""
        return f"{self.file}: {self.row} {self.rows[sample]}"


def read_columns(
    source: Location | Path,
    names: Collection[str] | None,
    form: TextFormat | None = None,
    named: bool = True,
) -> Columns:
    """Columns of a file by name; its kind is told by its suffix, without .parquet or .mat it is text.

    names   None: all of a text or Parquet file, in their order
    form    of a text file; None: commas and points, nobody described it
    named   a text file has a row of names; else its columns are "0", "1", ...
    """
    file = source if isinstance(source, Location) else Location(source)
    if not file.inside and not file.path.is_file():
        raise Problem(f"{file}: no such file")
    kind = Path(str(file)).suffix.lower()
    if kind == ".parquet":
        columns = _read_parquet(file, names)
    else:
        columns = _read_mat(file, names) if kind == ".mat" else _read_text(file, names, form, named)
    if len(columns.rows) < (1 if names is None else 2):
        raise Problem(f"{file}: expected two or more rows of numbers, got {len(columns.rows) or 'none'}")
    for name, values in columns.values.items():
        for k in np.flatnonzero(np.isinf(values))[:1]:
            got = f"expected a finite number, got {values[k]:g}"
            raise Problem(f"{columns.place(k)}: column {name!r}: {got}")
    return columns


def _read_text(
    file: Location, names: Collection[str] | None, form: TextFormat | None, named: bool
) -> Columns:
    given = form or TextFormat()
    delimiter, decimal = given.delimiter or ",", given.decimal or "."
    _check_marks(str(file), given, delimiter, decimal)
    lines = _lines(file)[given.skip_lines :]
    if not lines:
        raise Problem(f"{file}: expected two or more rows of numbers, got an empty file")
    if delimiter not in lines[0] and len(delimiter) == 1:
        other = next((mark for mark in ";\t," if mark in lines[0]), "")
        if other:
            hint = ": " + SETTING["delimiter"].format(other.replace("\t", r"\t")) if form else ""
            raise Problem(
                f"{file}: line {given.skip_lines + 1}: expected cells separated by {delimiter!r}"
                f" ({_origin(given)}), got {other!r}{hint}"
            )
    header = [name.strip() for name in _split(lines[0], delimiter)]
    if not named:
        header = [str(i) for i in range(len(header))]
    places = _places(header, names, str(file), f"line {given.skip_lines + 1}: ")
    mark = delimiter if len(delimiter) == 1 else None
    rows = [i for i in range(int(named), len(lines)) if lines[i].strip(f" \t{mark or ''}")]
    numbers = [given.skip_lines + 1 + i for i in rows]
    kept = [lines[i] for i in rows]
    del lines
    if not kept:
        raise Problem(f"{file}: expected two or more rows of numbers, got none")
    _check_widths(kept, numbers, len(header), delimiter, str(file))
    plain = [line.replace(",", ".") for line in kept] if decimal == "," else kept
    try:
        table = np.loadtxt(
            plain, delimiter=mark, usecols=list(places.values()), comments=None, quotechar='"', ndmin=2
        )
    except ValueError:  # there are gaps, or something that is no number
        table = _cells(kept, numbers, places, delimiter, decimal, f"{file}: line", form is not None)
    values = {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(places)}
    return Columns(str(file), values, numbers, "line")


def _origin(form: TextFormat) -> str:
    return "the default" if form.delimiter is None else "as set"


def _check_marks(file: str, form: TextFormat, delimiter: str, decimal: str) -> None:
    """Refuse marks that cannot be, or that cannot be told apart."""
    if decimal not in (".", ","):
        raise Problem(f"{file}: [file] decimal: expected '.' or ',', got {decimal!r}")
    if len(delimiter) != 1 and delimiter != r"\s+":
        raise Problem(f"{file}: [file] delimiter: expected one character such as ';', got {delimiter!r}")
    if delimiter == decimal:
        raise Problem(
            f"{file}: [file] decimal is {decimal!r}: expected another delimiter than it,"
            f" got {delimiter!r} ({_origin(form)}): {SETTING['delimiter'].format(';')}"
        )


def _lines(file: Location) -> list[str]:
    content = file.read()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, byte = error.object[: error.start].count(b"\n") + 1, error.object[error.start]
        raise Problem(f"{file}: line {line}: expected text in UTF-8, got the byte 0x{byte:02x}") from None
    return text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\n").split("\n") if text.strip() else []


def _split(line: str, delimiter: str) -> list[str]:
    return line.split() if len(delimiter) > 1 else next(csv.reader([line], delimiter=delimiter), [])


def _places(
    header: Sequence[str], names: Collection[str] | None, file: str, where: str = ""
) -> dict[str, int]:
    """Where the columns stand that are asked for (None: all); each must be there once."""
    if names is None and "" in header:
        raise Problem(f"{file}: {where}column {list(header).index('') + 1} has no name")
    for name in header if names is None else sorted(names):
        count = list(header).count(name)
        if count > 1:
            raise Problem(f"{file}: column {name!r} expected once, got {count} times")
        if not count:
            raise Problem(f"{file}: column {name!r} expected, got {_listed(header)}{suggest(name, header)}")
    return {name: list(header).index(name) for name in (header if names is None else sorted(names))}


def _listed(names: Sequence[str]) -> str:
    return ", ".join([*names[:8], *(["..."] if len(names) > 8 else [])]) or "no names"


def _check_widths(
    lines: Sequence[str], numbers: Sequence[int], width: int, delimiter: str, file: str
) -> None:
    """Refuse a row with fewer or more cells than the first one."""
    for line, number in zip(lines, numbers, strict=True):
        if len(delimiter) == 1 and line.count(delimiter) == width - 1 and '"' not in line:
            continue
        if (cells := len(_split(line, delimiter))) != width:
            raise Problem(f"{file}: line {number}: expected {width} cells, got {cells}")


def _cells(
    lines: Sequence[str],
    numbers: Sequence[int],
    places: Mapping[str, int],
    delimiter: str,
    decimal: str,
    where: str,
    described: bool,
) -> Array:
    """The numbers cell by cell: gaps are NaN, what is no number is refused."""
    table = np.empty((len(lines), len(places)))
    for i, line in enumerate(lines):
        cells = _split(line, delimiter)
        for j, (name, place) in enumerate(places.items()):
            cell = cells[place].replace(",", ".") if decimal == "," else cells[place]
            if (value := _number(cell)) is None:
                comma = described and decimal == "." and _number(cell.replace(",", ".")) is not None
                hint = f": {SETTING['decimal']}" if comma else ""
                found = f"{cells[place].strip()!r}{hint}"
                raise Problem(f"{where} {numbers[i]}: column {name!r}: expected a number, got {found}")
            table[i, j] = value
    return table


def _number(cell: str) -> float | None:
    """A number, NaN for a gap, None for what is neither."""
    text = cell.strip()
    try:
        return math.nan if text.lower() in GAPS else float(text)
    except ValueError:
        return None


def _read_parquet(file: Location, names: Collection[str] | None) -> Columns:
    """Columns of a Parquet file by name; units from the metadata of the fields. A null is a gap."""
    import pyarrow
    import pyarrow.parquet

    try:
        with pyarrow.parquet.ParquetFile(BytesIO(file.read()) if file.inside else file.path) as opened:
            schema = opened.schema_arrow
            chosen = list(_places(schema.names, names, str(file)))
            table = opened.read(columns=chosen)
    except (pyarrow.ArrowInvalid, OSError) as error:
        raise Problem(f"{file}: expected a Parquet file, got {_first_line(error)}") from None
    values = {name: _arrow(table.column(name), f"{file}: row", name) for name in chosen}
    fields = {name: schema.field(name).metadata or {} for name in chosen}
    units = {name: told[b"unit"].decode() for name, told in fields.items() if b"unit" in told}
    return Columns(str(file), values, range(1, table.num_rows + 1), units=units)


def _arrow(column: Any, where: str, name: str) -> Array:
    """A column of Parquet as numbers; a column of text too if all of it is numbers."""
    import pyarrow

    kind = column.type
    if pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind) or pyarrow.types.is_decimal(kind):
        values: Array = np.array(column.cast(pyarrow.float64()).to_numpy(), dtype=np.float64)
        return values
    if pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind):
        cells = [text or "" for text in column.to_pylist()]
        numbers = [_number(cell) for cell in cells]
        if None in numbers:
            bad = numbers.index(None)
            raise Problem(f"{where} {bad + 1}: column {name!r}: expected a number, got {cells[bad]!r}")
        return np.array(numbers, dtype=np.float64)
    raise Problem(f"{where} 1: column {name!r}: expected numbers, got {kind}")


def _first_line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def _read_mat(file: Location, names: Collection[str] | None) -> Columns:
    """Columns of a MATLAB file by name, all of one length."""
    there = dict(_flat("", _variables(file)))
    values = {}
    for name in _places(list(there), names, str(file)):
        found = there[name]
        if isinstance(found, str) or found.dtype.kind not in "fiub":
            got = repr(found[:40]) if isinstance(found, str) else f"{found.dtype} such as {found[0]!r}"
            raise Problem(f"{file}: row 1: column {name!r}: expected numbers, got {got}")
        values[name] = found.astype(np.float64)
    sizes = {name: len(column) for name, column in values.items()}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise Problem(f"{file}: expected columns of one length, got {listed}")
    return Columns(str(file), values, range(1, 1 + min(sizes.values(), default=0)))


def _variables(file: Location) -> dict[str, Any]:
    """Arrays by name, structs as dictionaries: version 7.3 is HDF5, SciPy reads those before."""
    import h5py
    import scipy.io

    source = BytesIO(file.read()) if file.inside else file.path
    try:
        if file.inside or not h5py.is_hdf5(source):
            return dict(scipy.io.loadmat(source, simplify_cells=True))
        with h5py.File(source, "r") as opened:
            return _group(opened)
    except (ValueError, TypeError, OSError, NotImplementedError, scipy.io.matlab.MatReadError) as error:
        raise Problem(f"{file}: expected a MATLAB file, got {_first_line(error)}") from None


def _group(group: Any) -> dict[str, Any]:
    """A group of HDF5, which is a struct; text becomes a string, references (cells, objects) are left out."""
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
            result[name] = np.asarray(item).T  # HDF5 counts dimensions the other way round
    return result


def _flat(prefix: str, struct: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and contents of what could be a column: vectors, columns of a matrix, rows of a wide one."""
    for key, item in struct.items():
        name = f"{prefix}{key}"
        if name.startswith("__"):
            continue
        if isinstance(item, dict):
            yield from _flat(f"{name}.", item)
        elif isinstance(item, str):
            yield name, item
        elif (array := np.squeeze(np.asarray(item))).ndim < 2:
            yield name, np.atleast_1d(array)
        elif array.ndim == 2 and array.shape[1] <= MOST_COLUMNS:
            yield from ((f"{name}(:,{i + 1})", column) for i, column in enumerate(array.T))
        elif array.ndim == 2 and array.shape[0] <= MOST_COLUMNS:
            yield from ((f"{name}({i + 1},:)", row) for i, row in enumerate(array))
