"""Hose dynamics procedure (section 4(c), Fig. 7): inertance and capacitance from both ends of a hose.

Two methods. First, the equations of a lumped hose as laws of `balance`:

    I dQ/dt = P_in - P_out - R Q - C_R Q|Q|        Q = Q_in + s (Q_out - Q_in)
    C dP/dt = Q_in - Q_out                               P = P_out + s (P_in - P_out)

In the machine (`fmus.boom_stick.drive`) s = 0: the inertance sees the flow of the inlet, and the capacitance
is at the outlet. If both are distributed along the hose, s = 1/2: the mean of its ends. The position s, the
friction, and the zeros of the instruments are estimated together with I and C, so that they do not bias them.
The result is scaled to the machine's lines by I ~ l/A and C ~ A l.

Second, the definitions, which the paper uses, for comparison: sample by sample, then the mean of each group
of recordings, then the mean of these means.

    I = (P_in - P_out - drop)/(dQ_in/dt)        C = (Q_in - Q_out)/(dP_out/dt)

One Savitzky-Golay filter gives the derivatives and smooths the other signals. Samples with a small derivative
are left out, because the ratio is undetermined. Noise of the derivative biases the ratio towards zero, and it
includes what the lumped model neglects (the position s).

Validity: changes below the frequency of eq. (3), C_0/(2 pi l), above which a hose is not a single lump.
Windows of four periods of this frequency to each side pass what is below a quarter of it. Recordings with
fewer than 2.5 samples per period are refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from fmus.components import hose
from fmus.identification.balance import (
    SIGNIFICANT,
    UNLIKELY,
    Law,
    Regression,
    Samples,
    Solution,
    drift_finding,
    homogeneity,
    law,
    misfit_remark,
    model_finding,
    modulating_function,
    noise_of,
    shift_finding,
    solve,
    window_starts,
    zero_findings,
)
from fmus.identification.estimate import Estimate, coverage_factor
from fmus.identification.finding import Finding
from fmus.identification.procedure_result import BAR, LITRES_PER_MINUTE, Curve, Panel, ProcedureResult
from fmus.identification.procedures.experiment_data import (
    constants_remark,
    course,
    density_ratio,
    hose_size,
    interpolated,
    noise_sd,
    parameter_value,
    signal_findings,
    tested_density,
    training_recordings,
    zero_limits,
)
from fmus.identification.procedures.hose_resistance import scaled
from fmus.identification.recordings.clock import period, uniform_rate
from fmus.identification.recordings.derivatives import filter_for
from fmus.identification.recordings.masks import good_all
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

SIGNALS: Mapping[str, str] = {
    "pressure_in": "Pa",
    "pressure_out": "Pa",
    "flow_in": "m3/s",
    "flow_out": "m3/s",
}
PERIODS = 4.0  # half width of the windows, in periods of the frequency of eq. (3)
SAMPLES_PER_PERIOD = 2.5  # minimum, above Nyquist's two
UNITS = {"I": "kg/m4", "C": "m3/Pa"}
# parameters of the machine and the lines that they belong to
LINES = {
    "I": {
        "boom_stick.stick_hose_inertance": "boom_stick.stick_hose",
        "boom_stick.boom_hose_inertance": "boom_stick.boom_hose",
        "swing.line_inertance": "swing.line",
    },
    "C": {
        "boom_stick.stick_hose_capacitance": "boom_stick.stick_hose",
        "boom_stick.boom_hose_capacitance": "boom_stick.boom_hose",
    },
}
MIN_WINDOWS = 20  # per group: fewer do not determine five unknowns
DEFINITION_WINDOW = 0.055  # s, filter for the definitions: a third of the shortest change
DEFINITION_SAMPLES = 4  # intervals in that filter at least: more than the degree of its polynomial
POSITION = 1.0  # standard deviation of the prior of s, which is between 0 and 1
CLEAR = 0.3  # derivatives above this fraction of the recording's largest one are used in the definitions


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Inertance and capacitance of the stick's, the boom's and the swing's lines from the tested hose."""
    groups = training_recordings(recordings, "hose_dynamics", SIGNALS)
    length, bore = hose_size(groups)
    for group in groups:
        _check_flows(group)
    # resistance of the tested hose from that of the stick's hose, eq. (10)
    names = (f"boom_stick.stick_hose_{name}" for name in ("resistance", "length", "bore"))
    stick_resistance, stick_length, stick_bore = (parameter_value(parameters, name) for name in names)
    resistance = scaled(stick_resistance, stick_length, stick_bore, length, bore)
    inertances, capacitances = _fit_both(groups, parameters, length, bore, resistance)
    defined = [by_definition(group, resistance) for group in groups]
    return ProcedureResult(
        procedure="hose_dynamics",
        title=f"Hose inertance and capacitance: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=7,
        estimates=(*_lines(inertances, groups, parameters), *_lines(capacitances, groups, parameters)),
        panels=(
            _groups_panel(inertances, [i for i, _ in defined], "inertance [kg/m4]"),
            _groups_panel(capacitances, [c for _, c in defined], "capacitance [m3/Pa]"),
            *_equation_panels(inertances, "dQ/dt [m3/s2]", "drop without friction", BAR),
            *_equation_panels(capacitances, "dP/dt [Pa/s]", "flow stored in the hose", LITRES_PER_MINUTE),
        ),
        remarks=(
            *_remarks(inertances, capacitances),
            constants_remark(parameters, ["density", "bulk_modulus"], tested_density(groups)),
        ),
        others=tuple(_others(inertances, capacitances, defined)),
        findings=tuple(_findings(inertances, capacitances)),
    )


