r"""Reads columns of numbers from text files (CSV), Parquet files and MATLAB files.

How a text file is written follows from the table [file] of its description, or else from its first rows, see
`_Text`. A missing sample is a gap, NaN. An incomplete row, such as the last one of a logger that lost
power, is an error. Messages name the file and the line (text) or the row (other files), counted from 1.
Columns of a MATLAB file are vectors, fields of structs ("run.pressure"), columns of a matrix ("data(:,2)")
and rows of a matrix with many columns ("data(2,:)").
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from io import BytesIO
from itertools import islice, pairwise, product, takewhile, zip_longest
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem, suggest
from orchestrator.base.extras import require
from orchestrator.base.files import Location, tell_once
from orchestrator.base.numerals import real
from orchestrator.base.processes import FLOAT64
from orchestrator.base.text import first_names
from orchestrator.base.toml import NOT_NEGATIVE, Rule
from orchestrator.base.units import factor_and_offset, is_unit
from orchestrator.data.logger_files import CLOCK, PIVOT, channels, labview_table, logger_format, on_one_clock
from orchestrator.data.matlab import MAX_BYTES, NotNumbers, check_size, foreign, read_variables, shortened

Array = NDArray[np.float64]
SUFFIXES = (".csv", ".parquet", ".mat")  # of a run
READABLE = (*SUFFIXES, ".mf4", ".mdf", ".tdms", ".lvm")
PARTIAL = ".partial.csv"  # end of the name of a trace that is being written, see `trace_writer`
GAP_MARKS = ("", "nan", "na", "n/a", "null", "none")  # texts that loggers write for a missing sample
WORDS = {"true": 1.0, "wahr": 1.0, "false": 0.0, "falsch": 0.0}
ONE = "1"  # unit of Booleans
CHUNK = 5000  # rows of text converted at once, or cell by cell if one of them has a gap
MAX_LINE = 20_000_000  # characters: a million columns
MAX_LISTED_COLUMNS = 256  # a matrix with more columns is read by rows
LINE_BREAK = re.compile(r"\r\n?|\n")
DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", r"\s+": "white space"}
FIRST_ROWS, FIRST_CELLS = 30, 200  # number of rows, and of their cells, that show how a file is written
MOST_HEADINGS = 3  # rows of texts below the names: units, channels, comments
DAY, FIRST_DATE, LAST_DATE = 86400.0, 1e9, 1e11  # [s]; times in between are seconds since 1970
# days of a spreadsheet in the years 1970 to 2099; steps of a logger are shorter than 9 s = 1e-4 d
FIRST_DAY, LAST_DAY, LONGEST_STEP = 25569.0, 73050.0, 1e-4
NUMBER = re.compile(
    r"([-+]?(?:[0-9][0-9.,']*|[.,][0-9]+)(?:[eE][-+]?[0-9]+)?)\s*([^\W\d_].*|[%°].*)?"
)  # and its unit
DATE = re.compile(r"\d\d?\.\d\d?\.\d{4}|\d{4}-\d\d-\d\d")
GERMAN_DATE = re.compile(r"(\d\d?)\.(\d\d?)\.(\d{4})(?= |$)")
MATLAB_DATE = re.compile(r"(\d\d)-([A-Z][a-z]{2})-(\d{4})(?= )")
KEYS = re.compile(r"_?(?i:name|topic|signal|variable|channel|field|metric|key|tag|sensor|parameter)s?")
MONTHS = "JanFebMarAprMayJunJulAugSepOctNovDec"
LIKE_NUMBER = re.compile(r"[-+]?[.,]?\d")  # beginning of a cell that is no word, such as "Not available"
NAME_AND_UNIT = re.compile(r"(.*\S)(?: *\[([^][]+)\]| +\(([^()]+)\))", re.DOTALL)

FILE_NAME = Rule("the name of a file in the folder of the description", lambda v: Path(v).name == v)
DELIMITER = Rule(
    r"one character such as ';', or \s+", lambda v: v == r"\s+" or (len(v) == 1 and v not in '"\r\n')
)


@dataclass(frozen=True)
class TextFormat:
    r"""Format of a text file: the table [file] of a description.

    csv          name of the data file, of any format; "": the name of the description
    delimiter    one character, or r"\s+" for any white space; None: detected
    decimal      a point or a comma; None: detected
    skip_lines   number of lines before the column names; None: detected
    skip_rows    number of rows between the column names and the numbers that are not read; None: rows of
                 units and other texts are recognised
    """

    csv: Annotated[str, FILE_NAME] = ""
    delimiter: Annotated[str | None, DELIMITER] = None
    decimal: Annotated[str | None, Rule("'.' or ','", lambda v: v in (".", ","))] = None
    skip_lines: Annotated[int | None, NOT_NEGATIVE] = None
    skip_rows: Annotated[int | None, NOT_NEGATIVE] = None


@dataclass(frozen=True)
class Columns:
    """Columns of a file by name, each of shape (n,).

    rows       the line or row of each sample, counted from 1
    row_word   "line" or "row", for messages
    units      units that the file contains
    moments    columns of times of day or dates, [s] since midnight or 1970 -> the first cell
    faults     columns that are left out, such as those of texts -> why
    """

    file: str
    values: Mapping[str, Array]
    rows: Sequence[int]
    row_word: str = "row"
    units: Mapping[str, str] = field(default_factory=dict)
    moments: Mapping[str, str] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)

    def location(self, sample: int) -> str:
        """File and line or row of a sample, for messages."""
        return f"{self.file}: {self.row_word} {self.rows[sample]}"

    def finite(self) -> Columns:
        """These columns, which must have no infinite number; gaps are allowed."""
        for name, values in self.values.items():
            for k in np.flatnonzero(np.isinf(values))[:1]:
                got = f"got {values[k]:g}"
                raise Problem(f"{self.location(k)}: column {name!r}: expected a finite number, {got}")
        return self


def read_columns(
    source: Location | Path,
    names: Collection[str] | None,
    form: TextFormat | None = None,
    named: bool = True,
    lenient: bool = False,
) -> Columns:
    """Read columns of a file: Parquet (.parquet), MATLAB (.mat), or MF4, TDMS or text (any other suffix).

    names     columns to read; None: all columns of a text or Parquet file, in their order
    form      format of a text file; None: detected
    named     True if a text file has a row of names; else its columns are "0", "1", ...
    lenient   leave out columns without numbers, and words in others; else they are refused
    """
    file = source if isinstance(source, Location) else Location(source)
    suffix = Path(str(file)).suffix.lower()
    if not file.members:
        with file.opened():  # refuses what is no file
            pass
    if suffix == ".parquet":
        columns = _read_parquet(file, names)
    elif suffix == ".mat":
        columns = _read_mat(file, names)
    elif kind := logger_format(file):
        columns = _read_logger(file, kind, names)
    else:
        columns = _read_text(file, names, form, named, gaps=lenient or names is not None)
    if len({len(values) for values in columns.values.values()}) > 1:
        got = first_names(f"{name} {len(values)}" for name, values in columns.values.items())
        raise Problem(f"{file}: expected columns of one length, got {got}")
    for fault in () if lenient and columns.values else columns.faults.values():
        raise Problem(fault)
    if len(columns.rows) < (1 if names is None else 2):
        raise Problem(f"{file}: expected two or more rows of numbers, got {len(columns.rows) or 'none'}")
    return columns.finite()


def _read_logger(file: Location, kind: str, names: Collection[str] | None) -> Columns:
    """Columns of an MF4 or TDMS file, with units."""
    with channels(file, kind) as found:
        chosen = _column_indices(["time", *found], names, str(file), {})
        values, units = on_one_clock(file, {n: found[n] for n in chosen if n in found}, names is None)
    return Columns(str(file), values, range(1, 1 + len(next(iter(values.values()), ()))), "sample", units)


def split_unit(name: str) -> tuple[str, str]:
    """Name and unit of a column "Druck [bar]" or "Druck (bar)"; all of the name and "" without a unit."""
    match = NAME_AND_UNIT.fullmatch(name)
    unit = (match[2] or match[3]).strip() if match else ""
    return (match[1], unit) if match and not unit.isdigit() and is_unit(unit) else (name, "")


def clock(columns: Columns) -> str:
    """The first column with the name of a clock, or of dates, whose times increase; "" without one."""
    clocks = (n for n in columns.values if n in columns.moments or CLOCK.match(n))
    return next((n for n in clocks if (np.diff(columns.values[n]) > 0).all()), "")


def is_in_days(columns: Columns, name: str) -> bool:
    """Has a column of times without a unit the days of a spreadsheet?"""
    times, stated = columns.values[name], {*columns.moments, *columns.units}
    usual = len(times) > 1 and 0 < np.median(np.diff(times)) < LONGEST_STEP
    return name not in stated and bool(usual and FIRST_DAY <= times[0] < LAST_DAY)


def time_axis(columns: Columns, name: str, unit: str = "", offset: float = 0.0) -> Array:
    """The times in a column [s], from `unit`, or else from that of the file; offset: added [s].

    Dates, times of day, days of a spreadsheet, and seconds since 1970 begin at 0. The latter may be ms, us or
    ns without a unit.
    """
    values, moment = columns.values[name], columns.moments.get(name, "")
    unit = unit or columns.units.get(name) or ("d" if is_in_days(columns, name) else "s")
    where = f"{columns.file}: column {name!r}"
    factor = 1.0 if moment else factor_and_offset(unit, "s", where)[0]
    begin = factor * values[0] + offset
    if not moment and not begin >= FIRST_DATE:
        return np.asarray(factor * values + offset)
    factor *= next((f for f in (1.0, 1e-3, 1e-6) if f * begin < LAST_DATE), 1e-9)
    first = f"{values[0]:.16g} {'d' if unit == 'd' else 'since 1970'}"
    tell_once(f"{where}: {moment or first} is taken as 0 s")
    # seven digits of a second are certain in seconds since 1970
    return np.asarray(np.round(factor * (values - values[0]), 6) + offset)


def _read_text(
    file: Location, names: Collection[str] | None, form: TextFormat | None, named: bool, gaps: bool
) -> Columns:
    text = _Text(file, form or TextFormat(), named)
    faults = dict[str, str]()
    indices = _column_indices(text.names, names, str(file), faults, f"line {text.above + 1}: ")
    text.check_widths()
    numbers, table = list(text.rows), np.empty((len(indices), len(text.rows)))
    for start in range(0, len(numbers), CHUNK):
        part = {number: text.rows[number] for number in numbers[start : start + CHUNK]}
        table[:, start : start + CHUNK] = text.parse_rows(part, indices).T
    values, first = dict(zip(indices, table, strict=True)), text.cells(text.rows[numbers[0]])
    if names is None:
        text.refuse_messages(len(indices))
    for name, fault in text.faults.items():
        words = text.words[name]
        if gaps and words.total() < np.isfinite(values[name]).sum() and not CLOCK.match(name):
            told = first_names(f"{n} {shortened(word)!r}" for word, n in words.most_common())
            tell_once(f"{file}: column {name!r}: gaps in place of {told}")
        else:
            faults[name] = fault
            del values[name], indices[name]
    cells = {name: first[k].strip() for name, k in indices.items()}
    moments = {name: cell for name, cell in cells.items() if ":" in cell or DATE.fullmatch(cell)}
    for name in (n for n, cell in moments.items() if ":" in cell[:3]):  # times of day, over midnight
        values[name] += DAY * np.cumsum(np.diff(values[name], prepend=values[name][0]) < -DAY / 2)
    units = {name: text.units[text.names[k]] for name, k in indices.items() if text.names[k] in text.units}
    return Columns(str(file), values, numbers, "line", units, moments, faults)


class _Text:
    """A text file: how it is written follows from its format, or else from its first rows.

    names       of the columns; without a row of names "0", "1", ... of the first line
    above       number of lines above the names
    units       of columns, in their names, in a row next to them or in all cells
    rows        those of numbers that are not blank, by the numbers of their lines, counted from 1
    mark        the delimiter, None for any white space
    decimal     a point or a comma
    words       column -> texts in place of numbers, such as "Not available", with their counts
    faults      column -> message about its first cell without a number
    """

    def __init__(self, file: Location, form: TextFormat, named: bool = True) -> None:
        self.file, self.form = file, form
        self.words, self.faults = defaultdict[str, Counter[str]](Counter), dict[str, str]()
        text, detected = self._text(), named and form.skip_lines is None
        self.above = _lines_above(text) if detected else form.skip_lines or 0
        if detected and self.above:
            left_out = f"lines 1 to {self.above} are" if self.above > 1 else "line 1 is"
            tell_once(f"{file}: {left_out} left out, the names are in line {self.above + 1}")
        breaks = [match.end() for match in islice(LINE_BREAK.finditer(text), self.above)]
        start = breaks[-1] if breaks else 0
        if len(breaks) < self.above or not text[start:].strip():
            raise Problem(f"{file}: expected two or more rows of numbers, got an empty file")
        marks = [form.delimiter] if form.delimiter else [m for m in DELIMITERS if m != form.decimal]
        fits = {mark: _count_values(text, start, mark) for mark in marks}
        self.delimiter = max(fits, key=fits.__getitem__) if any(fits.values()) else form.delimiter or ","
        self.mark = self.delimiter if len(self.delimiter) == 1 else None
        if not any(fits.values()) or self.delimiter == form.decimal:
            self.check_delimiter(LINE_BREAK.split(text[start:], maxsplit=1)[0])
        names, end = _cells(text, self.mark, start)
        self.names = names[:-1] if names[1:] and not names[-1] else names  # of a delimiter at the end
        if not named and _is_heading(names):
            got = f"got names: select columns by name, such as {names[0]!r}, not by index"
            raise Problem(f"{file}: line {self.above + 1}: expected numbers, {got}")
        if detected and all(map(_is_value, names)):
            got = f"got the numbers {first_names(names)}: add a line of names"
            raise Problem(f"{file}: line {self.above + 1}: expected the names of the columns, {got}")
        if not named:
            self.names, end = [str(i) for i in range(len(self.names))], start
        lines = text[end:].replace("\r\n", "\n").replace("\r", "\n").rstrip("\n").split("\n")
        if named:  # the rest of the line of names, which is empty
            del lines[0]
        self.rows = self._rows(lines, len(LINE_BREAK.findall(text, 0, end)) + 1 + named)
        heading = self._take_heading(form.skip_rows if named else 0)
        self._join_date()
        has_comma = self.delimiter != "," and text.find(",", end) >= 0
        self.decimal = form.decimal or (self._decimal() if has_comma else ".")
        if not self.rows:
            raise Problem(f"{file}: expected two or more rows of numbers, got none")
        first = [self.cells(row) for row in islice(self.rows.values(), FIRST_ROWS)]
        for k, name in enumerate(self.names):
            if unit := _unit_of([row[k].strip() for row in first if k < len(row)]):
                self.units[name] = unit
        found = {
            f"cells separated by {DELIMITERS.get(self.delimiter)}": self.delimiter != (form.delimiter or ","),
            "decimal commas": self.decimal != (form.decimal or "."),
            heading: heading,
        }
        if told := ", ".join(words for words, is_so in found.items() if is_so):
            tell_once(f"{file}: read with {told}")

    def _take_heading(self, skip_rows: int | None) -> str:
        """Take the rows of units and other texts off the numbers; what was found, for a message.

        Names that are not unique are joined with the other texts of their columns.
        """
        few = islice(self.rows.items(), skip_rows or MOST_HEADINGS)
        rows = [(number, [cell.strip() for cell in self.cells(row)]) for number, row in few][:skip_rows]
        below = dict(rows if skip_rows is not None else takewhile(lambda row: _is_heading(row[1]), rows))
        behind = rows[len(below) : len(below) + 2]
        if below and len(behind) == 2 and _are_channels(*(row for _, row in behind)):
            below |= behind[:1]
        for number in below:
            del self.rows[number]
        if numbers := sum(not _is_heading(row) for row in below.values()) * (skip_rows is not None):
            tell_once(f"{self.file}: {numbers} rows of numbers are left out, as skip_rows = {skip_rows}")
        if skip_rows is not None:
            below = {}
        units = next(filter(_are_units, below.values()), [])
        texts = {number: row for number, row in below.items() if row is not units}
        found, names = ["a row of units"] if units else [], self.names
        if texts and len({*names}) < len(names):
            parts = zip_longest((split_unit(name)[0] for name in names), *texts.values(), fillvalue="")
            self.names = [" ".join(filter(None, cells)) for cells in parts]
            found.append("names of several rows")
        elif texts:
            found.append(f"line {', '.join(map(str, texts))} left out")
        stated = zip_longest(self.names, (split_unit(name)[1] for name in names), units, fillvalue="")
        self.units = {n: unit for n, inside, below in stated if (unit := _unwrapped(below) or inside)}
        return ", ".join(found)

    def place(self, key: str) -> str:
        """Where the user can set a key of the format."""
        return f"set {key} in [file] of {self.file.path.with_suffix('.toml').name}"

    def _join_date(self) -> None:
        """A column of dates next to one of times of day is a part of it."""
        first = [cell.strip() for cell in self.cells(next(iter(self.rows.values()), ""))]
        dates = [k for k, cell in enumerate(first) if DATE.fullmatch(cell)]
        pairs = [(k, n) for k in dates for n in (k + 1, k - 1) if ":" in "".join(first[n : n + 1])]
        for date, time in pairs[:1]:
            del self.names[date : date + 1]
            for number, row in self.rows.items():
                cells = [*self.cells(row)]
                if len(cells) > max(date, time):
                    cells[time] = f"{cells[date].strip()} {cells[time].strip()}"
                    del cells[date]
                self.rows[number] = cells

    def _decimal(self) -> str:
        """The last mark in the first number that has one."""
        cells = (cell.strip() for row in self.rows.values() for cell in self.cells(row))
        numbers = (NUMBER.fullmatch(cell) for cell in cells if not DATE.fullmatch(cell))
        return next((max(".,", key=n[1].rfind) for n in numbers if n and {*".,"} & {*n[1]}), ".")

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
            text = text[: text.rfind("\n") + 1]
        if (longest := max(end - begin for begin, end in _first_lines(text))) > MAX_LINE:
            got = f"one of {longest / 1e6:.0f} MB"
            raise Problem(f"{self.file}: expected lines of at most {MAX_LINE / 1e6:.0f} MB, got {got}")
        return labview_table(self.file, text)

    def _rows(self, lines: Sequence[str], first: int) -> dict[int, str | list[str]]:
        """The rows after the number `first` of a line; as cells if any has quotes (RFC 4180).

        A quoted cell may have line breaks. One that goes on over whole rows lacks a quote.
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
                if endless or any(line.count(mark) >= len(self.names) - 1 for line in inside):
                    got = "none in the file" if endless else "none before the next row"
                    raise csv.Error(f"a quoted cell: expected its end, got {got}")
                if "".join(lines[begin : begin + 1]).strip(blank):
                    rows[first + begin] = cells
                begin = reader.line_num
        except csv.Error as error:
            raise Problem(f"{self.file}: line {first + begin}: {error}") from None
        return rows

    def check_delimiter(self, line: str) -> None:
        """Refuse a delimiter that is the decimal mark, too, or not in the row of names."""
        origin = "the default" if self.form.delimiter is None else "as set"
        if self.delimiter == self.form.decimal:
            remedy = self.place('delimiter = ";"')
            expected = f"expected another character than the decimal mark, got {self.delimiter!r} ({origin})"
            raise Problem(f"{self.file}: [file] delimiter: {expected}: {remedy}")
        other = next((mark for mark in ";\t," if mark in line), "")
        if self.mark and self.mark not in line and other:
            escaped = other.replace("\t", r"\t")
            hint = self.place(f'delimiter = "{escaped}"')
            expected = f"expected cells separated by {self.delimiter!r} ({origin})"
            raise Problem(f"{self.file}: line {self.above + 1}: {expected}, got {other!r}: {hint}")

    def check_widths(self) -> None:
        """Refuse a row with fewer or more cells than the row of names, but for an empty one at the end."""
        width = len(self.names)
        for number, row in self.rows.items():
            plain = self.mark and isinstance(row, str)
            cells = row.count(self.mark) + 1 if plain else len(self.cells(row))  # type: ignore[arg-type]
            if cells != width and (cells != width + 1 or self.cells(row)[-1].strip()):
                hint = ": is a comma inside a number?" if self.mark == "," and cells > width else ""
                raise Problem(f"{self.file}: line {number}: expected {width} cells, got {cells}{hint}")

    def refuse_messages(self, width: int) -> None:
        """Refuse rows of messages: a long table of time, name and value, and lists of values in cells."""
        for name, words in self.words.items():
            where, word = f"{self.file}: column {name!r}", words.most_common(1)[0][0]
            if KEYS.fullmatch(name) and width - len(self.words) == 2 and 1 < len(words) < words.total():
                got = f"got a long table with names such as {shortened(word)!r}"
                raise Problem(f"{where}: expected a column for each signal, {got}: {PIVOT}")
            if word.startswith("[") and word.endswith("]"):
                got = f"got lists such as {shortened(word)!r}, as LeRobot writes them"
                raise Problem(f"{where}: expected numbers, {got}: write a column for each element")

    def cells(self, row: str | list[str]) -> list[str]:
        """The cells of a row."""
        return row.split(self.mark) if isinstance(row, str) else row

    def parse_rows(self, rows: Mapping[int, str | list[str]], indices: Mapping[str, int]) -> Array:
        """Convert the columns `indices` of rows, by the numbers of their lines; shape (rows, columns)."""
        columns, point = list(indices.values()), self.decimal
        lines = [row.replace(point, ".") for row in rows.values() if isinstance(row, str)]
        mixed = point == "," and any("." in row for row in rows.values() if isinstance(row, str))
        with suppress(ValueError):  # a gap, or a cell that is not a number
            if len(lines) == len(rows) and not mixed:
                table = np.loadtxt(lines, delimiter=self.mark, usecols=columns, comments=None, ndmin=2)
                if len(table) == len(rows):
                    return table
        table, split = np.empty((len(rows), len(indices))), [self.cells(row) for row in rows.values()]
        for j, (name, index) in enumerate(indices.items()):
            cells = [row[index].strip() for row in split]
            try:
                text = "".join(cells)
                if (point == "," and "." in text) or "_" in text or not text.isascii():
                    raise ValueError
                table[:, j] = np.array([cell.replace(point, ".") for cell in cells], float)
            except ValueError:
                each = zip(cells, rows, strict=True)
                table[:, j] = [self.parse_cell(cell, number, name, index) for cell, number in each]
        return table

    def parse_cell(self, cell: str, line: int, column: str, index: int) -> float:
        """The number in a cell, with or without the unit of its column; NaN for a gap or a fault."""
        match, unit, comma = NUMBER.fullmatch(cell), self.units.get(self.names[index]), self.decimal == ","
        number = match[1] if match and match[2] == unit else cell
        if ":" in number or DATE.fullmatch(number):
            value = _moment(number)
        elif (comma and "." in number) or (unit != ONE and number.lower() in WORDS):
            value = None
        else:
            value = _number(number.replace(",", ".") if comma else number)
        if value is None:
            expected = hint = ""
            if number.strip("-") and {*number} <= {*"+-0123456789.,' \xa0"}:
                expected = f" with a decimal {'comma' if comma else 'point'} and no thousands separator"
                hint = f": export it so, or {self.place('decimal')}"
            elif "/" in number or ":" in number:
                hint = ": a time is like 2026-03-02T08:15:00.050 or 08:15:00,050"
            where = f"{self.file}: line {line}: column {column!r}"
            got = f"got {shortened(cell)!r}{hint}"
            self.faults.setdefault(column, f"{where}: expected a number{expected}, {got}")
            # what may be a number makes all of the column unreadable
            may_be = LIKE_NUMBER.match(cell) or cell.lower() in WORDS
            self.words[column][cell] += len(self.rows) if may_be else 1
        return math.nan if value is None else value


