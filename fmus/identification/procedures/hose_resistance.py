"""Hose resistance procedure (section 4(b), Fig. 6): turbulent pressure drop along a hose at stepped flows.

    P_in - P_out = C_R Q|Q|, eq. (1)        P_in - P_out = k Q^1.75, k ~ l/D^4.75, eq. (10)

Eq. (1) is the law that the machine simulates, with |Q| rounded to sqrt(Q^2 + Q_t^2) as in
`fmus.components.spool_valve.turbulent_drop`. Eq. (10) is Blasius' law, so C_R = k Q^-0.25 is valid for one
reference flow (correction E10 in docs/equations.md). Both are fitted to the means over the steps (`balance`),
with the errors of drop and flow. Chi-square and AIC show which law the data support.

The readings of two transducers differ slightly without flow, and a tenth of a bar is a hundredth of a hose's
drop: the zeros of the transducers and of the meter are estimated with each law.

Validity: steady flow above the dead zone of the meter; eq. (10) for a smooth pipe and Re 3e3 to 1e5.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache, partial
from operator import mul

import casadi as ca
import numpy as np
from scipy import stats

from fmus.components import hose
from fmus.identification import balance
from fmus.identification.balance import Solution
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.experiment_data import StepMeans, parameter_value
from fmus.identification.results import (
    BAR,
    LITRES_PER_MINUTE,
    Curve,
    CurveKind,
    Estimate,
    Finding,
    Panel,
    ProcedureResult,
)
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

SIGNALS: Mapping[str, str] = {"pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
FLOWS = (60.0, 100.0, 200.0, 300.0)  # L/min, at which C_R by eq. (10) is reported
UNIT = "Pa.s2/m6"
LABELS = {  # of the laws in the panels of drop and residual
    "square": ("C_R Q|Q|, eq. (1)", "eq. (1)"),
    "power": ("k Q^1.75, eq. (10)", "eq. (10)"),
    "mixed": ("with laminar part", "with laminar part"),
}
TINY = 1e-30  # (m3/s)^4, avoids a division by the zero variance of equal flows
MIN_STEPS = 4  # fewer steps cannot distinguish between the laws
LEVEL = 0.02  # of C_R: a change over the flows that is no contradiction, the bar of the project for a value
ONE_WAY = 0.9  # rank correlation of flow and time from which on a change in time cannot be told
Fits = Mapping[str, Solution]  # by each law; "mixed" only if the others are misfits and it is significant


@lru_cache(maxsize=1)
def laws() -> Mapping[str, balance.Law]:
    """The drop by eq. (1) as the machine simulates it, by eq. (10), and with a laminar part.

    square   C_R Q sqrt(Q^2 + Q_t^2)
    power    k Q^1.75 with the sign of Q
    mixed    Q sqrt(R^2 + (C_R Q)^2), laminar below R/C_R as in `fmus.components.hose`; R^2 may be negative
    """
    z, transition = ca.SX.sym("z", 3), ca.SX.sym("transition")
    u = {name: ca.SX.sym(name) for name in ("resistance", "factor", "laminar_square")}
    q, turbulent = z[2], (u["resistance"] * z[2]) ** 2
    mixed = q * ca.sqrt(ca.fmax(u["laminar_square"] + turbulent, 1e-6 * turbulent + 1e-9))
    forms = {
        "square": (("resistance",), u["resistance"] * q * ca.sqrt(q**2 + transition**2)),
        "power": (("factor",), u["factor"] * ca.sign(q) * ca.fabs(q) ** 1.75),
        "mixed": (("resistance", "laminar_square"), mixed),
    }
    return {
        name: balance.law(z, {n: u[n] for n in unknowns}, transition, z[0] - z[1] - drop)
        for name, (unknowns, drop) in forms.items()
    }


def drop_by(fits: Fits, name: str, flow: Array) -> Array:
    """Drop [Pa] by one of the laws at flows [m3/s]."""
    readings, known = np.outer([0.0, 0.0, 1.0], flow), fits[name].samples[0].known
    return np.asarray(-laws()[name].terms(readings, fits[name].fit.values, known)[0].full()[0])


def scaled(resistance: float, length: float, diameter: float, to_length: float, to_diameter: float) -> float:
    """C_R or k of a hose of another length and diameter [m], from that of `length` and `diameter`, eq. (10).

    R ~ l/D^4.75, at the same flow and with the same oil.
    """
    return float(hose.scaled_resistance(resistance, to_length / length, to_diameter / diameter))


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """C_R of the stick's and the boom's hoses from that of the tested hose."""
    tests = data.training_recordings(recordings, "hose_resistance", SIGNALS)
    means, times, word = [], list[Array](), ""
    for test in tests:
        stretches = data.steady_stretches(test, ["flow"])
        if not stretches:
            expected = f"expected a steady flow for {data.SHORTEST_STRETCH:g} s or longer, got none"
            raise Problem(f"{test.source}: flow: {expected}")
        means.append(data.step_means(test, stretches))
        along, word = data.course(test, stretches)
        times.append(along)
    steps, along = data.concatenate(means), np.concatenate(times)
    limits = data.zero_limits(tests, ("pressure_in", "pressure_out")) | data.declared_limits(tests, ["flow"])
    fits = fit_laws(steps, parameter_value(parameters, "boom_stick.valve_transition_flow"), limits)
    square, good = fits["square"], steps[steps.good]
    zero = zero_of(fits)
    weights = square.column("resistance") ** 2
    reference_flow = float(np.sqrt(weights @ good.flow**2 / weights.sum()))  # weighted rms
    length, bore = data.hose_size(tests)
    flow = f"{reference_flow / LITRES_PER_MINUTE[1]:.0f} L/min"
    estimates = []
    for axis in ("stick", "boom"):
        size = tuple(parameter_value(parameters, f"boom_stick.{axis}_hose_{n}") for n in ("length", "bore"))
        factor = data.density_ratio(tests, parameters) ** 0.75 * scaled(1.0, length, bore, *size)
        note = f"eq. (1), section 4(b), at {flow}"
        if abs(factor - 1) > 1e-9:
            note += f", eq. (10) from {length:g} m to {size[0]:g} m, {size[1] * 1e3:.4g} mm"
        name = f"boom_stick.{axis}_hose_resistance"
        estimates.append(square.fit.estimate(name, UNIT, note, "resistance", factor))
    return ProcedureResult(
        procedure="hose_resistance",
        title=f"Hose resistance: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=6,
        estimates=tuple(estimates),
        panels=panels(steps.without_zero(zero.value), fits),
        remarks=(
            *_remarks(steps, fits, zero, flow),
            data.constants_remark(tests, parameters, "density"),
        ),
        others=tuple(_others(fits, zero, flow)),
        findings=(
            *_findings(square, good.flow, (along[steps.good], word)),
            *data.signal_findings(tests, SIGNALS, "hose_resistance"),
        ),
    )


def fit_laws(steps: StepMeans, transition_flow: float, limits: Mapping[str, float]) -> Fits:
    """All laws, fitted to the measured steps; `limits` are the largest errors of the zeros."""
    good = steps[steps.good]
    if good.flow.size < MIN_STEPS:
        raise Problem(
            f"hose_resistance: expected at least {MIN_STEPS} steady steps, got {good.flow.size}; "
            f"left out of {steps.flow.size} steps: {steps.omissions() or 'none'}"
        )
    turbulent = good.flow * np.abs(good.flow)
    start = float(np.cov(turbulent, good.drop)[0, 1] / max(np.var(turbulent, ddof=1), TINY))
    if start <= 0:
        raise Problem(
            f"hose_resistance: the drop pressure_in - pressure_out falls with the flow, C_R = {start:.3g}: "
            "change the sign of the flow, or exchange the two pressures"
        )
    largest, none = float(np.abs(good.flow).max()), np.zeros_like(good.drop)
    # only the difference of the pressures counts, so that at the outlet is taken as zero
    means, errors = np.array([good.drop, none, good.flow]), np.array([good.drop_error, none, good.flow_error])

    def fitted(name: str, **initial: float) -> Solution:
        samples = balance.samples_of(laws()[name], SIGNALS, means, errors, (transition_flow,))
        return balance.solve([samples], initial, "hose_resistance", limits)

    fits = {
        "square": fitted("square", resistance=start),
        "power": fitted("power", factor=start * largest**0.25),
    }
    if all(solution.fit.misfit for solution in fits.values()):
        try:
            mixed = fitted("mixed", resistance=start, laminar_square=(start * largest / 10) ** 2)
        except Problem:  # data that contradict this law may have no optimum
            return fits
        if mixed.fit["laminar_square"] > 0 and mixed.fit.significant("laminar_square"):
            fits["mixed"] = mixed
    return fits


def zero_of(fits: Fits) -> Estimate:
    """Pressure difference without flow by the best law."""
    best = fits.get("mixed") or min(fits.values(), key=_aic)
    zero, sd = best.every.combination({"pressure_in": 1.0, "pressure_out": -1.0})
    return Estimate.normal("pressures without flow", zero, "Pa", sd, "pressure_in - pressure_out")


def _aic(solution: Solution) -> float:
    """Akaike's criterion for residuals of known standard deviation, in which a zero counts with its prior."""
    zeros = sum((2 * solution.every[n] / limit) ** 2 for n, limit in solution.limits.items())
    return solution.fit.chi_square + 2 * len(solution.fit.names) + zeros


