"""Hose resistance procedure (section 4(b), Fig. 6): pressure drop along a hose at stepped flows.

    P_in - P_out = dp(Q) of `hose.Friction`        P_in - P_out = C_R Q|Q|, eq. (1)

The first is the law of the machine: laminar flow by the known viscosity of the oil, above the critical flow
Blasius' law, whose C_R is stated at 170 L/min (correction E10 in docs/equations.md). Eq. (1) is compared with
it. Both are fitted to the means over the steps (`balance`), with the errors of drop and flow; AIC shows which
law the data support. If both are misfits and the small flows are clearly those of another viscosity, it is
estimated, too.

The readings of two transducers differ slightly without flow, and a tenth of a bar is a hundredth of a hose's
drop: the zeros of the transducers and of the meter are estimated with each law.

Validity: steady flow above the dead zone of the meter; a smooth pipe, up to Re 1e5.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy import stats

from fmus.components import hose
from fmus.components.chamber import Liquid
from fmus.contract import Scalar
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
FLOWS = (60.0, 100.0, 200.0, 300.0)  # L/min, at which C_R by Blasius' law is reported
UNIT = "Pa.s2/m6"
REFERENCE = f"{hose.REFERENCE_FLOW / LITRES_PER_MINUTE[1]:.0f} L/min"
LABELS: Mapping[str, tuple[str, CurveKind]] = {  # of the laws in the panels
    "machine": ("laminar to turbulent", "fit"),
    "square": ("C_R Q|Q|, eq. (1)", "compared"),
    "viscosity": ("viscosity fitted", "compared"),
}
TINY = 1e-30  # (m3/s)^4, avoids a division by the zero variance of equal flows
RATIOS = tuple(2.0 ** (k / 4) for k in range(-8, 13))  # of viscosities with which a search begins
MIN_STEPS = 4  # fewer steps cannot distinguish between the laws
LEVEL = 0.02  # of C_R: a change over the flows that is no contradiction, the bar of the project for a value
ONE_WAY = 0.9  # rank correlation of flow and time from which on a change in time cannot be told
Fits = Mapping[str, Solution]  # by each law; "viscosity" only if the others are misfits and it is better


@lru_cache(maxsize=1)
def laws() -> Mapping[str, balance.Law]:
    """The drop as the machine simulates it, by eq. (1), and the former with another viscosity.

    Known are length and bore of the hose, density and viscosity of the oil; C_R is that at this viscosity.
    The logarithm of the viscosity over it is unknown in the third law.
    """
    z, known = ca.SX.sym("z", 3), ca.SX.sym("known", 4)
    length, bore, density, nominal = ca.vertsplit(known)
    size = hose.HoseSize(length=length, bore=bore)
    u = {name: ca.SX.sym(name) for name in ("resistance", "thicker")}

    thicker = ca.fmax(-3, ca.fmin(u["thicker"], 3))  # finite in a search that diverges

    def machine(viscosity: ca.SX) -> Scalar:
        own = hose.scaled_resistance(u["resistance"], 1, 1, viscosity / nominal)
        return hose.Friction.of(size, own, Liquid(density=density, viscosity=viscosity)).drop(z[2])

    forms = {
        "machine": (("resistance",), machine(nominal)),
        "square": (("resistance",), u["resistance"] * z[2] * ca.fabs(z[2])),
        "viscosity": (("resistance", "thicker"), machine(nominal * ca.exp(thicker))),
    }
    return {
        name: balance.law(z, {n: u[n] for n in unknowns}, known, z[0] - z[1] - drop)
        for name, (unknowns, drop) in forms.items()
    }


def drop_by(fits: Fits, name: str, flow: Array) -> Array:
    """Drop [Pa] by one of the laws at flows [m3/s]."""
    readings, known = np.outer([0.0, 0.0, 1.0], flow), fits[name].samples[0].known
    return np.asarray(-laws()[name].terms(readings, fits[name].fit.values, known)[0].full()[0])


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
    length, bore = data.hose_size(tests)
    density, viscosity = (parameter_value(parameters, f"boom_stick.{n}") for n in ("density", "viscosity"))
    to_density = data.density_ratio(tests, parameters)
    fits = fit_laws(steps, (length, bore, density / to_density, viscosity), limits)
    found, zero = fits.get("viscosity", fits["machine"]), zero_of(fits)
    estimates = []
    for axis in ("stick", "boom"):
        size = tuple(parameter_value(parameters, f"boom_stick.{axis}_hose_{n}") for n in ("length", "bore"))
        factor = float(hose.scaled_resistance(to_density**0.75, size[0] / length, size[1] / bore))
        note = f"Blasius, section 4(b), at {REFERENCE}"
        if abs(factor - 1) > 1e-9:
            note += f", eq. (10) from {length:g} m to {size[0]:g} m, {size[1] * 1e3:.4g} mm"
        name = f"boom_stick.{axis}_hose_resistance"
        estimates.append(found.fit.estimate(name, UNIT, note, "resistance", factor))
    return ProcedureResult(
        procedure="hose_resistance",
        title=f"Hose resistance: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=6,
        estimates=tuple(estimates),
        panels=panels(steps.without_zero(zero.value), fits),
        remarks=(
            *_remarks(steps, fits, zero),
            data.constants_remark(tests, parameters, "density", "viscosity"),
        ),
        others=tuple(_others(fits, zero)),
        findings=(
            *_findings(found, steps[steps.good].flow, (along[steps.good], word)),
            *data.signal_findings(tests, SIGNALS, "hose_resistance"),
        ),
    )


def fit_laws(steps: StepMeans, known: tuple[float, float, float, float], limits: Mapping[str, float]) -> Fits:
    """All laws, fitted to the measured steps.

    known    length and bore of the hose, density and viscosity of the oil
    limits   largest errors of the zeros
    """
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
    none = np.zeros_like(good.drop)
    # only the difference of the pressures counts, so that at the outlet is taken as zero
    means, errors = np.array([good.drop, none, good.flow]), np.array([good.drop_error, none, good.flow_error])

    def fitted(name: str, ratio: float = 1.0, **initial: float) -> Solution:
        constants = (*known[:3], ratio * known[3])
        samples = balance.samples_of(laws()[name], SIGNALS, means, errors, constants)
        return balance.solve([samples], initial, "hose_resistance", limits)

    fits = {name: fitted(name, resistance=start) for name in ("machine", "square")}
    if all(solution.fit.misfit for solution in fits.values()):
        near = {1.0: fits["machine"]}
        with suppress(Problem):  # all flows are laminar
            for x in RATIOS:
                near[x] = fitted("machine", x, resistance=start)
        with suppress(Problem):  # data that contradict this law may have no optimum
            x = min(near, key=lambda x: near[x].fit.chi_square)
            other = fitted("viscosity", resistance=near[x].fit["resistance"] / x**0.25, thicker=math.log(x))
            sd, better = other.fit.sd("thicker"), _aic(other) < min(map(_aic, fits.values()))
            # else a misfit of another cause, such as a drift, would be taken for a viscosity
            significant = abs(other.fit["thicker"]) > balance.SIGNIFICANT * sd
            if better and significant and sd < balance.DETERMINED:
                fits["viscosity"] = other
    return fits


def zero_of(fits: Fits) -> Estimate:
    """Pressure difference without flow by the best law."""
    best = min(fits.values(), key=_aic)
    zero, sd = best.every.combination({"pressure_in": 1.0, "pressure_out": -1.0})
    return Estimate.normal("pressures without flow", zero, "Pa", sd, "pressure_in - pressure_out")


def _aic(solution: Solution) -> float:
    """Akaike's criterion for residuals of known standard deviation, in which a zero counts with its prior."""
    return solution.cost + 2 * len(solution.fit.names)


