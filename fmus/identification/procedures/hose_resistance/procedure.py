"""Hose resistance (section 4(b), Fig. 6): the turbulent drop along a hose at stepped flows.

    P_in - P_out = C_R Q|Q|, eq. (1)        P_in - P_out = k Q^1.75, k ~ l/D^4.75, eq. (10)

Eq. (1) is what the machine simulates, with |Q| rounded to sqrt(Q^2 + Q_t^2) as in
`fmus.components.spool_valve.turbulent_drop`. Eq. (10) is Blasius' law, so C_R = k Q^-0.25 belongs to one
reference flow (correction E10 in docs/equations.md). Both are fitted to the means of the steps, weighted with
the errors of drop and flow; which one the data support is told by chi-square and AIC.

Validity: steady flow above the dead zone of the meter; eq. (10) for a smooth pipe and Re 3e3 to 1e5.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

from fmus.identification.finding import Estimate, Finding
from fmus.identification.procedures.hose_resistance.laws import HoseFit, fit_laws, scaled, steps
from fmus.identification.procedures.hose_resistance.panels import panels
from fmus.identification.procedures.shared.given import training, value
from fmus.identification.procedures.shared.regression import misfit_remark
from fmus.identification.procedures.shared.step_means import StepMeans
from fmus.identification.recordings.recording import Recording
from fmus.parameters import Number

SIGNALS: Mapping[str, str] = {"pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
FLOWS = (60.0, 100.0, 200.0, 300.0)  # L/min, where C_R is told
LITRES = 1e-3 / 60  # m3/s in one L/min
UNIT = "Pa.s2/m6"


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """C_R of the stick's and the boom's hoses from that of the tested hose."""
    tested = training(recordings, "hose_resistance")
    every = steps(tested)
    laws = fit_laws(every.measured, value(known, "boom_stick.valve_transition_flow"))
    size = (tested[0].number("length"), tested[0].number("diameter"))
    return Finding(
        procedure="hose_resistance",
        title=f"Hose resistance: {size[0]:g} m, bore {size[1] * 1e3:.4g} mm",
        figure=6,
        estimates=tuple(_machine(laws, axis, size, known) for axis in ("stick", "boom")),
        panels=panels(every, laws),
        remarks=_remarks(every, laws),
        others=tuple(_others(laws)),
    )


def _machine(laws: HoseFit, axis: str, size: tuple[float, float], known: Mapping[str, Number]) -> Estimate:
    own = tuple(value(known, f"boom_stick.{axis}_hose_{name}") for name in ("length", "bore"))
    factor = scaled(1.0, *size, own[0], own[1])
    note = f"eq. (1), section 4(b), at {laws.reference_flow / LITRES:.0f} L/min"
    if abs(factor - 1) > 1e-9:
        note += f", eq. (10) from {size[0]:g} m to {own[0]:g} m, {own[1] * 1e3:.4g} mm"
    return laws.square.estimate(f"boom_stick.{axis}_hose_resistance", UNIT, note, "resistance", factor)


def _others(laws: HoseFit) -> list[Estimate]:
    found = [
        laws.square.estimate(
            "C_R", UNIT, f"eq. (1), the tested hose at {laws.reference_flow / LITRES:.0f} L/min", "resistance"
        ),
        laws.power.estimate("k", "Pa/(m3/s)^1.75", "eq. (10), the tested hose", "factor"),
    ]
    for litres in FLOWS:
        at = partial(_at_flow, litres * LITRES)
        found.append(laws.power.derived(f"C_R({litres:g} L/min)", UNIT, "k Q^-0.25, eq. (10)", at))
    if laws.mixed is not None:
        found += [
            laws.mixed.estimate("C_R beside laminar part", UNIT, "Q sqrt(R^2 + (C_R Q)^2)", "resistance"),
            laws.mixed.derived("R, laminar part", "Pa.s/m3", "Q sqrt(R^2 + (C_R Q)^2)", _laminar),
        ]
    return found


def _laminar(values: Mapping[str, float]) -> float:
    return math.sqrt(values["laminar_square"])


def _at_flow(flow: float, values: Mapping[str, float]) -> float:
    return float(values["factor"] * flow**-0.25)


def _remarks(every: StepMeans, laws: HoseFit) -> tuple[str, ...]:
    square, power = laws.square, laws.power
    better, worse = ("eq. (1)", "eq. (10)") if square.aic < power.aic else ("eq. (10)", "eq. (1)")
    found = [
        f"{better} fits better than {worse}: chi-square {square.chi_square:.4g} by eq. (1), "
        f"{power.chi_square:.4g} by eq. (10) with {square.freedom} degrees of freedom.",
        f"C_R belongs to {laws.reference_flow / LITRES:.0f} L/min, the rms flow with the weights of the fit; "
        "by eq. (10) it falls by 16 % per doubling of the flow.",
    ]
    dead = int(every.dead.sum())
    if dead:
        found.insert(
            0,
            f"{dead} of {every.flow.size} steps are masked: their flow is in the dead zone of the meter, the "
            "flat region at the beginning of Fig. 6.",
        )
    if laws.mixed is not None:
        found.append(
            f"The small flows show a laminar part: with Q sqrt(R^2 + (C_R Q)^2) chi-square is "
            f"{laws.mixed.chi_square:.4g}. The lumped hose has no such term, so C_R takes its share of it."
        )
    return (*found, *misfit_remark(square, "Eq. (1)"))
