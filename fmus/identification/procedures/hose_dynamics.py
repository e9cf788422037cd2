"""Inertance and capacitance by their definitions, as in section 4(c): sample by sample, then a mean.

    I = (P_in - P_out - drop)/(dQ_in/dt)        C = (Q_in - Q_out)/(dP_out/dt)

Derivatives by the Savitzky-Golay filter that smooths the other signals too. Only samples with a clear
derivative count, as a ratio with nothing below it says nothing. The result is that of the paper: the mean of
each group, then the mean of these; its scatter is that of the groups. Noise of the derivative draws it to
zero, and what the machine's model leaves out (a share s of the hose, `equations`) goes into it.

The two equations of a hose of one lump, filtered over windows of a recording.

    I dQ/dt = P_in - P_out - R Q - C_R Q|Q| - p_0        Q = Q_in + s (Q_out - Q_in)
    C dP/dt = Q_in - Q_out - q_0                         P = P_out + s (P_in - P_out)

where the machine (`fmus.components.cylinder_drive`) has the flow of the inlet and the capacitance at the
outlet, s = 0. A hose along which both are spread has s = 1/2: the mean of its ends. The share s, the friction
and the offsets p_0, q_0 between two instruments of one kind are estimated with I and C, so that none of them
is mistaken for these.

Fits of the filtered equations of a hose: each group on its own, and all together.

Fig. 7 again: inertance and capacitance of each group, the filtered equations, the residuals.

Inertance and capacitance of a hose (section 4(c), Fig. 7) from pressures and flows at both ends.

Two ways: by their definitions with filtered derivatives and means of groups, as the paper does
(`definition`), and by a regression that differentiates no noise (`weak_form`, `equations`), whose
result goes to the machine: I ~ l/A and C ~ A l for its other lines.

Validity: changes below the frequency of eq. (3), C_0/(2 pi l), above which a hose is no single lump: windows
of four of its periods to each side pass what is below a quarter of it. A clock with fewer than 2.5
samples in such a period is refused.

Hose inertance and capacitance, section 4(c), Fig. 7: `procedure`, by `equations` and by `definition`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse, stats

from fmus.components import hose
from fmus.identification.known import Curve, Estimate, Finding, Panel
from fmus.identification.procedures.hose_resistance import scaled
from fmus.identification.procedures.known_values import denser, hose_size, noise_of, training, value
from fmus.identification.procedures.regression import (
    SURE,
    UNLIKELY,
    WIDTH,
    Guess,
    Regression,
    differ,
    fit,
    misfit_remark,
)
from fmus.identification.procedures.weak_form import Equation, Windows, windows
from fmus.identification.recordings.clock import period, uniform_rate
from fmus.identification.recordings.derivatives import filter_for
from fmus.identification.recordings.masks import good_all
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording, stretches

Array = NDArray[np.float64]

WINDOW = 0.055  # s, of the filter: a third of the shortest change
DEFINITION_SAMPLES = 4  # from the first to the last at least: more than the degree of the filter's polynomial
CLEAR = 0.3  # of the largest derivative of the recording


@dataclass(frozen=True)
class ByDefinition:
    """Samples of I and C of one group."""

    inertance: Array
    capacitance: Array


def by_definition(recording: Recording, resistance: float) -> ByDefinition:
    """Samples of both; the drop is C_R Q|Q| with the hose's C_R [Pa.s2/m6]."""
    window = max(WINDOW, DEFINITION_SAMPLES * period(recording.time))
    used, good = filter_for(recording, window), good_all(recording, EQUATION_SIGNALS)
    value, rate = (
        {name: used.apply(np.where(good, recording[name], np.nan), order) for name in EQUATION_SIGNALS}
        for order in (0, 1)
    )
    flow = value["flow_in"]
    driving = value["pressure_in"] - value["pressure_out"] - resistance * flow * np.abs(flow)
    return ByDefinition(
        inertance=_ratio(driving, rate["flow_in"]),
        capacitance=_ratio(flow - value["flow_out"], rate["pressure_out"]),
    )


