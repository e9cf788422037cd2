"""A recording: signals over one clock, the instruments that took them, what holds during the experiment.

`read_recording` reads samples (CSV, Parquet, MATLAB) and the TOML file of the same name that describes them,
and converts all to SI. What is identified from and what a run is compared with are both recordings;
`write_recording` writes a computed one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.units import parse, si_unit
from orchestrator.data.description import (
    Condition,
    Description,
    Origin,
    SignalDescription,
    Tolerance,
    read_description,
)
from orchestrator.data.table import SUFFIXES, Array, Columns, read_columns
from orchestrator.data.trace import Trace

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Sensor:
    """The instrument of one signal, numbers in the signal's SI unit.

    text         what it is
    noise        standard deviation of one sample, 0 if unknown
    resolution   step of the converter, 0 if unknown
    low, high    range; a value at an end is clipped
    dead_zone    magnitude below which it reads nothing useful, such as the slowest flow of a turbine
    """

    text: str = ""
    noise: float = 0.0
    resolution: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    dead_zone: float = 0.0

    @property
    def sd(self) -> float:
        """Standard deviation of one sample with the converter's: noise, and a step's width over sqrt(12)."""
        return math.hypot(self.noise, self.resolution / math.sqrt(12))


@dataclass(frozen=True)
class Criterion:
    """How a comparison shows and judges a signal.

    group       signals of one kind, such as angle, speed, pressure; they share a tolerance
    span        what NRMSE divides by instead of the range of the values, in the signal's unit
    tolerance   what to judge, None: shown but not judged
    """

    label: str = ""
    group: str = ""
    span: float | None = None
    tolerance: Tolerance | None = None


@dataclass(frozen=True)
class Recording:
    """Signals over one clock; those of a file are in SI units.

    source       the file
    time         shape (n,) [s], increasing
    signals      each of shape (n,); NaN where a sample is missing
    units        unit of each signal
    procedure    which experiment it is: "valve", "hose_resistance", ..., "machine"; "": none
    use          "train" or "test": what is fitted, what is held out
    conditions   what holds during the experiment: numbers in SI units, or words
    sensors      instrument of each signal, where known
    kind         where it comes from: "measurement", "simulation" or "published"
    file_units   unit of each signal as the file has it, for messages
    criteria     how a comparison shows and judges each signal
    start, stop  the window that counts [s]
    about        the table [reference] of its description: title, kind, origin, solver, date, change ...
    """

    source: Path
    time: Array
    signals: Mapping[str, Array]
    units: Mapping[str, str]
    title: str = ""
    procedure: str = ""
    use: str = "train"
    conditions: Mapping[str, float | str] = field(default_factory=dict)
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    kind: str = "measurement"
    file_units: Mapping[str, str] = field(default_factory=dict)
    criteria: Mapping[str, Criterion] = field(default_factory=dict)
    start: float = -math.inf
    stop: float = math.inf
    metadata: Mapping[str, str | float] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        """One signal, shape (n,)."""
        if name not in self.signals:
            raise Problem(
                f"{self.source}: signal {name} is missing, expected for {self.procedure or 'it'};"
                f" has {', '.join(self.signals)}"
            )
        return self.signals[name]

    @property
    def heading(self) -> str:
        """The title in its description, else the name of its file."""
        return str(self.metadata.get("title", self.source.name))

    def sensor(self, name: str) -> Sensor:
        """The instrument of a signal; one of which nothing is known if none is described."""
        return self.sensors.get(name, Sensor())

    def criterion(self, name: str) -> Criterion:
        """How a comparison shows and judges a signal."""
        return self.criteria.get(name, Criterion())

    def unit_label(self, name: str) -> str:
        """The unit of a signal as its file has it, and what it is in SI."""
        unit = self.units[name]
        own = self.file_units.get(name, unit)
        return unit if own == unit else f"{own} ({unit})"

    def numeric_condition(self, name: str) -> float:
        """A condition that is a number, in SI units."""
        value = self.conditions.get(name)
        if not isinstance(value, float):
            found = "nothing" if value is None else repr(value)
            raise Problem(f"{self.source}: experiment: {name}: expected a number with its unit, got {found}")
        return value

    def text_condition(self, name: str) -> str:
        """A condition that is a word."""
        value = self.conditions.get(name)
        if not isinstance(value, str):
            found = "nothing" if value is None else repr(value)
            raise Problem(f"{self.source}: experiment: {name}: expected a word, got {found}")
        return value

    def select(self, names: Sequence[str]) -> Recording:
        """The recording with only these signals."""
        return replace(self, signals={name: self[name] for name in names})

    def trace(self) -> Trace:
        """The signals with straight lines over gaps, held before the first and after the last sample."""
        signals = {}
        for name, values in self.signals.items():
            there = np.isfinite(values)
            if there.any():
                signals[name] = (
                    values if there.all() else np.interp(self.time, self.time[there], values[there])
                )
        return Trace(self.time, signals, {n: u for n, u in self.units.items() if n in signals})


def read_recording(path: Path | str, data: Path | str | None = None) -> Recording:
    """A file of samples with its description, whole: `start` and `stop` are noted.

    path   the samples, whose description has the same name with .toml, or the description itself
    data   the samples, when the description is one for many files
    """
    path = Path(path)
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise Problem(f"{path}: expected a .csv, .parquet, .mat or .toml file, got {found}")
    description_file = path if path.suffix == ".toml" else path.with_suffix(".toml")
    description = read_description(description_file)
    file = Path(data) if data else path if path != description_file else _data_file(path, description)
    column = {name: spec.column or name for name, spec in description.signals.items()}
    columns = read_columns(file, {description.time.column, *column.values()}, description.file)
    described = description.signals.items()
    conditions = {name: _condition(value) for name, value in description.experiment.items()}
    origin = description.reference
    about = {f.name: getattr(origin, f.name) for f in fields(origin)} | {
        "date": origin.date and str(origin.date)
    }
    return Recording(
        source=file,
        title=origin.title or file.stem,
        procedure=str(conditions.pop("procedure", "")),
        use=str(conditions.pop("use", "train")),
        conditions=conditions,
        time=_seconds(columns, description),
        signals={name: _in_si(columns.values[column[name]], spec) for name, spec in described},
        units={name: si_unit(spec.unit) for name, spec in described},
        sensors={name: sensor for name, spec in described if (sensor := _sensor(spec))},
        kind=origin.kind,
        file_units={name: spec.unit for name, spec in described},
        criteria={name: _criterion(spec, description) for name, spec in described},
        start=description.time.start,
        stop=description.time.stop,
        metadata={key: value for key, value in about.items() if value not in ("", None)},
    )


LONGEST_GAP = 0.1  # s: a hand takes longer from one position of a lever to another


def true_intervals(mask: Mask) -> list[slice]:
    """The runs of True of a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def fill_gaps(recording: Recording, name: str, longest: float = LONGEST_GAP) -> Array:
    """A signal that a simulation needs at every sample: straight lines over gaps of at most `longest` [s].

    Before its first sample and after its last one it keeps that value.
    """
    values, time = recording[name], recording.time
    there = np.isfinite(values)
    if not there.any():
        raise Problem(f"{recording.source}: {name} has no sample, expected one to simulate with")
    for gap in true_intervals(~there):
        first, last = max(gap.start - 1, 0), min(gap.stop, len(time) - 1)
        if time[last] - time[first] > longest:
            raise Problem(
                f"{recording.source}: {name} has no sample from {time[gap.start]:.6g} s to"
                f" {time[gap.stop - 1]:.6g} s, expected gaps of at most {longest:g} s:"
                " leave that part out with start or stop of [time]"
            )
    return np.interp(time, time[there], values[there])


