"""Fig. 7 again: inertance and capacitance of each group, the filtered equations, the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.identification.finding import Curve, Panel
from fmus.identification.procedures.hose_dynamics.definition import ByDefinition
from fmus.identification.procedures.hose_dynamics.fits import Fits
from fmus.identification.procedures.shared.regression import WIDTH

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Axes:
    """Words for one quantity: its axis, the derivative and the other side of its equation, with units."""

    quantity: str
    rate: str
    side: str
    side_unit: tuple[str, float]


INERTANCE = Axes("inertance [kg/m4]", "dQ/dt [m3/s2]", "drop without friction", ("bar", 1e5))
CAPACITANCE = Axes("capacitance [m3/Pa]", "dP/dt [Pa/s]", "flow that stays in the hose", ("L/min", 1e-3 / 60))


def panels(inertance: Fits, capacitance: Fits, defined: Sequence[ByDefinition]) -> tuple[Panel, ...]:
    """Values by group, then the equations, then the residuals."""
    return (
        _groups(inertance, [one.inertance for one in defined], INERTANCE),
        _groups(capacitance, [one.capacitance for one in defined], CAPACITANCE),
        *_equation(inertance, INERTANCE),
        *_equation(capacitance, CAPACITANCE),
    )


def _groups(of: Fits, defined: Sequence[Array], axes: Axes) -> Panel:
    number = np.arange(1.0, len(defined) + 1)
    values = np.array([one[of.name] for one in of.groups])
    errors = WIDTH * np.array([one.sd(of.name) for one in of.groups])
    means, scatter = (np.array([f(one) for one in defined]) for f in (np.mean, np.std))
    ends = np.array([0.5, len(defined) + 0.5])
    curves = (
        Curve("by definition: mean and scatter of samples", number - 0.1, means, "compared", error=scatter),
        Curve("by definition: mean of means", ends, np.full(2, means.mean()), "compared", line=True),
        Curve("regression, 95 %", number + 0.1, values, "measured", error=errors),
        Curve("regression, all groups", ends, np.full(2, of.pooled[of.name]), "fit", line=True),
    )
    return Panel("group", axes.quantity, curves, f"{axes.quantity.split()[0].capitalize()} of each group")


def _equation(of: Fits, axes: Axes) -> tuple[Panel, Panel]:
    """Both sides of the equation, as means over the windows: its slope is the quantity; and the residual."""
    theta = of.pooled.as_dict()
    names = (of.name, f"{of.name} s")
    x = np.concatenate([e.columns[names[0]] + theta["s"] * e.columns[names[1]] for e in of.equations])
    left = np.concatenate([e.residual(theta) for e in of.equations])
    weight = np.concatenate([e.weight for e in of.equations])
    x, left = x / weight, left / weight
    ends = np.array([x.min(), x.max()])
    curves = (
        Curve("measured, filtered", x, theta[of.name] * x + left),
        Curve("fit", ends, theta[of.name] * ends, "fit", line=True),
    )
    rest = (Curve("measured - fitted", x, left),)
    return (
        Panel(axes.rate, axes.side, curves, "Filtered equation", y_unit=axes.side_unit),
        Panel(axes.rate, axes.side + ", residual", rest, "Residual", y_unit=axes.side_unit),
    )
