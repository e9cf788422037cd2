"""Steady points of a motor with a locked shaft: means of pressures and flows where both pressures stand.

Figure 8: internal and external leakage over pressure with their lines, residuals below.

Leakage of the swing motor (section 4(d), eqs. (11), (12), Fig. 8): shaft locked, port pressures stepped.

    drain_flow = (P_1 + P_2)/R_ex              flow_a = (P_1 - P_2)/R_in + P_1/R_ex

with pressures above that of the tank. Both flows are linear in the conductances 1/R, which are found together
by least squares over the means of the steps, weighted with their errors; those of the pressures count by the
slope. Each flow has a zero beside its lines, which takes what the zeros of meters and transducers add up to.
Quadratic terms are tested, not used.

Validity: laminar leakage, steady pressures, pressure sensors at the motor (the line between is told of).

Motor leakage, section 4(d), eqs. (11), (12), Fig. 8: `procedure` fits the `points`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from fmus.identification.known import Curve, Estimate, Finding, Panel
from fmus.identification.procedures.known_values import NEEDED, standing, tank_pressure, training, value
from fmus.identification.procedures.regression import SURE, WIDTH, Regression, linear, misfit_remark
from fmus.identification.recordings.masks import averages
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
SIGNALS = {"pressure_a": "Pa", "pressure_b": "Pa", "flow_a": "m3/s", "drain_flow": "m3/s"}
PRESSURES = ("pressure_a", "pressure_b")


@dataclass(frozen=True)
class Points:
    """One entry per stretch, shape (n,): gauge pressures above the tank [Pa], flows [m3/s], standard errors.

    source   number of the recording
    """

    pressure_a: Array
    pressure_b: Array
    flow_a: Array
    drain: Array
    pressure_a_error: Array
    pressure_b_error: Array
    flow_a_error: Array
    drain_error: Array
    source: Array

    @property
    def difference(self) -> Array:
        """P_1 - P_2, over which the internal leakage flows."""
        return self.pressure_a - self.pressure_b

    @property
    def total(self) -> Array:
        """P_1 + P_2 above the tank, over which both external leakages flow."""
        return self.pressure_a + self.pressure_b


def points(recordings: Sequence[Recording]) -> Points:
    """All steady points of these recordings; at least three."""
    table = np.concatenate([_points(r, k) for k, r in enumerate(recordings)])
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < 3:
        raise Problem(
            f"{recordings[0].source}: {len(table)} stretches with steady pressures, expected 3 or more of "
            f"{NEEDED:g} s"
        )
    return Points(*(table[:, i] for i, _ in enumerate(fields(Points))))


def _points(recording: Recording, number: int) -> Array:
    """(n, 9) in the order of `Points`."""
    if recording.conditions.get("shaft", "locked") != "locked":
        raise Problem(
            f"{recording.source}: [experiment] shaft is {recording.conditions['shaft']!r}, expected 'locked'"
        )
    parts = standing(recording, PRESSURES)
    if not parts:
        return np.empty((0, len(fields(Points))))
    found = averages(recording, list(SIGNALS), parts)
    means, errors = (np.column_stack([one[n] for n in SIGNALS]) for one in (found.mean, found.error))
    means[:, :2] -= tank_pressure(recording)
    return np.column_stack([means, errors, np.full(len(parts), number)])


BAR, LITRES, MILLILITRES = ("bar", 1e5), ("L/min", 1e-3 / 60), ("mL/min", 1e-6 / 60)


def panels(p: Points, internal: float, external: float, titles: Sequence[str]) -> tuple[Panel, ...]:
    """Two each, for these conductances."""
    inner = p.flow_a - external * p.pressure_a
    by_pressure = external * p.pressure_a_error
    inner_error = np.sqrt(p.flow_a_error**2 + by_pressure**2)
    return (
        *_pair("internal", "P_1 - P_2", p.difference, inner, inner_error, internal, p, titles),
        *_pair("external", "P_1 + P_2", p.total, p.drain, p.drain_error, external, p, titles),
    )


def _pair(
    which: str,
    over: str,
    x: Array,
    y: Array,
    error: Array,
    slope: float,
    p: Points,
    titles: Sequence[str],
) -> tuple[Panel, Panel]:
    parts = [(title, p.source == k) for k, title in enumerate(titles)]
    ends = np.array([min(x.min(), 0.0), max(x.max(), 0.0)])
    measured = [Curve(title, x[m], y[m]) for title, m in parts]
    left = [Curve(title, x[m], (y - slope * x)[m], error=WIDTH * error[m]) for title, m in parts]
    line = Panel(
        x_label=over,
        y_label=f"{which} leakage",
        curves=(*measured, Curve(f"line, 1/R = {slope:.4g} m3/(s.Pa)", ends, slope * ends, "fit", line=True)),
        x_unit=BAR,
        y_unit=LITRES,
    )
    return line, replace(line, y_label="residual", curves=tuple(left), y_unit=MILLILITRES)


__all__ = ["SIGNALS", "identify"]

UNIT = "Pa.s/m3"
LITTLE = 0.1  # of a standard deviation: what is smaller is not told
WHICH = ("internal", "external")
LITRES_PROCEDURE = 1e-3 / 60  # m3/s in one L/min
# what else could be in the flows
TESTED = {
    "square_in": "a quadratic part of the internal leakage",
    "square_ex": "a quadratic part of the external leakage",
}
ZEROS = {"zero_a": "in line A", "zero_drain": "in the drain"}
FOUND = ("internal", "external", *ZEROS)


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """Internal and external leakage resistance."""
    own = training(recordings, "motor_leakage", SIGNALS)
    steady = points(own)
    fit = conductances(steady)
    _check_signs(fit)
    return Finding(
        procedure="motor_leakage",
        title="Leakage of the swing motor: flow over pressure",
        figure=8,
        estimates=tuple(_resistance(fit, which, len(steady.total)) for which in WHICH if told(fit, which)),
        panels=panels(steady, fit["internal"], fit["external"], [r.title for r in own]),
        remarks=(
            f"{len(steady.total)} stretches with steady pressures in {len(own)} recordings are used.",
            *misfit_remark(fit, "The linear law"),
            *_zeros(fit),
            *_tested(steady),
            *_untold(fit),
            *_line(fit, steady, value(known, "swing.line_resistance")),
        ),
        others=tuple(
            fit.estimate(f"conductance, {which} leakage", "m3/(s.Pa)", "1/R", which) for which in WHICH
        ),
    )


def told(fit: Regression, which: str) -> bool:
    """Is a conductance clearly above zero, so that there is a resistance?"""
    return fit[which] > SURE * fit.sd(which)


def _check_signs(fit: Regression) -> None:
    for which in WHICH:
        if fit[which] < -SURE * fit.sd(which):
            raise Problem(
                f"motor_leakage: the {which} leakage is {fit[which]:.3g} m3/(s.Pa), expected positive: turn "
                "the sign of flow_a (positive into port A) or of drain_flow (positive out of the motor)"
            )


def conductances(p: Points, tested: Sequence[str] = ()) -> Regression:
    """Both equations over all points, flows in line A first; `tested` are names of TESTED."""
    y = np.concatenate([p.flow_a, p.drain])
    columns = _columns(p)
    used = {n: columns[n] for n in (*FOUND, *tested)}
    meters = np.concatenate([p.flow_a_error, p.drain_error])
    fit = linear(y, used, meters, "motor_leakage")
    g_in, g_ex = fit["internal"], fit["external"]
    by_a = np.concatenate([(g_in + g_ex) * p.pressure_a_error, g_ex * p.pressure_a_error])
    by_b = np.concatenate([g_in * p.pressure_b_error, g_ex * p.pressure_b_error])
    return linear(y, used, np.sqrt(meters**2 + by_a**2 + by_b**2), "motor_leakage")


def _columns(p: Points) -> dict[str, Array]:
    zero, one = np.zeros_like(p.total), np.ones_like(p.total)
    d = p.difference
    square_a, square_b = p.pressure_a * np.abs(p.pressure_a), p.pressure_b * np.abs(p.pressure_b)
    return {
        "internal": np.concatenate([d, zero]),
        "external": np.concatenate([p.pressure_a, p.total]),
        "square_in": np.concatenate([d * np.abs(d), zero]),
        "square_ex": np.concatenate([square_a, square_a + square_b]),
        "zero_a": np.concatenate([one, zero]),
        "zero_drain": np.concatenate([zero, one]),
    }


def _resistance(fit: Regression, which: str, count: int) -> Estimate:
    equation = {"internal": "(11)", "external": "(12)"}[which]
    note = f"eq. {equation}, line through {count} steady points"
    return fit.derived(f"{which}_leakage_resistance", UNIT, note, lambda g: 1 / g[which])


def _tested(p: Points) -> tuple[str, ...]:
    """A sentence on each term that can be seen, the clearest first, and one if none can."""
    chosen: list[str] = []
    while left := [n for n in TESTED if n not in chosen]:
        ratios = {n: _ratio(conductances(p, [*chosen, n]), n) for n in left}
        best = max(ratios, key=lambda n: ratios[n])
        if ratios[best] < SURE:
            break
        chosen.append(best)
    largest = {n: np.abs(column).max() for n, column in _columns(p).items()}
    if chosen:
        fit = conductances(p, chosen)
        return tuple(
            f"The flows have {TESTED[n]}: {fit[n] * largest[n] / LITRES_PROCEDURE:.2g} +- "
            f"{fit.sd(n) * largest[n] / LITRES_PROCEDURE:.1g} L/min at most, which the laminar law of eqs. (11), (12) "
            "does not have."
            for n in chosen
        )
    seen = max(SURE * conductances(p, [n]).sd(n) * largest[n] for n in TESTED)
    share = 100 * seen / max(np.abs(p.flow_a).max(), np.abs(p.drain).max())
    return (
        f"The leakage is linear: a quadratic part would be seen from {share:.2g} % of the largest flow on.",
    )


def _ratio(fit: Regression, name: str) -> float:
    """A term over its standard deviation."""
    return abs(fit[name]) / fit.sd(name)


def _zeros(fit: Regression) -> tuple[str, ...]:
    """Flows that are there without pressure."""
    return tuple(
        f"Without pressure a flow {where} of {fit[n] / LITRES_PROCEDURE:.2g} +- {fit.sd(n) / LITRES_PROCEDURE:.1g} L/min would "
        "be left. That is taken off as an error of the zeros of meters or transducers."
        for n, where in ZEROS.items()
        if fit.seen(n)
    )


def _untold(fit: Regression) -> tuple[str, ...]:
    return tuple(
        f"The {which} leakage is too small to be seen: it is below "
        f"{max(fit[which], 0.0) + WIDTH * fit.sd(which):.2g} m3/(s.Pa). The resistance stays as it is known."
        for which in WHICH
        if not told(fit, which)
    )


def _line(fit: Regression, p: Points, resistance: float) -> tuple[str, ...]:
    """What the line between sensor and motor does, if it is not small beside the interval."""
    drop = resistance * float(np.abs(p.flow_a).max())
    share = resistance * (fit["internal"] + fit["external"])
    if share < LITTLE * fit.sd("external") / abs(fit["external"]):
        return ()
    return (
        f"The pressures are taken as those at the motor. If the sensors are at the far end of its lines "
        f"({resistance:.3g} Pa.s/m3), up to {drop:.2g} Pa lie between, and the resistances are "
        f"{100 * share:.2g} % too large.",
    )
