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
from dataclasses import replace
from functools import partial

from fmus.identification.finding import Estimate, Finding
from fmus.identification.procedures.hose_resistance.laws import HoseFit, fit_laws, scaled, steps
from fmus.identification.procedures.hose_resistance.panels import panels
from fmus.identification.procedures.shared.given import denser, hose_size, training, value
from fmus.identification.procedures.shared.regression import SURE, misfit_remark, symmetrical
from fmus.identification.procedures.shared.step_means import StepMeans, left_out
from fmus.identification.recordings.recording import Recording
from fmus.parameters import Number

SIGNALS: Mapping[str, str] = {"pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
FLOWS = (60.0, 100.0, 200.0, 300.0)  # L/min, where C_R is told
LITRES = 1e-3 / 60  # m3/s in one L/min
UNIT, BAR = "Pa.s2/m6", 1e5


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """C_R of the stick's and the boom's hoses from that of the tested hose."""
    tested = training(recordings, "hose_resistance", SIGNALS)
    every = steps(tested)
    laws = fit_laws(every, value(known, "boom_stick.valve_transition_flow"))
    size, thicker = hose_size(tested), denser(tested, known) ** 0.75
    return Finding(
        procedure="hose_resistance",
        title=f"Hose resistance: {size[0]:g} m, bore {size[1] * 1e3:.4g} mm",
        figure=6,
        estimates=tuple(_machine(laws, axis, size, thicker, known) for axis in ("stick", "boom")),
        panels=panels(replace(every, drop=every.drop - laws.zero), laws),
        remarks=_remarks(every, laws),
        others=tuple(_others(laws)),
    )


def _machine(
    laws: HoseFit, axis: str, size: tuple[float, float], thicker: float, known: Mapping[str, Number]
) -> Estimate:
    own = tuple(value(known, f"boom_stick.{axis}_hose_{name}") for name in ("length", "bore"))
    factor = thicker * scaled(1.0, *size, own[0], own[1])
    note = f"eq. (1), section 4(b), at {laws.reference_flow / LITRES:.0f} L/min"
    if abs(factor - 1) > 1e-9:
        note += f", eq. (10) from {size[0]:g} m to {own[0]:g} m, {own[1] * 1e3:.4g} mm"
    return laws.square.estimate(f"boom_stick.{axis}_hose_resistance", UNIT, note, "resistance", factor)


def _others(laws: HoseFit) -> list[Estimate]:
    found = [
        laws.square.estimate(
            "C_R", UNIT, f"eq. (1), the tested hose at {laws.reference_flow / LITRES:.0f} L/min", "resistance"
        ),
        symmetrical("pressures without flow", laws.zero, "Pa", laws.zero_sd, "pressure_in - pressure_out"),
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
    return tuple(
        text
        for text in (
            _masked(every),
            _better(laws),
            _reference(laws),
            _zero(laws),
            _mixed(laws),
            *misfit_remark(laws.square, "Eq. (1)"),
        )
        if text
    )


def _masked(every: StepMeans) -> str:
    dead, lost = int(every.dead.sum()), left_out(every.dead, every.clipped, every.good)
    if not lost:
        return ""
    flat = ", the flat region at the beginning of Fig. 6" if dead else ""
    return f"Left out of {every.flow.size} steps: {lost}{flat}."


def _better(laws: HoseFit) -> str:
    square, power = laws.square, laws.power
    better, worse = ("eq. (1)", "eq. (10)") if square.aic < power.aic else ("eq. (10)", "eq. (1)")
    return (
        f"{better.capitalize()} fits better than {worse}: chi-square is {square.chi_square:.4g} by eq. (1), "
        f"{power.chi_square:.4g} by eq. (10), with {square.freedom} degrees of freedom."
    )


def _reference(laws: HoseFit) -> str:
    return (
        f"C_R belongs to {laws.reference_flow / LITRES:.0f} L/min, where the data weigh most. By eq. (10) it "
        "would fall by 16 % per doubling of the flow."
    )


def _zero(laws: HoseFit) -> str:
    if abs(laws.zero) < SURE * laws.zero_sd:
        return ""
    return (
        f"Without flow the pressures would differ by {laws.zero / BAR:.2g} +- {laws.zero_sd / BAR:.1g} bar "
        "by the law that fits best. That is taken off as an error of their zeros."
    )


def _mixed(laws: HoseFit) -> str:
    if laws.mixed is None:
        return ""
    return (
        "The small flows show a laminar part: with Q sqrt(R^2 + (C_R Q)^2) chi-square is "
        f"{laws.mixed.chi_square:.4g}. The lumped hose has no such term, so C_R takes its share of it."
    )