def _moment(cell: str) -> float | None:
    """A date and time [s] since 1970, or a time of day [s]; None for other texts."""
    text = GERMAN_DATE.sub(lambda day: f"{day[3]}-{day[2]:0>2}-{day[1]:0>2}", cell)
    text = MATLAB_DATE.sub(lambda day: f"{day[3]}-{MONTHS.find(day[2]) // 3 + 1:02}-{day[1]}", text)
    text = f"1970-01-01 {'0' * (text[1] == ':')}{text}" if ":" in text[1:3] else text
    with suppress(ValueError):
        moment = datetime.fromisoformat(text)
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    return None


def _is_value(cell: str) -> bool:
    is_time = ":" in cell and _moment(cell) is not None
    return is_time or bool(NUMBER.fullmatch(cell) or DATE.fullmatch(cell)) or cell.lower() in WORDS


def _count_values(text: str, start: int, delimiter: str) -> int:
    """The number of numbers and times in the first rows that are as wide as the names at `start`."""
    mark = delimiter if len(delimiter) == 1 else None
    names, end = _cells(text, mark, start)
    last = next(islice(LINE_BREAK.finditer(text, end), FIRST_ROWS, None), None)
    rows = [_cells(r, mark)[0] for r in LINE_BREAK.split(text[end : last and last.start()])[1:]]
    # an empty last cell is that of a delimiter at the end
    wide = [row for row in rows if len(row) in (len(names), len(names) + (not row[-1]))]
    return sum(map(_is_value, (cell for row in wide for cell in row[:FIRST_CELLS]))) if names[1:] else 0


