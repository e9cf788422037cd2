"""Recordings: signals over one time axis in SI units, with instruments and conditions of the experiment.

`read_recording` reads samples (CSV, Parquet, MATLAB) and the TOML file of the same name that describes them,
and converts the values to SI units. Measurements for the identification and references for the validation
are both recordings. `write_recording` writes a computed recording.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from orchestrator.base import toml
from orchestrator.base.errors import Problem, UnknownSignal
from orchestrator.base.files import Location, require, tell_once, write_columns
from orchestrator.base.units import convert, is_unit, number_and_unit, parse_unit, si_unit
from orchestrator.data.corrections import corrected, log_faults, rate_faults, unwrapping
from orchestrator.data.description import (
    Condition,
    Description,
    Origin,
    SignalDescription,
    Tolerance,
    read_description,
    write_description,
)
from orchestrator.data.table import READABLE, Array, Columns, read_columns, time_axis
from orchestrator.data.trace import TIME, Trace, checked, inside, trace_of

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Sensor:
    """The instrument of one signal; values in the SI unit of the signal.

    text         description of the instrument
    noise        standard deviation of one sample, 0 if unknown
    resolution   step of the converter, 0 if unknown
    low, high    range; a value at a limit is clipped
    dead_zone    magnitude below which readings are not valid, such as the smallest flow of a turbine meter
    zero_error   largest error of the zero, of a data sheet; None if unknown
    delay_error  largest error of the times of its samples [s], 0 if they are right
    """

    text: str = ""
    noise: float = 0.0
    resolution: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    dead_zone: float = 0.0
    zero_error: float | None = None
    delay_error: float = 0.0

    @property
    def sd(self) -> float:
        """Standard deviation of one sample: noise, and the quantisation error resolution / sqrt(12)."""
        return math.hypot(self.noise, self.resolution / math.sqrt(12))


@dataclass(frozen=True)
class Criterion:
    """Presentation and limit of a signal in a comparison.

    group       quantity such as angle, speed or pressure; signals of a group share a tolerance
    span        divisor of the NRMSE instead of the range of the values, in the unit of the signal
    floor       smallest divisor of the NRMSE otherwise, in the unit of the run
    tolerance   limit; None: the signal is shown without a verdict
    """

    label: str = ""
    group: str = ""
    span: float | None = None
    tolerance: Tolerance | None = None
    floor: float = 0.0


class MissingSignal(UnknownSignal):
    """A signal that a recording lacks."""

    def __init__(self, message: str) -> None:
        Problem.__init__(self, message)


@dataclass(frozen=True, repr=False)
class Recording(Trace):
    """A trace with gaps, instruments and conditions of the experiment; read from a file it is in SI units.

    signals      each of shape (n,); NaN for a missing sample
    source       the file
    procedure    the experiment: "valve", "hose_resistance", ..., "machine"; "": none
    use          "train" for the fit, "test" for the validation of the fit
    conditions   constants of the experiment: values in SI units, or texts
    sensors      known instruments by signal
    kind         "measurement", "simulation" or "published"
    file_units   unit of each signal in the file, for messages
    criteria     presentation and limit of each signal in a comparison
    start, stop  limits of the evaluated window [s]
    metadata     the table [reference] of the description: title, kind, origin, solver, date, change ...
    description  the TOML file that describes the columns, if there is one
    faults       signal -> what its logger has probably done, see `log_faults`
    """

    source: Path = Path("recording")
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
    description: Path | None = None
    faults: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def _only(self, variable: str) -> NoReturn:
        """A recording has no short names."""
        purpose = f" for {self.procedure}" if self.procedure else ""
        got = ", ".join(self.signals)
        raise MissingSignal(f"{self.source}: expected the signal {variable}{purpose}, got {got}")

    def __repr__(self) -> str:
        return f"Recording {self.source.name}: {self.extent}"

    @property
    def heading(self) -> str:
        """The title in the description, or else the name of the file."""
        return str(self.metadata.get("title", self.source.name))

    def place(self, name: str) -> str:
        """File and table with the unit of a signal, as the beginning of a message."""
        if self.description:
            return f"{self.description}: signals.{toml.quote_key(name)}"
        return f"{self.source}: {name}"

    def log_faults(self) -> Iterator[str]:
        """A line for each fault of the logger."""
        found = [(name, fault) for name in self for fault in self.faults.get(name, ())]
        rates = rate_faults(self.time, self.signals, self.units)
        yield from (f"{self.source}: {name}: {fault}" for name, fault in (*found, *rates))

    def sensor(self, name: str) -> Sensor:
        """The instrument of a signal; without properties if the description contains none."""
        return self.sensors.get(name, Sensor())

    def criterion(self, name: str) -> Criterion:
        """Presentation and limit of a signal in a comparison."""
        return self.criteria.get(name, Criterion())

    @cached_property
    def unlisted(self) -> frozenset[str]:
        """Signals without label of a computed reference in which others have one.

        They are judged, but not listed while they pass, and left out where a run lacks them.
        """
        labelled = {name for name in self.signals if self.criterion(name).label}
        computed = self.kind == "simulation" and bool(labelled)
        return frozenset(self.signals.keys() - labelled if computed else ())

    def peak(self, name: str) -> tuple[float, str]:
        """The largest magnitude of a signal, 0 without samples, in the unit of the file; this unit."""
        unit = self.file_units.get(name, self.units[name])
        values = convert(self[name], self.units[name], unit, f"{self.source}: {name}")
        return float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values))), unit

    def unit_label(self, name: str) -> str:
        """The unit of a signal in the file, with the SI unit if it differs."""
        unit = self.units[name]
        file_unit = self.file_units.get(name, unit)
        return unit if file_unit == unit else f"{file_unit} ({unit})"

    def numeric_condition(self, name: str) -> float:
        """The value of a numeric condition, in SI units."""
        value = self.conditions.get(name)
        if isinstance(value, float):
            return value
        got = "nothing" if value is None else repr(value)
        raise Problem(f"{self.source}: experiment: {name}: expected a number with its unit, got {got}")

    def interpolated(self, name: str) -> Array:
        """A signal, linear over gaps and constant before its first and after its last sample; else zeros."""
        values, valid = self[name], np.isfinite(self[name])
        if valid.all():
            return values
        return np.interp(self.time, self.time[valid], values[valid]) if valid.any() else np.zeros_like(values)

    def without_gaps(self) -> Recording:
        """The recording with all signals interpolated; those without any sample are left out."""
        return self._with({n: self.interpolated(n) for n, v in self.signals.items() if np.isfinite(v).any()})

    def filled(self) -> Trace:
        """The samples of the window for a simulation, see `fill_gaps`."""
        chosen = inside(self.time, self.start, self.stop)
        part = self._with({name: values[chosen] for name, values in self.items()}, self.time[chosen])
        return Trace(part.time, {name: fill_gaps(part, name) for name in part}, part.units)


def read_recording(path: Path | str, data: Path | str | None = None) -> Recording:
    """Read all samples of a file with its description; `start` and `stop` are stored, not applied.

    Without a description, or one of signals, all columns are signals.

    path   the samples, whose description has the same name with .toml, or the description
    data   the samples, if one description is used for many files
    """
    path = require(path, (".toml", *READABLE))
    if path.is_dir():
        raise Problem(f"{path}: expected a .csv, .parquet, .mat or .toml file, got a folder")
    description_file = path if path.suffix == ".toml" else path.with_suffix(".toml")
    is_described = path == description_file or description_file.is_file()
    description = read_description(description_file) if is_described else Description()
    file = Path(data) if data else path if path != description_file else _data_file(path, description)
    if not description.signals:
        trace = trace_of(Location(file), description, gaps=True)
        return Recording(
            *(trace.time, trace.signals, trace.units, file, file.stem),
            file_units=trace.units,
            metadata={"kind": "measurement"},
        )
    column = {name: spec.column or name for name, spec in description.signals.items()}
    columns = read_columns(file, {description.time.column, *column.values()}, description.file)
    specs = [
        (name, replace(spec, unit=spec.unit or columns.units.get(column[name], "")))
        for name, spec in description.signals.items()
    ]
    for name, spec in specs:
        if not spec.unit:
            where = f"{description_file}: signals.{toml.quote_key(name)}"
            raise Problem(f"{where}: unit: expected a text, got nothing")
        # a calibrated column may have another unit than in the file
        unit = columns.units.get(column[name], spec.unit) if spec.factor == 1 else spec.unit
        if is_unit(unit) and parse_unit(unit) != parse_unit(spec.unit):
            told = f"in {unit}, but read in {spec.unit}, as {description_file.name} states"
            tell_once(f"{file}: column {column[name]!r}: {told}")
    if description.experiment:  # angles of a machine have no end; the output of another system may wrap
        specs = [(n, unwrapping(columns.values[column[n]], s, f"{file}: {n}")) for n, s in specs]
    stated = description.experiment.items()
    conditions = {n: x if n in WORDS and isinstance(x, str) else _condition(x) for n, x in stated}
    time = _seconds(columns, description)
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    signals = {n: _si(corrected(columns.values[column[n]], time, s), s.unit) for n, s in specs}
    if not description.experiment:  # rows of one event are apart, as in a trace
        trace = checked(replace(columns, values={TIME: time, **signals}, units={}), gaps=True)
        time, signals = trace.time, dict(trace.signals)
    origin = description.reference
    about = vars(origin) | {"date": origin.date and str(origin.date)}
    return Recording(
        source=file,
        title=origin.title or file.stem,
        procedure=str(conditions.pop("procedure", "")),
        use=str(conditions.pop("use", "train")),
        conditions=conditions,
        time=time,
        signals=signals,
        units={name: si_unit(spec.unit) for name, spec in specs},
        sensors={name: sensor for name, spec in specs if (sensor := _sensor(spec))},
        kind=origin.kind,
        file_units={name: spec.unit for name, spec in specs},
        criteria={name: _criterion(spec, description) for name, spec in specs},
        start=description.time.start,
        stop=description.time.stop,
        metadata={key: value for key, value in about.items() if value not in ("", None)},
        description=description_file,
        faults={name: [*log_faults(columns.values[column[name]], spec, step)] for name, spec in specs},
    )


LONGEST_GAP = 0.1  # [s]; an operator needs longer to move a lever
WORDS = ("procedure", "use", "note")  # keys of [experiment] that are texts, also if they look like a number
OUTSIDE = 0.05  # of the span, beyond its ends; the noise of a sensor is smaller


def true_intervals(mask: Mask) -> list[slice]:
    """The intervals in which a mask is True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def fill_gaps(recording: Recording, name: str) -> Array:
    """A signal for a simulation, interpolated over gaps of at most `LONGEST_GAP`.

    Samples far outside the span of the sensor are gaps, such as error codes of a bus.
    """
    sensor, time = recording.sensor(name), recording.time
    margin = OUTSIDE * (sensor.high - sensor.low)
    inside = (recording[name] >= sensor.low - margin) & (recording[name] <= sensor.high + margin)
    recording = recording._with({name: np.where(inside, recording[name], np.nan)})
    valid = np.isfinite(recording[name])
    if not valid.any():
        raise Problem(f"{recording.source}: {name}: expected a sample to simulate with, got none")
    for gap in true_intervals(~valid):
        first, last = max(gap.start - 1, 0), min(gap.stop, len(time) - 1)
        if time[last] - time[first] > LONGEST_GAP:
            got = f"got one from {time[gap.start]:.6g} s to {time[gap.stop - 1]:.6g} s"
            expected = f"expected gaps of at most {LONGEST_GAP:g} s"
            hint = "leave that part out with start or stop of [time]"
            raise Problem(f"{recording.source}: {name}: {expected}, {got}: {hint}")
    return recording.interpolated(name)


