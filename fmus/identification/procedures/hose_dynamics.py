"""Hose dynamics procedure (section 4(c), Fig. 7): inertance and capacitance from both ends of a hose.

The equations of a lumped hose are laws of `balance`:

    I dQ/dt = P_in - P_out - R Q - dp(Q)           Q = Q_in + s (Q_out - Q_in)
    C dP/dt = Q_in - Q_out                               P = P_out + s (P_in - P_out)

dp is the friction with C_R (`hose.Friction`). In the machine s = 0: the inertance sees the flow of the inlet,
and the capacitance is at the outlet. If both are distributed along the hose, s = 1/2: the mean of its ends.
The position s, R, C_R, and the zeros of the instruments are estimated together with I and C, so that they do
not bias them. The result is scaled to the machine's lines by I ~ l/A and C ~ A l.

If an equation does not fit, the delay between two loggers is searched for: signals and time with which plain
least squares leave least of both equations. A delay that noise does not explain is taken out of the
recordings, and its error is in the intervals: 1 ms between the flows is half of C.

Validity: changes below the frequency of eq. (3), C_0/(2 pi l), above which a hose is not a single lump.
Windows of four periods of this frequency to each side pass what is below a quarter of it. Recordings with
fewer than 2.5 samples per period are refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy import optimize, stats
from scipy.ndimage import shift

from fmus.components import hose
from fmus.components.chamber import Liquid
from fmus.identification import balance
from fmus.identification.balance import Law, Regression, Samples, Solution, probability
from fmus.identification.procedures import experiment_data as data
from fmus.identification.recordings.clock import uniform_rate
from fmus.identification.recordings.masks import good, good_all
from fmus.identification.results import (
    BAR,
    LITRES_PER_MINUTE,
    Curve,
    Estimate,
    Finding,
    Panel,
    ProcedureResult,
    coverage_factor,
)
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

SIGNALS: Mapping[str, str] = {
    "pressure_in": "Pa",
    "pressure_out": "Pa",
    "flow_in": "m3/s",
    "flow_out": "m3/s",
}
PERIODS = 4.0  # half width of the windows, in periods of the frequency of eq. (3)
SAMPLES_PER_PERIOD = 2.5  # minimum, above Nyquist's two
MIN_WINDOWS = 20  # per group: fewer do not determine five unknowns
LOGGERS: tuple[Sequence[str], ...] = (  # signals that may have another logger than the others
    ("pressure_in", "pressure_out"),
    ("pressure_out", "flow_out"),
    *((name,) for name in SIGNALS),
)
DELAYS = 11  # that are tried, up to the distance of neighbouring windows
POSITION = 1.0  # standard deviation of the prior of s, which is between 0 and 1


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Inertance and capacitance of the stick's, the boom's and the swing's lines from the tested hose."""
    tests = data.training_recordings(recordings, "hose_dynamics", SIGNALS)
    length, bore = data.hose_size(tests)
    equations_ = equations(parameters, length, bore)
    for test in tests:
        _check(test, equations_[0])
    groups, solutions, later, delay = align(equations_, tests)
    both = [fitted(e, groups, s, later) for e, s in zip(equations_, solutions, strict=True)]
    sides = (
        ("dQ/dt [m3/s2]", "drop without friction", BAR),
        ("dP/dt [Pa/s]", "flow stored in the hose", LITRES_PER_MINUTE),
    )
    findings = list[Finding]()
    for fits in both:
        label = f"hose_dynamics, {fits.equation.quantity}"
        findings += balance.zero_findings(fits.solution, label)
        findings.append(balance.model_finding(fits.solution, label))
    courses = data.courses(groups, solutions[0])
    drift = balance.drift_finding(solutions[0], "C_R", courses, "hose_dynamics: the resistance")
    return ProcedureResult(
        procedure="hose_dynamics",
        title=f"Hose inertance and capacitance: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=7,
        estimates=tuple(e for fits in both for e in _lines(fits, tests, parameters)),
        panels=(
            *map(_groups_panel, both),
            *(p for fits, labels in zip(both, sides, strict=True) for p in _equation_panels(fits, *labels)),
        ),
        remarks=(*_remarks(both), data.constants_remark(tests, parameters, "density", "bulk_modulus")),
        others=tuple(_others(both)),
        findings=(*findings, delay, drift, *data.signal_findings(tests, SIGNALS, "hose_dynamics")),
    )


@dataclass(frozen=True)
class Equation:
    """The law of one quantity, "I" or "C", with the start of its search and its windows.

    lines        of the machine that have the quantity as a parameter
    start        initial value of each unknown
    half_width   of the windows [s]
    """

    name: str
    quantity: str
    unit: str
    lines: tuple[str, ...]
    law: Law
    start: Mapping[str, float]
    half_width: float