def _first_lines(text: str) -> list[tuple[int, int]]:
    """Begin and end of each of the first lines."""
    ends = [match.end() for match in islice(LINE_BREAK.finditer(text), FIRST_ROWS + 1)]
    if len(ends) <= FIRST_ROWS and ends[-1:] != [len(text)]:
        ends.append(len(text))
    return [*pairwise([0, *ends])]


def _lines_above(text: str) -> int:
    """The number of lines above the names, which are in the heading before the most rows of its width.

    Of the rows of a heading they are the one with a clock, else the one above the units, else the last.
    """
    starts, ends = zip(*_first_lines(text), strict=True)
    lines = [text[a:b].rstrip("\r\n") for a, b in zip(starts, ends, strict=True)]
    best, last, end, mark = 0, 0, 0, None
    for number, delimiter in product(range(len(lines)), DELIMITERS):
        m = delimiter if len(delimiter) == 1 else None
        row, past = _cells(text, m, starts[number])
        if starts[number] < end or (number and not _is_heading(row)):  # in a quoted name, or no heading
            continue
        count = _count_values(text, starts[number], delimiter)
        if count > best or (count == best > 0 and number > last):
            best, last, end, mark = count, number, past, m
    rows, first = [_cells(line, mark)[0] for line in lines[: last + 1]], last
    while first and len(rows[first - 1]) == len(rows[last]) and _is_heading(rows[first - 1]):
        first -= 1
    plain = [k for k in range(first, last + 1) if not _are_units(rows[k])] or [first]
    with_clock = [k for k in plain if any(map(CLOCK.match, rows[k]))]
    over_units = [k for k in plain if k < last and _are_units(rows[k + 1])]
    return (with_clock or over_units or plain[-1:])[0]