def _ratio(top: Array, rate: Array) -> Array:
    size = np.abs(rate)
    clear = size > CLEAR * np.max(size, initial=0.0, where=np.isfinite(size))
    found: Array = top[clear] / rate[clear]
    return found


def mean_of_means(name: str, unit: str, groups: list[Array]) -> Estimate:
    """The mean of the groups' means; its interval by Student's t from their scatter."""
    means = np.array([group.mean() for group in groups if group.size])
    value, n = float(means.mean()) if means.size else float("nan"), means.size
    sd = float(means.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
    half = float(stats.t.ppf(0.975, n - 1)) * sd if n > 1 else float("inf")
    note = f"by definition, mean of {n} group means, section 4(c); the interval is their scatter"
    return Estimate(name, value, unit, sd, value - half, value + half, note)


EQUATION_SIGNALS = ("pressure_in", "pressure_out", "flow_in", "flow_out")


def cut(recording: Recording, half_width: float) -> Windows:
    """Windows [half width in s] in which all four signals are good throughout."""
    parts = stretches(good_all(recording, EQUATION_SIGNALS))
    return windows(parts, recording.time.size, 1 / uniform_rate(recording), half_width)


def inertance(recording: Recording, w: Windows, transition_flow: float) -> Equation:
    """P_in - P_out = I dQ/dt + R Q + C_R Q|Q| + p_0 at Q = Q_in + s (Q_out - Q_in), to the first order in s.

    |Q| is rounded as in `spool_valve.turbulent_drop`.
    """
    flow, more = (
        np.nan_to_num(x) for x in (recording["flow_in"], recording["flow_out"] - recording["flow_in"])
    )
    speed = np.hypot(flow, transition_flow)
    growth = speed + flow**2 / speed  # of Q|Q| with Q
    bend = flow / speed * (3 - (flow / speed) ** 2)  # of that with Q
    own, other = w.bump @ _diagonal(growth), w.bump @ _diagonal(bend * more)
    return Equation(
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
            (
                noise_of(recording, "flow_in"),
                {
                    "I": w.slope,
                    "I s": -w.slope,
                    "R": w.bump,
                    "R s": -w.bump,
                    "C_R": own,
                    "C_R s": other - own,
                },
            ),
            (noise_of(recording, "flow_out"), {"I s": w.slope, "R s": w.bump, "C_R s": own}),
        ),
        factors=lambda v: {
            **{name: v[name] for name in ("I", "R", "C_R", "p_0")},
            **{f"{name} s": v[name] * v["s"] for name in ("I", "R", "C_R")},
        },
    )


