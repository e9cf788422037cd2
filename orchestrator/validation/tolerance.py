"""Limits: which number of a signal is judged, and by what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from orchestrator.errors import Problem
from orchestrator.validation.metrics import Metrics

# Metric -> whether a smaller value is better. `maximum` and `rmse` are in the unit of the signal, `fit` and
# `vaf` in percent, the others are pure numbers.
METRICS = {
    "nrmse": True,
    "rmse": True,
    "maximum": True,
    "maximum_relative": True,
    "fit": False,
    "vaf": False,
    "iso": False,
}


@dataclass(frozen=True)
class Tolerance:
    """A limit on one metric: an upper one for errors, a lower one for fit, VAF and ISO rating."""

    metric: str
    limit: float

    @property
    def upper(self) -> bool:
        """Whether the value must not exceed the limit (else: must reach it)."""
        return METRICS[self.metric]

    @property
    def in_unit(self) -> bool:
        """Whether the limit is in the unit of the signal."""
        return self.metric in ("rmse", "maximum")

    def value(self, metrics: Metrics) -> float | None:
        """The judged number, None where it is undefined."""
        names = {"maximum": metrics.maximum_error, "iso": metrics.iso.overall}
        if self.metric in names:
            return names[self.metric]
        found: float | None = getattr(metrics, self.metric)
        return found

    def use(self, metrics: Metrics) -> float:
        """How much of the limit a signal uses: 1 at the limit, above it when it fails."""
        value = self.value(metrics)
        if value is None:
            return float("inf")
        if self.upper:
            return value / self.limit
        best = 1.0 if self.metric == "iso" else 100.0
        return (best - value) / (best - self.limit) if best > self.limit else float(value < self.limit)

    def holds(self, metrics: Metrics) -> bool:
        """Whether the signal is within its limit; an undefined number is not."""
        value = self.value(metrics)
        if value is None:
            return False
        return value <= self.limit if self.upper else value >= self.limit


def read_tolerance(table: Any, where: str) -> Tolerance | None:
    """A tolerance from `{ metric = "nrmse", limit = 0.005 }`; None from `"none"`: shown, not judged."""
    if table == "none":
        return None
    if not isinstance(table, Mapping) or set(table) != {"metric", "limit"}:
        raise Problem(f'{where}: expected {{ metric = NAME, limit = NUMBER }} or "none", got {table!r}')
    metric, limit = table["metric"], table["limit"]
    if metric not in METRICS:
        raise Problem(f"{where}: metric is {metric!r}, expected one of {', '.join(METRICS)}")
    if isinstance(limit, bool) or not isinstance(limit, int | float) or not limit > 0:
        raise Problem(f"{where}: limit is {limit!r}, expected a number above 0")
    return Tolerance(metric, float(limit))