def _check_flows(group: Recording) -> None:
    """Refuse constant flows, and meters at the two ends that count in opposite directions."""
    ends = [group[name] for name in ("flow_in", "flow_out")]
    valid = np.isfinite(ends[0]) & np.isfinite(ends[1])
    inlet, outlet = (flow[valid] for flow in ends)
    if inlet.size and not np.ptp(inlet) > 0:
        raise Problem(f"{group.source}: flow_in: expected fast changes of flow and pressure, got a constant")
    if inlet @ outlet < 0:
        raise Problem(
            f"{group.source}: flow_in, flow_out: expected both positive from inlet to outlet, got "
            "opposite signs"
        )


def _fit_both(
    groups: Sequence[Recording],
    parameters: Mapping[str, Number],
    length: float,
    bore: float,
    resistance: float,
) -> tuple[GroupFits, GroupFits]:
    """Fits of the inertance and of the capacitance."""
    density = parameter_value(parameters, "boom_stick.density")
    modulus = parameter_value(parameters, "boom_stick.bulk_modulus")
    limit = float(hose.frequency_limit(length, density, modulus))
    for group in groups:
        rate = uniform_rate(group)
        if rate < SAMPLES_PER_PERIOD * limit:
            raise Problem(
                f"{group.source}: sampling rate: expected {SAMPLES_PER_PERIOD * limit:.0f} Hz or more, got "
                f"{rate:.0f} Hz: the hose oscillates at up to {limit:.0f} Hz, which would be aliased"
            )
    known = parameter_value(parameters, "boom_stick.valve_transition_flow")
    start = {"I": float(hose.inertance(length, bore, density)), "C_R": resistance, "R": 0.0, "s": 0.0}
    inertances = fits("I", inertance_law(), groups, start, PERIODS / limit, known)
    start = {"C": float(hose.capacitance(length, bore, modulus)), "s": 0.0}
    return inertances, fits("C", capacitance_law(), groups, start, PERIODS / limit, known)


