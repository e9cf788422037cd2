"""Motor leakage procedure (section 4(d), eqs. (11), (12), Fig. 8): shaft locked, port pressures stepped.

    drain_flow = (P_1 + P_2)/R_ex              flow_a = (P_1 - P_2)/R_in + P_1/R_ex

Pressures are relative to that of the tank. Both flows are linear in the conductances 1/R, which are estimated
together by weighted least squares over means of steady stretches. The weights contain the errors of the flows
and of the pressures times the conductances. Each flow has an additional offset for the zeros of meters and
transducers. Quadratic terms are tested but not used.

Validity: laminar leakage, steady pressures, pressure sensors at the motor (a remark gives the effect of the
lines).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from fmus.identification.estimate import coverage_factor
from fmus.identification.procedure_result import BAR, LITRES_PER_MINUTE, Curve, Panel, ProcedureResult
from fmus.identification.procedures.experiment_data import (
    SHORTEST_STRETCH,
    condition,
    difference_limit,
    parameter_value,
    steady_stretches,
    tank_pressure,
    training_recordings,
    zero_warning,
)
from fmus.identification.procedures.regression import (
    NEGLIGIBLE,
    SIGNIFICANT,
    Regression,
    linear,
    misfit_remark,
    misfit_warning,
)
from fmus.identification.recordings.masks import averages
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

SIGNALS = {"pressure_a": "Pa", "pressure_b": "Pa", "flow_a": "m3/s", "drain_flow": "m3/s"}
PRESSURES = ("pressure_a", "pressure_b")
EQUATIONS = {"internal": "(11)", "external": "(12)"}
# terms that the laminar law neglects
QUADRATIC_TERMS = {
    "square_in": "a quadratic part of the internal leakage",
    "square_ex": "a quadratic part of the external leakage",
}
OFFSETS = {"zero_a": "in line A", "zero_drain": "in the drain"}
MIN_POINTS = 3
LITRE = LITRES_PER_MINUTE[1]


@dataclass(frozen=True)
class SteadyPoints:
    """Means over steady stretches with their standard errors; arrays with one entry per stretch, shape (n,).

    pressure_a, pressure_b   above the tank pressure [Pa]
    flow_a, drain            [m3/s]
    recording                index of the recording
    """

    pressure_a: Array
    pressure_b: Array
    flow_a: Array
    drain: Array
    pressure_a_error: Array
    pressure_b_error: Array
    flow_a_error: Array
    drain_error: Array
    recording: Array

    @property
    def difference(self) -> Array:
        """P_1 - P_2, which drives the internal leakage."""
        return self.pressure_a - self.pressure_b

    @property
    def total(self) -> Array:
        """P_1 + P_2, which drives both external leakages."""
        return self.pressure_a + self.pressure_b


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Internal and external leakage resistance."""
    tests = training_recordings(recordings, "motor_leakage", SIGNALS)
    points = steady_points(tests)
    fit = conductances(points)
    for name in EQUATIONS:
        if fit[name] < -SIGNIFICANT * fit.sd(name):
            raise Problem(
                f"motor_leakage: the {name} leakage is {fit[name]:.3g} m3/(s.Pa), expected positive: change "
                "the sign of flow_a (positive into port A) or of drain_flow (positive out of the motor)"
            )
    # a resistance 1/g is only determined if the conductance g is clearly positive
    positive = [name for name in EQUATIONS if fit[name] > SIGNIFICANT * fit.sd(name)]
    line = f"line through {points.recording.size} steady points"
    return ProcedureResult(
        procedure="motor_leakage",
        title="Leakage of the swing motor: flow over pressure",
        figure=8,
        estimates=tuple(
            fit.derived(
                f"{name}_leakage_resistance",
                "Pa.s/m3",
                f"eq. {EQUATIONS[name]}, {line}",
                partial(lambda name, conductance: 1 / conductance[name], name),
            )
            for name in positive
        ),
        panels=panels(points, fit["internal"], fit["external"], [r.title for r in tests]),
        remarks=(
            f"{points.recording.size} stretches with steady pressures in {len(tests)} recordings are used.",
            *misfit_remark(fit, "The linear law"),
            *_remarks(fit, points, positive, parameter_value(parameters, "swing.line_resistance")),
        ),
        others=tuple(
            fit.estimate(f"conductance, {name} leakage", "m3/(s.Pa)", "1/R", name) for name in EQUATIONS
        ),
        warnings=tuple(_warnings(fit, tests)),
    )


def _warnings(fit: Regression, tests: Sequence[Recording]) -> Iterator[str]:
    """Residuals far above the noise, and zeros that the meters and transducers cannot have."""
    yield from misfit_warning(fit.times_noise, "motor_leakage: the linear law")
    largest = max(fit[name] for name in EQUATIONS)  # flow by the zeros of the pressures, through the leakage
    pressures = 2 * max(0.0, largest) * difference_limit(tests, PRESSURES)
    for name, meter in zip(OFFSETS, ("flow_a", "drain_flow"), strict=True):
        limit = difference_limit(tests, (meter,)) + pressures
        label = f"motor_leakage: {OFFSETS[name]}"
        yield from zero_warning(label, fit[name], fit.sd(name), limit, LITRES_PER_MINUTE)


