"""Figure 8: internal and external leakage over pressure with their lines, residuals below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fmus.identification.finding import Curve, Panel
from fmus.identification.procedures.motor_leakage.points import Points
from fmus.identification.procedures.shared.regression import WIDTH

Array = NDArray[np.float64]
BAR, LITRES, MILLILITRES = ("bar", 1e5), ("L/min", 1e-3 / 60), ("mL/min", 1e-6 / 60)


def panels(p: Points, internal: float, external: float, titles: Sequence[str]) -> tuple[Panel, ...]:
    """Two each, for these conductances."""
    inner = p.flow_a - external * p.pressure_a
    by_pressure = external * p.pressure_a_error
    inner_error = np.sqrt(p.flow_a_error**2 + by_pressure**2)
    return (
        *_pair("internal", "P_1 - P_2", p.difference, inner, inner_error, internal, p, titles),
        *_pair("external", "P_1 + P_2", p.total, p.drain, p.drain_error, external, p, titles),
    )


def _pair(
    which: str,
    over: str,
    x: Array,
    y: Array,
    error: Array,
    slope: float,
    p: Points,
    titles: Sequence[str],
) -> tuple[Panel, Panel]:
    parts = [(title, p.source == k) for k, title in enumerate(titles)]
    ends = np.array([min(x.min(), 0.0), max(x.max(), 0.0)])
    measured = [Curve(title, x[m], y[m]) for title, m in parts]
    left = [Curve(title, x[m], (y - slope * x)[m], error=WIDTH * error[m]) for title, m in parts]
    line = Panel(
        x_label=over,
        y_label=f"{which} leakage",
        curves=(*measured, Curve(f"line, 1/R = {slope:.4g} m3/(s.Pa)", ends, slope * ends, "fit", line=True)),
        x_unit=BAR,
        y_unit=LITRES,
    )
    return line, replace(line, y_label="residual", curves=tuple(left), y_unit=MILLILITRES)