def _findings(square: Solution, flow: Array, along: tuple[Array, str]) -> Iterator[Finding]:
    """Tests of the residual of eq. (1): a C_R that changes with the flow, or in time; zeros; the model."""
    size = np.abs(flow)
    level = square.column("resistance") * (size - size.mean()) / max(float(np.ptp(size)), TINY)
    change, sd = square.effect(level)
    percent = 100 / square.fit["resistance"]
    yield Finding(
        "model",
        balance.probability(change, sd, LEVEL * square.fit["resistance"]),
        f"hose_resistance: C_R of eq. (1) changes by {percent * change:+.3g} +- {percent * sd:.2g} % from "
        "the smallest to the largest flow",
    )
    if abs(float(stats.spearmanr(size, along[0])[0])) < ONE_WAY:  # else time and flow look alike
        yield balance.drift_finding(square, "resistance", [along], "hose_resistance: C_R", given=[level])
    yield from balance.zero_findings(square, "hose_resistance")
    yield balance.model_finding(square, "hose_resistance: eq. (1)")


def panels(steps: StepMeans, fits: Fits) -> tuple[Panel, ...]:
    """Drop over flow with the laws, residual, C_R over flow."""
    good, dead = steps[steps.good], steps[steps.dead]
    flows = np.linspace(0.0, float(np.abs(good.flow).max()), 200)
    drop = [
        Curve("measured", good.flow, good.drop, error=good.drop_error),
        Curve("masked: dead zone of the meter", dead.flow, dead.drop, "masked"),
    ]
    residual = []
    for name in fits:
        label, short = LABELS[name]
        kind: CurveKind = "fit" if name == "square" else "compared"
        error = good.drop_error if name == "square" else None
        drop.append(Curve(label, flows, drop_by(fits, name, flows), kind, line=True))
        left = good.drop - drop_by(fits, name, good.flow)
        residual.append(Curve(short, good.flow, left, kind, error=error))
    constant = np.full_like(flows[1:], fits["square"].fit["resistance"])
    in_range = flows[flows >= np.abs(good.flow).min() / 2]  # eq. (10) has no limit at Q = 0
    power_resistance = fits["power"].fit["factor"] * in_range**-0.25
    resistance = (
        Curve("measured", good.flow, good.resistance, error=good.resistance_error),
        Curve("eq. (1)", flows[1:], constant, "fit", line=True),
        Curve("k Q^-0.25, eq. (10)", in_range, power_resistance, "compared", line=True),
    )
    litres = LITRES_PER_MINUTE
    return (
        Panel("flow", "pressure drop", tuple(drop), "Drop along the hose", litres, BAR),
        Panel("flow", "drop, measured - fitted", tuple(residual), "Residual", litres, BAR),
        Panel("flow", "C_R [Pa.s2/m6]", resistance, "C_R is valid for one flow", litres),
    )


