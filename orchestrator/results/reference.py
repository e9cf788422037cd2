"""Number columns of a CSV file as people and loggers write them.

What a run is compared with: a CSV of recorded signals and a TOML file that tells what they are.

The same format serves the project's reference traces, where it also tells how each was made, and a user's own
measurements, where it maps columns to signals. docs/reference-traces.md describes it.

Write a computed reference trace: the CSV and, beside it, the TOML that tells how it was made.
"""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from difflib import get_close_matches
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.units import linear, parse
from orchestrator.data.trace import Trace
from orchestrator.results.metrics import Tolerance, read_tolerance


def read_columns(
    path: Path, names: Collection[str], delimiter: str = ",", decimal: str = ".", skip_lines: int = 0
) -> dict[str, NDArray[np.float64]]:
    """The named columns, each of shape (n,).

    skip_lines   lines before the row of column names
    decimal      "." or ","
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise Problem(f"{path}: expected a CSV file, got no such file") from None
    except UnicodeDecodeError as error:
        raise Problem(f"{path}: expected text in UTF-8, got {error}") from None
    if len(delimiter) != 1 or decimal not in (".", ",") or delimiter == decimal:
        raise Problem(
            f"{path}: expected a one-character delimiter and decimal . or ,, got {delimiter!r}, {decimal!r}"
        )
    rows = csv.reader(text.splitlines()[skip_lines:], delimiter=delimiter)
    header = [name.strip() for name in next(rows, [])]
    places = {name: _place(name, header, path) for name in sorted(names)}
    cells: dict[str, list[float]] = {name: [] for name in places}
    for number, row in enumerate(rows, skip_lines + 2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise Problem(f"{path}: line {number}: expected {len(header)} cells, got {len(row)}")
        for name, place in places.items():
            cells[name].append(_number(row[place], decimal, f"{path}: line {number}: column {name!r}"))
    if any(len(column) < 2 for column in cells.values()):
        raise Problem(f"{path}: expected two or more rows of numbers, got {max(map(len, cells.values()))}")
    return {name: np.array(column) for name, column in cells.items()}


def _place(name: str, header: list[str], path: Path) -> int:
    if header.count(name) == 1:
        return header.index(name)
    if name in header:
        raise Problem(f"{path}: column {name!r} expected once, got it {header.count(name)} times")
    near = get_close_matches(name, header, 3) or header[:8]
    raise Problem(f"{path}: column {name!r} expected, got {', '.join(near) or 'no header'}")


def _number(cell: str, decimal: str, where: str) -> float:
    try:
        value = float(cell.replace(decimal, ".") if decimal != "." else cell)
    except ValueError:
        raise Problem(f"{where}: expected a number, got {cell!r}") from None
    if not isfinite(value):
        raise Problem(f"{where}: expected a finite number, got {cell!r}")
    return value


KINDS = ("simulation", "measurement", "published")
_NUMBER = (int, float)

# The tables and keys of the TOML file, with the types of their values. [experiment] and the instrument of a
# signal belong to a recording for identification (docs/recordings.md); a comparison does not use them.
_TABLES = {
    "reference": dict,
    "file": dict,
    "time": dict,
    "tolerances": dict,
    "signals": dict,
    "experiment": dict,
}
_ABOUT = {
    "title": str,
    "kind": str,
    "origin": str,
    "made_by": str,
    "solver": str,
    "relative_tolerance": _NUMBER,
    "absolute_tolerance": _NUMBER,
    "date": date,
    "change": str,
    "note": str,
}
_FILE = {"csv": str, "delimiter": str, "decimal": str, "skip_lines": int}
_TIME = {"column": str, "unit": str, "offset": _NUMBER, "start": _NUMBER, "stop": _NUMBER}
_SIGNAL = {
    "column": str,
    "unit": str,
    "label": str,
    "group": str,
    "factor": _NUMBER,
    "offset": _NUMBER,
    "range": _NUMBER,
    "tolerance": (dict, str),
    "sensor": str,
    "noise": _NUMBER,
    "resolution": _NUMBER,
    "span": list,
    "dead_zone": _NUMBER,
}
# A computed trace must be reproducible, so its file must tell all of this.
_NEEDED = {
    "simulation": ("title", "origin", "made_by", "solver", "relative_tolerance", "date", "change"),
    "published": ("title", "origin", "date", "change"),
    "measurement": (),
}


@dataclass(frozen=True)
class Signal:
    """One recorded signal.

    name       the run's name for it, `component.variable`
    values     shape (n,), in `unit`
    group      signals of one kind, such as angle, speed, pressure; they share a tolerance
    span       what NRMSE divides by instead of the range of the values, in `unit`
    tolerance  what to judge, None: shown but not judged
    """

    name: str
    values: NDArray[np.float64]
    unit: str
    label: str = ""
    group: str = ""
    span: float | None = None
    tolerance: Tolerance | None = None


@dataclass(frozen=True)
class Reference:
    """Signals to compare a run with, over one time axis of shape (n,) [s].

    start, stop   the window to compare [s], None: all there is
    about         the [reference] table: title, kind, origin, made_by, solver, date, change ...
    """

    time: NDArray[np.float64]
    signals: Mapping[str, Signal]
    source: str
    start: float | None = None
    stop: float | None = None
    about: Mapping[str, str | float] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """The title in the meta file, else the file's name."""
        return str(self.about.get("title", self.source))


