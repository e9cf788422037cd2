"""What was varied, in words and as a small picture of what was drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from orchestrator.sweep.report.scatter import shown_factor
from orchestrator.sweep.store import Results
from orchestrator.sweep.study import Factor
from orchestrator.sweep.units import display, factor, number

BARS = 16


def varied(results: Results) -> list[dict[str, Any]]:
    """A row per factor: name, distribution in words, unit, heights of bars 0..1."""
    return [
        {
            "name": own.name,
            "distribution": own.distribution,
            "numbers": words(own),
            "bars": bars(results.table[own.column]),
        }
        for own in results.study.factors
    ]


def words(own: Factor) -> str:
    """The numbers of a distribution with their unit, such as `0.5 to 3 bar`."""
    unit = shown_factor(own)
    scale = factor(unit)
    ending = " times its value" if own.relative else f" {display(unit)}".rstrip()

    def told(key: str) -> str:
        value = own.numbers[key]
        assert not isinstance(value, tuple)
        return number(value * scale, 4)

    if own.distribution == "values":
        values = own.numbers["values"]
        assert isinstance(values, tuple)
        return ", ".join(number(value * scale, 4) for value in values) + ending
    if own.distribution in ("normal", "lognormal"):
        return f"mean {told('mean')}, standard deviation {told('sd')}{ending}"
    mode = f", most often {told('mode')}" if own.distribution == "triangular" else ""
    return f"{told('minimum')} to {told('maximum')}{ending}{mode}"


def bars(column: pd.Series) -> list[float]:
    """Heights of a histogram of what was drawn, the highest 1."""
    values = column.to_numpy(float)
    if not len(values) or np.ptp(values) == 0:
        return [1.0]
    counts, _ = np.histogram(values, bins=BARS)
    return [round(float(count / counts.max()), 3) for count in counts]
