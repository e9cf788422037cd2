"""Fig. 6 again: the drop over the flow with the laws fitted to it, the residual, C_R over the flow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fmus.identification.finding import Curve, Panel
from fmus.identification.procedures.hose_resistance.laws import HoseFit, mixed_drop, power_drop, square_drop
from fmus.identification.procedures.shared.step_means import StepMeans

Array = NDArray[np.float64]

FLOW, LITRES, BAR = "flow", ("L/min", 1e-3 / 60), ("bar", 1e5)


def panels(every: StepMeans, laws: HoseFit) -> tuple[Panel, ...]:
    """Drop, residual, C_R."""
    good = every.measured
    dead = every.where(every.dead)
    fine = np.linspace(0.0, float(np.abs(good.flow).max()), 200)
    square, power = _laws(laws, fine)
    drop: tuple[Curve, ...] = (
        Curve("measured", good.flow, good.drop, error=good.drop_error),
        Curve("masked: dead zone of the meter", dead.flow, dead.drop, "masked"),
        Curve("C_R Q|Q|, eq. (1)", fine, square, "fit", line=True),
        Curve("k Q^1.75, eq. (10)", fine, power, "compared", line=True),
    )
    if laws.mixed is not None:
        mixed = mixed_drop(fine, laws.mixed.as_dict())
        drop += (Curve("with laminar part", fine, mixed, "compared", line=True),)
    return (
        Panel(FLOW, "pressure drop", drop, "Drop along the hose", LITRES, BAR),
        _residual(good, laws),
        _resistance(good, laws, fine[1:]),
    )


def _laws(laws: HoseFit, flow: Array) -> tuple[Array, Array]:
    return (
        square_drop(flow, laws.square.as_dict(), laws.transition_flow),
        power_drop(flow, laws.power.as_dict()),
    )


def _residual(good: StepMeans, laws: HoseFit) -> Panel:
    square, power = _laws(laws, good.flow)
    curves: tuple[Curve, ...] = (
        Curve("eq. (1)", good.flow, good.drop - square, "fit", error=good.drop_error),
        Curve("eq. (10)", good.flow, good.drop - power, "compared"),
    )
    if laws.mixed is not None:
        mixed = mixed_drop(good.flow, laws.mixed.as_dict())
        curves += (Curve("with laminar part", good.flow, good.drop - mixed, "compared"),)
    return Panel(FLOW, "drop, measured - fitted", curves, "Residual", LITRES, BAR)


def _resistance(good: StepMeans, laws: HoseFit, fine: Array) -> Panel:
    drop = good.drop
    measured = drop / (good.flow * np.abs(good.flow))
    relative = np.hypot(good.drop_error / drop, 2 * good.flow_error / good.flow)
    constant = np.full_like(fine, laws.square["resistance"])
    within = fine >= np.abs(good.flow).min() / 2  # eq. (10) has no limit at Q = 0
    curves = (
        Curve("measured", good.flow, measured, error=np.abs(measured * relative)),
        Curve("eq. (1)", fine, constant, "fit", line=True),
        Curve(
            "k Q^-0.25, eq. (10)",
            fine[within],
            laws.power["factor"] * fine[within] ** -0.25,
            "compared",
            True,
        ),
    )
    return Panel(FLOW, "C_R [Pa.s2/m6]", curves, "C_R belongs to one flow", LITRES)
