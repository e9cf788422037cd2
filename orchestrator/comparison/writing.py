"""A comparison as files: numbers for programs, a picture for people."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orchestrator.comparison.compare import Comparison
from orchestrator.comparison.figure import draw
from orchestrator.comparison.runs import Run
from orchestrator.validation.compare import Row
from orchestrator.validation.figures import png


def write(comparison: Comparison, folder: str | Path) -> tuple[Path, Path]:
    """Write comparison.png and comparison.json to a folder; returns both."""
    home = Path(folder)
    home.mkdir(parents=True, exist_ok=True)
    picture, numbers = home / "comparison.png", home / "comparison.json"
    picture.write_bytes(png(draw(comparison)))
    text = json.dumps(data(comparison), indent=1, ensure_ascii=False)
    numbers.write_text(text + "\n", encoding="utf-8", newline="\n")
    return picture, numbers


def data(comparison: Comparison) -> Mapping[str, Any]:
    """All numbers: of each run its cost, the difference of each common signal, the worst of each quantity."""
    return {
        "reference": comparison.reference.label,
        "shown": list(comparison.signals),
        "runs": {run.label: _about(run) | _differences(comparison, run.label) for run in comparison.runs},
        "notes": list(comparison.notes),
    }


def _about(run: Run) -> dict[str, Any]:
    known = run.facts
    if known is None:
        return {"file": run.file}
    return {
        "file": run.file,
        "system": known.system,
        "fmus": dict(known.fmus),
        "swapped": dict(known.swapped),
        "given": dict(known.given),
        "master": known.master,
        "coupling": dict(known.coupling),
        "step [s]": known.step,
        "steps": known.steps,
        "passes": known.passes,
        "repeated": known.repeated,
        "simulated [s]": known.simulated,
        "wall [s]": known.wall,
        "inside [s]": dict(known.inside),
        "times real time": known.simulated / known.wall if known.wall else None,
    }


def _differences(comparison: Comparison, label: str) -> dict[str, Any]:
    if label not in comparison.against:
        return {}
    found = comparison.against[label]
    worst = {q: row.signal for q in comparison.quantities() if (row := comparison.worst(label, q))}
    return {
        "window [s]": list(found.window),
        "notes": list(found.notes),
        "worst": worst,
        "largest": {q: comparison.largest(label, q).signal for q in comparison.quantities()},
        "signals": {row.signal: _row(row) for row in found.rows},
    }


def _row(row: Row) -> dict[str, Any]:
    m = row.metrics
    return {
        "quantity": row.group,
        "unit": row.unit,
        "nrmse": m.nrmse,
        "rmse": m.rmse,
        "maximum": m.maximum_error,
        "time of maximum [s]": m.time_of_maximum,
    }
