"""Writes traces row by row: into memory, or into a file that gets its name when it is complete.

While a run goes on, its rows are in NAME.partial.csv. A Parquet or MATLAB file is made of them at the end.
`TraceFile.publish` gives a complete file its name in one operation. If the run fails, or if the process is
killed, the partial file stays, and so does an earlier file NAME.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.extras import require
from orchestrator.base.files import Location, csv_header, naming
from orchestrator.base.processes import check_room
from orchestrator.base.units import LinearTransformation
from orchestrator.data.matlab import foreign, read_variables
from orchestrator.data.table import SUFFIXES, read_columns
from orchestrator.data.trace import METADATA_SUFFIX, TIME, Trace, Units, check_suffix, read_trace

Array = NDArray[np.float64]
Points = tuple[Array, Array, NDArray[np.int64]]  # times, Real and Integer values
ORIGIN = "harvester"  # key of the JSON text about the run in the metadata of a Parquet file
CHUNK = 8192  # rows of a trace written at a time
BLOCK = 1 << 24  # bytes of text that are converted at a time, without all rows in memory
MANY = 5000  # values whose text takes Python as long as loading the library that is faster
MAX_KEPT = 32 << 20  # bytes that are kept in memory besides a file: 190 s of 110 signals every 5 ms


@dataclass(frozen=True)
class RowLayout:
    """The signals of a trace, and where their values are in a recorded point of a run.

    names, units      of the signals
    columns           index of each signal among the Real and then the Integer values of a point
    scaled            indices of the signals that are outputs of the system, with `maps` from their sources
    reals, integers   number of values of a point
    every             every `every`-th communication point is recorded
    """

    names: tuple[str, ...]
    units: Mapping[str, str]
    columns: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    scaled: Sequence[int] = ()
    maps: Sequence[LinearTransformation] = ()
    reals: int = 0
    integers: int = 0
    every: int = 1

    @property
    def consistent(self) -> bool:
        """Do all parts refer to values that a point has?"""
        scaled = len(self.scaled) == len(self.maps) and all(0 <= k < len(self.names) for k in self.scaled)
        once = len(set(self.names)) == len(self.names)
        valid = min(self.reals, self.integers, self.every - 1) >= 0 and once
        inside = (self.columns >= 0) & (self.columns < self.reals + self.integers)
        each = inside.shape == (len(self.names),) and bool(inside.all())
        return scaled and valid and each

    def values(self, reals: Array, integers: NDArray[np.int64]) -> Array:
        """The signals at some points, shape (points, signals)."""
        points = np.hstack([reals, integers]) if self.integers else reals
        values = np.take(points, self.columns, axis=1)
        for k, linear in zip(self.scaled, self.maps, strict=True):
            values[:, k] = linear(values[:, k])
        return values


class TraceSink:
    """Receives the points of a run, or the rows of a trace; arrays are overwritten later.

    layout   the signals, from `begin` on
    rows     number of rows until now
    last     time of the last row [s]

    keeps_errors   whether `append_errors` has an effect
    """

    keeps_errors = False

    def begin(self, layout: RowLayout, rows: int = 0) -> None:
        """Receive the signals; `rows`: the expected number of points or rows."""
        del rows
        self.layout, self.rows, self.last = layout, 0, float("nan")

    def append_points(self, times: Array, reals: Array, integers: NDArray[np.int64]) -> None:
        """Receive points of a run: times [s], shape (n,), Real and Integer values, shape (n, ...)."""
        self.append(times, self.layout.values(reals, integers))

    def append_errors(self, outputs: Sequence[str], times: Array, errors: Array) -> None:
        """Receive estimated errors of outputs, shape (n, outputs); only a sink in memory keeps them."""

    def append_events(self, events: Sequence[Any]) -> None:
        """Receive events of FMUs, for a run whose process ends before it tells all of them."""

    @property
    def errors(self) -> Trace | None:
        """The estimated errors of the recorded signals; None if there are none or they were not kept."""
        return None

    @property
    def trace(self) -> Trace:
        """All rows until now."""
        raise NotImplementedError

    def close(self) -> None:
        """There are no further rows."""

    def append(self, times: Array, values: Array) -> None:
        """Receive rows: times [s], shape (n,), and values, shape (n, signals)."""
        if len(values):
            self.rows, self.last = self.rows + len(times), float(times[-1])

    def largest(self, name: str) -> tuple[float, float] | None:
        """The value of largest magnitude and its time [s]; None if the signal is not recorded."""
        if not self.rows or name not in self.layout.names:
            return None
        return self._largest(self.layout.names.index(name))

    def _largest(self, signal: int) -> tuple[float, float]:
        raise NotImplementedError


class TraceInMemory(TraceSink):
    """The rows as a `Trace`, whose signals are contiguous."""

    keeps_errors = True

    def begin(self, layout: RowLayout, rows: int = 0) -> None:
        """Allocate the arrays; raises Problem if they do not fit into memory."""
        super().begin(layout)
        self._times, self._values = np.zeros(0), np.zeros((len(layout.names), 0))
        self._outputs, self._errors = list[str](), list[tuple[Array, Array]]()
        self._allocate(rows)

    def append(self, times: Array, values: Array) -> None:
        """Store rows; the arrays grow if necessary."""
        first = self.rows
        super().append(times, values)
        if self.rows > len(self._times):
            self._allocate(2 * self.rows)
        self._times[first : self.rows], self._values[:, first : self.rows] = times, values.T

    def append_errors(self, outputs: Sequence[str], times: Array, errors: Array) -> None:
        """Store estimated errors of recorded signals, without times at which one is not finite."""
        recorded = set(self.layout.names)
        columns = {n: k for k, n in enumerate(outputs) if n in recorded}
        self._outputs, values = list(columns), errors[:, list(columns.values())]
        finite = np.isfinite(values).all(axis=1)
        if finite.any():
            self._errors.append((times[finite], values[finite]))

    def _largest(self, signal: int) -> tuple[float, float]:
        values = self._values[signal, : self.rows]
        row = np.argmax(np.abs(values))
        return float(values[row]), float(self._times[row])

    def _allocate(self, rows: int) -> None:
        check_room(rows, len(self._values))
        times, values = np.zeros(rows), np.zeros((len(self._values), rows))
        stored = len(self._times)
        times[:stored], values[:, :stored] = self._times, self._values
        self._times, self._values = times, values

    @property
    def trace(self) -> Trace:
        """All rows until now."""
        signals = dict(zip(self.layout.names, self._values[:, : self.rows], strict=True))
        return Trace(self._times[: self.rows], signals, self.layout.units)

    @property
    def errors(self) -> Trace | None:
        """The estimated errors of the recorded signals; None if there are none."""
        if not self._errors:
            return None
        times, rows = (np.concatenate(parts) for parts in zip(*self._errors, strict=True))
        signals = dict(zip(self._outputs, np.ascontiguousarray(rows.T), strict=True))
        return Trace(times, signals, {n: u for n, u in self.layout.units.items() if n in signals})


class TraceOnDisk(Trace):
    """A trace in a file, which is read at the first use of its samples."""

    def __init__(self, read: Callable[[], Trace], units: Units) -> None:
        self.__dict__.update(units=units, read=read)

    @cached_property
    def _samples(self) -> Trace:
        return self.__dict__["read"]()  # type: ignore[no-any-return]

    @property
    def time(self) -> Array:
        """As in `Trace`."""
        return self._samples.time

    @property
    def signals(self) -> Mapping[str, Array]:
        """As in `Trace`."""
        return self._samples.signals

    def _with(self, signals: Mapping[str, Array], time: Array | None = None) -> Any:
        return self._samples._with(signals, time)


class TraceFile(TraceSink):
    """A trace in a .csv, .parquet or .mat file, under a partial name until `publish`.

    path      name of the complete file
    partial   name until then, a CSV file
    origin    JSON text about the run, stored in Parquet and MATLAB files, see `read_origin`
    accept    called with the signals before the first row; a Problem that it raises ends the run
    """

    def __init__(self, path: str | Path, origin: str = "") -> None:
        check_suffix(path)
        named = Path(path)
        self.path = named.resolve() if named.is_symlink() else named  # the link stays
        self._kept = TraceInMemory()
        if self.path.is_dir():
            raise Problem(f"{path}: expected the name of a file, got a folder")
        if self.path.stem.endswith(".partial"):
            raise Problem(f"{path}: expected another name: NAME.partial.* is for unfinished results")
        self.partial = self.path.with_name(f"{self.path.stem}.partial.csv")
        self.origin = origin
        self._rows: _Rows | None = None
        self.accept: Callable[[RowLayout], None] = lambda _: None

    def begin(self, layout: RowLayout, rows: int = 0) -> None:
        """Make the partial file; that of an earlier run is removed, unless `accept` refuses the signals.

        Raises Problem if the rows do not fit on the disk.
        """
        if suffix := self._suffix.removeprefix(".csv"):
            what, package = {".parquet": ("Parquet", "pyarrow"), ".mat": ("MATLAB", "scipy")}[suffix]
            require("files", f"{self.path}: a {what} file", package)
        folder = next(p for p in self.path.absolute().parents if p.is_dir())
        check_room(rows, len(layout.names), folder, self.number_size)
        self.accept(layout)
        super().begin(layout, rows)
        self._peaks, self._peak_times = np.zeros((2, len(layout.names)))
        self._kept.begin(layout)
        with naming(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            remove_partial(self.partial)
            self._rows = _Rows(self.partial, layout.names)

    @property
    def _suffix(self) -> str:
        return self.path.suffix.lower()

    @property
    def number_size(self) -> int:
        """Bytes that a number takes on the disk until the file is complete, on average of a long run.

        The machine's runs have 14.4 to 15.5 characters for each, with the comma.
        """
        return 15 + {".csv": 0, ".parquet": 7, ".mat": 5}[self._suffix]

    def append(self, times: Array, values: Array) -> None:
        """Write rows; if the disk is full, the file ends with the last row that fits."""
        assert self._rows is not None
        until = f"; it has the rows up to t = {self.last:.6g} s" if self.rows else ""
        with naming(self.partial, until):
            self._rows.append(times, values)
        super().append(times, values)
        if len(times):
            row = np.argmax(np.abs(values), axis=0)
            largest = values[row, np.arange(values.shape[1])]
            higher = np.abs(largest) > np.abs(self._peaks)
            self._peaks[higher], self._peak_times[higher] = largest[higher], times[row[higher]]
        if values.shape[1] * 8 * self.rows > MAX_KEPT:
            self._kept.begin(self._kept.layout)  # releases the memory
        elif self._kept.rows + len(times) == self.rows:
            self._kept.append(times, values)

    def _largest(self, signal: int) -> tuple[float, float]:
        return float(self._peaks[signal]), float(self._peak_times[signal])

    @property
    def trace(self) -> Trace:
        """All rows: those in memory, or, if they are too many, those in the file when they are needed."""
        complete = self._kept.rows == self.rows
        units = Units(self.layout.units, self.layout.names)
        return self._kept.trace if complete else TraceOnDisk(self._read, units)

    def _read(self) -> Trace:
        self.close()
        return read_trace(self.path if self._rows is None else self.partial)

    def finish(self, check: Callable[[], None] = lambda: None) -> tuple[Path, str]:
        """Close the partial file, and make the one of it; returns that, under another name, and its SHA-256.

        check   called now and then; an exception leaves the partial file
        """
        assert self._rows is not None
        self._rows.close()
        self._rows.check_alone()
        if self._suffix == ".csv":
            return self.partial, self.sha256
        whole = self.partial.with_suffix(self._suffix)
        try:
            with naming(whole):
                if self._suffix == ".parquet":
                    self._to_parquet(whole, check)
                else:
                    self._to_matlab(whole)
                check()
                return whole, Location(whole).sha256
        except BaseException:
            whole.unlink(missing_ok=True)
            raise

    def _to_parquet(self, whole: Path, check: Callable[[], None]) -> None:
        """Parquet: one float64 column per signal, time first, with units in the metadata of the fields."""
        import pyarrow as pa
        from pyarrow import csv, parquet

        names = (TIME, *self.layout.names)
        units = {name: {"unit": unit} for name, unit in {TIME: "s", **self.layout.units}.items()}
        fields = [pa.field(name, pa.float64(), False, units.get(name)) for name in names]
        schema = pa.schema(fields, {ORIGIN: self.origin})
        with parquet.ParquetWriter(whole, schema) as writer:
            if not self.rows:
                writer.write_table(schema.empty_table())
                return
            longest = sum(len(name.encode()) + 30 for name in names)  # bytes of a line: names, or numbers
            block = max(BLOCK, 2 * longest)
            read = csv.ReadOptions(column_names=names, skip_rows_after_names=1, block_size=block)
            numbers = csv.ConvertOptions(column_types=schema, null_values=[])
            for batch in csv.open_csv(self.partial, read, csv.ParseOptions(newlines_in_values=True), numbers):
                check()
                writer.write_table(pa.Table.from_arrays(batch.columns, schema=schema))

    def _to_matlab(self, whole: Path) -> None:
        """MATLAB, version 5: `time`, and the signals as structs of components, such as `swing.swing_angle`.

        The struct `units` has the same fields, with texts. The text `run` is JSON: the origin, and `names`,
        the signals in their order -> their names in the file, which differ for what is no name in MATLAB.
        """
        import scipy.io

        rows = read_columns(Location(self.partial), None).values if self.rows else {}
        written, units = matlab_names(self.layout.names), dict[str, Any]({TIME: "s"})
        content = dict[str, Any]({TIME: rows.get(TIME, np.zeros(0))})
        for name in self.layout.names:
            _put(content, written[name], rows.get(name, np.zeros(0)))
        for name, unit in self.layout.units.items():
            _put(units, written[name], unit)
        about = json.loads(self.origin) if self.origin else {}
        run = json.dumps({**about, "names": {name: ".".join(path) for name, path in written.items()}})
        content |= {"units": units, "run": run}
        try:
            scipy.io.savemat(whole, content, long_field_names=True, do_compression=True, oned_as="column")
        except (ValueError, OverflowError, struct.error) as error:  # more than 4 GB
            raise Problem(f"{whole}: expected at most 4 GB in a MATLAB file: {error}") from None

    @property
    def sha256(self) -> str:
        """The checksum of the partial file."""
        return self._rows.sha256 if self._rows else ""

    def publish(self, complete: Path, others: Mapping[Path, str] | None = None) -> None:
        """Give a complete file its name, and write `others`, name -> text, at the same time."""
        assert self._rows is not None
        temporary = {file: file.with_name(f".{file.name}.{os.getpid()}") for file in others or {}}
        try:
            with naming(self.path):
                for file, text in (others or {}).items():
                    temporary[file].write_text(text, encoding="utf-8", newline="\n")
                self._rows.check_alone()
                complete.replace(self.path)
                for file, other in temporary.items():
                    other.replace(file)
                remove_partial(self.partial)
                self._rows = None
        finally:
            converted = {complete} - {self.partial}
            for other in (*temporary.values(), *converted):
                other.unlink(missing_ok=True)

    def close(self) -> None:
        """Write what is left into the partial file, and close it."""
        if self._rows is not None:
            with naming(self.partial):
                self._rows.close()


def rows_text(rows: Array) -> bytes:
    """Rows, shape (rows, columns), as lines of a CSV file."""
    text = None
    if rows.size >= MANY:
        from orchestrator.data import csv_text

        text = csv_text.rows_text(rows)
    return by_repr(rows) if text is None else text


def by_repr(rows: Array) -> bytes:
    """The same lines where the library of `csv_text` is missing, or takes longer to load."""
    return "".join([",".join(map(repr, row)) + "\n" for row in rows.tolist()]).encode()


class _Rows:
    """A CSV file: each value is the shortest decimal that is read back as the same float64."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self._path, self._size, self._digest = path, 0, hashlib.sha256()
        self._file = path.open("wb", buffering=0)
        self._identity = os.fstat(self._file.fileno()).st_ino
        self._write(f"{csv_header([TIME, *names])}\n".encode())

    def append(self, times: Array, values: Array) -> None:
        self._write(rows_text(np.column_stack([times, values])))

    def _write(self, data: bytes) -> None:
        """Write all bytes or none."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except BaseException:
            end = data.rfind(b"\n", 0, len(data) - len(rest)) + 1  # of the last row that fits
            self._size += end
            self._digest.update(data[:end])
            self._file.truncate(self._size)
            raise
        self._size += len(data)
        self._digest.update(data)

    @property
    def sha256(self) -> str:
        return self._digest.hexdigest()

    def close(self) -> None:
        self._file.close()

    def check_alone(self) -> None:
        if not self._path.is_file() or self._path.stat().st_ino != self._identity:
            raise Problem(f"{self._path}: another process has replaced or removed this file")


LONGEST_NAME = 63  # characters of a name in MATLAB
RESERVED = (TIME, "units", "run")  # variables of a MATLAB file that are no components
KEYWORDS = (  # of MATLAB
    *("break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global"),
    *("if", "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while"),
)


def matlab_names(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Signal -> fields of structs in a MATLAB file, such as ("swing", "swing_angle"); all differ."""
    paths: dict[str, tuple[str, ...]] = {}
    leaves, structs = set[tuple[str, ...]](), set[tuple[str, ...]]()
    for name in names:
        path = tuple(_matlab_name(part) for part in name.split("."))
        if path[0] in RESERVED:
            path = (f"{path[0]}_", *path[1:])
        stem, number = path, 1
        above = [path[:k] for k in range(1, len(path))]
        while path in leaves | structs or leaves & set(above):
            number += 1  # of a flat name
            path = (f"{'_'.join(stem)[: LONGEST_NAME - 5]}_{number}",)
            above = []
        leaves.add(path)
        structs |= set(above)
        paths[name] = path
    return paths


