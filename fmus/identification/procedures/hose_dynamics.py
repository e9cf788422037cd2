"""Inertance and capacitance of a hose (section 4(c), Fig. 7) from pressures and flows at both ends.

Two ways. By regression on the equations of a hose of one lump, filtered over windows (`weak_form`):

    I dQ/dt = P_in - P_out - R Q - C_R Q|Q| - p_0        Q = Q_in + s (Q_out - Q_in)
    C dP/dt = Q_in - Q_out - q_0                         P = P_out + s (P_in - P_out)

where the machine (`fmus.boom_stick.drive`) has the flow of the inlet and the capacitance at the
outlet, s = 0. A hose along which both are spread has s = 1/2: the mean of its ends. The share s, the friction
and the offsets p_0, q_0 between two instruments of one kind are estimated with I and C, so that none of them
is mistaken for these. The result goes to the machine: I ~ l/A and C ~ A l for its other lines.

And by their definitions, as the paper does, for comparison: sample by sample, then a mean of each group of
recordings, then the mean of these.

    I = (P_in - P_out - drop)/(dQ_in/dt)        C = (Q_in - Q_out)/(dP_out/dt)

Derivatives by the Savitzky-Golay filter that smooths the other signals too. Only samples with a clear
derivative count, as a ratio with nothing below it says nothing. Noise of the derivative draws it to zero, and
what the machine's model leaves out (the share s) goes into it.

Validity: changes below the frequency of eq. (3), C_0/(2 pi l), above which a hose is no single lump: windows
of four of its periods to each side pass what is below a quarter of it. A clock with fewer than 2.5
samples in such a period is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from fmus.components import hose
from fmus.identification.estimate import Curve, Estimate, Panel, ProcedureResult, coverage_factor
from fmus.identification.procedures.bench_data import (
    BAR,
    LITRES,
    density_ratio,
    hose_size,
    noise_of,
    training,
    value,
)
from fmus.identification.procedures.hose_resistance import scaled
from fmus.identification.procedures.regression import (
    SIGNIFICANT,
    UNLIKELY,
    Guess,
    Regression,
    fit,
    homogeneity,
    misfit_remark,
)
from fmus.identification.procedures.weak_form import FilteredEquation, Windows, windows
from fmus.identification.recordings.clock import period, uniform_rate
from fmus.identification.recordings.derivatives import filter_for
from fmus.identification.recordings.masks import good_all
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, true_intervals

Array = NDArray[np.float64]

SIGNALS: Mapping[str, str] = {
    "pressure_in": "Pa",
    "pressure_out": "Pa",
    "flow_in": "m3/s",
    "flow_out": "m3/s",
}
PERIODS = 4.0  # half width of the windows, in periods of eq. (3)
SAMPLES = 2.5  # in a period of eq. (3): above Nyquist's two
UNITS = {"I": "kg/m4", "C": "m3/Pa"}
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
DETERMINED = 0.25  # largest relative standard deviation of what the data determine
LEAST = 20  # windows of a group: with fewer its five unknowns say little
WINDOW = 0.055  # s, of the definition's filter: a third of the shortest change
DEFINITION_SAMPLES = 4  # from the first to the last at least: more than the degree of the filter's polynomial
CLEAR = 0.3  # of the largest derivative of the recording


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> ProcedureResult:
    """Inertance and capacitance of the stick's, the boom's and the swing's lines from the tested hose."""
    groups = training(recordings, "hose_dynamics", SIGNALS)
    length, bore = hose_size(groups)
    for group in groups:
        _check_flows(group)
    # of the tested hose from that of the stick's, eq. (10)
    own = (value(known, "boom_stick.stick_hose_length"), value(known, "boom_stick.stick_hose_bore"))
    resistance = scaled(value(known, "boom_stick.stick_hose_resistance"), *own, length, bore)
    by_inertance, by_capacitance = _both_fits(groups, known, length, bore, resistance)
    defined = [by_definition(group, resistance) for group in groups]
    return ProcedureResult(
        procedure="hose_dynamics",
        title=f"Hose inertance and capacitance: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=7,
        estimates=(*_lines(by_inertance, groups, known), *_lines(by_capacitance, groups, known)),
        panels=(
            _groups_panel(by_inertance, [i for i, _ in defined], "inertance [kg/m4]"),
            _groups_panel(by_capacitance, [c for _, c in defined], "capacitance [m3/Pa]"),
            *_equation_panels(by_inertance, "dQ/dt [m3/s2]", "drop without friction", BAR),
            *_equation_panels(by_capacitance, "dP/dt [Pa/s]", "flow that stays in the hose", LITRES),
        ),
        remarks=tuple(_remarks(by_inertance, by_capacitance)),
        others=tuple(_others(by_inertance, by_capacitance, defined)),
    )