def read_reference(path: Path | str, csv: Path | str | None = None) -> Reference:
    """Read a reference trace or measurements.

    path   the CSV, whose meta file has the same name with .toml, or the TOML itself
    csv    the CSV, when the TOML is a mapping for many recordings
    """
    if not Path(path).is_file():
        found = "a folder" if Path(path).is_dir() else "no such file"
        raise Problem(f"{path}: expected a .csv or .toml file, got {found}")
    meta = Path(path) if Path(path).suffix == ".toml" else Path(path).with_suffix(".toml")
    tables = _load(meta)
    _keys(tables, _TABLES, f"{meta}")
    about = _about(tables.get("reference", {}), f"{meta}: [reference]")
    file, time = tables.get("file", {}), tables.get("time", {})
    _keys(file, _FILE, f"{meta}: [file]")
    _keys(time, _TIME, f"{meta}: [time]")
    table = _beside(meta, file) if csv is None and Path(path).suffix == ".toml" else Path(csv or path)
    groups = {
        name: read_tolerance(value, f"{meta}: [tolerances] {name}")
        for name, value in tables.get("tolerances", {}).items()
    }
    specs = tables.get("signals", {})
    if not specs:
        raise Problem(f"{meta}: expected at least one table [signals.NAME], got none")
    for name, spec in specs.items():
        _check_signal(spec, groups, f"{meta}: [signals.{name!r}]")
    clock = time.get("column", "time")
    names = {clock, *(spec.get("column", name) for name, spec in specs.items())}
    columns = read_columns(
        table, names, file.get("delimiter", ","), file.get("decimal", "."), file.get("skip_lines", 0)
    )
    return Reference(
        time=_seconds(columns[clock], time, f"{table}: column {clock!r}"),
        signals={n: _signal(n, spec, columns[spec.get("column", n)], groups) for n, spec in specs.items()},
        source=table.name,
        start=time.get("start"),
        stop=time.get("stop"),
        about=about,
    )


