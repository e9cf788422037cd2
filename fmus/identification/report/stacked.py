"""Residuals of several signals as one column, each over its own size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fmus.identification.report.prediction import Array, Signals


def rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else 0.0


def rows(residual: Signals, used: Sequence[str]) -> dict[str, slice]:
    """Where each signal stands in the stacked rows."""
    ends = np.cumsum([0, *(int(np.isfinite(residual[n]).sum()) for n in used)])
    return {n: slice(int(ends[k]), int(ends[k + 1])) for k, n in enumerate(used)}


def stack(values: Signals, residual: Signals, size: Mapping[str, float], used: Sequence[str]) -> Array:
    """Signals under each other, each over the size of its residual; a signal that is not there is zero.

    Signals with many samples count as much as those with few.
    """
    pieces = []
    for n in used:
        known = np.isfinite(residual[n])
        weight = 1 / (size[n] * np.sqrt(known.sum()))
        pieces.append(values[n][known] * weight if n in values else np.zeros(int(known.sum())))
    return np.concatenate(pieces)