@lru_cache(maxsize=1)
def inertance_law() -> Law:
    """I dQ/dt = P_in - P_out - R Q - C_R Q|Q|; |Q| is rounded as in `spool_valve.turbulent_drop`."""
    z, transition = ca.SX.sym("z", 4), ca.SX.sym("transition")
    u = {name: ca.SX.sym(name) for name in ("I", "C_R", "R", "s")}
    flow = z[2] + u["s"] * (z[3] - z[2])
    friction = flow * (u["R"] + u["C_R"] * ca.sqrt(flow**2 + transition**2))
    return law(z, u, transition, z[0] - z[1] - friction, u["I"] * flow)


@lru_cache(maxsize=1)
def capacitance_law() -> Law:
    """C dP/dt = Q_in - Q_out."""
    z, transition = ca.SX.sym("z", 4), ca.SX.sym("transition")
    u = {name: ca.SX.sym(name) for name in ("C", "s")}
    return law(z, u, transition, z[2] - z[3], u["C"] * (z[1] + u["s"] * (z[0] - z[1])))


def prepared(recording: Recording, model: Law, half_width: float, transition_flow: float) -> Samples:
    """The four signals of a recording over windows of good samples; `half_width` in s."""
    rate = uniform_rate(recording)
    half = max(round(half_width * rate), 3)
    bump, slope = modulating_function(half)
    raw = np.array([interpolated(recording[n]) for n in SIGNALS])
    return Samples(
        law=model,
        names=model.unknowns,
        sensors=tuple(SIGNALS),
        raw=raw,
        sd=noise_of(raw, np.array([noise_sd(recording, n) for n in SIGNALS])),
        channels=[(k, np.ones(1)) for k in range(4)],
        known=np.array([transition_flow]),
        bump=bump / rate,
        slope=slope,
        starts=window_starts(good_all(recording, SIGNALS), half),
    )


@dataclass(frozen=True)
class GroupFits:
    """Fits of one quantity, "I" or "C": to each group of recordings, and to all groups.

    pooled        the fit to all groups; its interval is widened to their scatter if they differ
    homogeneity   probability of the scatter between the groups if all have the same value
    """

    name: str
    groups: tuple[Regression, ...]
    solution: Solution
    pooled: Regression
    homogeneity: float
    recordings: tuple[Recording, ...]

    @property
    def determined(self) -> bool:
        """Whether the data determine the quantity."""
        return self.pooled.determined(self.name)


def fits(
    name: str,
    model: Law,
    groups: Sequence[Recording],
    start: Mapping[str, float],
    half_width: float,
    transition_flow: float,
) -> GroupFits:
    """Fits of all groups and of each."""
    samples = [prepared(group, model, half_width, transition_flow) for group in groups]
    for group, own in zip(groups, samples, strict=True):
        if own.starts.size < MIN_WINDOWS:
            raise Problem(
                f"{group.source}: {own.starts.size} windows without a bad sample (gap, clipped, dead zone), "
                f"expected at least {MIN_WINDOWS}"
            )
    limits = zero_limits(groups, SIGNALS)

    def fitted(some: Sequence[Samples]) -> Solution:
        return solve(some, start, f"hose_dynamics, {name}", limits, priors={"s": POSITION})

    solution = fitted(samples)
    alone = tuple(fitted([own]).fit for own in samples) if len(samples) > 1 else (solution.fit,)
    pooled, values = solution.fit, [group[name] for group in alone]
    probability = homogeneity(values, [group.sd(name) for group in alone]) if len(alone) > 1 else 1.0
    if pooled[name] < -SIGNIFICANT * pooled.sd(name):
        files = ", ".join(str(group.source) for group in groups)
        raise Problem(
            f"{files}: {name}: expected positive, got {pooled[name]:.3g}: change the sign of the "
            "flows, or exchange the two pressures"
        )
    if probability < UNLIKELY:
        scatter = float(np.std(values, ddof=1)) / math.sqrt(len(values))
        widening = max(1.0, scatter / pooled.sd(name))
        pooled = replace(pooled, covariance=pooled.covariance * widening**2)
    return GroupFits(name, alone, solution, pooled, probability, tuple(groups))