def _load(meta: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(meta.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise Problem(f"{meta}: expected a TOML file that describes the columns, got no such file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise Problem(f"{meta}: expected TOML, got {error}") from None


def _keys(table: Any, known: Mapping[str, Any], where: str) -> None:
    """Refuse what is not a table, an unknown key and a value of the wrong type."""
    if not isinstance(table, dict):
        raise Problem(f"{where}: expected a table, got {table!r}")
    for key, value in table.items():
        if key not in known:
            raise Problem(f"{where}: unknown key {key!r}, expected one of {', '.join(known)}")
        if not isinstance(value, known[key]) or isinstance(value, bool):
            wanted = known[key] if isinstance(known[key], tuple) else (known[key],)
            kinds = " or ".join(kind.__name__ for kind in wanted)
            raise Problem(f"{where}: {key} is {value!r}, expected {kinds}")


def _about(table: Any, where: str) -> dict[str, str | float]:
    """The [reference] table, complete for its kind."""
    _keys(table, _ABOUT, where)
    kind = table.get("kind", "measurement")
    if kind not in KINDS:
        raise Problem(f"{where}: kind is {kind!r}, expected one of {', '.join(KINDS)}")
    missing = [key for key in _NEEDED[kind] if key not in table]
    if missing:
        raise Problem(f"{where}: a trace of kind {kind!r} must tell {', '.join(missing)}, got none")
    return {k: v.isoformat() if isinstance(v, date) else v for k, v in {**table, "kind": kind}.items()}


def _beside(meta: Path, file: Mapping[str, Any]) -> Path:
    return meta.with_name(file["csv"]) if "csv" in file else meta.with_suffix(".csv")


def _check_signal(spec: Any, groups: Mapping[str, Tolerance | None], where: str) -> None:
    """One [signals] table: known keys, a known unit, a group that [tolerances] names if it names any."""
    _keys(spec, _SIGNAL, where)
    if "unit" not in spec:
        raise Problem(f"{where}: expected a unit, got none")
    parse(spec["unit"], where)
    if "tolerance" in spec:
        read_tolerance(spec["tolerance"], f"{where} tolerance")
    if groups and "group" in spec and spec["group"] not in groups and "tolerance" not in spec:
        raise Problem(f"{where}: group is {spec['group']!r}, expected one of {', '.join(groups)}")
    if spec.get("range", 1) <= 0:
        raise Problem(f"{where}: range is {spec['range']}, expected more than 0")


def _seconds(raw: NDArray[np.float64], spec: Mapping[str, Any], where: str) -> NDArray[np.float64]:
    """The file's clock in seconds of the run: unit, then offset [s]; strictly increasing."""
    factor, _ = linear(spec.get("unit", "s"), "s", where)
    time = factor * raw + float(spec.get("offset", 0.0))
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        before, after = raw[back[0]], raw[back[0] + 1]
        raise Problem(f"{where}: expected increasing times, got {after:g} after {before:g}")
    return time


def _signal(
    name: str, spec: Mapping[str, Any], raw: NDArray[np.float64], groups: Mapping[str, Tolerance | None]
) -> Signal:
    """One signal from its column: factor and offset of the sensor first, both in the stated unit."""
    own = spec.get("tolerance")
    return Signal(
        name=name,
        values=float(spec.get("factor", 1.0)) * raw + float(spec.get("offset", 0.0)),
        unit=spec["unit"],
        label=spec.get("label", ""),
        group=spec.get("group", ""),
        span=spec.get("range"),
        tolerance=read_tolerance(own, name) if own else groups.get(spec.get("group", "")),
    )


@dataclass(frozen=True)
class Origin:
    """How a computed trace came to be; every field goes into the [reference] table."""

    title: str
    origin: str
    made_by: str
    solver: str
    relative_tolerance: float
    absolute_tolerance: float
    date: date
    change: str
    note: str = ""


def write_reference(
    path: Path | str,
    trace: Trace,
    origin: Origin,
    tolerances: Mapping[str, Tolerance],
    groups: Mapping[str, str],
    labels: Mapping[str, str] | None = None,
    digits: int = 9,
) -> Path:
    """Write all signals of the trace to a CSV at `path`, and the meta file; returns the path of that.

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
    meta = table.with_suffix(".toml")
    blocks = [_origin_about(origin), _tolerances(tolerances, sorted(set(groups.values()) - set(tolerances)))]
    blocks += [
        _signal_table(name, trace.units.get(name, "1"), groups, labels or {}) for name in trace.signals
    ]
    meta.write_text("\n".join(blocks), encoding="utf-8", newline="\n")
    return meta


def _quoted(text: str) -> str:
    """A TOML basic string: the escapes of JSON are its own."""
    return json.dumps(text, ensure_ascii=False)


def _lines(head: str, values: Sequence[tuple[str, str]]) -> str:
    return "\n".join([f"[{head}]", *(f"{key} = {value}" for key, value in values), ""])


def _origin_about(origin: Origin) -> str:
    texts = {key: value for key, value in vars(origin).items() if isinstance(value, str) and value}
    values = [(key, _quoted(value)) for key, value in texts.items()]
    values += [(key, repr(getattr(origin, key))) for key in ("relative_tolerance", "absolute_tolerance")]
    return _lines("reference", [("kind", '"simulation"'), *values, ("date", origin.date.isoformat())])


def _tolerances(tolerances: Mapping[str, Tolerance], unjudged: Sequence[str]) -> str:
    limits = {g: f"{{ metric = {_quoted(t.metric)}, limit = {t.limit!r} }}" for g, t in tolerances.items()}
    return _lines("tolerances", [(_quoted(g), limits.get(g, '"none"')) for g in [*limits, *unjudged]])


def _signal_table(name: str, unit: str, groups: Mapping[str, str], labels: Mapping[str, str]) -> str:
    values = [("unit", unit), ("group", groups.get(name, "")), ("label", labels.get(name, ""))]
    return _lines(f"signals.{_quoted(name)}", [(key, _quoted(value)) for key, value in values if value])