def _are_channels(row: Sequence[str], following: Sequence[str]) -> bool:
    """Whether a row has the numbers of channels, in turn, and no time, or one after that of the next row."""
    cells = [cell for cell in row if cell]
    if len(cells) < 2 or not all(map(str.isdecimal, cells)) or not any(following):
        return False
    numbers, later = [*map(int, cells)], _number(following[0].replace(",", "."))
    in_turn = numbers == [*range(numbers[0], numbers[0] + len(cells))]
    return in_turn and (not row[0] or (later is not None and later < numbers[0]))


def _are_units(row: Sequence[str]) -> bool:
    """Are all of these texts units, or half of them if none is the name of a clock?"""
    cells = [cell for cell in row[:FIRST_CELLS] if cell]
    share = sum(is_unit(_unwrapped(cell)) for cell in cells) / max(len(cells), 1)
    return share == 1 or (share >= 0.5 and not any(map(CLOCK.match, cells)))


def _is_heading(row: Sequence[str] = ()) -> bool:
    """Is this a row of texts? Next to other units the dimensionless unit 1 is one, too."""
    cells = {cell.strip() for cell in row if cell.strip().lower() not in GAP_MARKS}
    texts = {cell for cell in cells if not _is_value(cell)}
    return bool(texts) and (texts == cells or (texts == cells - {"1"} and any(map(is_unit, texts))))