def _data_file(path: Path, description: Description) -> Path:
    """The data file that belongs to a description."""
    if description.file.csv:
        return path.with_name(description.file.csv)
    files = [path.with_suffix(suffix) for suffix in READABLE if path.with_suffix(suffix).is_file()]
    if len(files) != 1:
        got = ", ".join(file.name for file in files) or "none"
        raise Problem(f"{path}: expected one data file {path.stem}.csv, .parquet or .mat, got {got}")
    return files[0]


def _seconds(columns: Columns, description: Description) -> Array:
    """The time column in seconds; refuse missing times, and equal ones of an experiment."""
    spec = description.time
    raw = columns.values[spec.column]
    for k in np.flatnonzero(np.isnan(raw))[:1]:
        raise Problem(f"{columns.location(k)}: column {spec.column!r}: expected a time, got none")
    steps = np.diff(raw)
    for k in np.flatnonzero((steps < 0) | ((steps == 0) & bool(description.experiment)))[:1]:
        got, where = f"{raw[k + 1]:.10g} after {raw[k]:.10g}", columns.location(k + 1)
        raise Problem(f"{where}: column {spec.column!r}: expected increasing times, got {got}")
    return time_axis(columns, spec.column, spec.unit, spec.offset)


def _condition(value: str | Condition) -> float | str:
    """A condition in SI units: a table with value and unit, a text such as "870 kg/m3", or any other text."""
    if isinstance(value, str):
        number, unit = number_and_unit(value)
        return float(_si(float(number), unit)) if unit and is_unit(unit) else value
    return float(_si(value.value, value.unit))