def _matlab_name(text: str) -> str:
    """A text as a name of MATLAB: ASCII letters, digits and underscores, beginning with a letter."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    if not name[:1].isalpha() or name in KEYWORDS:
        name = f"x{name}"
    return name[:LONGEST_NAME]


def _put(struct_: dict[str, Any], path: Sequence[str], value: Any) -> None:
    """Put a value into nested structs."""
    for field_ in path[:-1]:
        struct_ = struct_.setdefault(field_, {})
    struct_[path[-1]] = value


def read_origin(path: Path) -> str:
    """The JSON text about the run in a Parquet or MATLAB file; empty if there is none."""
    suffix = path.suffix.lower()
    if suffix == ".mat":
        run = read_variables(Location(path)).get("run")
        return run if isinstance(run, str) and '"master"' in run else ""
    if suffix != ".parquet" or not path.is_file():
        return ""
    import pyarrow.parquet as pq

    with foreign(path, "a Parquet"):
        return str((pq.read_schema(path).metadata or {}).get(ORIGIN.encode(), b"").decode())


def remove_partial(partial: Path) -> None:
    """Remove the partial file of an earlier run, its metadata, and what was being made of it."""
    for suffix in (METADATA_SUFFIX, *SUFFIXES):
        old = partial.with_suffix(suffix)
        if old.is_dir():  # as Parquet runs that were killed left it before
            raise Problem(f"{old}: expected no folder there: move it or remove it")
        old.unlink(missing_ok=True)


def write_trace(trace: Trace, path: str | Path, origin: str = "") -> Path:
    """Write a trace as .csv, .parquet or .mat; reading the file gives bit-identical values.

    origin   JSON text about the run, stored in Parquet and MATLAB files
    """
    file = TraceFile(path, origin)
    for name, values in trace.signals.items():
        if len(values) != len(trace.time):
            raise Problem(f"{path}: {name}: expected {len(trace.time)} values, got {len(values)}")
    try:
        units = {name: unit for name, unit in trace.units.items() if name in trace.signals}
        file.begin(RowLayout(tuple(trace.signals), units))
        columns = [trace.time, *trace.signals.values()]
        for first in range(0, len(trace.time), CHUNK):
            rows = np.column_stack([column[first : first + CHUNK] for column in columns])
            rows = rows.astype(np.float64, copy=False)  # a trace of whole numbers, too
            file.append(rows[:, 0], rows[:, 1:])
        file.publish(file.finish()[0])
    except BaseException:
        with suppress(Problem):
            file.close()
        remove_partial(file.partial)
        raise
    return Path(path)