def equations(parameters: Mapping[str, Number], length: float, bore: float) -> tuple[Equation, Equation]:
    """Both equations of a hose."""
    density, modulus, viscosity, resistance, stick_length, stick_bore = (
        data.parameter_value(parameters, f"boom_stick.{name}")
        for name in (
            *("density", "bulk_modulus", "viscosity"),
            *("stick_hose_resistance", "stick_hose_length", "stick_hose_bore"),
        )
    )
    half_width = PERIODS / float(hose.frequency_limit(length, density, modulus))
    z, size = ca.SX.sym("z", 4), hose.HoseSize(length=length, bore=bore)
    p_in, p_out, q_in, q_out = ca.vertsplit(z)
    u = {name: ca.SX.sym(name) for name in ("I", "C_R", "R", "s", "C")}
    flow, pressure = q_in + u["s"] * (q_out - q_in), p_out + u["s"] * (p_in - p_out)
    of = hose.Friction.of(size, u["C_R"], Liquid(density=density, viscosity=viscosity))
    inertance = {
        "I": float(hose.inertance(length, bore, density)),
        "C_R": float(hose.scaled_resistance(resistance, length / stick_length, bore / stick_bore)),
        "R": 0.0,
        "s": 0.0,
    }
    capacitance = {"C": float(hose.capacitance(length, bore, modulus)), "s": 0.0}

    def equation(
        quantity: str, unit: str, lines: tuple[str, ...], start: Mapping[str, float], f: ca.SX, h: ca.SX
    ) -> Equation:
        own = balance.law(z, {n: u[n] for n in start}, ca.SX.sym("known"), f, h)
        return Equation(next(iter(start)), quantity, unit, lines, own, start, half_width)

    hoses = ("boom_stick.stick_hose", "boom_stick.boom_hose")
    drop, stored = p_in - p_out - u["R"] * flow - of.drop(flow), q_in - q_out
    return (
        equation("inertance", "kg/m4", (*hoses, "swing.line"), inertance, drop, u["I"] * flow),
        equation("capacitance", "m3/Pa", hoses, capacitance, stored, u["C"] * pressure),
    )


def _check(test: Recording, equation: Equation) -> None:
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
    rate, limit = uniform_rate(test), PERIODS / equation.half_width
    if rate < SAMPLES_PER_PERIOD * limit:
        raise Problem(
            f"{test.source}: sampling rate: expected {SAMPLES_PER_PERIOD * limit:.0f} Hz or more, got "
            f"{rate:.0f} Hz: the hose oscillates at up to {limit:.0f} Hz, which would be aliased"
        )
    windows = prepared(test, equation).starts.size
    if windows < MIN_WINDOWS:
        raise Problem(
            f"{test.source}: {windows} windows without a bad sample (gap, clipped, dead zone), "
            f"expected at least {MIN_WINDOWS}"
        )


def prepared(recording: Recording, equation: Equation) -> Samples:
    """The four signals of a recording over windows of good samples."""
    rate = uniform_rate(recording)
    bump, slope = balance.modulating_function(max(round(equation.half_width * rate), 3), rate)
    raw = np.array([recording.interpolated(n) for n in SIGNALS])
    noise = np.array([data.noise_sd(recording, n) for n in SIGNALS])
    samples = balance.samples_of(equation.law, SIGNALS, raw, noise)
    starts = balance.window_starts(good_all(recording, SIGNALS), bump.size)
    return replace(samples, rate=rate, bump=bump, slope=slope, starts=starts)


def solved(equation: Equation, groups: Sequence[Recording]) -> Solution:
    """Fit of one equation to some recordings."""
    return balance.solve(
        [prepared(group, equation) for group in groups],
        equation.start,
        f"hose_dynamics, {equation.name}",
        data.zero_limits(groups, SIGNALS),
        priors={"s": POSITION},
    )


# ---- delay of a logger ---------------------------------------------------------------------------------


def align(
    both: Sequence[Equation], tests: Sequence[Recording]
) -> tuple[Sequence[Recording], Sequence[Solution], Sequence[Recording], Finding]:
    """The recordings without the delay of a logger, if noise does not explain it, and the finding of it.

    A delay is searched for only if an equation does not fit. The second result are fits of each equation to
    all recordings, whose samples that are not good are gaps if a delay is taken out. The third are those with
    a delay that is one standard deviation larger; empty if none is taken out.
    """

    def attempt(groups: Sequence[Recording]) -> list[Solution] | None:
        try:
            return [solved(equation, groups) for equation in both]
        except Problem:  # one does not converge
            return None

    plain = aligned = attempt(tests)
    late, delayed = LOGGERS[0], 0.0
    if plain is None or any(solution.fit.misfit for solution in plain):
        late, delayed = _search(both, tests)
        aligned = attempt([_without(test, late, delayed) for test in tests])
    changes = [balance.delay(solution, late) for solution in aligned or ()]
    change, sd = min(changes, key=lambda found: found[1], default=(0.0, math.inf))
    delayed += change
    tolerance = balance.SHIFT / min(map(uniform_rate, tests))
    p = min(1.0, len(LOGGERS) * probability(delayed, sd, tolerance))
    milliseconds = f"{1e3 * delayed:.3g} +- {1e3 * sd:.2g} ms"
    sentence = f"hose_dynamics: {', '.join(late)} would have to be {milliseconds} late"
    if p > balance.UNLIKELY:
        solutions = plain or [solved(equation, tests) for equation in both]
        return tests, solutions, (), Finding("time shift", p, sentence)
    groups, later = ([_without(test, late, x) for test in tests] for x in (delayed, delayed + sd))
    finding = Finding("time shift", p, f"{sentence}; the estimates are without this delay")
    return groups, [solved(equation, groups) for equation in both], later, finding


