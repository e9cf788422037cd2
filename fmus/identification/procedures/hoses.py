"""Hose procedures of one hose on a bench: its friction in steady flow, its dynamics with moving flows.

Resistance (section 4(b), eqs. (1), (10), Fig. 6):

    P_in - P_out = dp(Q)

dp is the friction of the machine (`hose.Friction`): laminar by the viscosity of the oil, above the critical
flow Blasius' law, whose C_R is stated at 170 L/min (correction E10 in docs/equations.md). The viscosity is an
unknown if the small flows contradict the known one, and so are the zeros of the instruments. C_R is scaled to
the machine's hoses by eq. (10). Validity: a smooth pipe up to Re 1e5, flows above the dead zone of the meter.

Inertance and capacitance (section 4(c), Fig. 7):

    I dQ/dt = P_in - P_out - R Q - dp(Q)           Q = Q_in + s (Q_out - Q_in)
    C dP/dt = Q_in - Q_out                         P = P_out + r (P_in - P_out)

R takes what the small flows add to dp. In the machine s = r = 0; distributed along the hose, both are 1/2.
The zeros of the instruments are unknowns, and so is the delay of a logger if it is clear: 1 ms between the
flows is half of C. The machine's lines have I ~ rho l/A, C ~ A l. Validity: changes below the frequency of
eq. (3), C_0/(2 pi l), above which a hose is not a single lump. Windows of four periods of this frequency to
each side pass what is below a quarter of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from fmus.components import hose
from fmus.components.chamber import Liquid
from fmus.identification import balance
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.experiment_data import parameter_value
from fmus.identification.procedures.procedure import (
    Fit,
    Parameters,
    Parts,
    Procedure,
    Quantity,
    Recordings,
    law_of,
    window_samples,
)
from fmus.identification.recordings.clock import uniform_rate
from fmus.identification.results import BAR, LITRES_PER_MINUTE, Curve, Estimate, Finding, Panel
from orchestrator.base.errors import Problem
from orchestrator.data.table import Array

Factor = Callable[[float, float], float]  # of the ratios of length and bore
AXES = ("boom_stick.stick_hose", "boom_stick.boom_hose")
UNITS = {"C_R": "Pa.s2/m6", "I": "kg/m4", "C": "m3/Pa"}
WIDEST = 3.0  # of the logarithm of a viscosity over the known one, in a search that diverges


@dataclass(frozen=True)
class TestedHose:
    """Size of a tested hose [m], density and viscosity of its oil."""

    length: float
    bore: float
    density: float
    viscosity: float
    parameters: Parameters

    @classmethod
    def of(cls, tests: Recordings, parameters: Parameters) -> TestedHose:
        """As the recordings state it; an oil that they do not state is the machine's."""
        length, bore = (data.one_size(tests, n) for n in ("length", "diameter"))
        density, viscosity = (
            data.stated(tests[0], n) or parameter_value(parameters, f"boom_stick.{n}")
            for n in ("density", "viscosity")
        )
        return cls(length, bore, density, viscosity, parameters)

    @property
    def size(self) -> str:
        """For a title."""
        return f"{self.length:g} m, bore {self.bore * 1e3:.4g} mm"

    @property
    def to_density(self) -> float:
        """Density of the machine's oil over that of the tested oil."""
        return parameter_value(self.parameters, "boom_stick.density") / self.density

    @property
    def frequency(self) -> float:
        """Of eq. (3), above which it is no single lump [Hz]."""
        modulus = parameter_value(self.parameters, "boom_stick.bulk_modulus")
        return float(hose.frequency_limit(self.length, self.density, modulus))

    @property
    def constants(self) -> tuple[float, ...]:
        """Those of the law."""
        return self.length, self.bore, self.density, self.viscosity

    def scaled(
        self, quantity: str, unknown: str, lines: Sequence[str], factor: Factor, note: str, scaling: str
    ) -> list[Quantity]:
        """A quantity of the machine's lines: `factor` of the ratios of length and bore times the unknown.

        scaling   format of what is added to the note if that is not 1
        """
        found = []
        for line in lines:
            length, bore = (parameter_value(self.parameters, f"{line}_{n}") for n in ("length", "bore"))
            ratio, size = factor(length / self.length, bore / self.bore), f"{length:g} m, {bore * 1e3:.4g} mm"
            how = note + scaling.format(ratio=ratio, size=size, own=self) * (abs(ratio - 1) > 1e-9)
            found.append(Quantity(f"{line}_{quantity}", UNITS[unknown], unknown, how, ratio))
        return found

    def remark(self) -> str:
        """What was taken as known."""
        return f"Known: density {self.density:.4g} kg/m3, viscosity {self.viscosity:.4g} Pa.s."


