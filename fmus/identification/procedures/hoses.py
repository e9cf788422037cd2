"""Hose procedures (section 4(b), (c), Figs. 6, 7): friction, inertance and capacitance of one hose.

A lumped hose, at rest between steps of the flow (`hose_resistance`) and in motion (`hose_dynamics`):

    I dQ/dt = P_in - P_out - R Q - dp(Q)           Q = Q_in + s (Q_out - Q_in)
    C dP/dt = Q_in - Q_out                         P = P_out + r (P_in - P_out)

dp is the friction of the machine (`hose.Friction`): laminar by the viscosity of the oil, above the critical
flow Blasius' law, whose C_R is stated at 170 L/min (correction E10 in docs/equations.md). In steady flow the
viscosity is an unknown if the small flows contradict the known one; in motion R takes what they add to dp.
In the machine s = r = 0; distributed along the hose, both are 1/2. The zeros of the instruments are unknowns,
and so is the delay of a logger if it is clear: 1 ms between the flows is half of C. The results are scaled
to the machine's lines: C_R by eq. (10), I ~ rho l/A, C ~ A l.

Validity: a smooth pipe up to Re 1e5, flows above the dead zone of the meter; in motion, changes below the
frequency of eq. (3), C_0/(2 pi l), above which a hose is not a single lump. Windows of four periods of this
frequency to each side pass what is below a quarter of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial

import casadi as ca
import numpy as np

from fmus.components import hose
from fmus.components.chamber import Liquid
from fmus.identification import balance
from fmus.identification.balance import Law, Samples
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.experiment_data import StepMeans, parameter_value
from fmus.identification.procedures.fit import Fit, Procedure, Quantity, fitted
from fmus.identification.recordings.clock import uniform_rate
from fmus.identification.recordings.masks import good_all
from fmus.identification.results import (
    BAR,
    LITRES_PER_MINUTE,
    Curve,
    Estimate,
    Finding,
    Panel,
    ProcedureResult,
)
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

PRESSURES = {"pressure_in": "Pa", "pressure_out": "Pa"}
STEADY_SIGNALS: Mapping[str, str] = {**PRESSURES, "flow": "m3/s"}
SIGNALS: Mapping[str, str] = {**PRESSURES, "flow_in": "m3/s", "flow_out": "m3/s"}
PAIRS = ("pressure_in", "pressure_out"), ("pressure_out", "flow_out")  # that may share a logger
UNKNOWNS = {False: ("C_R", "viscosity"), True: ("I", "C", "C_R", "R", "s", "r")}  # steady, in motion
UNITS = {"C_R": "Pa.s2/m6", "I": "kg/m4", "C": "m3/Pa"}
FLOWS = (60.0, 100.0, 200.0, 300.0)  # L/min, at which C_R by Blasius' law is reported
REFERENCE = f"{hose.REFERENCE_FLOW / LITRES_PER_MINUTE[1]:.0f} L/min"
AXES = ("boom_stick.stick_hose", "boom_stick.boom_hose")
STARTS = (-1.0, 0.0, 1.0, 2.0)  # of the logarithm of the viscosity over the known one, in its search
THINNEST, THICKEST = -3.0, 3.0  # of it, in a search that diverges
FURTHER = 12.0  # by which the chi-square of a free viscosity is less: 1 in 2000 by chance
TINY = 1e-30  # (m3/s)^4, avoids a division by the zero variance of equal flows
MIN_STEPS = 4  # fewer steps do not tell the viscosity from a zero
LEVEL = 0.02  # of C_R: a change over the flows that is no contradiction, the bar of the project for a value
EQUAL = ("I", "C")  # in all recordings of a hose
PERIODS = 4.0  # half width of the windows, in periods of the frequency of eq. (3)
SAMPLES_PER_PERIOD = 2.5  # minimum, above Nyquist's two
MIN_WINDOWS = 20  # per recording: fewer do not determine six unknowns
LOGGERS = (*PAIRS, *((name,) for name in SIGNALS))
POSITION = 1.0  # standard deviation of the prior of s and r, which are between 0 and 1


@lru_cache(maxsize=2)
def hose_law(moving: bool) -> Law:
    """The equations of a hose; known are its length and bore, density and viscosity of the oil.

    C_R is that at the known viscosity. Unknown is also the logarithm of the true viscosity over it.
    """
    z, known = ca.SX.sym("z", 4 if moving else 3), ca.SX.sym("known", 4)
    p_in, p_out, q_in, q_out = ca.vertsplit(ca.vertcat(z, *(() if moving else (z[2],))))
    length, bore, density, viscosity = ca.vertsplit(known)
    u = {name: ca.SX.sym(name) for name in UNKNOWNS[moving]}
    thicker = ca.exp(ca.fmax(THINNEST, ca.fmin(u.get("viscosity", 0), THICKEST)))
    oil = Liquid(density=density, viscosity=viscosity * thicker)
    own = hose.scaled_resistance(u["C_R"], 1, 1, thicker)
    friction = hose.Friction.of(hose.HoseSize(length=length, bore=bore), own, oil)
    if not moving:
        return balance.law(z, u, known, p_in - p_out - friction.drop(q_in))
    flow, pressure = q_in + u["s"] * (q_out - q_in), p_out + u["r"] * (p_in - p_out)
    drop = p_in - p_out - u["R"] * flow - friction.drop(flow)
    return balance.law(
        z, u, known, ca.vertcat(drop, q_in - q_out), ca.vertcat(u["I"] * flow, u["C"] * pressure)
    )


def _constants(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> tuple[float, ...]:
    """Length and bore of the tested hose, density and viscosity of its oil."""
    oil = (
        data.stated(recordings[0], n) or parameter_value(parameters, f"boom_stick.{n}")
        for n in ("density", "viscosity")
    )
    return *data.hose_size(recordings), *oil


def _result(
    fit: Fit, name: str, figure: int, known: tuple[float, ...], wanted: Sequence[Quantity], law: str
) -> ProcedureResult:
    length, bore, density, viscosity = known
    return ProcedureResult(
        procedure=name,
        title=f"{name.replace('_', ' ').capitalize()}: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=figure,
        estimates=fit.estimates(wanted),
        panels=(),
        remarks=(
            *fit.remarks(wanted, law),
            f"Known: density {density:.4g} kg/m3, viscosity {viscosity:.4g} Pa.s.",
        ),
        others=tuple(
            fit.estimate(Quantity(n, UNITS[n], n, "the tested hose"))
            for n in UNITS
            if n in fit.solution.fit.names
        ),
    )


# ---- steady flow: C_R ----------------------------------------------------------------------------------


def identify_resistance(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """C_R of the stick's and the boom's hoses from that of the tested hose."""
    tests = data.training_recordings(recordings, "hose_resistance", STEADY_SIGNALS)
    known, (steps, along) = _constants(tests, parameters), _steps(tests)
    fit = _steady_fit(tests, steps, along, known)
    zero, sd = fit.solution.every.combination({"pressure_in": 1.0, "pressure_out": -1.0})
    offset = Estimate.normal("pressures without flow", zero, "Pa", sd, "pressure_in - pressure_out")
    to_density = data.density_ratio(tests, parameters)
    wanted = []
    for axis in AXES:
        size = tuple(parameter_value(parameters, f"{axis}_{n}") for n in ("length", "bore"))
        factor = float(hose.scaled_resistance(to_density**0.75, size[0] / known[0], size[1] / known[1]))
        note = f"Blasius, section 4(b), at {REFERENCE}"
        if abs(factor - 1) > 1e-9:
            note += f", eq. (10) from {known[0]:g} m to {size[0]:g} m, {size[1] * 1e3:.4g} mm"
        wanted.append(Quantity(f"{axis}_resistance", UNITS["C_R"], "C_R", note, factor))
    result = _result(fit, "hose_resistance", 6, known, wanted, "The hose's law")
    at = [(q, (hose.REFERENCE_FLOW / (q * LITRES_PER_MINUTE[1])) ** 0.25) for q in FLOWS]
    blasius = (
        Quantity(f"C_R({q:g} L/min)", UNITS["C_R"], "C_R", "Blasius, where the flow is turbulent", factor)
        for q, factor in at
    )
    ratio, note = list[Estimate](), "of the tested oil over the known one, by the small flows"
    if told := "viscosity" in fit.solution.fit.names:
        ratio = [fit.solution.fit.derived("viscosity ratio", "1", note, "viscosity", math.exp)]
    return replace(
        result,
        panels=_resistance_panels(steps.without_zero(zero), fit),
        remarks=(
            *_resistance_remarks(steps, fit, told),
            *data.pressure_offset_remark(offset),
            *result.remarks,
        ),
        others=(*result.others, offset, *map(fit.estimate, blasius), *ratio),
        findings=tuple(_resistance_findings(fit)),
    )


def _steps(tests: Sequence[Recording]) -> tuple[StepMeans, tuple[Array, str]]:
    """The steps of the flow, and their `course`."""
    means, along, word = list[StepMeans](), list[Array](), ""
    for test in tests:
        stretches = data.steady_stretches(test, ["flow"])
        if not stretches:
            expected = f"expected a steady flow for {data.SHORTEST_STRETCH:g} s or longer, got none"
            raise Problem(f"{test.source}: flow: {expected}")
        means.append(data.step_means(test, stretches))
        values, word = data.course(test, stretches)
        along.append(values)
    steps = data.concatenate(means)
    if (count := np.count_nonzero(steps.good)) < MIN_STEPS:
        raise Problem(
            f"hose_resistance: expected at least {MIN_STEPS} steady steps, got {count}; "
            f"left out of {steps.flow.size} steps: {steps.omissions() or 'none'}"
        )
    return steps, (np.concatenate(along)[steps.good], word)


def _steady_fit(
    tests: Sequence[Recording],
    steps: StepMeans,
    along: tuple[Array, str],
    known: tuple[float, ...],
) -> Fit:
    good = steps[steps.good]
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
    samples = balance.samples_of(hose_law(False), STEADY_SIGNALS, means, errors, known)
    limits = data.zero_limits(tests, PRESSURES) | data.declared_limits(tests, ["flow"])
    solve = partial(balance.solve, [samples], label="hose_resistance", limits=limits)
    solution = solve({"C_R": start, "viscosity": 0.0}, tested=["viscosity"])
    for x in STARTS if solution.fit.misfit else ():
        with suppress(Problem):  # with a viscosity that is far off
            other = solve({"C_R": start / math.exp(x / 4), "viscosity": x})
            # else a misfit of another cause, such as a drift, would be taken for a viscosity
            told = other.fit.sd("viscosity") < balance.DETERMINED and other.fit.significant("viscosity")
            if told and other.cost < solution.cost - FURTHER:
                solution = other
    return Fit("hose_resistance", tests, STEADY_SIGNALS, solution, [along])


def _resistance_findings(fit: Fit) -> Iterator[Finding]:
    """The tests of all procedures, and whether C_R changes with the flow."""
    flow = np.abs(fit.solution.samples[0].raw[2])
    level = fit.solution.column("C_R") * (flow - flow.mean()) / (float(np.ptp(flow)) or 1.0)
    change, sd = fit.solution.effect(level)
    percent = 100 / fit["C_R"]
    yield Finding(
        "model",
        balance.probability(change, sd, LEVEL * fit["C_R"]),
        f"hose_resistance: C_R changes by {percent * change:+.3g} +- {percent * sd:.2g} % from "
        "the smallest to the largest flow",
    )
    yield from fit.findings({"C_R": "C_R"}, given=[level])


def _resistance_remarks(steps: StepMeans, fit: Fit, told: bool) -> Iterator[str]:
    if omissions := steps.omissions():
        flat = ", the flat region at the beginning of Fig. 6" if steps.dead.any() else ""
        yield f"Left out of {steps.flow.size} steps: {omissions}{flat}."
    yield f"C_R is valid for {REFERENCE}. It falls by 16 % for each doubling of the flow."
    if told:
        yield (
            f"The small flows are those of {math.exp(fit['viscosity']):.3g} times the viscosity. C_R is "
            "converted to the machine's oil by eq. (10)."
        )
    if "flow" not in fit.solution.limits:
        yield "The description of the flow meter has no `zero_error`: the intervals do not cover its zero."


def _resistance_panels(steps: StepMeans, fit: Fit) -> tuple[Panel, Panel]:
    """Drop over flow with the law, and the residual."""
    good, dead = steps[steps.good], steps[steps.dead]
    flows = np.linspace(0.0, float(np.abs(good.flow).max()), 200)
    sample, solution = fit.solution.samples[0], fit.solution.fit
    theta = np.array([solution[n] if n in solution.names else 0.0 for n in sample.names])
    none = np.zeros_like(flows)
    drop = -np.array(sample.law.terms(np.array([none, none, flows]), theta, sample.known)[0])[0]
    curves = (
        Curve("measured", good.flow, good.drop, error=good.drop_error),
        Curve("masked: dead zone of the meter", dead.flow, dead.drop, "masked"),
        Curve("laminar to turbulent", flows, drop, "fit", line=True),
    )
    left = Curve("measured - fit", good.flow, fit.residual(), error=good.drop_error)
    panel = Panel("flow", "pressure drop", curves, "Drop along the hose", LITRES_PER_MINUTE, BAR)
    return panel, replace(panel, y_label="residual", title="", curves=(left,))


# ---- flow in motion: I and C ---------------------------------------------------------------------------


def identify_dynamics(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Inertance and capacitance of the stick's, the boom's and the swing's lines from the tested hose."""
    tests = data.training_recordings(recordings, "hose_dynamics", SIGNALS)
    known = _constants(tests, parameters)
    length, bore, density, _ = known
    modulus = parameter_value(parameters, "boom_stick.bulk_modulus")
    half_width = PERIODS / float(hose.frequency_limit(length, density, modulus))
    for test in tests:
        _check(test, half_width, known)
    resistance, size = (parameter_value(parameters, f"{AXES[0]}_{n}") for n in ("resistance", "length"))
    width = parameter_value(parameters, f"{AXES[0]}_bore")
    start = {
        "I": float(hose.inertance(length, bore, density)),
        "C": float(hose.capacitance(length, bore, modulus)),
        "C_R": float(hose.scaled_resistance(resistance, length / size, bore / width)),
        **dict.fromkeys(("R", "s", "r"), 0.0),
    }
    solve = partial(
        fitted,
        signals=SIGNALS,
        prepare=partial(prepared, half_width=half_width, known=known),
        start=start,
        priors=dict.fromkeys(("s", "r"), POSITION),
        limits=data.zero_limits(tests, SIGNALS),
        loggers=LOGGERS,
    )
    fit = solve("hose_dynamics", tests)
    for name in ("I", "C"):
        if fit[name] < -balance.SIGNIFICANT * fit.sd(name):
            files = ", ".join(str(test.source) for test in tests)
            raise Problem(
                f"{files}: {name}: expected positive, got {fit[name]:.3g}: change the sign of the "
                "flows, or exchange the two pressures"
            )
    wanted = list(_lines(parameters, known, data.density_ratio(tests, parameters)))
    result = _result(fit.widened(EQUAL), "hose_dynamics", 7, known, wanted, "The hose's law")
    sides = (
        ("dQ/dt [m3/s2]", "drop without friction", BAR),
        ("dP/dt [Pa/s]", "flow stored", LITRES_PER_MINUTE),
    )
    panels = (
        fit.line(Panel(x, y, (), "Filtered equation", y_unit=unit), name, row)
        for row, (name, (x, y, unit)) in enumerate(zip(("I", "C"), sides, strict=True))
    )
    positions = (("s", "outlet", "flow"), ("r", "inlet", "pressure"))
    return replace(
        result,
        panels=tuple(p for both in panels for p in both),
        others=(
            *result.others,
            *(
                fit.estimate(Quantity(f"weight of the {end}'s {x}", "1", n, "0 lumped, 1/2 distributed"))
                for n, end, x in positions
            ),
        ),
        findings=tuple(fit.findings({"C_R": "the resistance"}, equal=EQUAL)),
    )