def _unwrapped(unit: str) -> str:
    """A unit without the brackets around it."""
    unit = unit.strip()
    return unit[1:-1].strip() if unit[:1] + unit[-1:] in ("[]", "()") else unit


def _unit_of(cells: Sequence[str]) -> str:
    """The unit behind the numbers in all cells but gaps, that of Booleans, or ""."""
    known = [cell for cell in cells if cell.lower() not in GAP_MARKS]
    if known and all(cell.lower() in WORDS for cell in known):
        return ONE
    numbers = (NUMBER.fullmatch(cell) for cell in known if LIKE_NUMBER.match(cell))
    units = {number[2] if number else None for number in numbers}
    unit = units.pop() if len(units) == 1 else None
    return unit if unit and is_unit(unit) else ""


def _column_indices(
    header: Sequence[str], names: Collection[str] | None, file: str, faults: dict[str, str], where: str = ""
) -> dict[str, int]:
    """Index of each requested column, which must occur exactly once; None: all, `faults` gets the others."""
    counts, index = Counter(header), {name: i for i, name in enumerate(header)}
    bare = [split_unit(name)[0] for name in header]  # these names do, too
    counts, index = Counter(bare) | counts, {name: i for i, name in enumerate(bare)} | index
    selected = header if names is None else sorted(names)
    for name in dict.fromkeys(selected):
        if names is None and not name:
            faults[name] = f"{file}: {where}column {list(header).index('') + 1} has no name"
        elif counts[name] > 1:
            got = f"got it {counts[name]} times"
            faults[name] = f"{file}: expected the column {shortened(name)!r} once, {got}"
        elif not counts[name]:
            got = f"got {_name_list(header)}{suggest(name, header)}"
            faults[name] = f"{file}: expected a column {shortened(name)!r}, {got}"
    for fault in faults.values() if names is not None else ():
        raise Problem(fault)
    return {name: index[name] for name in selected if name not in faults}


