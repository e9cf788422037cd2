"""Traces: sampled signals over one time axis, read from and written to CSV and Parquet.

The file formats of traces.

CSV: the first row names the columns, time first, then numbers with a decimal point, separated by commas.
Parquet: the same columns as float64; units stand in the metadata of each field.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.base.errors import Problem, UnknownSignal
from orchestrator.base.files import Location


@dataclass(frozen=True)
class Trace:
    """Signals over a common, strictly increasing time axis, in SI units.

    time      shape (n,) [s]
    signals   name -> shape (n,); of a run, names are `component.variable`
    units     name -> unit as the FMU or the file's meta data writes it; a missing name has no unit
    """

    time: NDArray[np.float64]
    signals: Mapping[str, NDArray[np.float64]]
    units: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        if name not in self.signals:
            raise UnknownSignal(name, self.signals)
        return self.signals[name]

    def at(self, time: ArrayLike) -> Trace:
        """The signals at other times [s]: linear between the samples, held outside of them."""
        when = np.asarray(time, dtype=np.float64)
        return Trace(when, {n: np.interp(when, self.time, v) for n, v in self.signals.items()}, self.units)

    def select(self, names: Iterable[str]) -> Trace:
        """The trace with only these signals, in this order."""
        kept = {name: self[name] for name in names}
        return Trace(self.time, kept, {n: u for n, u in self.units.items() if n in kept})


def read(path: str | Path | Location) -> Trace:
    """Read a trace; the suffix (.csv or .parquet) tells the format. The file may lie inside an archive."""
    file = path if isinstance(path, Location) else Location(Path(path))
    check_suffix(str(file))
    parse = parse_csv if str(file).lower().endswith(".csv") else parse_parquet
    return parse(file.read(), str(file))


def write(trace: Trace, path: str | Path) -> Path:
    """Write a trace as .csv or .parquet, by the suffix; reading it gives the same numbers, bit for bit."""
    file = Path(path)
    check_suffix(file)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        (write_csv if file.suffix.lower() == ".csv" else write_parquet)(trace, file)
    except OSError as error:
        raise Problem(f"{file}: cannot be written: {error.strerror or error}") from error
    return file


def check_suffix(path: str | Path) -> None:
    """Refuse a file name whose format is unknown, before work is spent on it."""
    if Path(path).suffix.lower() not in (".csv", ".parquet"):
        raise Problem(f"{path}: expected a file name ending in .csv or .parquet")


TIME = "time"
CHUNK = 8192  # rows formatted at a time


def parse_csv(content: bytes, path: str) -> Trace:
    """Read a CSV file; every mistake is reported with file, row and column."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Problem(f"{path}: expected text in UTF-8, got byte {error.object[error.start]:#x}") from None
    lines = text.rstrip().splitlines()
    names = _names(path, next(csv.reader(lines[:1]), []))
    if len(lines) < 2:
        raise Problem(f"{path}: expected rows of numbers below the names, got none")
    try:
        table = np.loadtxt(
            io.StringIO("\n".join(lines[1:])), delimiter=",", ndmin=2, comments=None, quotechar='"'
        )
        if table.shape != (len(lines) - 1, len(names)) or not np.isfinite(table).all():
            raise ValueError
    except ValueError:
        table = _read_slowly(path, names, lines[1:])
    return _trace(path, names, table, {})


def parse_parquet(content: bytes, path: str) -> Trace:
    """Read a Parquet file whose first column is the time."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(pa.BufferReader(content))
    except (pa.ArrowInvalid, OSError) as error:
        raise Problem(f"{path}: cannot be read as Parquet: {error}") from error
    names = _names(path, table.column_names)
    columns = []
    for name, column in zip(names, table.columns, strict=True):
        if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
            raise Problem(f"{path}: column {name!r}: expected numbers, got {column.type}")
        values = column.to_numpy().astype(np.float64)
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            raise Problem(f"{path}: row {row + 1}, column {name!r}: expected a number, got {values[row]}")
        columns.append(values)
    fields = {f.name: f.metadata for f in table.schema if f.metadata}
    units = {n: m[b"unit"].decode() for n, m in fields.items() if b"unit" in m}
    return _trace(path, names, np.stack(columns, axis=1), units)


def write_csv(trace: Trace, path: Path) -> None:
    """Shortest decimal text that gives back the same float64."""
    columns = [trace.time, *trace.signals.values()]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow([TIME, *trace.signals])
        for first in range(0, len(trace.time), CHUNK):
            rows = zip(*(c[first : first + CHUNK].tolist() for c in columns), strict=True)
            file.writelines(",".join(map(repr, row)) + "\n" for row in rows)


def write_parquet(trace: Trace, path: Path) -> None:
    """One float64 column per signal, time first."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    units = {TIME: "s", **trace.units}
    columns = {TIME: trace.time, **trace.signals}
    fields = [
        pa.field(n, pa.float64(), nullable=False, metadata={"unit": units[n]} if n in units else None)
        for n in columns
    ]
    arrays = [pa.array(np.ascontiguousarray(v, dtype=np.float64)) for v in columns.values()]
    pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), path)


