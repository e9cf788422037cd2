"""The TOML file that describes sampled data: columns, instruments, experiment, limits of a comparison.

`harvester identify` reads recordings of a test rig or a machine in this format, `harvester validate` reads
reference traces. The dataclasses below are the tables of the file. docs/recordings.md describes the keys.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from datetime import date as Date
from pathlib import Path
from typing import Annotated, Any, Literal

from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.files import write_whole
from orchestrator.base.toml import NOT_NEGATIVE, POSITIVE, Rule
from orchestrator.base.units import parse_unit
from orchestrator.data.table import TextFormat

# `maximum` and `rmse` are in the unit of the signal, `fit` and `vaf` in percent, the others are
# dimensionless. orchestrator/results/metrics.py contains the formulas. `iso` is an old name of `iso18571`.
Metric = Literal["nrmse", "rmse", "maximum", "maximum_relative", "fit", "vaf", "iso18571", "iso"]


@dataclass(frozen=True)
class Tolerance:
    """A limit on a metric: upper limit for errors, lower limit for fit, VAF and ISO/TS 18571."""

    metric: Metric
    limit: Annotated[float, POSITIVE]

    def __post_init__(self) -> None:
        if self.metric == "iso":
            object.__setattr__(self, "metric", "iso18571")

    @property
    def upper(self) -> bool:
        """True for an upper limit, False for a lower limit."""
        return self.metric not in ("fit", "vaf", "iso18571")

    @property
    def in_unit(self) -> bool:
        """True if the limit is in the unit of the signal."""
        return self.metric in ("rmse", "maximum")

    def scaled(self, factor: float) -> Tolerance:
        """The same limit for a signal in another unit."""
        return replace(self, limit=self.limit * factor) if self.in_unit else self

    def fraction_used(self, value: float | None) -> float:
        """The fraction of the limit that a value uses: 1 at the limit, more if the value fails."""
        if value is None:
            return float("inf")
        if self.upper:
            return value / self.limit
        best = 1.0 if self.metric == "iso18571" else 100.0
        return (best - value) / (best - self.limit) if self.limit < best else float(value < self.limit)

    def holds(self, value: float | None) -> bool:
        """True if a value of the metric is within the limit; False for None, an undefined value."""
        if value is None:
            return False
        return value <= self.limit if self.upper else value >= self.limit


@dataclass(frozen=True)
class Origin:
    """Origin of the samples: the table [reference]."""

    title: str = ""
    kind: Literal["simulation", "measurement", "published"] = "measurement"
    origin: str = ""
    made_by: str = ""
    solver: str = ""
    relative_tolerance: float | None = None
    absolute_tolerance: float | None = None
    date: Date | None = None
    change: str = ""
    note: str = ""


# Keys of [reference] that each kind requires. A computed trace must be reproducible.
REQUIRED_KEYS = {
    "simulation": ("title", "origin", "made_by", "solver", "relative_tolerance", "date", "change"),
    "published": ("title", "origin", "date", "change"),
    "measurement": (),
}
OTHERS = {"system", "parameters"}  # keys of other .toml files: studies and parameter sets


@dataclass(frozen=True)
class TimeDescription:
    """The time column: the table [time]; `start` and `stop` [s] limit the evaluated window.

    unit   "": that of the file, else s
    """

    column: str = "time"
    unit: str = ""
    offset: float = 0.0
    start: float = -math.inf
    stop: float = math.inf


@dataclass(frozen=True)
class SignalDescription:
    """One column: a table [signals.NAME].

    unit                                         "": that of the file
    invalid, held, delay, wrap                   faults of the logger, see `corrections`
    factor, offset                               calibration: factor * value + offset is in `unit`
    label, group, tolerance, range               presentation and limit in a comparison
    sensor, noise, resolution, span, dead_zone,
    zero_error                                   properties of the instrument, in `unit`
    delay_error                                  largest error of `delay` [s]
    """

    unit: str = ""
    column: str = ""
    factor: Annotated[float, Rule("another number than 0", lambda value: value != 0)] = 1.0
    offset: float = 0.0
    invalid: tuple[float | str, ...] = ()
    wrap: Annotated[float, POSITIVE] | None = None
    held: bool = False
    delay: float = 0.0
    label: str = ""
    group: str = ""
    tolerance: Tolerance | Literal["none"] | None = None
    range: Annotated[float, POSITIVE] | None = None
    sensor: str = ""
    noise: Annotated[float, NOT_NEGATIVE] = 0.0
    resolution: Annotated[float, NOT_NEGATIVE] = 0.0
    span: Annotated[tuple[float, float], Rule("[lowest, highest]", lambda v: v[0] < v[1])] | None = None
    dead_zone: Annotated[float, NOT_NEGATIVE] = 0.0
    zero_error: Annotated[float, NOT_NEGATIVE] | None = None
    delay_error: Annotated[float, NOT_NEGATIVE] = 0.0

    def tolerance_of(self, groups: Mapping[str, Tolerance | Literal["none"]]) -> Tolerance | None:
        """The limit of the signal, or else that of its group; None for a signal without a limit."""
        tolerance = groups.get(self.group) if self.tolerance is None else self.tolerance
        return tolerance if isinstance(tolerance, Tolerance) else None


@dataclass(frozen=True)
class Condition:
    """A constant physical quantity of an experiment."""

    value: float
    unit: str


@dataclass(frozen=True)
class Description:
    """A description with valid keys and types; values in the units of the file."""

    signals: Mapping[str, SignalDescription] = field(default_factory=dict)
    reference: Origin = Origin()
    experiment: Mapping[str, str | Condition] = field(default_factory=dict)
    file: TextFormat = field(default_factory=TextFormat)
    time: TimeDescription = TimeDescription()
    tolerances: Mapping[str, Tolerance | Literal["none"]] = field(default_factory=dict)


def read_description(path: Path) -> Description:
    """Read and check the TOML file of a recording or a reference."""
    table = toml.read_file(path, "expected a TOML file that describes the columns, got no such file")
    description = toml.read_dataclass(Description, table.allow_only(Description.__dataclass_fields__))
    if not description.signals and ("signals" in table.data or not table.data.keys() & {"file", "time"}):
        raise Problem(f"{path}: expected at least one table [signals.NAME], got none")
    origin = description.reference
    if missing := [key for key in REQUIRED_KEYS[origin.kind] if getattr(origin, key) in ("", None)]:
        expected = f"expected {', '.join(missing)} for a trace of kind {origin.kind!r}"
        raise Problem(f"{path}: reference: {expected}, got none")
    if "experiment" in table.data:
        experiment = table.table("experiment")
        experiment.require("procedure", "the name of an experiment")
        if description.experiment.get("use", "train") not in ("train", "test"):
            raise experiment.problem("use", "one of train, test")
    unit = description.time.unit
    if unit and parse_unit(unit, f"{path}: time").exponents != parse_unit("s").exponents:
        raise Problem(f"{path}: time: unit: expected a unit of time such as s or ms, got {unit!r}")
    for name, value in description.experiment.items():
        if isinstance(value, Condition):
            parse_unit(value.unit, f"{path}: experiment: {name}")
    groups = description.tolerances
    for name, signal in description.signals.items():
        where = f"{path}: signals.{toml.quote_key(name)}"
        parse_unit(signal.unit, where)
        if groups and signal.group and signal.tolerance is None and signal.group not in groups:
            raise Problem(f"{where}: group: expected one of {', '.join(groups)}, got {signal.group!r}")
    return description


def description_next_to(file: Path) -> Description | None:
    """The description of a data file, NAME.toml; None without one, and for one of `OTHERS`."""
    path = file.with_suffix(".toml")
    if not path.is_file() or toml.read_file(path).data.keys() & OTHERS:
        return None
    return read_description(path)


def write_description(path: Path, description: Description) -> None:
    """Write a description, so that `read_description` returns an equal one; default values are left out."""
    tables = {f.name: getattr(description, f.name) for f in fields(description) if f.name != "signals"}
    tables |= {f"signals.{_key(name)}": signal for name, signal in description.signals.items()}
    blocks = [
        "\n".join([f"[{name}]", *(f"{_key(key)} = {_value(value)}" for key, value in entries.items()), ""])
        for name, table in tables.items()
        if (entries := _entries(table))
    ]
    write_whole(path, "\n".join(blocks))


def _entries(table: Any) -> dict[str, object]:
    """The entries of a table; of a dataclass those that differ from the defaults."""
    if not is_dataclass(table):
        return dict(table)
    return {f.name: value for f in fields(table) if (value := getattr(table, f.name)) != f.default}


def _key(name: str) -> str:
    """A key in TOML; strings have the same escapes as in JSON."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def _value(value: object) -> str:
    """A value in TOML."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_value, value))}]"
    if is_dataclass(value):
        return f"{{ {', '.join(f'{_key(key)} = {_value(v)}' for key, v in _entries(value).items())} }}"
    return str(value)