def friction(own: Any, known: Sequence[Any], thicker: Any = 0.0) -> hose.Friction:
    """The friction of a hose with C_R at the known viscosity, in an oil that is exp(thicker) times it.

    known   `TestedHose.constants`
    """
    length, bore, density, viscosity = known
    ratio = ca.exp(ca.fmax(-WIDEST, ca.fmin(thicker, WIDEST)))
    oil = Liquid(density=density, viscosity=viscosity * ratio)
    scaled = hose.scaled_resistance(own, 1, 1, ratio)
    return hose.Friction.of(hose.HoseSize(length=length, bore=bore), scaled, oil)


# ---- resistance

STEADY = {"pressure_in": "Pa", "pressure_out": "Pa", "flow": "m3/s"}
MIN_STEPS = 4  # fewer steps of a flow do not tell a viscosity from a zero
REFERENCE = f"{hose.REFERENCE_FLOW / LITRES_PER_MINUTE[1]:.0f} L/min"
STARTS = (-1.0, 0.0, 1.0, 2.0)  # of the logarithm of the viscosity over the known one, in its search
FURTHER = 12.0  # by which the chi-square of a free viscosity is less: 1 in 2000 by chance
TINY = 1e-30  # (m3/s)^4, avoids a division by the zero variance of equal flows
LEVEL = 0.02  # of C_R: a change over the flows that is no contradiction, the bar of the project for a value


def drop(p_in: Any, p_out: Any, flow: Any, u: Any, *known: Any) -> Any:
    """The law."""
    return ((p_in - p_out - friction(u.C_R, known, u.viscosity).drop(flow),),)


def _steps(_: Recordings, known: Any) -> Parts:
    tested, steps, along = known
    good, law = steps[steps.good], law_of(drop, len(STEADY), ("C_R", "viscosity"), 4)
    return [(balance.samples_of(law, STEADY, good.means, good.errors, tested.constants), along)]


def _turbulent(known: Any, thicker: float = 0.0) -> dict[str, float]:
    """C_R as if all flows were turbulent, and the logarithm of the viscosity over the known one."""
    inlet, outlet, flow = known[1].means[:, known[1].good]
    turbulent = flow * np.abs(flow)
    start = float(np.cov(turbulent, inlet - outlet)[0, 1] / max(np.var(turbulent, ddof=1), TINY))
    if start <= 0:
        raise Problem(
            f"hose_resistance: the drop pressure_in - pressure_out falls with the flow, C_R = {start:.3g}: "
            "change the sign of the flow, or exchange the two pressures"
        )
    return {"C_R": start / math.exp(thicker / 4), "viscosity": thicker}


def _refined(fit: Fit, again: Callable[[Procedure], Fit]) -> Fit:
    """With the viscosity as an unknown, if that explains the data far better and they tell it.

    Else a misfit of another cause, such as a drift, would be taken for a viscosity.
    """
    for thicker in STARTS if fit.solution.fit.misfit else ():
        with suppress(Problem):  # with a viscosity that is far off
            other = again(replace(fit.procedure, tested=(), start=partial(_turbulent, thicker=thicker)))
            found = other.solution.fit
            told = found.sd("viscosity") < balance.DETERMINED and found.significant("viscosity")
            if told and other.solution.cost < fit.solution.cost - FURTHER:
                fit = other
    return fit


def _resistances(fit: Fit) -> list[Quantity]:
    """Those of the machine's hoses."""
    tested: TestedHose = fit.known[0]
    thicker = tested.to_density**0.75
    return tested.scaled(
        *("resistance", "C_R", AXES),
        lambda length, bore: float(hose.scaled_resistance(thicker, length, bore)),
        *(f"Blasius, section 4(b), at {REFERENCE}", ", eq. (10) from {own.length:g} m to {size}"),
    )


def _of_tested(fit: Fit) -> Iterator[Estimate]:
    """C_R of the tested hose, and what was estimated with it."""
    yield fit.estimate(Quantity("C_R", UNITS["C_R"], "C_R", "the tested hose"))
    yield data.pressure_offset(fit.solution)
    if "viscosity" in fit.solution.fit.names:
        note = "of the tested oil over the known one, by the small flows"
        yield fit.derived("viscosity ratio", "1", note, "viscosity", math.exp)


def _by_flow(fit: Fit) -> Array:
    """The column of a C_R that changes with the flow."""
    return fit.over("C_R", np.abs(fit.solution.samples[0].raw[2]))