def _findings(found: Solution, flow: Array, along: tuple[Array, str]) -> Iterator[Finding]:
    """Tests of the residual: a C_R that changes with the flow, or in time; zeros; the model."""
    size = np.abs(flow)
    level = found.column("resistance") * (size - size.mean()) / max(float(np.ptp(size)), TINY)
    change, sd = found.effect(level)
    percent = 100 / found.fit["resistance"]
    yield Finding(
        "model",
        balance.probability(change, sd, LEVEL * found.fit["resistance"]),
        f"hose_resistance: C_R changes by {percent * change:+.3g} +- {percent * sd:.2g} % from "
        "the smallest to the largest flow",
    )
    if abs(float(stats.spearmanr(size, along[0])[0])) < ONE_WAY:  # else time and flow look alike
        yield balance.drift_finding(found, "resistance", [along], "hose_resistance: C_R", given=[level])
    yield from balance.zero_findings(found, "hose_resistance")
    yield balance.model_finding(found, "hose_resistance")


def panels(steps: StepMeans, fits: Fits) -> tuple[Panel, ...]:
    """Drop over flow with the laws, residual, C_R over flow."""
    good, dead = steps[steps.good], steps[steps.dead]
    flows = np.linspace(0.0, float(np.abs(good.flow).max()), 200)
    drop = [
        Curve("measured", good.flow, good.drop, error=good.drop_error),
        Curve("masked: dead zone of the meter", dead.flow, dead.drop, "masked"),
    ]
    residual = []
    resistance = [Curve("measured", good.flow, good.resistance, error=good.resistance_error)]
    in_range = flows[flows >= np.abs(good.flow).min() / 2]  # laminar flow has no limit at Q = 0
    for name in fits:
        label, kind = LABELS[name]
        error = good.drop_error if kind == "fit" else None
        drop.append(Curve(label, flows, drop_by(fits, name, flows), kind, line=True))
        left = good.drop - drop_by(fits, name, good.flow)
        residual.append(Curve(label, good.flow, left, kind, error=error))
        ratio = drop_by(fits, name, in_range) / in_range**2
        resistance.append(Curve(label, in_range, ratio, kind, line=True))
    litres = LITRES_PER_MINUTE
    return (
        Panel("flow", "pressure drop", tuple(drop), "Drop along the hose", litres, BAR),
        Panel("flow", "drop, measured - fitted", tuple(residual), "Residual", litres, BAR),
        Panel("flow", "C_R [Pa.s2/m6]", tuple(resistance), "C_R is valid for one flow", litres),
    )