def capacitance(recording: Recording, w: Windows) -> Equation:
    """Q_in - Q_out = C dP/dt + q_0 at P = P_out + s (P_in - P_out)."""
    outlet, more = recording["pressure_out"], recording["pressure_in"] - recording["pressure_out"]
    return Equation(
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


def _diagonal(values: Array) -> sparse.dia_array:
    return sparse.diags_array(values)


TELLS = 0.25  # largest relative standard deviation of what the data tell
LEAST = 20  # windows of a group: with fewer its five unknowns say little

Start = Mapping[str, Guess]


@dataclass(frozen=True)
class Fits:
    """Of one quantity, "I" or "C": the fit of all groups and those of each.

    differ   probability of the groups' scatter if all have the same value
    """

    name: str
    equations: tuple[Equation, ...]
    groups: tuple[Regression, ...]
    pooled: Regression
    differ: float

    @property
    def told(self) -> bool:
        """Do the data tell the quantity at all?"""
        return self.pooled.sd(self.name) < TELLS * self.pooled[self.name]


def inertance_start(guess: float, resistance: float, flow: float) -> dict[str, Guess]:
    """Where the fit of `hose_equations.inertance` starts, and the magnitudes of its parameters."""
    drop = resistance * flow**2
    return {
        "I": Guess(guess),
        "C_R": Guess(resistance),
        "R": Guess(0.0, drop / flow),
        "s": Guess(0.0, 1.0),
        "p_0": Guess(0.0, drop),
    }


def capacitance_start(guess: float, flow: float) -> dict[str, Guess]:
    """Where the fit of `hose_equations.capacitance` starts."""
    return {"C": Guess(guess), "s": Guess(0.0, 1.0), "q_0": Guess(0.0, flow)}


def fits(name: str, equations: Sequence[Equation], start: Start, files: Sequence[str]) -> Fits:
    """All groups together and each; the pooled interval is widened to the groups' scatter if they differ."""
    for equation, file in zip(equations, files, strict=True):
        if equation.y.size < LEAST:
            raise Problem(
                f"{file}: {equation.y.size} windows without a bad sample (gap, clipped, dead zone), "
                f"expected at least {LEAST}"
            )
    each = tuple(_fit(name, [equation], start) for equation in equations)
    values, sds = [one[name] for one in each], [one.sd(name) for one in each]
    probability = differ(values, sds) if len(each) > 1 else 1.0
    pooled = _fit(name, equations, start)
    if pooled[name] < -SURE * pooled.sd(name):
        raise Problem(
            f"{', '.join(files)}: {name} is {pooled[name]:.3g}, expected positive: turn the sign of the "
            "flows or the order of the pressures"
        )
    if probability < UNLIKELY:
        scatter = float(np.std(values, ddof=1)) / math.sqrt(len(values))
        pooled = _widened(pooled, max(1.0, scatter / pooled.sd(name)))
    return Fits(name, tuple(equations), each, pooled, probability)


def _fit(name: str, equations: Sequence[Equation], start: Start) -> Regression:
    return fit(partial(_residual, equations), start, f"hose_dynamics, {name}")


def _residual(equations: Sequence[Equation], theta: Mapping[str, float]) -> Array:
    return np.concatenate([equation.weighted(theta) for equation in equations])


def _widened(found: Regression, ratio: float) -> Regression:
    return replace(found, covariance=found.covariance * ratio**2)


@dataclass(frozen=True)
class Axes:
    """Words for one quantity: its axis, the derivative and the other side of its equation, with units."""

    quantity: str
    rate: str
    side: str
    side_unit: tuple[str, float]


INERTANCE = Axes("inertance [kg/m4]", "dQ/dt [m3/s2]", "drop without friction", ("bar", 1e5))
CAPACITANCE = Axes("capacitance [m3/Pa]", "dP/dt [Pa/s]", "flow that stays in the hose", ("L/min", 1e-3 / 60))


def panels(inertance: Fits, capacitance: Fits, defined: Sequence[ByDefinition]) -> tuple[Panel, ...]:
    """Values by group, then the equations, then the residuals."""
    return (
        _groups(inertance, [one.inertance for one in defined], INERTANCE),
        _groups(capacitance, [one.capacitance for one in defined], CAPACITANCE),
        *_equation(inertance, INERTANCE),
        *_equation(capacitance, CAPACITANCE),
    )


def _groups(of: Fits, defined: Sequence[Array], axes: Axes) -> Panel:
    number = np.arange(1.0, len(defined) + 1)
    values = np.array([one[of.name] for one in of.groups])
    errors = WIDTH * np.array([one.sd(of.name) for one in of.groups])
    means, scatter = (np.array([f(one) for one in defined]) for f in (np.mean, np.std))
    ends = np.array([0.5, len(defined) + 0.5])
    curves = (
        Curve("by definition: mean and scatter of samples", number - 0.1, means, "compared", error=scatter),
        Curve("by definition: mean of means", ends, np.full(2, means.mean()), "compared", line=True),
        Curve("regression, 95 %", number + 0.1, values, "measured", error=errors),
        Curve("regression, all groups", ends, np.full(2, of.pooled[of.name]), "fit", line=True),
    )
    return Panel("group", axes.quantity, curves, f"{axes.quantity.split()[0].capitalize()} of each group")


def _equation(of: Fits, axes: Axes) -> tuple[Panel, Panel]:
    """Both sides of the equation, as means over the windows: its slope is the quantity; and the residual."""
    theta = of.pooled.as_dict()
    names = (of.name, f"{of.name} s")
    x = np.concatenate([e.columns[names[0]] + theta["s"] * e.columns[names[1]] for e in of.equations])
    left = np.concatenate([e.residual(theta) for e in of.equations])
    weight = np.concatenate([e.weight for e in of.equations])
    x, left = x / weight, left / weight
    ends = np.array([x.min(), x.max()])
    curves = (
        Curve("measured, filtered", x, theta[of.name] * x + left),
        Curve("fit", ends, theta[of.name] * ends, "fit", line=True),
    )
    rest = (Curve("measured - fitted", x, left),)
    return (
        Panel(axes.rate, axes.side, curves, "Filtered equation", y_unit=axes.side_unit),
        Panel(axes.rate, axes.side + ", residual", rest, "Residual", y_unit=axes.side_unit),
    )


SIGNALS: Mapping[str, str] = {
    "pressure_in": "Pa",
    "pressure_out": "Pa",
    "flow_in": "m3/s",
    "flow_out": "m3/s",
}
PERIODS = 4.0  # half width of the windows, in periods of eq. (3)
SAMPLES = 2.5  # in a period of eq. (3): above Nyquist's two
UNITS = {"I": "kg/m4", "C": "m3/Pa"}
INERTANCES = {
    "boom_stick.stick_hose_inertance": "boom_stick.stick_hose",
    "boom_stick.boom_hose_inertance": "boom_stick.boom_hose",
    "swing.line_inertance": "swing.line",
}
CAPACITANCES = {
    "boom_stick.stick_hose_capacitance": "boom_stick.stick_hose",
    "boom_stick.boom_hose_capacitance": "boom_stick.boom_hose",
}


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """Inertance and capacitance of the stick's, the boom's and the swing's lines from the tested hose."""
    groups = training(recordings, "hose_dynamics", SIGNALS)
    length, bore = hose_size(groups)
    for group in groups:
        _check_flows(group)
    resistance = _resistance(known, length, bore)
    inertance, capacitance = _fits(groups, known, length, bore, resistance)
    defined = [by_definition(group, resistance) for group in groups]
    return Finding(
        procedure="hose_dynamics",
        title=f"Hose inertance and capacitance: {length:g} m, bore {bore * 1e3:.4g} mm",
        figure=7,
        estimates=(*_machines(inertance, groups, known), *_machines(capacitance, groups, known)),
        panels=panels(inertance, capacitance, defined),
        remarks=_remarks(inertance, capacitance),
        others=tuple(_others(inertance, capacitance, defined)),
    )


def _resistance(known: Mapping[str, Number], length: float, bore: float) -> float:
    """C_R of the tested hose from that of the stick's, eq. (10)."""
    own = (value(known, "boom_stick.stick_hose_length"), value(known, "boom_stick.stick_hose_bore"))
    return scaled(value(known, "boom_stick.stick_hose_resistance"), *own, length, bore)


def _fits(
    groups: Sequence[Recording], known: Mapping[str, Number], length: float, bore: float, resistance: float
) -> tuple[Fits, Fits]:
    density, modulus = value(known, "boom_stick.density"), value(known, "boom_stick.bulk_modulus")
    limit = float(hose.frequency_limit(length, density, modulus))
    for group in groups:
        _check_rate(group, limit)
    half_width = PERIODS / limit
    cuts = [cut(group, half_width) for group in groups]
    transition = value(known, "boom_stick.valve_transition_flow")
    flow = max(float(np.nanstd(group["flow_in"])) for group in groups)
    files = [str(group.source) for group in groups]
    start = inertance_start(float(hose.inertance(length, bore, density)), resistance, flow)
    both = zip(groups, cuts, strict=True)
    inertances = fits("I", [inertance(g, w, transition) for g, w in both], start, files)
    start = capacitance_start(float(hose.capacitance(length, bore, modulus)), flow)
    both = zip(groups, cuts, strict=True)
    return inertances, fits("C", [capacitance(g, w) for g, w in both], start, files)


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


def _check_rate(group: Recording, limit: float) -> None:
    rate = uniform_rate(group)
    if rate < SAMPLES * limit:
        raise Problem(
            f"{group.source}: {rate:.0f} samples per second, expected {SAMPLES * limit:.0f} or more: the "
            f"hose itself swings at up to {limit:.0f} Hz, which would be folded into what is slow"
        )


def _machines(of: Fits, groups: Sequence[Recording], known: Mapping[str, Number]) -> list[Estimate]:
    """The machine's lines by I ~ rho l/A, C ~ A l: the same kind of hose. None if the data do not tell it."""
    if not of.told:
        return []
    lines, denser_by = (INERTANCES, denser(groups, known)) if of.name == "I" else (CAPACITANCES, 1.0)
    return [_machine(of, name, at, known, hose_size(groups), denser_by) for name, at in lines.items()]


def _machine(
    of: Fits, name: str, line: str, known: Mapping[str, Number], size: tuple[float, float], denser_by: float
) -> Estimate:
    longer = value(known, f"{line}_length") / size[0]
    wider = float(hose.area(value(known, f"{line}_bore")) / hose.area(size[1]))
    factor = denser_by * (longer / wider if of.name == "I" else longer * wider)
    note = "regression over windows, section 4(c)"
    if abs(factor - 1) > 1e-9:
        note += f", times {factor:.4g} for {longer * size[0]:g} m instead of {size[0]:g} m"
        note += "" if abs(wider - 1) < 1e-9 else f" and {wider:.4g} times the area"
        note += "" if abs(denser_by - 1) < 1e-9 else f" and {denser_by:.4g} times the density"
    return of.pooled.estimate(name, UNITS[of.name], note, of.name, factor)


def _others(inertance: Fits, capacitance: Fits, defined: Sequence[ByDefinition]) -> list[Estimate]:
    note = "regression, the tested hose"
    return [
        inertance.pooled.estimate("I", UNITS["I"], note),
        mean_of_means("I by definition", UNITS["I"], [one.inertance for one in defined]),
        capacitance.pooled.estimate("C", UNITS["C"], note),
        mean_of_means("C by definition", UNITS["C"], [one.capacitance for one in defined]),
        inertance.pooled.estimate(
            "share of the outlet's flow", "1", "s of the flow; 0 lumped, 1/2 spread", "s"
        ),
        capacitance.pooled.estimate(
            "share of the inlet's pressure", "1", "s of the pressure; 0 lumped, 1/2 spread", "s"
        ),
    ]


def _remarks(inertance: Fits, capacitance: Fits) -> tuple[str, ...]:
    count = sum(e.y.size for e in inertance.equations)
    found = [
        f"The regression uses {count} windows of {len(inertance.groups)} groups, none with a sample in the "
        "dead zone of a meter. It accounts for the noise of every signal, also of those beside I and C.",
        "The values by definition are the paper's way: their scatter is that of the groups' means, and the "
        "noise of the derivatives and the place where the flow is measured are in them.",
    ]
    for of, what in ((inertance, "inertance"), (capacitance, "capacitance")):
        if not of.told:
            found.append(
                f"These recordings do not tell the {what}: {of.pooled[of.name]:.2g} +- "
                f"{of.pooled.sd(of.name):.1g} {UNITS[of.name]}. It stays as it is known; faster changes "
                "would tell more."
            )
        elif of.differ < UNLIKELY:
            each = ", ".join(f"{one[of.name]:.4g}" for one in of.groups)
            found.append(
                f"The {what} differs between the groups ({each} {UNITS[of.name]}), more than noise explains: "
                "one number cannot describe this hose. The interval is widened to their scatter."
            )
    share = inertance.pooled
    if inertance.told and share.seen("s"):
        found.append(
            f"The inertia goes with a flow {share['s']:.2f} of the way from the inlet's to the outlet's "
            "(1/2: it is spread evenly along the hose). The lumped hose takes that of the inlet."
        )
    return (
        *found,
        *misfit_remark(inertance.pooled, "The equation of the inertance"),
        *misfit_remark(capacitance.pooled, "The equation of the capacitance"),
    )


__all__ = ["SIGNALS", "identify"]