def _findings(fit: Fit) -> Iterator[Finding]:
    change, sd = fit.solution.effect(_by_flow(fit))
    percent = 100 / fit["C_R"]
    yield Finding(
        "model",
        balance.probability(change, sd, LEVEL * fit["C_R"]),
        f"hose_resistance: C_R changes by {percent * change:+.3g} +- {percent * sd:.2g} % from "
        "the smallest to the largest flow",
    )


def _remarks(fit: Fit) -> Iterator[str]:
    tested, steps, _ = fit.known
    if omissions := steps.omissions():
        flat = ", the flat region at the beginning of Fig. 6" if steps.dead.any() else ""
        yield f"Left out of {steps.good.size} steps: {omissions}{flat}."
    yield f"C_R is valid for {REFERENCE}. With the flow it falls as Q^(-1/4), by 16 % for each doubling."
    if "viscosity" in fit.solution.fit.names:
        yield (
            f"The small flows are those of {math.exp(fit['viscosity']):.3g} times the viscosity. C_R is "
            "converted to the machine's oil by eq. (10)."
        )
    if "flow" not in fit.solution.limits:
        yield "The description of the flow meter has no `zero_error`: the intervals do not cover its zero."
    yield from data.pressure_offset_remark(data.pressure_offset(fit.solution))
    yield tested.remark()


def _drop_over_flow(fit: Fit) -> tuple[Panel, Panel]:
    """Drop over flow with the law, and the residual."""
    steps, sample = fit.known[1], fit.solution.samples[0]
    flow, drops = steps.means[2], steps.means[0] - steps.means[1] - data.pressure_offset(fit.solution).value
    error = np.hypot(*steps.errors[:2, steps.good])
    flows = np.linspace(0.0, float(np.abs(flow[steps.good]).max()), 200)
    theta = np.array([fit[n] if n in fit.solution.fit.names else 0.0 for n in sample.names])
    none = np.zeros_like(flows)
    law = -np.array(sample.law.terms(np.array([none, none, flows]), theta, sample.known)[0])[0]
    curves = (
        Curve("measured", flow[steps.good], drops[steps.good], error=error),
        Curve("masked: dead zone of the meter", flow[steps.dead], drops[steps.dead], "masked"),
        Curve("laminar to turbulent", flows, law, "fit", line=True),
    )
    left = Curve("measured - fit", flow[steps.good], fit.residual(), error=error)
    panel = Panel("flow", "pressure drop", curves, "Drop along the hose", LITRES_PER_MINUTE, BAR)
    return panel, replace(panel, y_label="residual", title="", curves=(left,))


HOSE_RESISTANCE = Procedure(
    name="hose_resistance",
    title="Hose resistance: {0[0].size}",
    figure=6,
    signals=STEADY,
    law="The hose's law",
    known=lambda tests, parameters: (
        TestedHose.of(tests, parameters),
        *data.steady_means(tests, STEADY, ["flow"], MIN_STEPS),
    ),
    samples=_steps,
    start=_turbulent,
    limits=lambda tests: (
        data.zero_limits(tests, ("pressure_in", "pressure_out")) | data.declared_limits(tests, ["flow"])
    ),
    tested=["viscosity"],
    refined=_refined,
    estimates=_resistances,
    others=_of_tested,
    panels=_drop_over_flow,
    remarks=_remarks,
    findings=_findings,
    given=lambda fit: [_by_flow(fit)],
    drift={"C_R": "C_R"},
)


# ---- dynamics

MOVING = {"pressure_in": "Pa", "pressure_out": "Pa", "flow_in": "m3/s", "flow_out": "m3/s"}
PAIRS = ("pressure_in", "pressure_out"), ("pressure_out", "flow_out")  # that may share a logger
UNKNOWNS = ("I", "C", "C_R", "R", "s", "r")
EQUAL = ("I", "C")  # in all recordings of a hose
PERIODS = 4.0  # half width of the windows, in periods of the frequency of eq. (3)
SAMPLES_PER_PERIOD = 2.5  # minimum, above Nyquist's two
MIN_WINDOWS = 20  # per recording: fewer do not determine six unknowns
POSITION = 1.0  # standard deviation of the prior of s and r, which are between 0 and 1


def lump(p_in: Any, p_out: Any, q_in: Any, q_out: Any, u: Any, *known: Any) -> Any:
    """Both equations, and what they store."""
    flow, pressure = q_in + u.s * (q_out - q_in), p_out + u.r * (p_in - p_out)
    drop = p_in - p_out - u.R * flow - friction(u.C_R, known).drop(flow)
    return (drop, q_in - q_out), (u.I * flow, u.C * pressure)