def _others(fits: Fits, zero: Estimate) -> Iterator[Estimate]:
    found = fits.get("viscosity", fits["machine"]).fit
    yield found.estimate("C_R", UNIT, f"the tested hose at {REFERENCE}", "resistance")
    yield zero
    for litres in FLOWS:
        factor = (hose.REFERENCE_FLOW / (litres * LITRES_PER_MINUTE[1])) ** 0.25
        note = "Blasius, where the flow is turbulent"
        yield found.estimate(f"C_R({litres:g} L/min)", UNIT, note, "resistance", factor)
    yield fits["square"].fit.estimate("C_R by eq. (1)", UNIT, "the tested hose, all flows", "resistance")
    if "viscosity" in fits:
        note = "of the tested oil over that of the machine's, by the small flows"
        yield found.derived("viscosity ratio", "1", note, "thicker", math.exp)


def _remarks(steps: StepMeans, fits: Fits, zero: Estimate) -> Iterator[str]:
    """Steps left out, the better law, the reference flow, the offset, another viscosity, a misfit."""
    if omissions := steps.omissions():
        flat = ", the flat region at the beginning of Fig. 6" if steps.dead.any() else ""
        yield f"Left out of {steps.flow.size} steps: {omissions}{flat}."
    machine, square = fits["machine"].fit, fits["square"].fit
    better = "Eq. (1)" if _aic(fits["square"]) < _aic(fits["machine"]) else "The machine's law"
    yield (
        f"{better} fits better: chi-square is {square.chi_square:.4g} by eq. (1), {machine.chi_square:.4g} "
        f"by the machine's law, with {square.freedom} degrees of freedom."
    )
    yield f"C_R is valid for {REFERENCE}. It falls by 16 % for each doubling of the flow."
    yield from data.pressure_offset_remark(zero)
    if "viscosity" in fits:
        other = fits["viscosity"].fit
        yield (
            f"The small flows are those of {math.exp(other['thicker']):.3g} times the viscosity: with it "
            f"chi-square is {other.chi_square:.4g}. C_R is converted to the machine's oil by eq. (10)."
        )
    yield from balance.misfit_remark(fits.get("viscosity", fits["machine"]).fit, "The hose's law")
    if "flow" not in fits["square"].limits:
        yield "The description of the flow meter has no `zero_error`: the intervals do not cover its zero."
