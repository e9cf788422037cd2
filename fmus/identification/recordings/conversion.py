"""What a file holds becomes SI: clock, signals, instruments, conditions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.contract import ModelError
from fmus.identification.recordings.columns import Table
from fmus.identification.recordings.meta import Meta, unit
from fmus.identification.recordings.recording import Array, Sensor
from fmus.units import parse


def seconds(table: Table, column: str, meta: Meta, data: Path) -> Array:
    """The clock in seconds; each row has a time, and later than the row before."""
    raw, where = table.columns[column], f"{data}: {table.rows} {{}}: column {column!r}"
    scale = parse(unit(meta.time.get("unit", "s"), f"{meta.path}: [time]"))
    if scale.exponents != parse("s").exponents:
        raise ModelError(
            f"{meta.path}: [time]: unit is {meta.time['unit']!r}, expected one of time such as s or ms"
        )
    empty = np.flatnonzero(np.isnan(raw))
    if len(empty):
        raise ModelError(f"{where.format(table.row[empty[0]])}: expected a time, found none")
    back = np.flatnonzero(np.diff(raw) <= 0)
    if len(back):
        k = back[0]
        found = f"{raw[k + 1]:.10g} after {raw[k]:.10g}"
        raise ModelError(f"{where.format(table.row[k + 1])}: expected increasing times, found {found}")
    time: Array = scale.factor * raw + float(meta.time.get("offset", 0.0))
    return time


def signal(raw: Array, spec: Mapping[str, Any]) -> Array:
    """A column in SI: factor and offset of the sensor first, both in the stated unit."""
    scale = parse(unit(spec["unit"], "unit"))
    calibrated = float(spec.get("factor", 1.0)) * raw + float(spec.get("offset", 0.0))
    values: NDArray[np.float64] = scale.factor * calibrated + scale.offset
    return values


def sensor(spec: Mapping[str, Any]) -> Sensor | None:
    """The instrument in SI, if one is told; a span has the unit's zero, the other numbers are differences."""
    if not {"sensor", "noise", "resolution", "span", "dead_zone"} & set(spec):
        return None
    scale = parse(unit(spec["unit"], "unit"))
    low, high = spec.get("span", (-math.inf, math.inf))
    return Sensor(
        text=spec.get("sensor", ""),
        noise=scale.factor * spec.get("noise", 0.0),
        resolution=scale.factor * spec.get("resolution", 0.0),
        low=scale.factor * low + scale.offset,
        high=scale.factor * high + scale.offset,
        dead_zone=scale.factor * spec.get("dead_zone", 0.0),
    )


def conditions(meta: Meta) -> dict[str, float | str]:
    """What holds during the experiment: words, numbers in SI."""
    result: dict[str, float | str] = {}
    for name, value in meta.experiment.items():
        if isinstance(value, str):
            result[name] = value
        else:
            scale = parse(unit(value["unit"], name))
            result[name] = float(scale.factor * value["value"] + scale.offset)
    return result