def _cells(text: str, mark: str | None, start: int = 0) -> tuple[list[str], int]:
    """The cells of a row from `start` on, and the index of its end, a line break that is not quoted.

    White space around a cell is stripped, unless it is inside quotes. A quote inside an unquoted cell counts
    as text.
    """
    line_break = LINE_BREAK.search(text, start)
    line = text[start : line_break and line_break.start()]
    if mark is None:
        return line.split() or [""], start + len(line)
    if '"' not in line:
        return [cell.strip() for cell in line.split(mark)], start + len(line)
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
        return real(cell)
    except ValueError:
        word = cell.strip().lower()
        return math.nan if word in GAP_MARKS else WORDS.get(word)


def _read_parquet(file: Location, names: Collection[str] | None) -> Columns:
    """Columns of a Parquet file, with units from the fields. A null is a gap."""
    require("files", f"{file}: a Parquet file", "pyarrow")
    import pyarrow.parquet

    with foreign(file, "a Parquet"):
        faults = dict[str, str]()
        with pyarrow.parquet.ParquetFile(BytesIO(file.read()) if file.members else file.path) as opened:
            schema = opened.schema_arrow
            selected = list(_column_indices(schema.names, names, str(file), faults))
            check_size(file, 8 * len(selected) * opened.metadata.num_rows, "columns")
            table = opened.read(columns=selected)
        values = dict[str, Array]()
        for name in selected:
            try:
                values[name] = _arrow_values(table.column(name), f"{file}: row", name)
            except Problem as problem:
                faults[name] = str(problem)
        metadata = {name: schema.field(name).metadata or {} for name in selected}
        units = {name: data[b"unit"].decode() for name, data in metadata.items() if b"unit" in data}
    return Columns(str(file), values, range(1, table.num_rows + 1), units=units, faults=faults)


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
            got = f"got {shortened(cells[bad])!r}"
            raise Problem(f"{where} {bad + 1}: column {name!r}: expected a number, {got}")
        return np.array(numbers, dtype=np.float64)
    hint = ": write a column for each element" if types.is_nested(column_type) else ""
    raise Problem(f"{where} 1: column {name!r}: expected numbers, got {column_type}{hint}")