def _without(recording: Recording, late: Sequence[str], delayed: float) -> Recording:
    """The good samples of a recording in which some signals are late by a time [s], without this delay."""
    samples, signals = delayed * uniform_rate(recording), dict(recording.signals)
    for name in SIGNALS:
        usable, values = good(recording, name), recording.interpolated(name)
        if name in late:
            values = shift(values, -samples, mode="nearest")
            usable = shift(usable.astype(float), -samples, order=1) > 1 - 1e-9
        signals[name] = np.where(usable, values, np.nan)
    return replace(recording, signals=signals)


def _search(both: Sequence[Equation], tests: Sequence[Recording]) -> tuple[Sequence[str], float]:
    """Sensors with one logger, and their delay [s] against the others with which both equations fit best.

    Windows count whose neighbours are without a bad sample, too, up to which signals are moved.
    """
    every = [(equation, [prepared(test, equation) for test in tests]) for equation in both]
    for _, samples in every:
        for k, s in enumerate(samples):
            before, after = (s.starts + sign * balance.hop(s.bump.size) for sign in (-1, 1))
            samples[k] = replace(s, starts=s.starts[np.isin(before, s.starts) & np.isin(after, s.starts)])
    if any(s.starts.size < MIN_WINDOWS for _, samples in every for s in samples):
        return LOGGERS[0], 0.0
    longest = balance.HOP * both[0].half_width
    grid = np.linspace(-longest, longest, DELAYS)

    def misfit(delayed: float, late: Sequence[str]) -> float:
        """Sum of the logarithms of the squares that plain least squares leave, linear about the starts."""
        logarithms = []
        for equation, samples in every:
            columns, theta = [], np.array([*equation.start.values()])
            for s in samples:
                moved = shift(s.raw, (0, -delayed * s.rate), mode="nearest")
                at = balance.linearised(s, np.where(np.isin(s.sensors, late)[:, None], moved, s.raw), theta)
                columns.append(np.concatenate([at.e, at.by_theta[:, 0], np.ones_like(at.e)]))
            e, *x = np.concatenate(columns, axis=1)
            matrix = np.array(x).T / np.maximum(np.linalg.norm(x, axis=1), 1e-300)
            left = e - matrix @ np.linalg.lstsq(matrix, e)[0]
            logarithms.append(math.log(max(float(left @ left), 1e-300)))
        return sum(logarithms)

    nearest, late = min(((x, late) for late in LOGGERS for x in grid), key=lambda tried: misfit(*tried))
    around = nearest + (grid[1] - grid[0]) * np.array([-1, 1])
    accuracy = {"xatol": 1e-2 / max(map(uniform_rate, tests))}
    found = optimize.minimize_scalar(misfit, bounds=around, args=(late,), options=accuracy)
    return late, float(found.x)


# ---- results -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class GroupFits:
    """Fits of one quantity, "I" or "C": to each group of recordings, and to all groups.

    pooled   the fit to all groups; its interval is widened to their scatter if they differ
    equal    probability of the scatter between the groups if all have the same value
    """

    equation: Equation
    groups: tuple[Regression, ...]
    solution: Solution
    pooled: Regression
    equal: float

    @property
    def name(self) -> str:
        """Of the quantity."""
        return self.equation.name

    @property
    def determined(self) -> bool:
        """Whether the data determine the quantity."""
        return self.pooled.determined(self.name)