def steady_points(recordings: Sequence[Recording]) -> SteadyPoints:
    """The steady points of all recordings; at least three."""
    rows = [np.empty((0, len(fields(SteadyPoints))))]
    for k, recording in enumerate(recordings):
        if "shaft" in recording.conditions:
            condition(recording, "shaft", ["locked"])
        steady = steady_stretches(recording, PRESSURES)
        if steady:
            average = averages(recording, list(SIGNALS), steady)
            means, errors = (
                np.column_stack([table[n] for n in SIGNALS]) for table in (average.mean, average.error)
            )
            means[:, :2] -= tank_pressure(recording)
            rows.append(np.column_stack([means, errors, np.full(len(steady), k)]))
    table = np.concatenate(rows)
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < MIN_POINTS:
        raise Problem(
            f"{recordings[0].source}: expected {MIN_POINTS} or more stretches of "
            f"{SHORTEST_STRETCH:g} s with steady pressures, got {len(table)}"
        )
    return SteadyPoints(*table.T)


def conductances(p: SteadyPoints, terms: Sequence[str] = ()) -> Regression:
    """Fit of both equations to all points; `terms` are additional ones of `QUADRATIC_TERMS`."""
    y, regressors = np.concatenate([p.flow_a, p.drain]), _regressors(p)
    selected = {n: regressors[n] for n in (*EQUATIONS, *OFFSETS, *terms)}
    flow_error = np.concatenate([p.flow_a_error, p.drain_error])
    fit = linear(y, selected, flow_error, "motor_leakage")
    g_in, g_ex = fit["internal"], fit["external"]
    by_a = np.concatenate([(g_in + g_ex) * p.pressure_a_error, g_ex * p.pressure_a_error])
    by_b = np.concatenate([g_in * p.pressure_b_error, g_ex * p.pressure_b_error])
    return linear(y, selected, np.sqrt(flow_error**2 + by_a**2 + by_b**2), "motor_leakage")


def _regressors(p: SteadyPoints) -> dict[str, Array]:
    """Regressors of all terms, first for the flows in line A, then for those in the drain."""
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
    inner = p.flow_a - external * p.pressure_a
    inner_error = np.hypot(p.flow_a_error, external * p.pressure_a_error)
    millilitres = ("mL/min", LITRE / 1000)
    result: list[Panel] = []
    for name, pressure, x, y, error, conductance in (
        ("internal", "P_1 - P_2", p.difference, inner, inner_error, internal),
        ("external", "P_1 + P_2", p.total, p.drain, p.drain_error, external),
    ):
        half = coverage_factor() * error
        of_recording = [(title, p.recording == k) for k, title in enumerate(titles)]
        measured = tuple(Curve(title, x[m], y[m], error=half[m]) for title, m in of_recording)
        panel = Panel(pressure, f"{name} leakage", measured, x_unit=BAR, y_unit=LITRES_PER_MINUTE)
        line, residual = panel.with_line(conductance, f"line, 1/R = {conductance:.4g} m3/(s.Pa)")
        result += [line, replace(residual, y_unit=millilitres)]
    return tuple(result)


def _remarks(fit: Regression, p: SteadyPoints, positive: Sequence[str], resistance: float) -> Iterator[str]:
    """Offsets, quadratic terms, leakages too small to be determined, and the lines to the sensors."""
    for name, location in OFFSETS.items():
        if fit.significant(name):
            yield (
                f"Without pressure a flow {location} of {fit[name] / LITRE:.2g} +- "
                f"{fit.sd(name) / LITRE:.1g} L/min would remain. It is subtracted as an offset of meters or "
                "transducers."
            )
    yield from _linearity_remarks(p)
    for name in EQUATIONS:
        if name not in positive:
            bound = max(fit[name], 0.0) + coverage_factor() * fit.sd(name)
            yield (
                f"The {name} leakage is too small to be determined: it is below {bound:.2g} m3/(s.Pa). The "
                "resistance keeps its known value."
            )
    drop = resistance * float(np.abs(p.flow_a).max())
    bias = resistance * (fit["internal"] + fit["external"])
    if bias >= NEGLIGIBLE * fit.sd("external") / abs(fit["external"]):
        yield (
            "The pressures are assumed to be those at the motor. If the sensors are at the far end of its "
            f"lines ({resistance:.3g} Pa.s/m3), the drop along a line is up to {drop:.2g} Pa, and the "
            f"resistances are {100 * bias:.2g} % too large."
        )


def _linearity_remarks(p: SteadyPoints) -> Iterator[str]:
    """A sentence on each significant quadratic term, the clearest first; one sentence if there is none."""
    chosen: list[str] = []
    while candidates := [n for n in QUADRATIC_TERMS if n not in chosen]:
        fits = {n: conductances(p, [*chosen, n]) for n in candidates}
        best = max(candidates, key=lambda n: abs(fits[n][n]) / fits[n].sd(n))
        if not fits[best].significant(best):
            break
        chosen.append(best)
    largest = {n: np.abs(regressor).max() / LITRE for n, regressor in _regressors(p).items()}
    if chosen:
        fit = conductances(p, chosen)
        for n in chosen:
            yield (
                f"The flows have {QUADRATIC_TERMS[n]}: {fit[n] * largest[n]:.2g} +- "
                f"{fit.sd(n) * largest[n]:.1g} L/min at most, which the laminar law of eqs. (11), (12) "
                "neglects."
            )
        return
    visible = max(SIGNIFICANT * conductances(p, [n]).sd(n) * largest[n] for n in QUADRATIC_TERMS) * LITRE
    percent = 100 * visible / max(np.abs(p.flow_a).max(), np.abs(p.drain).max())
    yield (
        f"The leakage is linear: a quadratic part would be significant from {percent:.2g} % of the largest "
        "flow on."
    )
