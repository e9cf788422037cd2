"""Traces: signals over one time axis, recorded by a run or used as a scenario, in CSV and Parquet files.

CSV: a row of column names (time first), then rows of numbers with a decimal point, separated by commas.
Parquet: the same columns as float64, with units in the metadata of the fields.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.base.errors import Problem, UnknownSignal
from orchestrator.base.files import Location
from orchestrator.data.table import Columns, read_columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIME = "time"


@dataclass(frozen=True)
class Trace:
    """Signals over a common, strictly increasing time axis, in SI units.

    time      shape (n,) [s]
    signals   name -> shape (n,); the names in a run are `component.variable`
    units     name -> unit as written in the FMU or in the metadata of the file; empty without a unit
    """

    time: NDArray[np.float64]
    signals: Mapping[str, NDArray[np.float64]]
    units: Mapping[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        if name not in self.signals:
            raise UnknownSignal(name, self.signals)
        return self.signals[name]

    def at(self, time: ArrayLike) -> Trace:
        """The signals at other times [s]: linear interpolation, constant before and after the samples."""
        times = np.asarray(time, dtype=np.float64)
        return Trace(times, {n: np.interp(times, self.time, v) for n, v in self.signals.items()}, self.units)

    def plot(self, *patterns: str, title: str = "") -> Figure:
        """Draw signals over time as a matplotlib figure, one panel per unit, without showing or saving it.

        patterns   names of signals, or patterns such as `*.swing_pressure_*`; default: all signals
        """
        from orchestrator.base.plotting import plot_signals

        names: dict[str, None] = {}
        for pattern in patterns or self.signals:
            matches = [pattern] if pattern in self.signals else fnmatch.filter(self.signals, pattern)
            names |= dict.fromkeys(matches or [pattern])
        return plot_signals(self.time, self.select(names).signals, self.units, title)

    def select(self, names: Iterable[str]) -> Trace:
        """The trace with only these signals, in this order."""
        signals = {name: self[name] for name in names}
        return Trace(self.time, signals, {n: u for n, u in self.units.items() if n in signals})


def read_trace(path: str | Path | Location) -> Trace:
    """Read a trace from a .csv or .parquet file, on disk or inside an archive."""
    file = path if isinstance(path, Location) else Location(Path(path))
    check_suffix(str(file))
    columns = read_columns(file, None)
    first = next(iter(columns.values))
    if first != TIME:
        raise Problem(f"{file}: line 1: expected the first column to be named {TIME!r}, got {first!r}")
    _check_samples(columns)
    signals = {name: values for name, values in columns.values.items() if name != TIME}
    return Trace(columns.values[TIME], signals, {n: u for n, u in columns.units.items() if n in signals})


def _check_samples(columns: Columns) -> None:
    """Refuse empty rows, missing samples, times that do not increase, and missing rows."""
    time, rows = columns.values[TIME], np.asarray(columns.rows)
    for k in np.flatnonzero(np.diff(rows) > 1)[:1]:
        row = f"{columns.file}: {columns.row_word} {rows[k] + 1}"
        raise Problem(f"{row}: expected {len(columns.values)} cells, got an empty row")
    for name, values in columns.values.items():
        if (missing := np.isnan(values)).any():
            raise Problem(
                f"{columns.location(int(missing.argmax()))}: column {name!r}: expected a number, got none"
            )
    steps = np.diff(time)
    for k in np.flatnonzero(steps <= 0)[:1]:
        raise Problem(f"{columns.location(k + 1)}: expected a time after {time[k]!s} s, got {time[k + 1]!s}")
    if (gap := _gap(steps)) is not None:
        expected = f"a sample every {np.median(steps):.6g} s"
        interval = f"between {time[gap]!s} and {time[gap + 1]!s} s"
        raise Problem(f"{columns.location(gap + 1)}: expected {expected}, got none {interval}")


def check_suffix(path: str | Path) -> None:
    """Refuse a file name with an unknown suffix, before the computation starts."""
    if Path(path).suffix.lower() not in (".csv", ".parquet"):
        raise Problem(f"{path}: expected a file name ending in .csv or .parquet")


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


read = read_trace  # name in 0.1
