"""TOML files that people write: what cannot be read and what is not known is refused by name.

The meta file of a recording: NAME.toml beside NAME.csv, what the columns are and which experiment it is.

docs/recordings.md describes it. It is a superset of docs/reference-traces.md: what only a comparison needs
([tolerances] and a signal's label, group, tolerance and range) is allowed and not used here.

What a file holds becomes SI: clock, signals, instruments, conditions.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.identification.recordings.recording import Array, Sensor
from fmus.identification.recordings.table import Table
from orchestrator.base.errors import Problem
from orchestrator.base.units import parse, spelled


def load(path: Path) -> dict[str, Any]:
    """The tables of a TOML file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise Problem(
            f"{path}: expected a TOML file that describes the columns, found no such file"
        ) from None
    except OSError as error:
        raise Problem(f"{path}: expected a TOML file, found {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise Problem(f"{path}: cannot be read as TOML: {error}") from None


def keys(table: Any, known: Mapping[str, Any], where: str) -> None:
    """Refuse what is not a table, an unknown key and a value of the wrong type."""
    if not isinstance(table, dict):
        raise Problem(f"{where}: expected a table, found {table!r}")
    for key, value in table.items():
        if key not in known:
            raise Problem(f"{where}: unknown key {key!r}, expected one of {', '.join(known)}")
        if not isinstance(value, known[key]) or isinstance(value, bool):
            kinds = known[key] if isinstance(known[key], tuple) else (known[key],)
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise Problem(f"{where}: {key} is {value!r}, expected {wanted}")


# "" is a recording that no experiment claims.
PROCEDURES = ("valve", "hose_resistance", "hose_dynamics", "motor_leakage", "damping", "machine")
USES = ("train", "test")

_NUMBER = (int, float)
_TABLES = {
    "reference": dict,
    "experiment": dict,
    "file": dict,
    "time": dict,
    "tolerances": dict,
    "signals": dict,
}
_ABOUT = {
    **dict.fromkeys(("title", "kind", "origin", "made_by", "solver", "change", "note"), str),
    **dict.fromkeys(("relative_tolerance", "absolute_tolerance"), _NUMBER),
    "date": date,
}
_FILE = {"csv": str, "delimiter": str, "decimal": str, "skip_lines": int}
_TIME = {"column": str, "unit": str, "offset": _NUMBER, "start": _NUMBER, "stop": _NUMBER}
_COMPARED = {"label": str, "group": str, "range": _NUMBER, "tolerance": (dict, str)}
_SIGNAL = {
    "column": str,
    "unit": str,
    **dict.fromkeys(("factor", "offset"), _NUMBER),
    "sensor": str,
    **dict.fromkeys(("noise", "resolution", "dead_zone"), _NUMBER),
    "span": list,
    **_COMPARED,
}
_VALUE = {"value": _NUMBER, "unit": str}


@dataclass(frozen=True)
class Meta:
    """A meta file whose keys and types are right; numbers as they stand there.

    file, time   the tables [file] and [time]
    signals      the tables [signals.NAME], each with its unit
    experiment   the table [experiment] without procedure and use
    """

    path: Path
    title: str
    kind: str
    procedure: str
    use: str
    experiment: Mapping[str, Any]
    file: Mapping[str, Any]
    time: Mapping[str, Any]
    signals: Mapping[str, Mapping[str, Any]]


def read_meta(path: Path) -> Meta:
    """Read and check a meta file."""
    tables = load(path)
    keys(tables, _TABLES, f"{path}")
    about, file, time = (tables.get(name, {}) for name in ("reference", "file", "time"))
    keys(about, _ABOUT, f"{path}: [reference]")
    keys(file, _FILE, f"{path}: [file]")
    keys(time, _TIME, f"{path}: [time]")
    experiment = dict(tables.get("experiment", {}))
    procedure, use = _which(experiment, f"{path}: [experiment]") if "experiment" in tables else ("", "train")
    signals = tables.get("signals", {})
    if not signals:
        raise Problem(f"{path}: expected at least one table [signals.NAME], found none")
    for name, spec in signals.items():
        _check_signal(spec, f"{path}: [signals.{name!r}]")
    title = about.get("title", path.stem)
    kind = about.get("kind", "measurement")
    return Meta(path, title, kind, procedure, use, experiment, file, time, signals)


def _which(experiment: dict[str, Any], where: str) -> tuple[str, str]:
    """Procedure and use, taken out of the table; the rest are numbers with a unit, or words."""
    procedure, use = experiment.pop("procedure", None), experiment.pop("use", "train")
    if procedure not in PROCEDURES:
        raise Problem(f"{where}: procedure is {procedure!r}, expected one of {', '.join(PROCEDURES)}")
    if use not in USES:
        raise Problem(f"{where}: use is {use!r}, expected one of {', '.join(USES)}")
    for name, value in experiment.items():
        if isinstance(value, str):
            continue
        if not isinstance(value, dict) or set(value) != set(_VALUE):
            raise Problem(f'{where}: {name} is {value!r}, expected {{ value = 1.0, unit = "..." }} or a word')
        keys(value, _VALUE, f"{where} {name}")
        unit(value["unit"], f"{where} {name}")
    return procedure, use


def _check_signal(spec: Any, where: str) -> None:
    """One [signals.NAME]: known keys, a known unit, an instrument that can exist."""
    keys(spec, _SIGNAL, where)
    if "unit" not in spec:
        raise Problem(f"{where}: expected a unit, found none")
    unit(spec["unit"], where)
    for key in ("noise", "resolution", "dead_zone"):
        if spec.get(key, 0.0) < 0:
            raise Problem(f"{where}: {key} is {spec[key]}, expected 0 or more")
    span = spec.get("span", [0.0, 1.0])
    numbers = len(span) == 2 and all(isinstance(v, _NUMBER) and not isinstance(v, bool) for v in span)
    if not numbers or span[0] >= span[1]:
        raise Problem(f"{where}: span is {span}, expected [lowest, highest]")
    if spec.get("factor", 1.0) == 0:
        raise Problem(f"{where}: factor is 0, expected another number")


def unit(text: str, where: str) -> str:
    """The unit in our spelling, checked."""
    try:
        parse(spelled(text))
    except Problem as error:
        raise Problem(f"{where}: {error}") from None
    return spelled(text)


def seconds(table: Table, column: str, meta: Meta, data: Path) -> Array:
    """The clock in seconds; each row has a time, and later than the row before."""
    raw, where = table.columns[column], f"{data}: {table.rows} {{}}: column {column!r}"
    scale = parse(unit(meta.time.get("unit", "s"), f"{meta.path}: [time]"))
    if scale.exponents != parse("s").exponents:
        raise Problem(
            f"{meta.path}: [time]: unit is {meta.time['unit']!r}, expected one of time such as s or ms"
        )
    empty = np.flatnonzero(np.isnan(raw))
    if len(empty):
        raise Problem(f"{where.format(table.row[empty[0]])}: expected a time, found none")
    back = np.flatnonzero(np.diff(raw) <= 0)
    if len(back):
        k = back[0]
        found = f"{raw[k + 1]:.10g} after {raw[k]:.10g}"
        raise Problem(f"{where.format(table.row[k + 1])}: expected increasing times, found {found}")
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