def _lines(parameters: Mapping[str, Number], known: tuple[float, ...], density: float) -> Iterator[Quantity]:
    """The machine's lines by I ~ rho l/A and C ~ A l."""
    for name, quantity in (("I", "inertance"), ("C", "capacitance")):
        for line in (*AXES, *(["swing.line"] if name == "I" else [])):
            length, bore = (parameter_value(parameters, f"{line}_{n}") for n in ("length", "bore"))
            ratio, area = length / known[0], float(hose.area(bore) / hose.area(known[1]))
            factor = density * ratio / area if name == "I" else ratio * area
            note = "regression over windows, section 4(c)"
            if abs(factor - 1) > 1e-9:
                note += f", times {factor:.4g} for {length:g} m, {bore * 1e3:.4g} mm and the machine's oil"
            yield Quantity(f"{line}_{quantity}", UNITS[name], name, note, factor)


def _check(test: Recording, half_width: float, known: tuple[float, ...]) -> None:
    """Refuse constant flows, meters that count in opposite directions, too few samples."""
    ends = np.array([test[name] for name in ("flow_in", "flow_out")])
    inlet, outlet = ends[:, np.isfinite(ends).all(axis=0)]
    if inlet.size and not np.ptp(inlet) > 0:
        raise Problem(f"{test.source}: flow_in: expected fast changes of flow and pressure, got a constant")
    if inlet @ outlet < 0:
        raise Problem(
            f"{test.source}: flow_in, flow_out: expected both positive from inlet to outlet, got "
            "opposite signs"
        )
    rate, limit = uniform_rate(test), PERIODS / half_width
    if rate < SAMPLES_PER_PERIOD * limit:
        raise Problem(
            f"{test.source}: sampling rate: expected {SAMPLES_PER_PERIOD * limit:.0f} Hz or more, got "
            f"{rate:.0f} Hz: the hose oscillates at up to {limit:.0f} Hz, which would be aliased"
        )
    if (windows := prepared(test, half_width, known).starts.size) < MIN_WINDOWS:
        raise Problem(
            f"{test.source}: {windows} windows without a bad sample (gap, clipped, dead zone), "
            f"expected at least {MIN_WINDOWS}"
        )


def prepared(recording: Recording, half_width: float, known: Sequence[float]) -> Samples:
    """The four signals of a recording over windows of good samples."""
    rate = uniform_rate(recording)
    bump, slope = balance.modulating_function(max(round(half_width * rate), 3), rate)
    raw = np.array([recording.interpolated(n) for n in SIGNALS])
    noise = np.array([data.noise_sd(recording, n) for n in SIGNALS])
    samples = balance.samples_of(hose_law(True), SIGNALS, raw, noise, known)
    starts = balance.window_starts(good_all(recording, SIGNALS), bump.size)
    return replace(samples, rate=rate, bump=bump, slope=slope, starts=starts)


HOSE_RESISTANCE = Procedure("hose_resistance", STEADY_SIGNALS, identify_resistance)
HOSE_DYNAMICS = Procedure("hose_dynamics", SIGNALS, identify_dynamics)