def _others(fits: Fits, zero: Estimate, reference_flow: str) -> Iterator[Estimate]:
    square, power = fits["square"].fit, fits["power"].fit
    yield square.estimate("C_R", UNIT, f"eq. (1), the tested hose at {reference_flow}", "resistance")
    yield zero
    yield power.estimate("k", "Pa/(m3/s)^1.75", "eq. (10), the tested hose", "factor")
    for litres in FLOWS:
        scale = (litres * LITRES_PER_MINUTE[1]) ** -0.25
        note = "k Q^-0.25, eq. (10)"
        yield power.derived(f"C_R({litres:g} L/min)", UNIT, note, "factor", partial(mul, scale))
    if "mixed" in fits:
        mixed, note = fits["mixed"].fit, "Q sqrt(R^2 + (C_R Q)^2)"
        yield mixed.estimate("C_R with laminar part", UNIT, note, "resistance")
        yield mixed.derived("R, laminar part", "Pa.s/m3", note, "laminar_square", math.sqrt)


def _remarks(steps: StepMeans, fits: Fits, zero: Estimate, reference_flow: str) -> Iterator[str]:
    """Steps left out, the better law, the reference flow, the offset, a laminar part, a misfit."""
    if omissions := steps.omissions():
        flat = ", the flat region at the beginning of Fig. 6" if steps.dead.any() else ""
        yield f"Left out of {steps.flow.size} steps: {omissions}{flat}."
    square, power = fits["square"].fit, fits["power"].fit
    one_is_better = _aic(fits["square"]) < _aic(fits["power"])
    order = "Eq. (1) fits better than eq. (10)" if one_is_better else "Eq. (10) fits better than eq. (1)"
    yield (
        f"{order}: chi-square is {square.chi_square:.4g} by eq. (1), {power.chi_square:.4g} by eq. (10), "
        f"with {square.freedom} degrees of freedom."
    )
    yield (
        f"C_R is valid for {reference_flow}, the weighted rms "
        "of the flows. By eq. (10) C_R would fall by 16 % for each doubling of the flow."
    )
    yield from data.pressure_offset_remark(zero)
    if "mixed" in fits:
        yield (
            "The small flows show a laminar part: with Q sqrt(R^2 + (C_R Q)^2) chi-square is "
            f"{fits['mixed'].fit.chi_square:.4g}. The lumped hose has no such term: C_R includes a part of "
            "it."
        )
    yield from balance.misfit_remark(square, "Eq. (1)")
    if "flow" not in fits["square"].limits:
        yield "The description of the flow meter has no `zero_error`: the intervals do not cover its zero."