def _data_file(path: Path, description: Description) -> Path:
    """The data file that belongs to a description."""
    if description.file.csv:
        return path.with_name(description.file.csv)
    there = [path.with_suffix(end) for end in SUFFIXES if path.with_suffix(end).is_file()]
    if len(there) != 1:
        found = ", ".join(file.name for file in there) or "none"
        raise Problem(f"{path}: expected one data file {path.stem}.csv, .parquet or .mat, got {found}")
    return there[0]


def _seconds(columns: Columns, description: Description) -> Array:
    """The clock in seconds; each row has a time, and later than the row before."""
    described = description.time
    raw = columns.values[described.column]
    for k in np.flatnonzero(np.isnan(raw))[:1]:
        raise Problem(f"{columns.location(k)}: column {described.column!r}: expected a time, got none")
    for k in np.flatnonzero(np.diff(raw) <= 0)[:1]:
        raise Problem(
            f"{columns.location(k + 1)}: column {described.column!r}:"
            f" expected increasing times, got {raw[k + 1]:.10g} after {raw[k]:.10g}"
        )
    time: Array = parse(described.unit).factor * raw + described.offset
    return time


def _in_si(values: Array, spec: SignalDescription) -> Array:
    """Values of a column in SI: calibrated first, in the stated unit."""
    scale = parse(spec.unit)
    result: Array = scale.factor * (spec.factor * values + spec.offset) + scale.offset
    return result