def _with_fast_changes(tests: Recordings, parameters: Parameters) -> TestedHose:
    """The hose, if all recordings have fast changes, meters of one sign and enough samples."""
    tested = TestedHose.of(tests, parameters)
    for test in tests:
        inlet, outlet = np.array([test[n] for n in ("flow_in", "flow_out")])
        usable, rate, limit = np.isfinite(inlet + outlet), uniform_rate(test), tested.frequency
        windows = _windows([test], tested)[0][0].starts.size
        least, wrong = SAMPLES_PER_PERIOD * limit, ""
        if usable.any() and not np.ptp(inlet[usable]) > 0:
            wrong = "flow_in: expected fast changes of flow and pressure, got a constant"
        elif inlet[usable] @ outlet[usable] < 0:
            wrong = "flow_in, flow_out: expected both positive from inlet to outlet, got opposite signs"
        elif rate < least:
            wrong = f"sampling rate: expected {least:.0f} Hz or more, got {rate:.0f} Hz: the hose oscillates"
            wrong += f" at up to {limit:.0f} Hz, which would be aliased"
        elif windows < MIN_WINDOWS:
            few = f"{windows} windows without a bad sample (gap, clipped, dead zone)"
            wrong = f"{few}, expected at least {MIN_WINDOWS}"
        if wrong:
            raise Problem(f"{test.source}: {wrong}")
    return tested


def _windows(tests: Recordings, tested: TestedHose) -> Parts:
    """Windows of each recording."""
    law = law_of(lump, len(MOVING), UNKNOWNS, len(tested.constants))
    width = PERIODS / tested.frequency
    return [window_samples(test, MOVING, law, width, tested.constants) for test in tests]


def _start(tested: TestedHose) -> dict[str, float]:
    """From the machine's hose and the known bulk modulus."""
    names = ("bulk_modulus", *(f"stick_hose_{n}" for n in ("resistance", "length", "bore")))
    known = (parameter_value(tested.parameters, f"boom_stick.{n}") for n in names)
    modulus, own, length, bore = known
    return {
        "I": float(hose.inertance(tested.length, tested.bore, tested.density)),
        "C": float(hose.capacitance(tested.length, tested.bore, modulus)),
        "C_R": float(hose.scaled_resistance(own, tested.length / length, tested.bore / bore)),
        **dict.fromkeys(("R", "s", "r"), 0.0),
    }


def _estimates(fit: Fit) -> list[Quantity]:
    """The machine's lines."""
    tested: TestedHose = fit.known
    about = "regression over windows, section 4(c)", ", times {ratio:.4g} for {size} and the machine's oil"
    inertance, capacitance = ("inertance", "I", (*AXES, "swing.line")), ("capacitance", "C", AXES)
    return [
        *tested.scaled(*inertance, lambda length, bore: tested.to_density * length / bore**2, *about),
        *tested.scaled(*capacitance, lambda length, bore: length * bore**2, *about),
    ]


def _others(fit: Fit) -> Iterator[Estimate]:
    yield from (fit.estimate(Quantity(n, unit, n, "the tested hose")) for n, unit in UNITS.items())
    for name, end, what in (("s", "outlet", "flow"), ("r", "inlet", "pressure")):
        note = "0 lumped, 1/2 distributed"
        yield fit.estimate(Quantity(f"weight of the {end}'s {what}", "1", name, note))


def _panels(fit: Fit) -> Iterator[Panel]:
    sides = (
        ("dQ/dt [m3/s2]", "drop without friction", BAR),
        ("dP/dt [Pa/s]", "flow stored", LITRES_PER_MINUTE),
    )
    for row, (name, (x, y, unit)) in enumerate(zip(EQUAL, sides, strict=True)):
        yield from fit.line(Panel(x, y, (), "Filtered equation", y_unit=unit), name, row)


HOSE_DYNAMICS = Procedure(
    name="hose_dynamics",
    title="Hose dynamics: {0.size}",
    figure=7,
    signals=MOVING,
    law="The hose's law",
    known=_with_fast_changes,
    samples=_windows,
    start=_start,
    limits=lambda tests: data.zero_limits(tests, MOVING),
    priors=dict.fromkeys(("s", "r"), POSITION),
    loggers=(*PAIRS, *((name,) for name in MOVING)),
    check=lambda fit: fit.expect_positive(
        ((n, fit[n], fit.sd(n)) for n in EQUAL), "change the sign of the flows, or exchange the two pressures"
    ),
    estimates=_estimates,
    others=_others,
    panels=_panels,
    remarks=lambda fit: [fit.known.remark()],
    drift={"C_R": "the resistance"},
    equal=EQUAL,
)
