"""Traces: sampled signals over one time axis, read from and written to CSV and Parquet."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.errors import Problem, UnknownSignal
from orchestrator.files.archive import Location


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
    from orchestrator.files import tracefile

    file = path if isinstance(path, Location) else Location(Path(path))
    check_suffix(str(file))
    parse = tracefile.parse_csv if str(file).lower().endswith(".csv") else tracefile.parse_parquet
    return parse(file.read(), str(file))


def write(trace: Trace, path: str | Path) -> Path:
    """Write a trace as .csv or .parquet, by the suffix; reading it gives the same numbers, bit for bit."""
    from orchestrator.files import tracefile

    file = Path(path)
    check_suffix(file)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        (tracefile.write_csv if file.suffix.lower() == ".csv" else tracefile.write_parquet)(trace, file)
    except OSError as error:
        raise Problem(f"{file}: cannot be written: {error.strerror or error}") from error
    return file


def check_suffix(path: str | Path) -> None:
    """Refuse a file name whose format is unknown, before work is spent on it."""
    if Path(path).suffix.lower() not in (".csv", ".parquet"):
        raise Problem(f"{path}: expected a file name ending in .csv or .parquet")
