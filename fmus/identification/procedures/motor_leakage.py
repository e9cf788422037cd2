"""Leakage of the swing motor (section 4(d), eqs. (11), (12), Fig. 8): shaft locked, port pressures stepped.

    drain_flow = (P_1 + P_2)/R_ex              flow_a = (P_1 - P_2)/R_in + P_1/R_ex

with pressures above that of the tank. Both flows are linear in the conductances 1/R, which are estimated
together by least squares over the means of the steps, weighted with their errors; those of the pressures
count by the slope. Each flow has a zero in addition, which takes what the zeros of meters and transducers add
up to. Quadratic terms are tested, not used.

Validity: laminar leakage, steady pressures, pressure sensors at the motor (a remark says what the line does).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fmus.identification.estimate import Curve, Panel, ProcedureResult, coverage_factor
from fmus.identification.procedures.bench_data import (
    BAR,
    LITRES,
    NEEDED,
    standing,
    tank_pressure,
    training,
    value,
)
from fmus.identification.procedures.regression import SIGNIFICANT, Regression, linear, misfit_remark
from fmus.identification.recordings.masks import averages
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording

Array = NDArray[np.float64]
SIGNALS = {"pressure_a": "Pa", "pressure_b": "Pa", "flow_a": "m3/s", "drain_flow": "m3/s"}
PRESSURES = ("pressure_a", "pressure_b")
LITTLE = 0.1  # of a standard deviation: what is smaller is not mentioned
EQUATIONS = {"internal": "(11)", "external": "(12)"}
# what else could be in the flows
TESTED = {
    "square_in": "a quadratic part of the internal leakage",
    "square_ex": "a quadratic part of the external leakage",
}
ZEROS = {"zero_a": "in line A", "zero_drain": "in the drain"}


@dataclass(frozen=True)
class SteadyPoints:
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


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> ProcedureResult:
    """Internal and external leakage resistance."""
    own = training(recordings, "motor_leakage", SIGNALS)
    points = steady_points(own)
    fit = conductances(points)
    for which in EQUATIONS:
        if fit[which] < -SIGNIFICANT * fit.sd(which):
            raise Problem(
                f"motor_leakage: the {which} leakage is {fit[which]:.3g} m3/(s.Pa), expected positive: turn "
                "the sign of flow_a (positive into port A) or of drain_flow (positive out of the motor)"
            )
    # only of a conductance clearly above zero there is a resistance
    clear = [which for which in EQUATIONS if fit[which] > SIGNIFICANT * fit.sd(which)]
    line = f"line through {points.source.size} steady points"
    return ProcedureResult(
        procedure="motor_leakage",
        title="Leakage of the swing motor: flow over pressure",
        figure=8,
        estimates=tuple(
            fit.derived(
                f"{which}_leakage_resistance",
                "Pa.s/m3",
                f"eq. {EQUATIONS[which]}, {line}",
                partial(lambda name, g: 1 / g[name], which),
            )
            for which in clear
        ),
        panels=panels(points, fit["internal"], fit["external"], [r.title for r in own]),
        remarks=(
            f"{points.source.size} stretches with steady pressures in {len(own)} recordings are used.",
            *misfit_remark(fit, "The linear law"),
            *_remarks(fit, points, clear, value(known, "swing.line_resistance")),
        ),
        others=tuple(
            fit.estimate(f"conductance, {which} leakage", "m3/(s.Pa)", "1/R", which) for which in EQUATIONS
        ),
    )


def steady_points(recordings: Sequence[Recording]) -> SteadyPoints:
    """All steady points of these recordings; at least three."""
    rows = [np.empty((0, len(fields(SteadyPoints))))]
    for k, recording in enumerate(recordings):
        shaft = recording.conditions.get("shaft", "locked")
        if shaft != "locked":
            raise Problem(f"{recording.source}: [experiment] shaft is {shaft!r}, expected 'locked'")
        parts = standing(recording, PRESSURES)
        if parts:
            average = averages(recording, list(SIGNALS), parts)
            means, errors = (
                np.column_stack([one[n] for n in SIGNALS]) for one in (average.mean, average.error)
            )
            means[:, :2] -= tank_pressure(recording)
            rows.append(np.column_stack([means, errors, np.full(len(parts), k)]))
    table = np.concatenate(rows)
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < 3:
        raise Problem(
            f"{recordings[0].source}: {len(table)} stretches with steady pressures, expected 3 or more of "
            f"{NEEDED:g} s"
        )
    return SteadyPoints(*table.T)


def conductances(p: SteadyPoints, tested: Sequence[str] = ()) -> Regression:
    """Both equations over all points, flows in line A first; `tested` are names of TESTED."""
    y, columns = np.concatenate([p.flow_a, p.drain]), _columns(p)
    used = {n: columns[n] for n in (*EQUATIONS, *ZEROS, *tested)}
    meters = np.concatenate([p.flow_a_error, p.drain_error])
    fit = linear(y, used, meters, "motor_leakage")
    g_in, g_ex = fit["internal"], fit["external"]
    by_a = np.concatenate([(g_in + g_ex) * p.pressure_a_error, g_ex * p.pressure_a_error])
    by_b = np.concatenate([g_in * p.pressure_b_error, g_ex * p.pressure_b_error])
    return linear(y, used, np.sqrt(meters**2 + by_a**2 + by_b**2), "motor_leakage")


def _columns(p: SteadyPoints) -> dict[str, Array]:
    zero, one, d = np.zeros_like(p.total), np.ones_like(p.total), p.difference
    square_a, square_b = p.pressure_a * np.abs(p.pressure_a), p.pressure_b * np.abs(p.pressure_b)
    return {
        "internal": np.concatenate([d, zero]),
        "external": np.concatenate([p.pressure_a, p.total]),
        "square_in": np.concatenate([d * np.abs(d), zero]),
        "square_ex": np.concatenate([square_a, square_a + square_b]),
        "zero_a": np.concatenate([one, zero]),
        "zero_drain": np.concatenate([zero, one]),
    }


def panels(p: SteadyPoints, internal: float, external: float, titles: Sequence[str]) -> tuple[Panel, ...]:
    """Both leakages over pressure with their lines, residuals below."""
    inner, inner_error = (
        p.flow_a - external * p.pressure_a,
        np.hypot(p.flow_a_error, external * p.pressure_a_error),
    )
    every: list[Panel] = []
    for which, over, x, y, error, slope in (
        ("internal", "P_1 - P_2", p.difference, inner, inner_error, internal),
        ("external", "P_1 + P_2", p.total, p.drain, p.drain_error, external),
    ):
        parts = [(title, p.source == k) for k, title in enumerate(titles)]
        ends = np.array([min(x.min(), 0.0), max(x.max(), 0.0)])
        measured = [Curve(title, x[m], y[m]) for title, m in parts]
        half = coverage_factor() * error
        left = [Curve(title, x[m], (y - slope * x)[m], error=half[m]) for title, m in parts]
        fitted = Curve(f"line, 1/R = {slope:.4g} m3/(s.Pa)", ends, slope * ends, "fit", line=True)
        line = Panel(over, f"{which} leakage", (*measured, fitted), x_unit=BAR, y_unit=LITRES)
        millilitres = ("mL/min", LITRES[1] / 1000)
        every += [line, replace(line, y_label="residual", curves=tuple(left), y_unit=millilitres)]
    return tuple(every)


def _remarks(fit: Regression, p: SteadyPoints, clear: Sequence[str], resistance: float) -> Iterator[str]:
    """Zeros, terms that the laminar law does not have, what cannot be seen, the line to the sensors."""
    litre = LITRES[1]
    for name, place in ZEROS.items():
        if fit.significant(name):
            yield (
                f"Without pressure a flow {place} of {fit[name] / litre:.2g} +- {fit.sd(name) / litre:.1g} "
                "L/min would be left. That is taken off as an error of the zeros of meters or transducers."
            )
    yield from _tested(p)
    for which in EQUATIONS:
        if which not in clear:
            yield (
                f"The {which} leakage is too small to be seen: it is below "
                f"{max(fit[which], 0.0) + coverage_factor() * fit.sd(which):.2g} m3/(s.Pa). The resistance "
                "stays as it is known."
            )
    drop = resistance * float(np.abs(p.flow_a).max())
    share = resistance * (fit["internal"] + fit["external"])
    if share >= LITTLE * fit.sd("external") / abs(fit["external"]):
        yield (
            f"The pressures are taken as those at the motor. If the sensors are at the far end of its lines "
            f"({resistance:.3g} Pa.s/m3), up to {drop:.2g} Pa lie between, and the resistances are "
            f"{100 * share:.2g} % too large."
        )


def _tested(p: SteadyPoints) -> Iterator[str]:
    """A sentence on each significant quadratic term, the clearest first, and one if there is none."""
    chosen: list[str] = []
    while left := [n for n in TESTED if n not in chosen]:
        fits = {n: conductances(p, [*chosen, n]) for n in left}
        best = max(left, key=lambda n: abs(fits[n][n]) / fits[n].sd(n))
        if not fits[best].significant(best):
            break
        chosen.append(best)
    largest = {n: np.abs(column).max() / LITRES[1] for n, column in _columns(p).items()}
    if chosen:
        fit = conductances(p, chosen)
        for n in chosen:
            yield (
                f"The flows have {TESTED[n]}: {fit[n] * largest[n]:.2g} +- {fit.sd(n) * largest[n]:.1g} "
                "L/min at most, which the laminar law of eqs. (11), (12) does not have."
            )
        return
    visible = max(SIGNIFICANT * conductances(p, [n]).sd(n) * largest[n] for n in TESTED) * LITRES[1]
    share = 100 * visible / max(np.abs(p.flow_a).max(), np.abs(p.drain).max())
    yield f"The leakage is linear: a quadratic part would be seen from {share:.2g} % of the largest flow on."
