"""Result of an identification procedure: estimates, remarks, and the panels of its figure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fmus.identification.estimate import Estimate
from fmus.identification.finding import Finding
from orchestrator.data.table import Array

BAR, LITRES_PER_MINUTE = ("bar", 1e5), ("L/min", 1e-3 / 60)  # display units: name, SI value of one
CurveKind = Literal["measured", "fit", "masked", "compared", "corrected"]


@dataclass(frozen=True)
class Curve:
    """A curve or a cloud of points.

    line    whether the points are joined
    error   half the length of each error bar
    band    lower and upper end of a band around the curve
    """

    label: str
    x: Array
    y: Array
    kind: CurveKind = "measured"
    line: bool = False
    error: Array | None = None
    band: tuple[Array, Array] | None = None


@dataclass(frozen=True)
class Panel:
    """A pair of axes with curves in SI units; `x_unit` and `y_unit` are display units with their SI value."""

    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    title: str = ""
    x_unit: tuple[str, float] = ("", 1.0)
    y_unit: tuple[str, float] = ("", 1.0)
    log: bool = False

    def with_line(self, slope: float, label: str) -> tuple[Panel, Panel]:
        """The measured points with the fitted line y = slope x, and a panel of their residuals.

        Error bars are drawn at the residuals only: next to the line they would be too short to see.
        """
        x = np.concatenate([points.x for points in self.curves])
        ends = np.array([min(x.min(), 0.0), max(x.max(), 0.0)])
        line = Curve(label, ends, slope * ends, "fit", line=True)
        points = [replace(curve, error=None) for curve in self.curves]
        residuals = [replace(curve, y=curve.y - slope * curve.x) for curve in self.curves]
        return (
            replace(self, curves=(*points, line)),
            replace(self, y_label="residual", curves=tuple(residuals), title=""),
        )


@dataclass(frozen=True)
class ProcedureResult:
    """Estimates of one procedure, and what the report shows of them.

    procedure   name of the procedure: "valve", "hose_resistance", ...
    figure      number of the corresponding figure in the paper, 0 if there is none
    estimates   parameters of the machine
    panels      measurement with fit, then residual
    remarks     sentences on masked and corrected samples, misfit, and what the data leave open
    listed      points of the opening curves, which are written to parameters.toml as lists
    findings    of the tests of what the procedure assumes, whether the data contradict it or not
    others      other estimates, such as C_R at each voltage, which are not written to parameters.toml
    """

    procedure: str
    title: str
    figure: int
    estimates: tuple[Estimate, ...]
    panels: tuple[Panel, ...]
    remarks: tuple[str, ...] = ()
    others: tuple[Estimate, ...] = ()
    listed: tuple[Estimate, ...] = ()
    findings: tuple[Finding, ...] = ()

    def __str__(self) -> str:
        """The estimates; of a procedure without parameters, such as a weighing, the others."""
        lines = [f"{self.procedure}:"]
        for e in self.estimates or self.others:
            value, low, high, unit = e.displayed(e.digits)
            lines.append(f"  {e.name:<38}{value:>12}  ({low} to {high}) {unit}")
        return "\n".join(lines)