def _check_flows(group: Recording) -> None:
    """Refuse flows that stand, and meters at the two ends that count against each other."""
    ends = [group[name] for name in ("flow_in", "flow_out")]
    there = np.isfinite(ends[0]) & np.isfinite(ends[1])
    inlet, outlet = (flow[there] for flow in ends)
    if inlet.size and not np.ptp(inlet) > 0:
        raise Problem(f"{group.source}: flow_in does not change, expected fast changes of flow and pressure")
    if inlet @ outlet < 0:
        raise Problem(
            f"{group.source}: flow_in and flow_out have opposite signs, expected both positive from inlet to "
            "outlet"
        )


def _both_fits(
    groups: Sequence[Recording], known: Mapping[str, Number], length: float, bore: float, resistance: float
) -> tuple[GroupFits, GroupFits]:
    density, modulus = value(known, "boom_stick.density"), value(known, "boom_stick.bulk_modulus")
    limit = float(hose.frequency_limit(length, density, modulus))
    for group in groups:
        rate = uniform_rate(group)
        if rate < SAMPLES * limit:
            raise Problem(
                f"{group.source}: {rate:.0f} samples per second, expected {SAMPLES * limit:.0f} or more: the "
                f"hose itself swings at up to {limit:.0f} Hz, which would be folded into what is slow"
            )
    pairs = [(group, cut(group, PERIODS / limit)) for group in groups]
    transition = value(known, "boom_stick.valve_transition_flow")
    flow = max(float(np.nanstd(group["flow_in"])) for group in groups)
    files = [str(group.source) for group in groups]
    start = inertance_start(float(hose.inertance(length, bore, density)), resistance, flow)
    by_inertance = fits("I", [inertance(g, w, transition) for g, w in pairs], start, files)
    guess = float(hose.capacitance(length, bore, modulus))
    start = {"C": Guess(guess), "s": Guess(0.0, 1.0), "q_0": Guess(0.0, flow)}
    return by_inertance, fits("C", [capacitance(g, w) for g, w in pairs], start, files)


def inertance_start(guess: float, resistance: float, flow: float) -> dict[str, Guess]:
    """Where the fit of the inertance starts, and the magnitudes of its parameters."""
    drop = resistance * flow**2
    return {
        "I": Guess(guess),
        "C_R": Guess(resistance),
        "R": Guess(0.0, drop / flow),
        "s": Guess(0.0, 1.0),
        "p_0": Guess(0.0, drop),
    }


def cut(recording: Recording, half_width: float) -> Windows:
    """Windows [half width in s] in which all four signals are good throughout."""
    parts = true_intervals(good_all(recording, SIGNALS))
    return windows(parts, recording.time.size, 1 / uniform_rate(recording), half_width)


