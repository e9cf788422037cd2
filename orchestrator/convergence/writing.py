"""A study as files: numbers for programs, pictures for people."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orchestrator.convergence.figure import draw_error, draw_work
from orchestrator.convergence.study import Row, Study
from orchestrator.validation.figures import png

DPI = 110


def write(study: Study, folder: str | Path) -> list[Path]:
    """Write convergence.csv, .json, .png and work_precision.png to a folder; pictures of the first group."""
    home = Path(folder)
    home.mkdir(parents=True, exist_ok=True)
    table, numbers = home / "convergence.csv", home / "convergence.json"
    with table.open("w", newline="", encoding="utf-8") as file:
        rows = [_flat(study, row) for row in study.rows]
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    text = json.dumps(data(study), indent=1, ensure_ascii=False)
    numbers.write_text(text + "\n", encoding="utf-8", newline="\n")
    pictures = {home / "convergence.png": draw_error(study), home / "work_precision.png": draw_work(study)}
    for path, figure in pictures.items():
        path.write_bytes(png(figure, DPI))
    return [table, numbers, *pictures]


def data(study: Study) -> Mapping[str, Any]:
    """All numbers."""
    return {
        "reference": study.truth.title,
        "groups": {group: [s.name for s in signals] for group, signals in study.truth.groups.items()},
        "notes": list(study.notes),
        "runs": [_row(study, row) for row in study.rows],
    }


def _about(row: Row) -> dict[str, Any]:
    coupling = row.setting.own.get(row.case, row.setting.coupling)
    return {
        "setting": row.setting.label,
        "master": coupling.master,
        "order": coupling.extrapolation,
        "passes": coupling.rounds,
        "without rate wires": row.setting.bare,
        "case": row.case,
        "step [s]": row.step,
        "mean step [s]": row.mean_step,
        "steps": row.taken,
        "simulated [s]": row.simulated,
        "stable": row.stable,
        "wall [s]": _number(row.wall),
        "wall per simulated [1]": _number(row.cost),
        "ended": row.ended or row.refused,
    }


def _row(study: Study, row: Row) -> dict[str, Any]:
    errors = {
        group: {
            "order": study.order(row, group),
            "signals": {
                e.signal: {"nrmse": _number(e.nrmse), "maximum": _number(e.maximum), "unit": e.unit}
                for e in found
            },
        }
        for group, found in row.errors.items()
    }
    return {**_about(row), "walls [s]": list(row.walls), "errors": errors}


def _flat(study: Study, row: Row) -> dict[str, Any]:
    """A line of the CSV: of each group its worst signal."""
    line = _about(row)
    for group in study.truth.groups:
        worst = row.errors[group][0] if row.errors else None
        line |= {
            f"{group} nrmse": worst.nrmse if worst else None,
            f"{group} worst": worst.signal if worst else None,
            f"{group} order": study.order(row, group),
        }
    return line


def _number(value: float) -> float | None:
    """JSON knows no infinity."""
    return value if math.isfinite(value) else None
