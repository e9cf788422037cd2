"""The TOML file that describes samples: columns, instruments, experiment, limits for a comparison.

One format serves all: what a test rig or a machine recorded, which `harvester identify` reads, and what a
run is compared with, which `harvester validate` reads. The dataclasses below are the tables of the file;
docs/recordings.md and docs/reference-traces.md describe the keys.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date as Date
from pathlib import Path
from typing import Annotated, Literal

from orchestrator.base import toml
from orchestrator.base.errors import Problem
from orchestrator.base.toml import NOT_NEGATIVE, POSITIVE, Rule
from orchestrator.base.units import parse
from orchestrator.data.table import TextFormat

# Metric -> whether a smaller value is better. `maximum` and `rmse` are in the unit of the signal, `fit` and
# `vaf` in percent, the others are pure numbers; orchestrator/results/metrics.py has their formulas.
METRICS = {
    "nrmse": True,
    "rmse": True,
    "maximum": True,
    "maximum_relative": True,
    "fit": False,
    "vaf": False,
    "iso": False,
}
Metric = Literal["nrmse", "rmse", "maximum", "maximum_relative", "fit", "vaf", "iso"]


@dataclass(frozen=True)
class Tolerance:
    """A limit on one metric: an upper one for errors, a lower one for fit, VAF and ISO rating."""

    metric: Metric
    limit: Annotated[float, POSITIVE]

    @property
    def upper(self) -> bool:
        """Whether the value must not exceed the limit (else: must reach it)."""
        return METRICS[self.metric]

    @property
    def in_unit(self) -> bool:
        """Whether the limit is in the unit of the signal."""
        return self.metric in ("rmse", "maximum")

    def scaled(self, factor: float) -> Tolerance:
        """The same limit for a signal in another unit."""
        return replace(self, limit=self.limit * factor) if self.in_unit else self

    def fraction_used(self, value: float | None) -> float:
        """How much of the limit a value of the metric uses: 1 at the limit, above it when it fails."""
        if value is None:
            return float("inf")
        if self.upper:
            return value / self.limit
        best = 1.0 if self.metric == "iso" else 100.0
        return (best - value) / (best - self.limit) if best > self.limit else float(value < self.limit)

    def holds(self, value: float | None) -> bool:
        """Whether a value of the metric is within the limit; None, an undefined one, is not."""
        if value is None:
            return False
        return value <= self.limit if self.upper else value >= self.limit


@dataclass(frozen=True)
class Origin:
    """Where the samples come from: the table [reference]."""

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


# A computed trace must be reproducible, so its file must tell all of this.
REQUIRED_KEYS = {
    "simulation": ("title", "origin", "made_by", "solver", "relative_tolerance", "date", "change"),
    "published": ("title", "origin", "date", "change"),
    "measurement": (),
}


@dataclass(frozen=True)
class TimeDescription:
    """The column of time: the table [time]; start and stop [s] are the window that counts."""

    column: str = "time"
    unit: str = "s"
    offset: float = 0.0
    start: float = -math.inf
    stop: float = math.inf


@dataclass(frozen=True)
class SignalDescription:
    """One column: a table [signals.NAME]. Its numbers are in `unit`, after the calibration.

    factor, offset                    the calibration: factor * value + offset is in `unit`
    label, group, tolerance, range    how a comparison shows and judges it
    sensor, noise, resolution, span, dead_zone    the instrument
    """

    unit: str
    column: str = ""
    factor: Annotated[float, Rule("another number than 0", lambda value: value != 0)] = 1.0
    offset: float = 0.0
    label: str = ""
    group: str = ""
    tolerance: Tolerance | Literal["none"] | None = None
    range: Annotated[float, POSITIVE] | None = None
    sensor: str = ""
    noise: Annotated[float, NOT_NEGATIVE] = 0.0
    resolution: Annotated[float, NOT_NEGATIVE] = 0.0
    span: Annotated[tuple[float, float], Rule("[lowest, highest]", lambda v: v[0] < v[1])] | None = None
    dead_zone: Annotated[float, NOT_NEGATIVE] = 0.0

    def tolerance_of(self, groups: Mapping[str, Tolerance | Literal["none"]]) -> Tolerance | None:
        """Its own limit, else that of its group; None if it is only shown."""
        found = groups.get(self.group) if self.tolerance is None else self.tolerance
        return found if isinstance(found, Tolerance) else None


@dataclass(frozen=True)
class Condition:
    """A number that holds during an experiment."""

    value: float
    unit: str


@dataclass(frozen=True)
class Description:
    """A description whose keys and types are right; numbers as they stand in the file."""

    signals: Mapping[str, SignalDescription]
    reference: Origin = Origin()
    experiment: Mapping[str, str | Condition] = field(default_factory=dict)
    file: TextFormat = field(default_factory=TextFormat)
    time: TimeDescription = TimeDescription()
    tolerances: Mapping[str, Tolerance | Literal["none"]] = field(default_factory=dict)


def read_description(path: Path) -> Description:
    """Read and check the TOML file of a recording or a reference."""
    try:
        table = toml.read(path, path.read_bytes())
    except FileNotFoundError:
        raise Problem(f"{path}: expected a TOML file that describes the columns, got no such file") from None
    except OSError as error:
        raise Problem(f"{path}: expected a TOML file, got {error.strerror}") from None
    if not table.data.get("signals"):
        table.allow_only(Description.__dataclass_fields__)
        raise Problem(f"{path}: expected at least one table [signals.NAME], got none")
    found = toml.read_dataclass(Description, table)
    told = found.reference
    if missing := [key for key in REQUIRED_KEYS[told.kind] if getattr(told, key) in ("", None)]:
        raise Problem(
            f"{path}: reference: a trace of kind {told.kind!r} must tell {', '.join(missing)}, got none"
        )
    if "experiment" in table.data:
        experiment = table.table("experiment")
        experiment.require("procedure", "the name of an experiment")
        if found.experiment.get("use", "train") not in ("train", "test"):
            raise experiment.problem("use", "one of train, test")
    if parse(found.time.unit, f"{path}: time").exponents != parse("s").exponents:
        raise Problem(f"{path}: time: unit: expected one of time such as s or ms, got {found.time.unit!r}")
    for name, value in found.experiment.items():
        if isinstance(value, Condition):
            parse(value.unit, f"{path}: experiment: {name}")
    for name, signal in found.signals.items():
        where = f"{path}: signals.{toml.quote_key(name)}"
        parse(signal.unit, where)
        if (
            found.tolerances
            and signal.group
            and signal.tolerance is None
            and signal.group not in found.tolerances
        ):
            raise Problem(
                f"{where}: group: expected one of {', '.join(found.tolerances)}, got {signal.group!r}"
            )
    return found