def inertance(recording: Recording, w: Windows, transition_flow: float) -> FilteredEquation:
    """P_in - P_out = I dQ/dt + R Q + C_R Q|Q| + p_0 at Q = Q_in + s (Q_out - Q_in), to the first order in s.

    |Q| is rounded as in `spool_valve.turbulent_drop`.
    """
    flow = np.nan_to_num(recording["flow_in"])
    more = np.nan_to_num(recording["flow_out"] - recording["flow_in"])
    speed = np.hypot(flow, transition_flow)
    growth = speed + flow**2 / speed  # of Q|Q| with Q
    bend = flow / speed * (3 - (flow / speed) ** 2)  # of that with Q
    own, other = (w.bump @ sparse.diags_array(values) for values in (growth, bend * more))
    of_inlet = {
        "I": w.slope,
        "I s": -w.slope,
        "R": w.bump,
        "R s": -w.bump,
        "C_R": own,
        "C_R s": other - own,
    }
    return FilteredEquation(
        windows=w,
        y=w.bump @ np.nan_to_num(recording["pressure_in"] - recording["pressure_out"]),
        columns={
            "I": w.slope @ flow,
            "I s": w.slope @ more,
            "R": w.bump @ flow,
            "R s": w.bump @ more,
            "C_R": w.bump @ (flow * speed),
            "C_R s": own @ more,
            "p_0": w.bump @ np.ones_like(flow),
        },
        noise=(
            (noise_of(recording, "pressure_in"), {"y": w.bump}),
            (noise_of(recording, "pressure_out"), {"y": w.bump}),
            (noise_of(recording, "flow_in"), of_inlet),
            (noise_of(recording, "flow_out"), {"I s": w.slope, "R s": w.bump, "C_R s": own}),
        ),
        factors=lambda v: {
            **{name: v[name] for name in ("I", "R", "C_R", "p_0")},
            **{f"{name} s": v[name] * v["s"] for name in ("I", "R", "C_R")},
        },
    )


def capacitance(recording: Recording, w: Windows) -> FilteredEquation:
    """Q_in - Q_out = C dP/dt + q_0 at P = P_out + s (P_in - P_out)."""
    outlet, more = recording["pressure_out"], recording["pressure_in"] - recording["pressure_out"]
    return FilteredEquation(
        windows=w,
        y=w.bump @ np.nan_to_num(recording["flow_in"] - recording["flow_out"]),
        columns={
            "C": w.slope @ np.nan_to_num(outlet),
            "C s": w.slope @ np.nan_to_num(more),
            "q_0": w.bump @ np.ones_like(outlet),
        },
        noise=(
            (noise_of(recording, "flow_in"), {"y": w.bump}),
            (noise_of(recording, "flow_out"), {"y": w.bump}),
            (noise_of(recording, "pressure_in"), {"C s": w.slope}),
            (noise_of(recording, "pressure_out"), {"C": w.slope, "C s": -w.slope}),
        ),
        factors=lambda v: {"C": v["C"], "C s": v["C"] * v["s"], "q_0": v["q_0"]},
    )


@dataclass(frozen=True)
class GroupFits:
    """Of one quantity, "I" or "C": the fit of all groups and those of each.

    homogeneity   probability of the groups' scatter if all have the same value
    """

    name: str
    equations: tuple[FilteredEquation, ...]
    groups: tuple[Regression, ...]
    pooled: Regression
    homogeneity: float

    @property
    def determined(self) -> bool:
        """Do the data determine the quantity at all?"""
        return self.pooled.sd(self.name) < DETERMINED * self.pooled[self.name]


