r"""Reads columns of numbers from text files (CSV), Parquet files and MATLAB files.

A missing sample is a gap, NaN. An incomplete row, such as the last one of a logger that lost power, is an
error. Messages name the file and the line (text) or the row (other files), counted from 1. Columns of a
MATLAB file are vectors, fields of structs ("run.pressure"), columns of a matrix ("data(:,2)") and rows of a
matrix with many columns ("data(2,:)").
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.extras import require
from orchestrator.base.files import Location, tell_once
from orchestrator.base.toml import NOT_NEGATIVE, Rule
from orchestrator.data.logger_files import channels, logger_format, on_one_clock
from orchestrator.data.matlab import MAX_BYTES, NotNumbers, check_size, first_line, read_variables, shortened

Array = NDArray[np.float64]
SUFFIXES = (".csv", ".parquet", ".mat")  # of a run
READABLE = (*SUFFIXES, ".mf4", ".mdf", ".tdms")
PARTIAL = ".partial.csv"  # end of the name of a trace that is being written, see `trace_writer`
GAP_MARKS = ("", "nan", "na", "n/a", "null", "none")  # texts that loggers write for a missing sample
CHUNK = 5000  # rows of text converted at once, or cell by cell if one of them has a gap
MAX_LISTED_COLUMNS = 256  # a matrix with more columns is read by rows
LINE_BREAK = re.compile(r"\r\n?|\n")

FILE_NAME = Rule("the name of a file in the folder of the description", lambda v: Path(v).name == v)


@dataclass(frozen=True)
class TextFormat:
    r"""Format of a text file: the table [file] of a description.

    csv          name of the data file, of any format; "": the name of the description
    delimiter    one character, or r"\s+" for any white space; None: a comma
    decimal      a point or a comma; None: a point
    skip_lines   number of lines before the column names
    """

    csv: Annotated[str, FILE_NAME] = ""
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
    """Read columns of a file: Parquet (.parquet), MATLAB (.mat), or MF4, TDMS or text (any other suffix).

    names   columns to read; None: all columns of a text or Parquet file, in their order
    form    format of a text file; None: commas and decimal points
    named   True if a text file has a row of names; else its columns are "0", "1", ...
    """
    file = source if isinstance(source, Location) else Location(source)
    suffix = Path(str(file)).suffix.lower()
    if not file.members and not file.path.is_file() and not (file.is_folder and suffix == ".parquet"):
        raise Problem(f"{file}: no such file")
    if suffix == ".parquet":
        columns = _read_parquet(file, names)
    elif suffix == ".mat":
        columns = _read_mat(file, names)
    elif kind := logger_format(file):
        columns = _read_logger(file, kind, names)
    else:
        columns = _read_text(file, names, form, named)
    if len(columns.rows) < (1 if names is None else 2):
        raise Problem(f"{file}: expected two or more rows of numbers, got {len(columns.rows) or 'none'}")
    for name, values in columns.values.items():
        if (infinite := np.isinf(values)).any():
            k = int(infinite.argmax())
            message = f"expected a finite number, got {values[k]:g}"
            raise Problem(f"{columns.location(k)}: column {name!r}: {message}")
    return columns


def column_names(source: Path) -> list[str]:
    """The names of the columns of a file; texts and empty arrays of a MATLAB file are left out."""
    file, suffix = Location(source), source.suffix.lower()
    if suffix == ".mat":
        columns = dict(_flat_columns("", read_variables(file)))
        return [name for name, content in columns.items() if isinstance(content, np.ndarray)]
    if suffix == ".parquet":
        return list(_read_parquet(file, None).values)
    if kind := logger_format(file):
        return list(_read_logger(file, kind, None).values)
    return _Text(file, TextFormat(), has_description=False).split_header(True)[0]


def _read_logger(file: Location, kind: str, names: Collection[str] | None) -> Columns:
    """Columns of an MF4 or TDMS file, with units."""
    with channels(file, kind) as found:
        chosen = _column_indices(["time", *found], names, str(file))
        values, units = on_one_clock(file, {n: found[n] for n in chosen if n in found}, names is None)
    return Columns(str(file), values, range(1, 1 + len(next(iter(values.values()), ()))), units=units)


def _read_text(
    file: Location, names: Collection[str] | None, form: TextFormat | None, named: bool
) -> Columns:
    text = _Text(file, form or TextFormat(), has_description=form is not None)
    header, first, lines = text.split_header(named)
    header, lines = text.without_last_delimiter(header, lines)
    indices = _column_indices(header, names, str(file), f"line {text.form.skip_lines + 1}: ")
    rows = text.rows(lines, first, len(header))
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

    @cached_property
    def mark(self) -> str | None:
        """The delimiter, None for any white space."""
        return self.delimiter if len(self.delimiter) == 1 else None

    @cached_property
    def decimal(self) -> str:
        return self.form.decimal or "."

    def split_header(self, named: bool) -> tuple[list[str], int, list[str]]:
        """The column names, the number of the next line, and the lines from there on.

        named   False if there is no row of names: the columns are "0", "1", ... of the first line
        """
        text = self._text()
        breaks = [match.end() for match in islice(LINE_BREAK.finditer(text), self.form.skip_lines)]
        start = breaks[-1] if breaks else 0
        if len(breaks) < self.form.skip_lines or not text[start:].strip():
            raise Problem(f"{self.file}: expected two or more rows of numbers, got an empty file")
        line_break = LINE_BREAK.search(text, start)
        end = line_break.start() if line_break else len(text)
        self.check_marks(text[start:end], self.form.skip_lines + 1)
        if self.mark:
            header, end = _cells(text, self.mark, start)
        else:
            header = text[start:end].split()
        if not named:
            header, end = [str(i) for i in range(len(header))], start
        lines = text[end:].replace("\r\n", "\n").replace("\r", "\n").rstrip("\n").split("\n")
        if named:  # the rest of the line of names, which is empty
            del lines[0]
        return header, len(LINE_BREAK.findall(text, 0, end)) + 1 + named, lines

    def _text(self) -> str:
        data = self.file.read(MAX_BYTES)
        wide = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}.get(data[:2])
        wide = wide or ("utf-16-le" if data[1:2] == b"\0" else "utf-16-be" if data[:1] == b"\0" else None)
        try:
            text = data.decode(wide or "utf-8-sig")
            if wide:
                tell_once(f"{self.file}: read as {wide.upper()}")
        except UnicodeDecodeError as error:
            line, byte = data[: error.start].count(b"\n") + 1, data[error.start]
            got = f"expected text in UTF-8, got the byte 0x{byte:02x}"
            try:
                text = data.decode("cp1252")
            except UnicodeDecodeError:
                raise Problem(f"{self.file}: line {line}: {got}") from None
            tell_once(f"{self.file}: line {line}: {got}; read as Windows-1252")
        if self.file.path.name.endswith(PARTIAL):  # the last row is cut if the run was killed
            return text[: text.rfind("\n") + 1]
        return text

    def rows(self, lines: Sequence[str], first: int, width: int) -> dict[int, str | list[str]]:
        """The rows that are not blank, by the numbers of their lines; as cells if any has quotes (RFC 4180).

        A quoted cell may have line breaks. One that goes on over whole rows lacks a quote.

        first   number of the first line
        width   cells of a row
        """
        mark, blank = self.mark, " \t" + (self.mark or "")
        if not mark or not any('"' in line for line in lines):
            return {number: line for number, line in enumerate(lines, first) if line.strip(blank)}
        # a quote without an end takes the empty line at the end into its row
        reader = csv.reader([*lines, ""], delimiter=mark, skipinitialspace=mark != " ")
        rows, begin = dict[int, str | list[str]](), 0
        try:
            for cells in reader:
                inside, endless = lines[begin + 1 : reader.line_num], begin < len(lines) < reader.line_num
                if endless or any(line.count(mark) >= width - 1 for line in inside):
                    got = "none in the file" if endless else "none before the next row"
                    raise csv.Error(f"a quoted cell: expected its end, got {got}")
                if "".join(lines[begin : begin + 1]).strip(blank):
                    rows[first + begin] = cells
                begin = reader.line_num
        except csv.Error as error:
            raise Problem(f"{self.file}: line {first + begin}: {error}") from None
        return rows

    def check_marks(self, line: str, number: int) -> None:
        """Refuse an invalid delimiter or decimal mark, and a delimiter that is not in the row of names."""
        origin = "the default" if self.form.delimiter is None else "as set"
        if self.decimal not in (".", ","):
            raise Problem(f"{self.file}: [file] decimal: expected '.' or ',', got {self.decimal!r}")
        if self.delimiter in ('"', "\r", "\n") or (not self.mark and self.delimiter != r"\s+"):
            expected = "expected one character such as ';'"
            raise Problem(f"{self.file}: [file] delimiter: {expected}, got {self.delimiter!r}")
        if self.delimiter == self.decimal:
            got = f'{self.delimiter!r} ({origin}): set delimiter = ";" in [file]'
            expected = "expected another character than the decimal mark"
            raise Problem(f"{self.file}: [file] delimiter: {expected}, got {got}")
        other = next((mark for mark in ";\t," if mark in line), "")
        if self.mark and self.mark not in line and other:
            escaped = other.replace("\t", r"\t")
            hint = f': set delimiter = "{escaped}" in [file]' if self.has_description else ""
            expected = f"expected cells separated by {self.delimiter!r} ({origin})"
            raise Problem(f"{self.file}: line {number}: {expected}, got {other!r}{hint}")

    def without_last_delimiter(self, header: list[str], lines: list[str]) -> tuple[list[str], list[str]]:
        """Names and lines without the delimiter at the end of each line, which some tools write."""
        mark, filled = self.mark, [line.rstrip() for line in lines if line.strip()]
        if not mark or not filled or not all(line.endswith(mark) for line in filled):
            return header, lines
        names, last = header[:-1] if header[-1] == "" else header, len(_cells(filled[0], mark)[0]) - 1
        without = [line.rstrip().removesuffix(mark) for line in lines]
        return (names, without) if last == len(names) else (header, lines)

    def check_widths(self, rows: Mapping[int, str | list[str]], width: int) -> None:
        """Refuse a row with fewer or more cells than the row of names."""
        for number, row in rows.items():
            plain = self.mark and isinstance(row, str)
            cells = row.count(self.mark) + 1 if plain else len(self.cells(row))  # type: ignore[arg-type]
            if cells != width:
                raise Problem(f"{self.file}: line {number}: expected {width} cells, got {cells}")

    def cells(self, row: str | list[str]) -> list[str]:
        """The cells of a row."""
        return row.split(self.mark) if isinstance(row, str) else row

    def parse_rows(self, rows: Mapping[int, str | list[str]], indices: Mapping[str, int]) -> Array:
        """Convert the columns `indices` of rows, by the numbers of their lines; shape (rows, columns)."""
        columns, point = list(indices.values()), "," if self.decimal == "," else "."
        lines = [row.replace(point, ".") for row in rows.values() if isinstance(row, str)]
        with suppress(ValueError):  # a gap, or a cell that is not a number
            if not lines:
                cells = [[row[k].replace(point, ".") for k in columns] for row in rows.values()]
                return np.array(cells, float)
            table = np.loadtxt(lines, delimiter=self.mark, usecols=columns, comments=None, ndmin=2)
            if len(table) == len(rows):
                return table
        table = np.empty((len(rows), len(indices)))
        for i, (number, row) in enumerate(rows.items()):
            for j, (name, index) in enumerate(indices.items()):
                table[i, j] = self.parse_cell(self.cells(row)[index], number, name)
        return table

    def parse_cell(self, cell: str, line: int, column: str) -> float:
        """The number in a cell, NaN for a gap."""
        with_point = cell.replace(",", ".")
        value = _number(with_point if self.decimal == "," else cell)
        if value is None:
            comma = self.has_description and self.decimal == "." and _number(with_point) is not None
            got = f"{shortened(cell.strip())!r}" + (': set decimal = "," in [file]' if comma else "")
            raise Problem(f"{self.file}: line {line}: column {column!r}: expected a number, got {got}")
        return value


def _column_indices(
    header: Sequence[str], names: Collection[str] | None, file: str, where: str = ""
) -> dict[str, int]:
    """Index of each requested column (None: all columns), which must occur exactly once."""
    counts, index = Counter(header), {name: i for i, name in enumerate(header)}
    if names is None and "" in counts:
        raise Problem(f"{file}: {where}column {list(header).index('') + 1} has no name")
    selected = header if names is None else sorted(names)
    for name in selected:
        if counts[name] > 1:
            raise Problem(
                f"{file}: expected the column {shortened(name)!r} once, got it {counts[name]} times"
            )
        if not counts[name]:
            got = f"got {_name_list(header)}{suggest(name, header)}"
            raise Problem(f"{file}: expected a column {shortened(name)!r}, {got}")
    return {name: index[name] for name in selected}


def _cells(text: str, mark: str, start: int = 0) -> tuple[list[str], int]:
    """The cells of a row from `start` on, and the index of its end, a line break that is not quoted.

    White space around a cell is stripped, unless it is inside quotes. A quote inside an unquoted cell counts
    as text.
    """
    end = re.escape(mark)
    quoted = rf' *"([^"]*+(?:""[^"]*+)*+)" *(?=[{end}\r\n]|\Z)'
    cell = re.compile(rf"{quoted}|([^{end}\r\n]*)")
    cells = []
    while match := cell.match(text, start):
        inside, plain = match.groups()
        cells.append(plain.strip() if inside is None else inside.replace('""', '"'))
        if text[match.end() : match.end() + 1] != mark:
            return cells, match.end()
        start = match.end() + 1
    raise AssertionError("an empty cell matches anywhere")


def _name_list(names: Sequence[str]) -> str:
    shown = [shortened(name) for name in names[:8]]
    return ", ".join([*shown, *(["..."] if len(names) > 8 else [])]) or "no names"


def _number(cell: str) -> float | None:
    """The number in a cell, 1 for true, 0 for false, NaN for a gap, None for any other text."""
    try:
        return float(cell)
    except ValueError:
        word = cell.strip().lower()
        return math.nan if word in GAP_MARKS else {"true": 1.0, "false": 0.0}.get(word)


def _read_parquet(file: Location, names: Collection[str] | None) -> Columns:
    """Columns of a Parquet file, or of a folder of them, with units from the fields. A null is a gap."""
    require("files", f"{file}: a Parquet file", "pyarrow")
    import pyarrow
    import pyarrow.parquet

    try:
        parts = sorted(file.path.glob("*.parquet")) if file.is_folder else [file.path]
        tables, rows = [], 0
        for part in parts:
            with pyarrow.parquet.ParquetFile(BytesIO(file.read()) if file.members else part) as opened:
                schema, rows = opened.schema_arrow, rows + opened.metadata.num_rows
                selected = list(_column_indices(schema.names, names, str(file)))
                check_size(file, 8 * len(selected) * rows, "columns")
                tables.append(opened.read(columns=selected))
        if not tables:
            raise Problem(f"{file}: expected Parquet files in this folder, got none")
        table = pyarrow.concat_tables(tables)
        values = {name: _arrow_values(table.column(name), f"{file}: row", name) for name in selected}
        metadata = {name: schema.field(name).metadata or {} for name in selected}
        units = {name: data[b"unit"].decode() for name, data in metadata.items() if b"unit" in data}
    except (pyarrow.ArrowException, OSError, ValueError) as error:  # ValueError: text that is not UTF-8
        raise Problem(f"{file}: expected a Parquet file, got {first_line(error)}") from None
    return Columns(str(file), values, range(1, table.num_rows + 1), units=units)


def _arrow_values(column: Any, where: str, name: str) -> Array:
    """The values of a Parquet column of numbers, or of texts that are all numbers."""
    import pyarrow

    column_type, types = column.type, pyarrow.types
    if types.is_boolean(column_type):
        column, column_type = column.cast(pyarrow.int8()), pyarrow.int8()
    if types.is_integer(column_type) or types.is_floating(column_type) or types.is_decimal(column_type):
        return np.array(column.cast(pyarrow.float64(), safe=False).to_numpy(), dtype=np.float64)
    if types.is_string(column_type) or types.is_large_string(column_type):
        cells = [text or "" for text in column.to_pylist()]
        numbers = [_number(cell) for cell in cells]
        if None in numbers:
            bad = numbers.index(None)
            raise Problem(
                f"{where} {bad + 1}: column {name!r}: expected a number, got {shortened(cells[bad])!r}"
            )
        return np.array(numbers, dtype=np.float64)
    raise Problem(f"{where} 1: column {name!r}: expected numbers, got {column_type}")


def _read_mat(file: Location, names: Collection[str] | None) -> Columns:
    """Columns of a MATLAB file, which must have the same length; with units if it is a trace of a run."""
    variables = read_variables(file)
    units, original = _of_trace(variables) if names is None else ({}, {})
    candidates, values = dict(_flat_columns("", variables)), {}
    for key, other in [c for c in candidates.items() if isinstance(c[1], NotNumbers)]:
        for name in names or ():
            if name == key or name.startswith((f"{key}.", f"{key}(")):
                raise Problem(f"{file}: column {shortened(name)!r}: expected numbers, got {other.what}")
        del candidates[key]
    for name in _column_indices(list(candidates), names, str(file)):
        column = candidates[name]
        if isinstance(column, str) or column.dtype.kind not in "fiub":
            got = repr(shortened(column)) if isinstance(column, str) else f"{column.dtype}"
            raise Problem(f"{file}: row 1: column {name!r}: expected numbers, got {got}")
        values[original.get(name, name)] = column.astype(np.float64)
    lengths = {name: len(column) for name, column in values.items()}
    if len(set(lengths.values())) > 1:
        got = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise Problem(f"{file}: expected columns of one length, got {got}")
    values = {n: values[n] for n in dict.fromkeys([*original.values(), *values]) if n in values}  # in order
    return Columns(str(file), values, range(1, 1 + min(lengths.values(), default=0)), units=units)


def _of_trace(variables: dict[str, Any]) -> tuple[dict[str, str], dict[str, str]]:
    """Take `units` and `run` out of a trace: units by signal, and names in the file -> signals."""
    run, units = variables.get("run"), variables.get("units")
    if not isinstance(run, str) or not isinstance(units, dict):
        return {}, {}
    del variables["run"], variables["units"]
    try:
        renamed = json.loads(run).get("names", {})
        original = {str(written): str(name) for name, written in renamed.items()}
    except (ValueError, AttributeError, RecursionError):  # of another tool
        original = {}
    texts = {name: text for name, text in _flat_columns("", units) if isinstance(text, str)}
    return {original.get(name, name): text for name, text in texts.items()}, original


def _flat_columns(prefix: str, struct: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and contents of possible columns: vectors, columns of a matrix, rows of a wide matrix."""
    for key, item in struct.items():
        name = f"{prefix}{key}"
        if name.startswith("__"):
            continue
        if isinstance(item, dict):
            yield from _flat_columns(f"{name}.", item)
        elif isinstance(item, str | NotNumbers):
            yield name, item
        elif not np.size(item):
            yield name, NotNumbers("an empty array")
        elif (array := np.squeeze(np.asarray(item))).ndim < 2:
            yield name, np.atleast_1d(array)
        elif array.ndim == 2 and array.shape[1] <= MAX_LISTED_COLUMNS:
            yield from ((f"{name}(:,{i + 1})", column) for i, column in enumerate(array.T))
        elif array.ndim == 2 and array.shape[0] <= MAX_LISTED_COLUMNS:
            yield from ((f"{name}({i + 1},:)", row) for i, row in enumerate(array))