def _findings(inertances: GroupFits, capacitances: GroupFits) -> Iterator[Finding]:
    """Tests of both residuals: zeros, a change in time, a delay of the pressures, the model."""
    for fits, quantity in ((inertances, "inertance"), (capacitances, "capacitance")):
        label = f"hose_dynamics, {quantity}"
        yield from zero_findings(fits.solution, label)
        yield model_finding(fits.solution, label)
    solution, step = inertances.solution, [1 / uniform_rate(group) for group in inertances.recordings]
    yield shift_finding(solution, ("pressure_in", "pressure_out"), step[0], "hose_dynamics")
    every = zip(inertances.recordings, solution.samples, step, strict=True)
    courses = [course(group, np.array(s.centres * dt, float)) for group, s, dt in every]
    yield drift_finding(solution, "C_R", courses, "hose_dynamics: the resistance")
    yield from signal_findings(inertances.recordings, SIGNALS, "hose_dynamics")


def by_definition(recording: Recording, resistance: float) -> tuple[Array, Array]:
    """Samples of I and of C; the drop is C_R Q|Q| with the hose's C_R [Pa.s2/m6]."""
    window = max(DEFINITION_WINDOW, DEFINITION_SAMPLES * period(recording.time))
    smoothing, good = filter_for(recording, window), good_all(recording, SIGNALS)
    signal, rate = (
        {name: smoothing.apply(np.where(good, recording[name], np.nan), order) for name in SIGNALS}
        for order in (0, 1)
    )
    flow = signal["flow_in"]
    inertial_drop = signal["pressure_in"] - signal["pressure_out"] - resistance * flow * np.abs(flow)
    fractions = ((inertial_drop, rate["flow_in"]), (flow - signal["flow_out"], rate["pressure_out"]))
    ratios = []
    for numerator, denominator in fractions:
        size = np.abs(denominator)
        clear = size > CLEAR * np.max(size, initial=0.0, where=np.isfinite(size))
        ratios.append(numerator[clear] / denominator[clear])
    return ratios[0], ratios[1]


