"""Tables of the page: spreads and effects as text."""

from __future__ import annotations

from typing import Any

from orchestrator.sweep.analysis.outcome import (
    FIRST,
    MU_STAR,
    REGRESSION,
    TOTAL,
    Effect,
    Finding,
    Sensitivity,
    Spread,
)
from orchestrator.sweep.analysis.wording import size
from orchestrator.sweep.units import Unit, told

HEADS = {
    TOTAL: "total",
    FIRST: "by itself",
    REGRESSION: "linear model, squared",
    MU_STAR: "μ*",
    "mu": "μ",
    "sigma": "\N{GREEK SMALL LETTER SIGMA}",
    "regression": "coefficient",
    "rank_regression": "coefficient of ranks",
}


def spreads(finding: Finding) -> list[dict[str, Any]]:
    """A row for all runs, then one for each option."""
    rows = (
        [{"choice": "", "option": "all", "cells": _cells(finding.spread, finding.seen)}]
        if finding.spread
        else []
    )
    for choice, options in finding.by_choice.items():
        rows += [
            {"choice": choice, "option": option, "cells": _cells(found, finding.seen)}
            for option, found in options.items()
        ]
    return rows


def _cells(found: Spread, unit: Unit) -> list[str]:
    numbers = (found.mean, found.sd, found.minimum, found.low, found.median, found.high, found.maximum)
    return [str(found.runs), *(told(value, unit, False) for value in numbers)]


def heads(sensitivity: Sensitivity) -> list[tuple[str, str]]:
    """Columns that any effect has: key and words."""
    known = {key for effect in sensitivity.effects for key in (*effect.estimates, *effect.more)}
    return [(key, words) for key, words in HEADS.items() if key in known]


def effects(sensitivity: Sensitivity, unit: Unit) -> list[dict[str, Any]]:
    """A row per effect, in the order of the tornado."""
    columns = heads(sensitivity)
    return [
        {
            "name": effect.label,
            "cells": [_cell(effect, key, unit) for key, _ in columns],
            "direction": ""
            if effect.direction is None
            else f"{effect.direction:+.2f}".replace("-", "\N{MINUS SIGN}"),
        }
        for effect in sensitivity.effects
    ]


def _cell(effect: Effect, key: str, unit: Unit) -> str:
    if key in effect.estimates:
        return size(effect.estimates[key], key, unit)
    if key not in effect.more:
        return ""
    return told(effect.more[key], unit if key in ("mu", "sigma") else "")


def apart(sensitivity: Sensitivity, unit: Unit) -> dict[str, Any]:
    """The ordering measure of each factor in each combination of choices."""
    names = [effect.name for effect in sensitivity.effects if effect.kind == "factor"]
    measure = sensitivity.measure
    rows = []
    for name in names:
        cells = []
        for found in sensitivity.apart.values():
            own = next((e.estimates[measure] for e in found if e.name == name), None)
            cells.append("-" if own is None else size(own, measure, unit))
        rows.append((name, cells))
    return {"combinations": list(sensitivity.apart), "rows": rows}