def fits(
    name: str, equations: Sequence[FilteredEquation], start: Mapping[str, Guess], files: Sequence[str]
) -> GroupFits:
    """All groups together and each; the pooled interval is widened to the groups' scatter if they differ."""
    for equation, file in zip(equations, files, strict=True):
        if equation.y.size < LEAST:
            raise Problem(
                f"{file}: {equation.y.size} windows without a bad sample (gap, clipped, dead zone), "
                f"expected at least {LEAST}"
            )

    def fitted(some: Sequence[FilteredEquation]) -> Regression:
        def residual(theta: Mapping[str, float]) -> Array:
            return np.concatenate([equation.weighted(theta) for equation in some])

        return fit(residual, start, f"hose_dynamics, {name}")

    each = tuple(fitted([equation]) for equation in equations)
    values, sds = [one[name] for one in each], [one.sd(name) for one in each]
    probability = homogeneity(values, sds) if len(each) > 1 else 1.0
    pooled = fitted(equations)
    if pooled[name] < -SIGNIFICANT * pooled.sd(name):
        raise Problem(
            f"{', '.join(files)}: {name} is {pooled[name]:.3g}, expected positive: turn the sign of the "
            "flows or the order of the pressures"
        )
    if probability < UNLIKELY:
        scatter = float(np.std(values, ddof=1)) / math.sqrt(len(values))
        widening = max(1.0, scatter / pooled.sd(name))
        pooled = replace(pooled, covariance=pooled.covariance * widening**2)
    return GroupFits(name, tuple(equations), each, pooled, probability)


def by_definition(recording: Recording, resistance: float) -> tuple[Array, Array]:
    """Samples of I and of C; the drop is C_R Q|Q| with the hose's C_R [Pa.s2/m6]."""
    window = max(WINDOW, DEFINITION_SAMPLES * period(recording.time))
    used, good = filter_for(recording, window), good_all(recording, SIGNALS)
    signal, rate = (
        {name: used.apply(np.where(good, recording[name], np.nan), order) for name in SIGNALS}
        for order in (0, 1)
    )
    flow = signal["flow_in"]
    driving = signal["pressure_in"] - signal["pressure_out"] - resistance * flow * np.abs(flow)
    ratios = []
    for top, below in ((driving, rate["flow_in"]), (flow - signal["flow_out"], rate["pressure_out"])):
        size = np.abs(below)
        clear = size > CLEAR * np.max(size, initial=0.0, where=np.isfinite(size))
        ratios.append(top[clear] / below[clear])
    return ratios[0], ratios[1]