def _si(value: Any, unit: str) -> Any:
    """A number or an array in SI units."""
    scale = parse_unit(unit)
    return scale.factor * value + scale.offset


def _sensor(spec: SignalDescription) -> Sensor | None:
    """The instrument in SI units, None if none is described; only the span is subject to a unit's offset."""
    factor = parse_unit(spec.unit).factor
    low, high = (_si(limit, spec.unit) for limit in spec.span or (-math.inf, math.inf))
    sizes = {name: getattr(spec, name) for name in ("noise", "resolution", "dead_zone", "zero_error")}
    sizes = {name: size and factor * size for name, size in sizes.items()}
    sensor = Sensor(text=spec.sensor, low=low, high=high, delay_error=spec.delay_error, **sizes)
    return None if sensor == Sensor() else sensor


def _criterion(spec: SignalDescription, description: Description) -> Criterion:
    """Presentation and limit in a comparison, in SI units."""
    factor, tolerance = parse_unit(spec.unit).factor, spec.tolerance_of(description.tolerances)
    return Criterion(
        label=spec.label,
        group=spec.group,
        span=spec.range and factor * spec.range,
        tolerance=tolerance and tolerance.scaled(factor),
    )


def write_recording(
    path: Path | str,
    trace: Trace,
    origin: Origin,
    tolerances: Mapping[str, Tolerance],
    groups: Mapping[str, str],
    labels: Mapping[str, str] | None = None,
    digits: int = 9,
) -> Path:
    """Write the signals of a computed trace to the CSV file `path`, and its description; return its path.

    tolerances   group -> limit
    groups       signal -> group; a signal without a group has no limit
    digits       significant digits in the CSV file
    """
    if not origin.change.strip():
        raise Problem(f"{path}: expected the reason of this change of the reference, got none")
    csv = Path(path)
    rows = np.column_stack([trace.time, *trace.signals.values()])
    write_columns(csv, ["time", *trace.signals], rows, digits)
    units, labels = trace.units, labels or {}
    signals = {
        n: SignalDescription(unit=units.get(n, "1"), group=groups.get(n, ""), label=labels.get(n, ""))
        for n in trace.signals
    }
    limits: dict[str, Tolerance | Literal["none"]] = dict.fromkeys(sorted(groups.values()), "none")
    description = csv.with_suffix(".toml")
    write_description(description, Description(signals, origin, tolerances=limits | dict(tolerances)))
    return description