def mean_of_means(name: str, unit: str, groups: list[Array]) -> Estimate:
    """The mean of the groups' means, with Student's t interval from their scatter."""
    means = np.array([group.mean() for group in groups if group.size])
    n = means.size
    mean = float(means.mean()) if n else float("nan")
    sd = float(means.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
    note = f"by definition, mean of {n} group means, section 4(c); the interval is their scatter"
    return Estimate.normal(name, mean, unit, sd, note, max(n - 1, 1))


def _lines(
    fits: GroupFits, groups: Sequence[Recording], parameters: Mapping[str, Number]
) -> Iterator[Estimate]:
    """The machine's lines by I ~ rho l/A and C ~ A l; none if the data do not determine the quantity."""
    if not fits.determined:
        return
    length, bore = hose_size(groups)
    density = density_ratio(groups, parameters) if fits.name == "I" else 1.0
    for name, line in LINES[fits.name].items():
        line_length = parameter_value(parameters, f"{line}_length")
        area = float(hose.area(parameter_value(parameters, f"{line}_bore")) / hose.area(bore))
        ratio = line_length / length
        factor = density * (ratio / area if fits.name == "I" else ratio * area)
        note = "regression over windows, section 4(c)"
        if abs(factor - 1) > 1e-9:
            note += f", times {factor:.4g} for {line_length:g} m instead of {length:g} m"
            note += "" if abs(area - 1) < 1e-9 else f" and {area:.4g} times the area"
            note += "" if abs(density - 1) < 1e-9 else f" and {density:.4g} times the density"
        yield fits.pooled.estimate(name, UNITS[fits.name], note, fits.name, factor)


def _others(
    inertances: GroupFits, capacitances: GroupFits, defined: Sequence[tuple[Array, Array]]
) -> Iterator[Estimate]:
    for k, fits in enumerate((inertances, capacitances)):
        unit = UNITS[fits.name]
        yield fits.pooled.estimate(fits.name, unit, "regression, the tested hose")
        yield mean_of_means(f"{fits.name} by definition", unit, [both[k] for both in defined])
    for fits, signal, end in ((inertances, "flow", "outlet"), (capacitances, "pressure", "inlet")):
        note = f"position s of the {signal}; 0 lumped, 1/2 distributed"
        yield fits.pooled.estimate(f"weight of the {end}'s {signal}", "1", note, "s")


def _groups_panel(fits: GroupFits, defined: Sequence[Array], label: str) -> Panel:
    """Values of each group by both methods."""
    number = np.arange(1.0, len(defined) + 1)
    values = np.array([group[fits.name] for group in fits.groups])
    errors = coverage_factor() * np.array([group.sd(fits.name) for group in fits.groups])
    means, scatter = (np.array([f(samples) for samples in defined]) for f in (np.mean, np.std))
    ends = np.array([0.5, len(defined) + 0.5])
    curves = (
        Curve("by definition: mean and scatter of samples", number - 0.1, means, "compared", error=scatter),
        Curve("by definition: mean of means", ends, np.full(2, means.mean()), "compared", line=True),
        Curve("regression, 95 %", number + 0.1, values, "measured", error=errors),
        Curve("regression, all groups", ends, np.full(2, fits.pooled[fits.name]), "fit", line=True),
    )
    return Panel("group", label, curves, f"{label.split()[0].capitalize()} of each group")


def _equation_panels(fits: GroupFits, rate: str, side: str, unit: tuple[str, float]) -> tuple[Panel, Panel]:
    """Both sides of the equation as means over the windows, whose slope is the quantity; and the residual."""
    value, weight = fits.pooled[fits.name], fits.solution.samples[0].weight
    linear = [part.linear for part in fits.solution.parts]
    x = -np.concatenate([one.by_theta[0, 0] for one in linear]) / weight
    residual = np.concatenate([one.e[0] for one in linear]) / weight
    measured = Curve("measured, filtered", x, value * x + residual)
    return Panel(rate, side, (measured,), "Filtered equation", y_unit=unit).with_line(value, "fit")


def _remarks(inertances: GroupFits, capacitances: GroupFits) -> Iterator[str]:
    count = sum(s.starts.size for s in inertances.solution.samples)
    yield (
        f"The regression uses {count} windows of {len(inertances.groups)} groups; no window has a "
        "sample in the dead zone of a meter. The regression accounts for the noise of all signals."
    )
    yield (
        "The values by definition follow the method of the paper: the interval is the scatter of the "
        "group means. They are biased by the noise of the derivatives and by the position of the flow meter."
    )
    for fits, quantity in ((inertances, "inertance"), (capacitances, "capacitance")):
        unit = UNITS[fits.name]
        if not fits.determined:
            yield (
                f"These recordings do not determine the {quantity}: {fits.pooled[fits.name]:.2g} +- "
                f"{fits.pooled.sd(fits.name):.1g} {unit}. The parameter keeps its known value. "
                "Recordings with faster changes of flow and pressure would determine the parameter better."
            )
        elif fits.homogeneity < UNLIKELY:
            values = ", ".join(f"{group[fits.name]:.4g}" for group in fits.groups)
            yield (
                f"The {quantity} differs between the groups ({values} {unit}) more than noise explains: "
                "one value cannot describe this hose. The interval is widened to their scatter."
            )
    if inertances.determined and inertances.pooled.significant("s"):
        yield (
            f"The inertance acts on the flow at {inertances.pooled['s']:.2f} of the way from the "
            "inlet to the outlet (1/2: distributed evenly along the hose). The lumped hose uses the "
            "flow of the inlet."
        )
    yield from misfit_remark(inertances.pooled, "The equation of the inertance")
    yield from misfit_remark(capacitances.pooled, "The equation of the capacitance")