def _sensor(spec: SignalDescription) -> Sensor | None:
    """The instrument in SI, if one is described; a span has the unit's zero, the rest are differences."""
    scale = parse(spec.unit)
    low, high = spec.span or (-math.inf, math.inf)
    sensor = Sensor(
        text=spec.sensor,
        noise=scale.factor * spec.noise,
        resolution=scale.factor * spec.resolution,
        low=scale.factor * low + scale.offset,
        high=scale.factor * high + scale.offset,
        dead_zone=scale.factor * spec.dead_zone,
    )
    return None if sensor == Sensor() else sensor


def _criterion(spec: SignalDescription, description: Description) -> Criterion:
    """What a comparison needs, in SI."""
    factor = parse(spec.unit).factor
    tolerance = spec.tolerance_of(description.tolerances)
    return Criterion(
        label=spec.label,
        group=spec.group,
        span=None if spec.range is None else factor * spec.range,
        tolerance=None if tolerance is None else tolerance.scaled(factor),
    )


def _condition(value: str | Condition) -> str | float:
    """A word, or a number in SI."""
    if isinstance(value, str):
        return value
    scale = parse(value.unit)
    return float(scale.factor * value.value + scale.offset)


def write_recording(
    path: Path | str,
    trace: Trace,
    origin: Origin,
    tolerances: Mapping[str, Tolerance],
    groups: Mapping[str, str],
    labels: Mapping[str, str] | None = None,
    digits: int = 9,
) -> Path:
    """Write the signals of a computed trace to a CSV at `path`, and its description, whose path is returned.

    tolerances   group -> limit
    groups       signal -> group; a signal without one is stored, shown and not judged
    digits       significant digits in the CSV
    """
    if not origin.change.strip():
        raise Problem(f"{path}: expected the reason of this change of the reference, got none")
    table = Path(path)
    columns = np.column_stack([trace.time, *trace.signals.values()])
    head = ",".join(["time", *trace.signals])
    np.savetxt(table, columns, f"%.{digits}g", ",", header=head, comments="", encoding="utf-8")
    about = {f.name: getattr(origin, f.name) for f in fields(origin)}
    limits: dict[str, object] = dict(tolerances)
    limits |= dict.fromkeys(sorted(set(groups.values()) - set(tolerances)), "none")
    blocks = [_toml_table("reference", about), _toml_table("tolerances", limits)]
    for name in trace.signals:
        spec = {
            "unit": trace.units.get(name, "1"),
            "group": groups.get(name),
            "label": (labels or {}).get(name),
        }
        blocks.append(_toml_table(f"signals.{json.dumps(name, ensure_ascii=False)}", spec))
    description = table.with_suffix(".toml")
    description.write_text("\n".join(blocks), encoding="utf-8", newline="\n")
    return description


def _toml_table(head: str, values: Mapping[str, object]) -> str:
    """A table of a TOML file, without what is empty; the escapes of a JSON string are those of TOML."""
    lines = [f"[{head}]"]
    for key, value in values.items():
        name = key if key.isidentifier() else json.dumps(key, ensure_ascii=False)
        if isinstance(value, Tolerance):
            lines.append(f"{name} = {{ metric = {json.dumps(value.metric)}, limit = {value.limit!r} }}")
        elif value not in ("", None):
            shown = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else str(value)
            lines.append(f"{name} = {shown}")
    return "\n".join([*lines, ""])