def _names(path: str, row: Sequence[str]) -> list[str]:
    names = [name.strip() for name in row]
    if names[:1] != [TIME]:
        got = repr(names[0]) if names and names[0] else "nothing"
        hint = " (columns are separated by commas)" if names and ";" in names[0] else ""
        raise Problem(f"{path}: row 1: expected the first column to be named 'time', got {got}{hint}")
    for i, name in enumerate(names):
        if not name:
            raise Problem(f"{path}: row 1: column {i + 1} has no name")
        if name in names[:i]:
            raise Problem(f"{path}: row 1: two columns are named {name!r}")
    return names


def _read_slowly(path: str, names: list[str], lines: list[str]) -> NDArray[np.float64]:
    """The numbers cell by cell, to find out what is wrong with them."""
    table = np.zeros((len(lines), len(names)))
    for i, cells in enumerate(csv.reader(lines)):
        if len(cells) != len(names):
            got = f"got {len(cells)}" if any(cells) else "got an empty row"
            raise Problem(f"{path}: row {i + 2}: expected {len(names)} values, {got}")
        for j, cell in enumerate(cells):
            table[i, j] = _number(path, i + 2, names[j], cell.strip())
    return table


def _number(path: str, row: int, column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        _wrong(path, row, column, repr(cell) if cell else "an empty cell")
    return value


def _wrong(path: str, row: int, column: str, got: str) -> NoReturn:
    raise Problem(f"{path}: row {row}, column {column!r}: expected a number, got {got}")


def _trace(path: str, names: list[str], table: NDArray[np.float64], units: dict[str, str]) -> Trace:
    """The trace, after checking its time axis."""
    time = np.ascontiguousarray(table[:, 0])
    steps = np.diff(time)
    if len(steps) and steps.min() <= 0:
        row = int(np.argmax(steps <= 0)) + 1
        raise Problem(f"{path}: row {row + 2}: expected a time after {time[row - 1]!s} s, got {time[row]!s}")
    gap = _gap(steps)
    if gap is not None:
        usual = f"a sample every {np.median(steps):.6g} s"
        raise Problem(
            f"{path}: row {gap + 3}: expected {usual}, got none between {time[gap]!s} and {time[gap + 1]!s} s"
        )
    signals = {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(names) if i > 0}
    return Trace(time, signals, {n: u for n, u in units.items() if n in signals})


def _gap(steps: NDArray[np.float64]) -> int | None:
    """The first interval in which rows of a uniformly sampled file are missing.

    Uniform means: nearly all intervals are equal, and the others are whole multiples of them. Files with
    other intervals are sampled irregularly on purpose.
    """
    if len(steps) < 20:
        return None
    ratio = steps / np.median(steps)
    whole = np.rint(ratio)
    if np.abs(ratio - whole).max() > 1e-3 or np.mean(whole == 1) < 0.98:
        return None
    return int(np.argmax(whole > 1)) if whole.max() > 1 else None
