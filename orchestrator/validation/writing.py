"""Write a computed reference trace: the CSV and, beside it, the TOML that tells how it was made."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np

from orchestrator.errors import Problem
from orchestrator.files.trace import Trace
from orchestrator.validation.tolerance import Tolerance


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
    blocks = [_about(origin), _tolerances(tolerances, sorted(set(groups.values()) - set(tolerances)))]
    blocks += [_signal(name, trace.units.get(name, "1"), groups, labels or {}) for name in trace.signals]
    meta.write_text("\n".join(blocks), encoding="utf-8", newline="\n")
    return meta


def _quoted(text: str) -> str:
    """A TOML basic string: the escapes of JSON are its own."""
    return json.dumps(text, ensure_ascii=False)


def _lines(head: str, values: Sequence[tuple[str, str]]) -> str:
    return "\n".join([f"[{head}]", *(f"{key} = {value}" for key, value in values), ""])


def _about(origin: Origin) -> str:
    texts = {key: value for key, value in vars(origin).items() if isinstance(value, str) and value}
    values = [(key, _quoted(value)) for key, value in texts.items()]
    values += [(key, repr(getattr(origin, key))) for key in ("relative_tolerance", "absolute_tolerance")]
    return _lines("reference", [("kind", '"simulation"'), *values, ("date", origin.date.isoformat())])


def _tolerances(tolerances: Mapping[str, Tolerance], unjudged: Sequence[str]) -> str:
    limits = {g: f"{{ metric = {_quoted(t.metric)}, limit = {t.limit!r} }}" for g, t in tolerances.items()}
    return _lines("tolerances", [(_quoted(g), limits.get(g, '"none"')) for g in [*limits, *unjudged]])


def _signal(name: str, unit: str, groups: Mapping[str, str], labels: Mapping[str, str]) -> str:
    values = [("unit", unit), ("group", groups.get(name, "")), ("label", labels.get(name, ""))]
    return _lines(f"signals.{_quoted(name)}", [(key, _quoted(value)) for key, value in values if value])