def _read_mat(file: Location, names: Collection[str] | None) -> Columns:
    """Columns of a MATLAB file, which must have the same length; with units if it is a trace of a run."""
    variables = read_variables(file)
    units, original = _of_trace(variables) if names is None else ({}, {})
    candidates, faults, values = dict(_flat_columns("", variables)), dict[str, str](), dict[str, Array]()
    size = FLOAT64 * sum(column.size for column in candidates.values() if isinstance(column, np.ndarray))
    check_size(file, size, "columns", file.path.stat().st_size)
    for key, other in [c for c in candidates.items() if isinstance(c[1], NotNumbers)]:
        for name in names or ():
            if name == key or name.startswith((f"{key}.", f"{key}(")):
                raise Problem(f"{file}: column {shortened(name)!r}: expected numbers, got {other.what}")
        del candidates[key]
    for name in _column_indices(list(candidates), names, str(file), faults):
        column = candidates[name]
        if isinstance(column, str) or column.dtype.kind not in "fiub":
            got = repr(shortened(column)) if isinstance(column, str) else f"{column.dtype}"
            faults[name] = f"{file}: row 1: column {name!r}: expected numbers, got {got}"
        else:
            values[original.get(name, name)] = column.astype(np.float64)
    values = {n: values[n] for n in dict.fromkeys([*original.values(), *values]) if n in values}  # in order
    rows = range(1, 1 + min(map(len, values.values()), default=0))
    return Columns(str(file), values, rows, units=units, faults=faults)


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
