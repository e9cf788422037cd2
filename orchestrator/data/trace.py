"""Traces: signals over one time axis, of a run or for a scenario, in CSV, Parquet and MATLAB files.

CSV: a row of column names (time first), then rows of numbers with a decimal point, separated by commas.
Parquet: the same columns as float64, with units in the metadata of the fields.
MATLAB: a vector `time`, and vectors or structs of vectors; a run writes a struct `units`, too.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from math import isfinite
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any, Self, TypeAlias, TypedDict, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.base import extras
from orchestrator.base.errors import Problem, UnknownSignal
from orchestrator.base.files import Location, require, tell_once
from orchestrator.base.options import Time, seconds
from orchestrator.base.signals import completions, found, matching
from orchestrator.base.text import first_names
from orchestrator.base.units import parse_unit, si_unit
from orchestrator.data.description import Description, TimeDescription, description_next_to
from orchestrator.data.logger_files import CLOCK, logger_format
from orchestrator.data.table import (
    READABLE,
    SUFFIXES,
    Array,
    Columns,
    clock,
    read_columns,
    split_unit,
    time_axis,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from orchestrator.pages.figures import TraceFigure

TIME = "time"
METADATA_SUFFIX = ".run.json"  # of the metadata of the run next to its trace
JUMP = 1e-6  # s, in which signals go from one row to the next one with the same time
SAME_ROW = 4  # units in the last place of a time: rows of one event, whose time was computed twice
# Times are equal if they differ by this fraction of the interval between them and their neighbours, or in the
# last of these digits, which a text file may have, but never by more than the last fraction of an interval.
SAME_TIME, TIME_DIGITS, LARGEST_ROUNDING = 1e-6, 1e-9, 1e-3


def rounding(time: ArrayLike, interval: float) -> Array:
    """Largest difference of equal times [s], near a time [s], if other times are an interval [s] apart."""
    largest = np.abs(TIME_DIGITS * np.asarray(time, np.float64))
    return np.asarray(np.clip(largest, SAME_TIME * interval, LARGEST_ROUNDING * interval))


def inside(time: Array, start: float, stop: float) -> NDArray[np.bool_]:
    """Whether each of these increasing times [s] is in a window, or equal to its ends up to rounding."""
    margin = rounding(time, np.ptp(time) / (len(time) - 1)) if len(time) > 1 else 0.0
    return np.asarray((time >= start - margin) & (time <= stop + margin))


class Units(dict[str, str]):
    """Name -> unit of each signal that has one; as in a `Trace`, unique names may lack the component."""

    def __init__(self, units: Mapping[str, str] | Iterable[tuple[str, str]], signals: Iterable[str] = ()):
        """signals: names of all signals; the unit of one without a unit is empty."""
        super().__init__(units)
        self._signals = tuple(signals)

    def __missing__(self, name: str) -> str:
        return self.get(found(self._signals, name), "")


class FigureArguments(TypedDict, total=False):
    """Options of `Trace.figure`."""

    title: str
    start: Time
    stop: Time
    others: Mapping[str, Any] | None
    label: str
    band: Trace | None


@dataclass(frozen=True, repr=False, eq=False)
class Trace(Mapping[str, Array]):
    """Signals over a common, strictly increasing time axis, in SI units: a mapping of names to values.

    time      shape (n,) [s]
    signals   name -> shape (n,); the names in a run are `component.variable`
    units     name -> unit as written in the FMU or in the metadata of the file; empty without a unit; a name
              may lack the component here, too
    """

    time: NDArray[np.float64]
    signals: Mapping[str, NDArray[np.float64]]
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "units", Units(self.units, self.signals))

    @overload
    def __getitem__(self, key: str) -> Array: ...
    @overload
    def __getitem__(self, key: list[str] | tuple[str, ...]) -> Self: ...
    def __getitem__(self, key: str | list[str] | tuple[str, ...]) -> Array | Self:
        """The values of a signal, shape (n,); the trace with some signals, for a list of names and patterns.

        A name may lack the component if only one signal has it.
        """
        if isinstance(key, str):
            return self.signals[key if key in self.signals else self._only(key)]
        names = list(key) if isinstance(key, Iterable) else [key]
        for name in names:
            if not isinstance(name, str):
                raise UnknownSignal(name, self.signals, hint=", or a list of names and patterns")
        return self._with({name: self.signals[name] for name in (self.matching(names) if names else ())})

    def _only(self, variable: str) -> str:
        """The one signal of this variable; raises UnknownSignal."""
        matches = matching(self.signals, variable)
        if matches and not any(name.endswith(variable) for name in matches):
            hint = f'; a pattern goes in a list: result[["{variable}"]]'
            raise UnknownSignal(variable, self.signals, hint=hint)
        return found(self.signals, variable)

    def _with(self, signals: Mapping[str, Array], time: Array | None = None) -> Self:
        """Some of these signals with other samples, at these times."""
        units = {name: unit for name, unit in self.units.items() if name in signals}
        return replace(self, time=self.time if time is None else time, signals=signals, units=units)

    def __eq__(self, other: object) -> bool:
        """Equal times, signals and units; missing samples are equal."""
        if not isinstance(other, Trace):
            return NotImplemented
        same = [*self] == [*other] and self.units == other.units and np.array_equal(self.time, other.time)
        return same and all(np.array_equal(v, other.signals[n], equal_nan=True) for n, v in self.items())

    __hash__ = None  # type: ignore[assignment]

    def _ipython_key_completions_(self) -> list[str]:
        """What a console offers after `trace["`."""
        return completions(self.signals)

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __len__(self) -> int:
        return len(self.signals)

    def __repr__(self) -> str:
        return f"{type(self).__name__}: {self.extent}"

    @property
    def extent(self) -> str:
        """Number of samples and names of signals, in two lines."""
        times = f" from {self.time[0]:g} to {self.time[-1]:g} s" if len(self.time) else ""
        names = shorten(first_names(self), 200, placeholder=" ...")
        return f"{len(self)} signals at {len(self.time)} times{times}\nsignals: {names or 'none'}"

    def _repr_html_(self) -> str:
        from orchestrator.pages.plotting import small_figure

        return f"<pre>{escape(repr(self))}</pre>{small_figure(self.time, self.signals, self.units)}"

    def to_pandas(self) -> pd.DataFrame:
        """A data frame with a column for each signal, the time [s] as index, and `attrs["units"]`."""
        extras.require("files", "to_pandas()", "pandas")
        import pandas as pd

        frame = pd.DataFrame(dict(self.signals), index=pd.Index(self.time, name=TIME))
        frame.attrs["units"] = {name: self.units.get(name, "") for name in self}
        return frame

    def to_xarray(self) -> xr.Dataset:
        """A dataset with a variable for each signal over `time`, each with its unit in `attrs["units"]`."""
        return dataset(self.time, self.signals, self.units)

    def at(self, time: ArrayLike) -> Self:
        """The signals at other times [s], or at one: linear interpolation, constant beyond the samples."""
        times = np.atleast_1d(np.asarray(time, dtype=np.float64))
        return self._with({n: np.interp(times, self.time, v) for n, v in self.signals.items()}, times)

    def plot(self, *patterns: str | Sequence[str], **options: Unpack[FigureArguments]) -> Figure:
        """Draw signals over time as a matplotlib figure, one panel per unit, without showing or saving it.

        The arguments are those of `figure`.
        """
        from orchestrator.pages.plotting import draw

        return draw(self.figure(*patterns, **options))

    def figure(
        self,
        *patterns: str | Sequence[str],
        title: str = "",
        start: Time = None,
        stop: Time = None,
        others: Mapping[str, Any] | None = None,
        label: str = "",
        band: Trace | None = None,
    ) -> TraceFigure:
        """Signals over time, one panel per unit, for a page or a picture.

        patterns      names of signals with or without component, patterns such as `boom_*_pressure` or, with
                      a dot for component.variable, `swing.*`, or lists of them; default: up to six signals
                      of each of four quantities
        start, stop   time window [s]; default: all
        others        label -> further traces or results, with other line styles; `label`: that of this one
        band          half width of a band around signals of this trace, in their units
        """
        from orchestrator.pages.signal_figure import signal_figure

        flat = [name for p in patterns for name in ([p] if isinstance(p, str) else p)]
        runs = {label or "1": self} | {n: getattr(t, "trace", t) for n, t in (others or {}).items()}
        units = {n: u for trace in reversed(runs.values()) for n, u in trace.units.items()}
        windows = {name: trace.window(start, stop) for name, trace in runs.items()}
        names = windows[label or "1"].matching(flat)
        left_out = not flat and len(names) < len(self.signals)
        below = f"{len(names)} of {len(self.signals)} signals" if left_out else ""
        curves = {
            run: (trace.time, {n: trace.signals[n] for n in names if n in trace.signals})
            for run, trace in windows.items()
        }
        around = band.at(windows[label or "1"].time).signals if band else {}
        return signal_figure(curves, units, title, below, around)

    def matching(self, patterns: Sequence[str] = ()) -> list[str]:
        """The signals that names and patterns select, see `base.signals`; default: those of a figure.

        Raises Problem if a pattern names none.
        """
        if not patterns:
            from orchestrator.pages.signal_figure import default_signals

            return default_signals(self.signals, self.units)
        names: dict[str, None] = {}
        for pattern in patterns:
            names |= dict.fromkeys(matching(self.signals, pattern) or [self._only(pattern)])
        return list(names)

    def window(self, start: Time = None, stop: Time = None) -> Self:
        """The samples from `start` to `stop`, [s] or such as "2 s", at least two; default: all."""
        start, stop = seconds(start, "start"), seconds(stop, "stop")
        first, last = (-np.inf if start is None else start), (np.inf if stop is None else stop)
        chosen = inside(self.time, first, last)
        if len(self.time) and (start is not None or stop is not None) and chosen.sum() < 2:
            got = f"got {chosen.sum()}; the samples cover {self.time[0]:g} to {self.time[-1]:g} s"
            raise Problem(f"time window {first:g} to {last:g} s: expected two or more samples, {got}")
        if chosen.all():
            return self
        return self._with({n: v[chosen] for n, v in self.signals.items()}, self.time[chosen])

    def select(self, names: Iterable[str]) -> Self:
        """The trace with only these signals, in this order."""
        return self[list(names)]


# signals over time in memory; a function of the time [s] is evaluated at the times of the others
Data: TypeAlias = "Trace | Mapping[str, ArrayLike | Callable[[float], float]] | NDArray[Any] | pd.DataFrame"


def as_trace(data: Data, name: str = "data") -> Trace:
    """A trace from columns: a mapping, pandas DataFrame or structured array with a column `time` [s].

    The index of a DataFrame can be the time instead, if it is named `time`. Raises Problem, beginning with
    `name`, for columns of different lengths, times that do not increase, and values that are no numbers.
    Rows of one time: see `read_trace`.
    """
    if isinstance(data, Trace):
        return data
    table: Any = data
    if isinstance(data, np.ndarray) and data.dtype.names:  # as FMPy takes inputs and returns results
        table = {column: data[column] for column in data.dtype.names}
    if TIME not in table and getattr(getattr(table, "index", None), "name", None) == TIME:
        table = table.reset_index()
    if TIME not in table:
        raise Problem(f"{name}: expected a column {TIME!r} [s], got {first_names(map(str, table)) or 'none'}")
    values = dict[str, Array]()
    for column in [TIME, *(c for c in table if c != TIME)]:
        try:
            samples = table[column]
            if callable(samples):
                samples = [samples(float(t)) for t in values[TIME]]
            values[str(column)] = np.atleast_1d(np.asarray(samples, dtype=np.float64))
        except (TypeError, ValueError) as error:
            raise Problem(f"{name}: column {column!r}: expected numbers: {error}") from None
    for column, samples in values.items():
        if samples.shape != (expected := values[TIME].shape) or samples.ndim != 1:
            told = f"expected a vector of one number for each time, got shape {samples.shape}"
            raise Problem(f"{name}: column {column!r}: {told}, and {expected} of the time")
    return checked(Columns(name, values, range(1, 1 + len(values[TIME]))).finite())


def dataset(
    time: Array,
    signals: Mapping[str, Array],
    units: Mapping[str, str],
    machines: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """An xarray dataset of signals, shape (n,), or (machines, n) with data of the `machines`."""
    try:
        import xarray as xr
    except ImportError:
        raise Problem("to_xarray() needs the package xarray; install with: pip install xarray") from None
    over = (TIME,) if machines is None else ("machine", TIME)
    values = {name: (over, samples, {"units": units.get(name, "")}) for name, samples in signals.items()}
    about = {name: ("machine", each) for name, each in (machines or {}).items()}
    return xr.Dataset(values, {TIME: (TIME, time, {"units": "s"}), **about})


def read_trace(path: str | Path | Location) -> Trace:
    """Read a trace from a .csv, .parquet, .mat, .mf4 or .tdms file, on disk or inside an archive.

    A description next to it, NAME.toml, holds; short gaps of signals that it describes are filled. Columns
    of a text file with units are converted to SI units.

    Two rows at one time are the limits from the left and from the right: the first one is moved 1 us back, or
    to the middle of a shorter interval, and left out at the beginning. Rows between them are left out.
    """
    file = path if isinstance(path, Location) else Location(require(path, READABLE))
    if Path(str(file)).suffix.lower() not in READABLE and not logger_format(file):
        check_suffix(str(file))
    description = None if file.members else description_next_to(file.path)
    if description and description.signals:
        from orchestrator.data.recording import read_recording

        recording = read_recording(file.path)
        for fault in recording.log_faults():
            tell_once(fault)
        return recording.filled()
    return trace_of(file, description)


def trace_of(
    file: Location, description: Description | None, gaps: bool = False, sort: bool = False
) -> Trace:
    """All columns of a file as a trace; its description has no signals.

    gaps   NaN is allowed
    sort   rows may be out of order: they are sorted, and of those at one time the last counts
    """
    columns = read_columns(file, None, description.file if description else None, lenient=gaps)
    for fault in columns.faults.values():
        tell_once(f"{fault}; left out")
    time = description.time if description else TimeDescription()
    written = not file.members and file.path.with_suffix(METADATA_SUFFIX).is_file()  # by a run
    in_si = _in_si(columns, time, named=description is not None, of_text=not written)
    trace = checked(_sorted(in_si) if sort else in_si, gaps)
    trace = trace.window(*(limit if isfinite(limit) else None for limit in (time.start, time.stop)))
    return trace if file.members or trace.units else replace(trace, units=units_of_run(file.path, trace))


def _sorted(columns: Columns) -> Columns:
    """The rows in the order of their times, the last one of each time, with a line about the others."""
    time = columns.values[TIME]
    if not (np.diff(time) <= 0).any():
        return columns
    _, last = np.unique(time[::-1], return_index=True)  # sorted; the first one from behind
    order = len(time) - 1 - last
    late, double = int((np.diff(time) < 0).sum()), len(time) - len(order)
    found = f"rows are out of order {late} times and {double} times double"
    tell_once(f"{columns.file}: {found}; they are sorted")
    values = {name: column[order] for name, column in columns.values.items()}
    return replace(columns, values=values, rows=[int(columns.rows[k]) for k in order])


def _in_si(columns: Columns, time: TimeDescription, named: bool, of_text: bool) -> Columns:
    """The columns of a trace: the time in seconds, and those of a text file without units in their names.

    named     whether the description names the time column, which else is the first one
    of_text   whether names of a text file may have units
    """
    is_text = columns.row_word != "row"  # or a file of a logger
    bare = {c: split_unit(c)[0] if is_text and of_text else c for c in columns.values}
    first, *_ = bare
    if first != TIME and (steady := clock(columns)) and is_text:
        first = steady
    if named or columns.file.lower().endswith(".mat"):  # its variables have no order
        first = next((c for c in bare if time.column in (c, bare[c])), first)
    hint = f"; column of [time] in {Path(columns.file).with_suffix('.toml').name} can name another"
    if first != next(iter(bare)) and time.column not in (first, bare[first]):
        tell_once(f"{columns.file}: the time is {first!r}{hint}")
    if time.column not in (first, bare[first]) and not CLOCK.match(first):
        where = "line 1: " if columns.row_word == "line" else ""
        expected = f"{where}expected the first column to be named {time.column!r}, got {first!r}"
        raise Problem(f"{columns.file}: {expected}{hint}")
    values = {TIME: time_axis(columns, first, time.unit, time.offset)}
    units = {} if is_text else dict(columns.units)
    for column, name in ((c, n) for c, n in bare.items() if c != first and c not in columns.moments):
        if name in values:
            raise Problem(f"{columns.file}: expected the column {name!r} once, got it with two units")
        values[name] = columns.values[column]
        if is_text and of_text and (unit := columns.units.get(column)):
            scale = parse_unit(unit, f"{columns.file}: column {column!r}")
            with np.errstate(over="ignore"):  # 1e308 bar are inf, as 1e309 would be
                values[name], units[name] = scale.factor * values[name] + scale.offset, si_unit(unit)
    return replace(columns, values=values, units=units)


def units_of_run(file: Path, signals: Collection[str]) -> Mapping[str, str]:
    """Units of signals in the metadata next to the file of a trace, if they are those of this file."""
    try:
        metadata = json.loads(Location(file.with_suffix(METADATA_SUFFIX)).text())
        written = Location(file).sha256 == metadata["sha256"]
        return {n: str(u) for n, u in metadata["units"].items() if n in signals} if written else {}
    except (Problem, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}


def checked(columns: Columns, gaps: bool = False) -> Trace:
    """The trace; refuses times that do not increase and, without `gaps`, missing samples and rows."""
    time, rows = columns.values[TIME].copy(), np.asarray(columns.rows)
    for k in np.flatnonzero(np.diff(rows) > 1)[: not gaps]:
        row = f"{columns.file}: {columns.row_word} {rows[k] + 1}"
        raise Problem(f"{row}: expected {len(columns.values)} cells, got an empty row")
    for name, values in columns.values.items():
        if (missing := np.isnan(values)).any() and not (gaps and name != TIME):
            location = columns.location(int(missing.argmax()))
            raise Problem(f"{location}: column {name!r}: expected a number, got none")
    steps = np.diff(time)
    equal = np.abs(steps) <= SAME_ROW * np.spacing(np.abs(time[1:]))
    for k in np.flatnonzero((steps <= 0) & (~equal | equal.all()))[:1]:
        raise Problem(f"{columns.location(k + 1)}: expected a time after {time[k]!s} s, got {time[k + 1]!s}")
    has_earlier, has_later = np.append(False, equal), np.append(equal, False)  # rows of the same time
    for k in np.flatnonzero(has_earlier & has_later)[:1]:
        tell_once(f"{columns.location(k)}: of more than two rows at one time the first and the last are read")
    for k in np.flatnonzero(has_later & ~has_earlier):
        time[k] -= min(JUMP, (time[k] - time[k - 1]) / 2) if k else JUMP
    kept = np.flatnonzero(~(has_earlier & has_later))[int(equal[:1].any()) :]
    time, steps = time[kept], np.diff(time[kept])
    if (gap := None if gaps else _gap(steps[:-1])) is not None:  # the last row may hold a value for long
        expected = f"a sample every {np.median(steps):.6g} s"
        interval = f"between {time[gap]!s} and {time[gap + 1]!s} s"
        raise Problem(f"{columns.location(kept[gap + 1])}: expected {expected}, got none {interval}")
    signals = {name: values[kept] for name, values in columns.values.items() if name != TIME}
    return Trace(time, signals, {n: u for n, u in columns.units.items() if n in signals})


def check_suffix(path: str | Path) -> None:
    """Refuse a file name with an unknown suffix, before the computation starts."""
    if Path(path).suffix.lower() not in SUFFIXES:
        raise Problem(f"{path}: expected a file name ending in .csv, .parquet or .mat")


def _gap(steps: NDArray[np.float64]) -> int | None:
    """Index of the first interval in which rows of a uniformly sampled file are missing, or None.

    In a uniformly sampled file nearly all intervals are equal and the others are integer multiples of them.
    Other files are regarded as irregularly sampled.
    """
    if len(steps) < 20:
        return None
    ratio = steps / np.median(steps)
    multiple = np.rint(ratio)
    if np.abs(ratio - multiple).max() > 1e-3 or np.mean(multiple == 1) < 0.98:
        return None
    return int(np.argmax(multiple > 1)) if multiple.max() > 1 else None