def fitted(
    equation: Equation, groups: Sequence[Recording], solution: Solution, later: Sequence[Recording]
) -> GroupFits:
    """Fits of all groups, which is `solution`, and of each; `later` is that of `align`."""
    name, pooled, equal = equation.name, solution.fit, 1.0
    alone = [solved(equation, [group]).fit for group in groups] if len(groups) > 1 else [pooled]
    if pooled[name] < -balance.SIGNIFICANT * pooled.sd(name):
        files = ", ".join(str(group.source) for group in groups)
        raise Problem(
            f"{files}: {name}: expected positive, got {pooled[name]:.3g}: change the sign of the "
            "flows, or exchange the two pressures"
        )
    if len(alone) > 1:
        values, weights = np.array([(group[name], group.sd(name) ** -2.0) for group in alone]).T
        away = values - np.average(values, weights=weights)
        equal = float(stats.chi2.sf(weights @ away**2, values.size - 1))
        if equal < balance.UNLIKELY:
            widening = max(1.0, values.std(ddof=1) / math.sqrt(values.size) / pooled.sd(name))
            pooled = replace(pooled, covariance=pooled.covariance * widening**2)
    if later:
        change = solved(equation, later).fit.values - pooled.values
        pooled = replace(pooled, covariance=pooled.covariance + np.outer(change, change))
    return GroupFits(equation, tuple(alone), solution, pooled, equal)


def _lines(
    fits: GroupFits, groups: Sequence[Recording], parameters: Mapping[str, Number]
) -> Iterator[Estimate]:
    """The machine's lines by I ~ rho l/A and C ~ A l; none if the data do not determine the quantity."""
    length, bore = data.hose_size(groups)
    density = data.density_ratio(groups, parameters) if fits.name == "I" else 1.0
    for line in fits.equation.lines if fits.determined else ():
        line_length = data.parameter_value(parameters, f"{line}_length")
        area = float(hose.area(data.parameter_value(parameters, f"{line}_bore")) / hose.area(bore))
        ratio = line_length / length
        factor = density * (ratio / area if fits.name == "I" else ratio * area)
        note = "regression over windows, section 4(c)"
        if abs(factor - 1) > 1e-9:
            note += f", times {factor:.4g} for {line_length:g} m instead of {length:g} m"
            for other, of in ((area, "area"), (density, "density")):
                note += f" and {other:.4g} times the {of}" if abs(other - 1) >= 1e-9 else ""
        yield fits.pooled.estimate(
            f"{line}_{fits.equation.quantity}", fits.equation.unit, note, fits.name, factor
        )


def _others(both: Sequence[GroupFits]) -> Iterator[Estimate]:
    """The tested hose, and the positions s."""
    for fits in both:
        yield fits.pooled.estimate(fits.name, fits.equation.unit, "regression, the tested hose")
    for fits, signal, end in zip(both, ("flow", "pressure"), ("outlet", "inlet"), strict=True):
        note = f"position s of the {signal}; 0 lumped, 1/2 distributed"
        yield fits.pooled.estimate(f"weight of the {end}'s {signal}", "1", note, "s")


def _groups_panel(fits: GroupFits) -> Panel:
    """Values of each group and of all together."""
    number, quantity = np.arange(1.0, len(fits.groups) + 1), fits.equation.quantity
    values, sds = np.array([(group[fits.name], group.sd(fits.name)) for group in fits.groups]).T
    ends = np.array([0.5, len(fits.groups) + 0.5])
    errors = coverage_factor() * sds
    curves = (
        Curve("regression, 95 %", number, values, "measured", error=errors),
        Curve("regression, all groups", ends, np.full(2, fits.pooled[fits.name]), "fit", line=True),
    )
    label = f"{quantity} [{fits.equation.unit}]"
    return Panel("group", label, curves, f"{quantity.capitalize()} of each group")


def _equation_panels(fits: GroupFits, rate: str, side: str, unit: tuple[str, float]) -> tuple[Panel, Panel]:
    """Both sides of the equation as means over the windows, whose slope is the quantity; and the residual."""
    value, linear = fits.pooled[fits.name], [part.linear for part in fits.solution.parts]
    x = -np.concatenate([one.by_theta[0, 0] for one in linear])
    residual = np.concatenate([one.e[0] for one in linear])
    measured = Curve("measured, filtered", x, value * x + residual)
    return Panel(rate, side, (measured,), "Filtered equation", y_unit=unit).with_line(value, "fit")


def _remarks(both: Sequence[GroupFits]) -> Iterator[str]:
    inertances = both[0]
    count = sum(s.starts.size for s in inertances.solution.samples)
    yield (
        f"The regression uses {count} windows of {len(inertances.groups)} groups; no window has a "
        "sample in the dead zone of a meter. The regression accounts for the noise of all signals."
    )
    for fits in both:
        quantity, unit = fits.equation.quantity, fits.equation.unit
        if not fits.determined:
            yield (
                f"These recordings do not determine the {quantity}: {fits.pooled[fits.name]:.2g} +- "
                f"{fits.pooled.sd(fits.name):.1g} {unit}. The parameter keeps its known value. "
                "Recordings with faster changes of flow and pressure would determine the parameter better."
            )
        elif fits.equal < balance.UNLIKELY:
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
    for fits in both:
        yield from balance.misfit_remark(fits.pooled, f"The equation of the {fits.equation.quantity}")