def mean_of_means(name: str, unit: str, groups: list[Array]) -> Estimate:
    """The mean of the groups' means; its interval by Student's t from their scatter."""
    means = np.array([group.mean() for group in groups if group.size])
    n = means.size
    mean = float(means.mean()) if n else float("nan")
    sd = float(means.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
    note = f"by definition, mean of {n} group means, section 4(c); the interval is their scatter"
    return Estimate.normal(name, mean, unit, sd, note, max(n - 1, 1))


def _lines(of: GroupFits, groups: Sequence[Recording], known: Mapping[str, Number]) -> Iterator[Estimate]:
    """The machine's lines by I ~ rho l/A, C ~ A l: the same kind of hose. None if the data leave it open."""
    if not of.determined:
        return
    length, bore = hose_size(groups)
    denser = density_ratio(groups, known) if of.name == "I" else 1.0
    for name, line in LINES[of.name].items():
        longer = value(known, f"{line}_length") / length
        wider = float(hose.area(value(known, f"{line}_bore")) / hose.area(bore))
        factor = denser * (longer / wider if of.name == "I" else longer * wider)
        note = "regression over windows, section 4(c)"
        if abs(factor - 1) > 1e-9:
            note += f", times {factor:.4g} for {longer * length:g} m instead of {length:g} m"
            note += "" if abs(wider - 1) < 1e-9 else f" and {wider:.4g} times the area"
            note += "" if abs(denser - 1) < 1e-9 else f" and {denser:.4g} times the density"
        yield of.pooled.estimate(name, UNITS[of.name], note, of.name, factor)


def _others(
    by_inertance: GroupFits, by_capacitance: GroupFits, defined: Sequence[tuple[Array, Array]]
) -> Iterator[Estimate]:
    for k, of in enumerate((by_inertance, by_capacitance)):
        unit = UNITS[of.name]
        yield of.pooled.estimate(of.name, unit, "regression, the tested hose")
        yield mean_of_means(f"{of.name} by definition", unit, [one[k] for one in defined])
    for of, what, end in ((by_inertance, "flow", "outlet"), (by_capacitance, "pressure", "inlet")):
        note = f"s of the {what}; 0 lumped, 1/2 spread"
        yield of.pooled.estimate(f"share of the {end}'s {what}", "1", note, "s")


def _groups_panel(of: GroupFits, defined: Sequence[Array], label: str) -> Panel:
    """Values by group, by both ways."""
    number = np.arange(1.0, len(defined) + 1)
    values = np.array([one[of.name] for one in of.groups])
    errors = coverage_factor() * np.array([one.sd(of.name) for one in of.groups])
    means, scatter = (np.array([f(one) for one in defined]) for f in (np.mean, np.std))
    ends = np.array([0.5, len(defined) + 0.5])
    curves = (
        Curve("by definition: mean and scatter of samples", number - 0.1, means, "compared", error=scatter),
        Curve("by definition: mean of means", ends, np.full(2, means.mean()), "compared", line=True),
        Curve("regression, 95 %", number + 0.1, values, "measured", error=errors),
        Curve("regression, all groups", ends, np.full(2, of.pooled[of.name]), "fit", line=True),
    )
    return Panel("group", label, curves, f"{label.split()[0].capitalize()} of each group")


def _equation_panels(of: GroupFits, rate: str, side: str, unit: tuple[str, float]) -> tuple[Panel, Panel]:
    """Both sides of the equation, as means over the windows: its slope is the quantity; and the residual."""
    theta = of.pooled.as_dict()
    x = np.concatenate([e.columns[of.name] + theta["s"] * e.columns[f"{of.name} s"] for e in of.equations])
    left = np.concatenate([e.residual(theta) for e in of.equations])
    weight = np.concatenate([e.weight for e in of.equations])
    x, left = x / weight, left / weight
    ends = np.array([x.min(), x.max()])
    curves = (
        Curve("measured, filtered", x, theta[of.name] * x + left),
        Curve("fit", ends, theta[of.name] * ends, "fit", line=True),
    )
    residual = (Curve("measured - fitted", x, left),)
    return (
        Panel(rate, side, curves, "Filtered equation", y_unit=unit),
        Panel(rate, side + ", residual", residual, "Residual", y_unit=unit),
    )


def _remarks(by_inertance: GroupFits, by_capacitance: GroupFits) -> Iterator[str]:
    count = sum(e.y.size for e in by_inertance.equations)
    yield (
        f"The regression uses {count} windows of {len(by_inertance.groups)} groups, none with a sample in "
        "the dead zone of a meter. It accounts for the noise of every signal, also of the other terms."
    )
    yield (
        "The values by definition are the paper's way: their scatter is that of the groups' means, and the "
        "noise of the derivatives and the place where the flow is measured are in them."
    )
    for of, what in ((by_inertance, "inertance"), (by_capacitance, "capacitance")):
        if not of.determined:
            yield (
                f"These recordings do not tell the {what}: {of.pooled[of.name]:.2g} +- "
                f"{of.pooled.sd(of.name):.1g} {UNITS[of.name]}. It stays as it is known; faster changes "
                "would tell more."
            )
        elif of.homogeneity < UNLIKELY:
            each = ", ".join(f"{one[of.name]:.4g}" for one in of.groups)
            yield (
                f"The {what} differs between the groups ({each} {UNITS[of.name]}), more than noise explains: "
                "one number cannot describe this hose. The interval is widened to their scatter."
            )
    if by_inertance.determined and by_inertance.pooled.significant("s"):
        yield (
            f"The inertia goes with a flow {by_inertance.pooled['s']:.2f} of the way from the inlet's to the "
            "outlet's (1/2: it is spread evenly along the hose). The lumped hose takes that of the inlet."
        )
    yield from misfit_remark(by_inertance.pooled, "The equation of the inertance")
    yield from misfit_remark(by_capacitance.pooled, "The equation of the capacitance")
