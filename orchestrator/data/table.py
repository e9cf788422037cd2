r"""Reads columns of numbers from text files (CSV), Parquet files and MATLAB files.

How a text file is written follows from the table [file] of its description, or else from its first rows, see
`text_layout`. A missing sample is a gap, NaN. An incomplete row, such as the last one of a logger that lost
power, is an error. Messages name the file and the line (text) or the row (other files), counted from 1.
Columns of a MATLAB file are vectors, fields of structs ("run.pressure"), columns of a matrix ("data(:,2)")
and rows of a matrix with many columns ("data(2,:)").
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
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
from orchestrator.base.units import factor_and_offset, parse_unit
from orchestrator.data.logger_files import channels, logger_format, on_one_clock
from orchestrator.data.matlab import MAX_BYTES, NotNumbers, check_size, first_line, read_variables, shortened

Array = NDArray[np.float64]
SUFFIXES = (".csv", ".parquet", ".mat")  # of a run
READABLE = (*SUFFIXES, ".mf4", ".mdf", ".tdms")
PARTIAL = ".partial.csv"  # end of the name of a trace that is being written, see `trace_writer`
GAP_MARKS = ("", "nan", "na", "n/a", "null", "none")  # texts that loggers write for a missing sample
WORDS = {"true": 1.0, "wahr": 1.0, "false": 0.0, "falsch": 0.0}
ONE = "1"  # unit of Booleans
CHUNK = 5000  # rows of text converted at once, or cell by cell if one of them has a gap
MAX_LISTED_COLUMNS = 256  # a matrix with more columns is read by rows
LINE_BREAK = re.compile(r"\r\n?|\n")
DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", r"\s+": "white space"}
FIRST_ROWS, FIRST_CELLS = 30, 200  # number of rows, and of their cells, from which a layout is detected
DAY, FIRST_DATE, LAST_DATE = 86400.0, 1e9, 1e11  # [s]; times in between are seconds since 1970
CLOCK, DATED = "times of day", "dates and times of day"  # kinds of columns
NUMBER = re.compile(r"([-+]?(?:\d[\d.,']*|[.,]\d+)(?:[eE][-+]?\d+)?)\s*([^\W\d_].*|[%°].*)?")  # and its unit
THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:[.,'\s]\d{3})+(?:[.,]\d+)?")
GERMAN_DATE = re.compile(r"(\d\d?)\.(\d\d?)\.(\d{4})(?= )")
NAME_AND_UNIT = re.compile(r"(.*\S)(?: *\[([^][]+)\]| +\(([^()]+)\))", re.DOTALL)

FILE_NAME = Rule("the name of a file in the folder of the description", lambda v: Path(v).name == v)


@dataclass(frozen=True)
class TextFormat:
    r"""Format of a text file: the table [file] of a description.

    csv          name of the data file, of any format; "": the name of the description
    delimiter    one character, or r"\s+" for any white space; None: detected
    decimal      a point or a comma; None: detected
    skip_lines   number of lines before the column names
    skip_rows    number of rows between the column names and the numbers that are not read; None: a row of
                 units is recognised
    """

    csv: Annotated[str, FILE_NAME] = ""
    delimiter: str | None = None
    decimal: str | None = None
    skip_lines: Annotated[int, NOT_NEGATIVE] = 0
    skip_rows: Annotated[int | None, NOT_NEGATIVE] = None


@dataclass(frozen=True)
class TextLayout:
    """How a text file is written.

    form       without None
    names      of the columns
    units      of columns, in their names, the row of units or the cells
    kinds      column -> the unit in its cells, `ONE` of Booleans, `CLOCK` or `DATED` of times
    detected   what follows from the first rows, in words
    """

    form: TextFormat
    names: Sequence[str]
    units: Mapping[str, str]
    kinds: Mapping[str, str]
    encoding: str
    detected: Sequence[str]

    def __str__(self) -> str:
        """All of it in one line."""
        mark, decimals = self.form.delimiter, "commas" if self.form.decimal == "," else "points"
        cells = f"cells separated by {DELIMITERS.get(str(mark), repr(mark))}, decimal {decimals}"
        units, time = "units" if self.units else "no units", self.kinds.get(self.names[0], "numbers")
        return f"{self.encoding}, {cells}, {units}, first column: {time}"


@dataclass(frozen=True)
class Columns:
    """Columns of a file by name, each of shape (n,).

    rows       the line or row of each sample, counted from 1
    row_word   "line" or "row", for messages
    units      units that the file contains
    moments    columns of times of day or dates, [s] since midnight or 1970 -> the first cell
    """

    file: str
    values: Mapping[str, Array]
    rows: Sequence[int]
    row_word: str = "row"
    units: Mapping[str, str] = field(default_factory=dict)
    moments: Mapping[str, str] = field(default_factory=dict)

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
    form    format of a text file; None: detected
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
    return list(text_layout(file).names)


def _read_logger(file: Location, kind: str, names: Collection[str] | None) -> Columns:
    """Columns of an MF4 or TDMS file, with units."""
    with channels(file, kind) as found:
        chosen = _column_indices(["time", *found], names, str(file))
        values, units = on_one_clock(file, {n: found[n] for n in chosen if n in found}, names is None)
    return Columns(str(file), values, range(1, 1 + len(next(iter(values.values()), ()))), "sample", units)


def text_layout(file: Location | Path, form: TextFormat | None = None) -> TextLayout:
    """How a text file with a row of names is written: as `form` states, or else as its first rows show."""
    location = file if isinstance(file, Location) else Location(file)
    return _Text(location, form or TextFormat()).opened()[0]


def split_unit(name: str) -> tuple[str, str]:
    """Name and unit of a column "Druck [bar]" or "Druck (bar)"; all of the name and "" without a unit."""
    match = NAME_AND_UNIT.fullmatch(name)
    unit = (match[2] or match[3]).strip() if match else ""
    return (match[1], unit) if match and not unit.isdigit() and is_unit(unit) else (name, "")


def is_unit(text: str) -> bool:
    """Is this a known unit?"""
    with suppress(Problem):
        return bool(parse_unit(text))
    return False


def time_axis(columns: Columns, name: str, unit: str = "", offset: float = 0.0) -> Array:
    """The times in a column [s], from `unit`, or else from that of the file; offset: added [s].

    Dates, times of day, and seconds since 1970 begin at 0. The latter may be ms, us or ns without a unit.
    """
    values, moment = columns.values[name], columns.moments.get(name, "")
    unit, where = unit or columns.units.get(name, "s"), f"{columns.file}: column {name!r}"
    factor = 1.0 if moment else factor_and_offset(unit, "s", where)[0]
    begin = factor * values[0] + offset
    if not moment and not begin >= FIRST_DATE:
        return np.asarray(factor * values + offset)
    factor *= next((f for f in (1.0, 1e-3, 1e-6) if f * begin < LAST_DATE), 1e-9)
    tell_once(f"{where}: {moment or f'{values[0]:.16g} since 1970'} is taken as 0 s")
    # seven digits of a second are certain in seconds since 1970
    return np.asarray(np.round(factor * (values - values[0]), 6) + offset)


def _read_text(
    file: Location, names: Collection[str] | None, form: TextFormat | None, named: bool
) -> Columns:
    layout, first, lines = _Text(file, form or TextFormat(), named).opened()
    text = _Text(file, layout.form, named)
    header, lines = text.without_last_delimiter(list(layout.names), lines)
    indices = _column_indices(header, names, str(file), f"line {text.form.skip_lines + 1}: ")
    kinds = {name: layout.kinds[header[k]] for name, k in indices.items() if header[k] in layout.kinds}
    text = replace(text, kinds=kinds)
    rows = text.rows(lines, first, len(header))
    del lines
    for number in list(islice(rows, layout.form.skip_rows)):
        del rows[number]
    if not rows:
        raise Problem(f"{file}: expected two or more rows of numbers, got none")
    text.check_widths(rows, len(header))
    if layout.detected:
        tell_once(f"{file}: read with {', '.join(layout.detected)}")
    numbers, table = list(rows), np.empty((len(indices), len(rows)))
    for start in range(0, len(rows), CHUNK):
        part = {number: rows[number] for number in numbers[start : start + CHUNK]}
        table[:, start : start + CHUNK] = text.parse_rows(part, indices).T
    values, first_row = dict(zip(indices, table, strict=True)), text.cells(rows[numbers[0]])
    for name in (n for n, kind in kinds.items() if kind == CLOCK):  # over midnight
        values[name] += DAY * np.cumsum(np.diff(values[name], prepend=values[name][0]) < -DAY / 2)
    moments = {n: first_row[indices[n]].strip() for n, kind in kinds.items() if kind in (CLOCK, DATED)}
    units = {name: layout.units[header[k]] for name, k in indices.items() if header[k] in layout.units}
    return Columns(str(file), values, numbers, "line", units, moments)


@dataclass(frozen=True)
class _Text:
    """Reader of a text file.

    named   False if there is no row of names: the columns are "0", "1", ... of the first line
    kinds   as in `TextLayout`, of the columns that are read
    """

    file: Location
    form: TextFormat
    named: bool = True
    kinds: Mapping[str, str] = field(default_factory=dict)

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

    def place(self, key: str) -> str:
        """Where the user can set a key of the format."""
        return f"{key} in [file] of {self.file.path.with_suffix('.toml').name}"

    def opened(self) -> tuple[TextLayout, int, list[str]]:
        """The layout, and the number and the text of the lines after the names."""
        text, encoding = self._text()
        form = self.form
        if not form.skip_lines and (of_excel := re.match(r"sep=([^\r\n])[\r\n]", text)):
            form = replace(form, delimiter=form.delimiter or of_excel[1], skip_lines=1)
        breaks = [match.end() for match in islice(LINE_BREAK.finditer(text), form.skip_lines)]
        start = breaks[-1] if breaks else 0
        if len(breaks) < form.skip_lines or not text[start:].strip():
            raise Problem(f"{self.file}: expected two or more rows of numbers, got an empty file")
        self.check_format()
        layout, end = replace(self, form=form).layout(text, start, encoding)
        lines = text[end:].replace("\r\n", "\n").replace("\r", "\n").rstrip("\n").split("\n")
        if self.named:  # the rest of the line of names, which is empty
            del lines[0]
        return layout, len(LINE_BREAK.findall(text, 0, end)) + 1 + self.named, lines

    def layout(self, text: str, start: int, encoding: str) -> tuple[TextLayout, int]:
        """The layout of a text whose names begin at `start`, and the end of the names.

        The delimiter is the one with which most cells are numbers, in rows that are as wide as the names.
        """
        form = self.form
        marks = [form.delimiter] if form.delimiter else [m for m in DELIMITERS if m != form.decimal]
        samples = {mark: self._first_rows(text, start, mark) for mark in marks}
        fits = {mark: _count_numbers(*samples[mark][:2]) for mark in marks if len(samples[mark][0]) > 1}
        delimiter = max(fits, key=fits.__getitem__, default="")
        if not fits.get(delimiter) or delimiter == form.decimal:
            delimiter = self.delimiter
            self.check_delimiter(LINE_BREAK.split(text[start:], maxsplit=1)[0], form.skip_lines + 1)
        names, rows, end = samples[delimiter]
        if not self.named and rows and _is_heading(rows[0]):
            got = f"got names: select columns by name, such as {rows[0][0]!r}, not by index"
            raise Problem(f"{self.file}: line {form.skip_lines + 1}: expected numbers, {got}")
        decimal = form.decimal or ("." if delimiter == "," else _decimal_mark(rows))
        if not decimal and (comma := text.find(",", end)) >= 0:  # the first rows have integers only
            line = text[text.rfind("\n", 0, comma) + 1 :].split("\n", 1)[0]
            decimal = _decimal_mark([line.split(delimiter if len(delimiter) == 1 else None)])
        headings = next((k for k, row in enumerate(rows) if not _is_heading(row)), 0) if self.named else 0
        known = [row for row in rows[:headings] if any(map(is_unit, filter(None, row)))]
        (unit_row, *_) = [*known, *rows[:headings], []] if form.skip_rows is None else [[]]
        units = {name: unit for name in names if (unit := split_unit(name)[1])}
        units |= {name: _unwrapped(unit) for name, unit in zip(names, unit_row, strict=False) if unit}
        headings = headings if form.skip_rows is None else form.skip_rows
        columns = {name: [row[k] for row in rows[headings:] if k < len(row)] for k, name in enumerate(names)}
        kinds = {name: kind for name, cells in columns.items() if (kind := _kind(cells))}
        in_cells = {name: kind for name, kind in kinds.items() if kind not in (CLOCK, DATED)}
        detected = {
            f"cells separated by {DELIMITERS.get(delimiter)}": not form.delimiter and delimiter != ",",
            "decimal commas": not form.decimal and decimal == ",",
            "a row of units (skip_rows leaves it out)": bool(unit_row),
            "units in the cells": bool({*in_cells.values()} - {ONE}),
            CLOCK: CLOCK in kinds.values(),
            DATED: DATED in kinds.values(),
        }
        form = replace(form, delimiter=delimiter, decimal=decimal or ".", skip_rows=headings)
        told = [words for words, is_so in detected.items() if is_so]
        return TextLayout(form, names, {**units, **in_cells}, kinds, encoding, told), end

    def _first_rows(self, text: str, start: int, delimiter: str) -> tuple[list[str], list[list[str]], int]:
        """The names, the cells of the first rows that are not blank, and the end of the names."""
        mark = delimiter if len(delimiter) == 1 else None
        line_break = LINE_BREAK.search(text, start)
        end = line_break.start() if line_break else len(text)
        names, end = _cells(text, mark, start) if mark else (text[start:end].split(), end)
        if not self.named:
            names, end = [str(i) for i in range(len(names))], start
        last = next(islice(LINE_BREAK.finditer(text, end), FIRST_ROWS, None), None)
        lines = LINE_BREAK.split(text[end : last.start() if last else None])[self.named :]
        filled = [line for line in lines if line.strip(" \t" + (mark or ""))]
        return names, [_cells(line, mark)[0] if mark else line.split() for line in filled], end

    def _text(self) -> tuple[str, str]:
        """The text, and its encoding."""
        data = self.file.read(MAX_BYTES)
        wide = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}.get(data[:2])
        wide = wide or ("utf-16-le" if data[1:2] == b"\0" else "utf-16-be" if data[:1] == b"\0" else None)
        try:
            text, encoding = data.decode(wide or "utf-8-sig"), (wide or "utf-8").upper()
            if wide:
                tell_once(f"{self.file}: read as {encoding}")
        except UnicodeDecodeError as error:
            line, byte = data[: error.start].count(b"\n") + 1, data[error.start]
            got = f"expected text in UTF-8, got the byte 0x{byte:02x}"
            try:
                text, encoding = data.decode("cp1252"), "Windows-1252"
            except UnicodeDecodeError:
                raise Problem(f"{self.file}: line {line}: {got}") from None
            tell_once(f"{self.file}: line {line}: {got}; read as {encoding}")
        if self.file.path.name.endswith(PARTIAL):  # the last row is cut if the run was killed
            text = text[: text.rfind("\n") + 1]
        return text, encoding

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

    def check_format(self) -> None:
        """Refuse an invalid delimiter or decimal mark."""
        if self.decimal not in (".", ","):
            raise Problem(f"{self.file}: [file] decimal: expected '.' or ',', got {self.decimal!r}")
        if self.delimiter in ('"', "\r", "\n") or (not self.mark and self.delimiter != r"\s+"):
            expected = "expected one character such as ';'"
            raise Problem(f"{self.file}: [file] delimiter: {expected}, got {self.delimiter!r}")

    def check_delimiter(self, line: str, number: int) -> None:
        """Refuse a delimiter that is the decimal mark, too, or not in the row of names."""
        origin = "the default" if self.form.delimiter is None else "as set"
        if self.delimiter == self.decimal:
            remedy = self.place('set delimiter = ";"')
            got = f"{self.delimiter!r} ({origin}): {remedy}"
            expected = "expected another character than the decimal mark"
            raise Problem(f"{self.file}: [file] delimiter: {expected}, got {got}")
        other = next((mark for mark in ";\t," if mark in line), "")
        if self.mark and self.mark not in line and other:
            escaped = other.replace("\t", r"\t")
            hint = self.place(f'set delimiter = "{escaped}"')
            expected = f"expected cells separated by {self.delimiter!r} ({origin})"
            raise Problem(f"{self.file}: line {number}: {expected}, got {other!r}: {hint}")

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
                hint = ": is a comma inside a number?" if self.mark == "," and cells > width else ""
                raise Problem(f"{self.file}: line {number}: expected {width} cells, got {cells}{hint}")

    def cells(self, row: str | list[str]) -> list[str]:
        """The cells of a row."""
        return row.split(self.mark) if isinstance(row, str) else row

    def parse_rows(self, rows: Mapping[int, str | list[str]], indices: Mapping[str, int]) -> Array:
        """Convert the columns `indices` of rows, by the numbers of their lines; shape (rows, columns)."""
        columns, point = list(indices.values()), "," if self.decimal == "," else "."
        lines = [row.replace(point, ".") for row in rows.values() if isinstance(row, str)]
        mixed = point == "," and any("." in (r if isinstance(r, str) else "".join(r)) for r in rows.values())
        with suppress(ValueError):  # a gap, or a cell that is not a number
            if not lines and not mixed:
                cells = [[row[k].replace(point, ".") for k in columns] for row in rows.values()]
                return np.array(cells, float)
            if not mixed:
                table = np.loadtxt(lines, delimiter=self.mark, usecols=columns, comments=None, ndmin=2)
                if len(table) == len(rows):
                    return table
        table = np.empty((len(rows), len(indices)))
        for i, (number, row) in enumerate(rows.items()):
            cells_of_row = self.cells(row)
            for j, (name, index) in enumerate(indices.items()):
                table[i, j] = self.parse_cell(cells_of_row[index], number, name)
        return table

    def parse_cell(self, cell: str, line: int, column: str) -> float:
        """The number in a cell, NaN for a gap."""
        kind, comma = self.kinds.get(column, ""), self.decimal == ","
        number = cell.strip().removesuffix(kind if kind != ONE else "")
        if kind in (CLOCK, DATED):
            value = _moment(number)
        elif (comma and "." in number) or (kind != ONE and number.lower() in WORDS):
            value = None
        else:
            value = _number(number.replace(",", ".") if comma else number)
        if value is None:
            match, expected, hint = (
                NUMBER.fullmatch(number),
                kind if kind in (CLOCK, DATED) else "a number",
                "",
            )
            if THOUSANDS.fullmatch(number) or (comma and match and not match[2]):
                mark = "comma" if comma else "point"
                expected = f"a number with a decimal {mark} and no thousands separator"
                hint = f": export it so, or {self.place('set decimal')}"
            elif not comma and _number(number.replace(",", ".")) is not None:
                hint = ": " + self.place('set decimal = ","')
            elif match:
                hint = ": units are read if all cells of the column have the same"
            elif ":" in number and not kind:
                hint = ": a time is like 2026-03-02T08:15:00.050 or 08:15:00,050"
            where, got = f"{self.file}: line {line}: column {column!r}", repr(shortened(cell.strip()))
            raise Problem(f"{where}: expected {expected}, got {got}{hint}")
        return value


def _moment(cell: str) -> float | None:
    """A date and time [s] since 1970, or a time of day [s]; NaN for a gap, None for other texts."""
    text = GERMAN_DATE.sub(lambda day: f"{day[3]}-{day[2]:0>2}-{day[1]:0>2}", cell)
    text = f"1970-01-01 {'0' * (text[1] == ':')}{text}" if ":" in text[1:3] else text
    if ":" not in text:
        return math.nan if cell.lower() in GAP_MARKS else None
    with suppress(ValueError):
        moment = datetime.fromisoformat(text)
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    return None


def _kind(cells: Sequence[str]) -> str:
    """The kind of a column, see `TextLayout`, or "": of times that of the first cell, else that of all."""
    filled = [cell for cell in cells if cell.lower() not in GAP_MARKS]
    if filled and _moment(filled[0]) is not None:
        return CLOCK if ":" in filled[0][:3] else DATED
    if filled and all(cell.lower() in WORDS for cell in filled):
        return ONE
    numbers = [NUMBER.fullmatch(cell) for cell in filled]
    units = {(number[2] or "").strip() if number else "" for number in numbers}
    unit = units.pop() if len(units) == 1 else ""
    return unit if unit and is_unit(unit) else ""


def _is_value(cell: str) -> bool:
    return (
        bool(NUMBER.fullmatch(cell)) or cell.lower() in WORDS or (":" in cell and _moment(cell) is not None)
    )


def _is_heading(row: Sequence[str]) -> bool:
    """Is this a row of texts? Next to other units the dimensionless unit 1 is one, too."""
    cells = [cell for cell in row if cell.lower() not in GAP_MARKS]
    texts = [cell for cell in cells if not _is_value(cell)]
    ones = len(texts) + cells.count("1") == len(cells)
    return bool(texts) and (len(texts) == len(cells) or (ones and any(map(is_unit, texts))))


def _unwrapped(unit: str) -> str:
    """A unit without the brackets around it."""
    return unit[1:-1].strip() if unit[:1] + unit[-1:] in ("[]", "()") else unit


def _count_numbers(names: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """The number of numbers and times in rows that are as wide as the names, but for an empty last cell."""
    wide = [r for r in rows if len(r) == len(names) or (len(r) == len(names) + 1 and not r[-1])]
    return sum(map(_is_value, (cell for row in wide for cell in row[:FIRST_CELLS])))


def _decimal_mark(rows: Sequence[Sequence[str]]) -> str:
    """A comma if it is the last mark in any number; else a point if there is one; else ""."""
    numbers = [match[1] for row in rows for cell in row if (match := NUMBER.fullmatch(cell.strip()))]
    marks = {max(".,", key=number.rfind) for number in numbers if {*".,"} & {*number}}
    return "," if "," in marks else "." if marks else ""


def _column_indices(
    header: Sequence[str], names: Collection[str] | None, file: str, where: str = ""
) -> dict[str, int]:
    """Index of each requested column (None: all columns), which must occur exactly once."""
    counts, index = Counter(header), {name: i for i, name in enumerate(header)}
    bare = [split_unit(name)[0] for name in header]  # these names do, too
    counts, index = Counter(bare) | counts, {name: i for i, name in enumerate(bare)} | index
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
        return math.nan if word in GAP_MARKS else WORDS.get(word)


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
