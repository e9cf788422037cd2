"""Motor leakage procedure (section 4(d), eqs. (11), (12), Fig. 8): shaft locked, port pressures stepped.

    drain_flow = (P_1 + P_2)/R_ex              flow_a = (P_1 - P_2)/R_in + P_1/R_ex

Pressures are relative to that of the tank. Both flows are linear in the conductances 1/R, which are estimated
together over means of steady stretches (`balance`), with the errors of flows and pressures and the zeros of
meters and transducers. Quadratic terms are tested but not used.

Validity: laminar leakage, steady pressures, pressure sensors at the motor (a remark gives the effect of the
lines).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca
import numpy as np

from fmus.identification.balance import (
    NEGLIGIBLE,
    SIGNIFICANT,
    Law,
    Regression,
    Solution,
    drift_finding,
    law,
    misfit_remark,
    model_finding,
    probability,
    solve,
    steady,
    zero_findings,
)
from fmus.identification.estimate import coverage_factor
from fmus.identification.finding import Finding
from fmus.identification.procedure_result import BAR, LITRES_PER_MINUTE, Curve, Panel, ProcedureResult
from fmus.identification.procedures.experiment_data import (
    SHORTEST_STRETCH,
    condition,
    course,
    parameter_value,
    signal_findings,
    steady_stretches,
    tank_pressure,
    training_recordings,
    zero_limits,
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
METERS = {"flow_a": "in line A", "drain_flow": "in the drain"}
MIN_POINTS = 3
GUESS = 1e-12  # m3/(s.Pa), start of the search for a conductance; the law is linear
LITRE = LITRES_PER_MINUTE[1]


def leakage_law() -> Law:
    """Both equations; pressures above the tank pressure."""
    z = ca.SX.sym("z", 4)
    a, b, flow_a, drain = ca.vertsplit(z)
    d = a - b
    u = {name: ca.SX.sym(name) for name in (*EQUATIONS, *QUADRATIC_TERMS)}
    square_a, square_b = u["square_ex"] * a * ca.fabs(a), u["square_ex"] * b * ca.fabs(b)
    through = u["internal"] * d + u["square_in"] * d * ca.fabs(d)
    at_a, at_b = u["external"] * a + square_a, u["external"] * b + square_b
    return law(z, u, ca.SX.sym("none"), ca.vertcat(flow_a - through - at_a, drain - at_a - at_b))


@dataclass(frozen=True)
class SteadyPoints:
    """Means over steady stretches of all recordings, shape (4, n) as `SIGNALS`, and their standard errors.

    means       pressures are above the tank pressure
    recording   index of the recording, shape (n,)
    along       time or temperature of the oil, shape (n,), and the word for it
    """

    means: Array
    errors: Array
    recording: Array
    along: Array
    word: str


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Internal and external leakage resistance."""
    tests = training_recordings(recordings, "motor_leakage", SIGNALS)
    points = steady_points(tests)
    solution = solve(
        [steady(leakage_law(), tuple(SIGNALS), points.means, points.errors)],
        dict.fromkeys(EQUATIONS, GUESS) | dict.fromkeys(QUADRATIC_TERMS, 0.0),
        "motor_leakage",
        zero_limits(tests, SIGNALS),
        tested=tuple(QUADRATIC_TERMS),
    )
    fit = solution.fit
    _check_signs(fit, points)
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
            *_remarks(solution, points, positive, parameter_value(parameters, "swing.line_resistance")),
        ),
        others=tuple(
            fit.estimate(f"conductance, {name} leakage", "m3/(s.Pa)", "1/R", name) for name in EQUATIONS
        ),
        findings=(*_findings(solution, points), *signal_findings(tests, SIGNALS, "motor_leakage")),
    )


def _check_signs(fit: Regression, points: SteadyPoints) -> None:
    """Refuse a negative leakage, and a drain that falls with the pressures."""
    slope, covariance = np.polyfit(points.means[0] + points.means[1], points.means[3], 1, cov=True)
    pairs = {name: (fit[name], fit.sd(name)) for name in EQUATIONS}
    pairs["external"] = min(pairs["external"], (slope[0], math.sqrt(covariance[0, 0])))
    for name, (value, sd) in pairs.items():
        if value < -SIGNIFICANT * sd:
            raise Problem(
                f"motor_leakage: the {name} leakage is {value:.3g} m3/(s.Pa), expected positive: change "
                "the sign of flow_a (positive into port A) or of drain_flow (positive out of the motor)"
            )


def _findings(solution: Solution, points: SteadyPoints) -> Iterator[Finding]:
    """Tests of the residual: quadratic parts, a change in time, zeros, the model."""
    for name, (value, sd, largest) in quadratic_terms(solution, points).items():
        yield Finding(
            "model",
            probability(value, sd),
            f"motor_leakage: {QUADRATIC_TERMS[name]} of {value * largest:.2g} +- {sd * largest:.1g} L/min",
        )
    for name in EQUATIONS:
        yield drift_finding(solution, name, [(points.along, points.word)], f"motor_leakage: {name} leakage")
    yield from zero_findings(solution, "motor_leakage")
    yield model_finding(solution, "motor_leakage: the linear law")


def quadratic_terms(solution: Solution, points: SteadyPoints) -> dict[str, tuple[float, float, float]]:
    """Each quadratic term, its standard deviation, and its largest regressor over one L/min."""
    values, covariance = solution.effects(np.array([solution.column(n) for n in QUADRATIC_TERMS]))
    a, b = points.means[:2]
    largest = (np.abs(a - b).max() ** 2 / LITRE, np.abs(a * np.abs(a) + b * np.abs(b)).max() / LITRE)
    sds = np.sqrt(np.diag(covariance))
    rows = zip(QUADRATIC_TERMS, values, sds, largest, strict=True)
    return {n: (float(v), float(sd), float(top)) for n, v, sd, top in rows}


def steady_points(recordings: Sequence[Recording]) -> SteadyPoints:
    """The steady points of all recordings; at least three."""
    columns, word = [np.empty((10, 0))], ""
    for k, recording in enumerate(recordings):
        if "shaft" in recording.conditions:
            condition(recording, "shaft", ["locked"])
        steady = steady_stretches(recording, PRESSURES)
        if steady:
            means, errors = averages(recording, tuple(SIGNALS), steady)
            means[:2] -= tank_pressure(recording)
            middles = np.array([recording.time[s].mean() - recording.time[0] for s in steady])
            along, word = course(recording, middles)
            more = np.array([np.full(len(steady), k), along])
            columns.append(np.concatenate([means, errors, more]))
    table = np.concatenate(columns, axis=1)
    table = table[:, np.isfinite(table).all(axis=0)]
    if table.shape[1] < MIN_POINTS:
        raise Problem(
            f"{recordings[0].source}: expected {MIN_POINTS} or more stretches of "
            f"{SHORTEST_STRETCH:g} s with steady pressures, got {table.shape[1]}"
        )
    return SteadyPoints(table[:4], table[4:8], table[8], table[9], word)


def panels(p: SteadyPoints, internal: float, external: float, titles: Sequence[str]) -> tuple[Panel, ...]:
    """Both leakages over pressure with their lines, residuals below."""
    (a, b, flow_a, drain), (a_error, _, flow_a_error, drain_error) = p.means, p.errors
    inner_error = np.hypot(flow_a_error, external * a_error)
    millilitres = ("mL/min", LITRE / 1000)
    result: list[Panel] = []
    for name, pressure, x, y, error, conductance in (
        ("internal", "P_1 - P_2", a - b, flow_a - external * a, inner_error, internal),
        ("external", "P_1 + P_2", a + b, drain, drain_error, external),
    ):
        half = coverage_factor() * error
        of_recording = [(title, p.recording == k) for k, title in enumerate(titles)]
        measured = tuple(Curve(title, x[m], y[m], error=half[m]) for title, m in of_recording)
        panel = Panel(pressure, f"{name} leakage", measured, x_unit=BAR, y_unit=LITRES_PER_MINUTE)
        line, residual = panel.with_line(conductance, f"line, 1/R = {conductance:.4g} m3/(s.Pa)")
        result += [line, replace(residual, y_unit=millilitres)]
    return tuple(result)


def _remarks(
    solution: Solution, p: SteadyPoints, positive: Sequence[str], resistance: float
) -> Iterator[str]:
    """Offsets, quadratic terms, leakages too small to be determined, and the lines to the sensors."""
    fit = solution.fit
    for row, (meter, location) in enumerate(METERS.items()):
        value, sd = _flow_without_pressure(solution, row)
        if abs(value) > SIGNIFICANT * sd:
            yield (
                f"Without pressure a flow {location} of {value / LITRE:.2g} +- "
                f"{sd / LITRE:.1g} L/min would remain. It is subtracted as zeros of {meter} and pressures."
            )
    yield from _linearity_remarks(solution, p)
    for name in EQUATIONS:
        if name not in positive:
            bound = max(fit[name], 0.0) + coverage_factor() * fit.sd(name)
            yield (
                f"The {name} leakage is too small to be determined: it is below {bound:.2g} m3/(s.Pa). The "
                "resistance keeps its known value."
            )
    drop = resistance * float(np.abs(p.means[2]).max())
    bias = resistance * (fit["internal"] + fit["external"])
    if bias >= NEGLIGIBLE * fit.sd("external") / abs(fit["external"]):
        yield (
            "The pressures are assumed to be those at the motor. If the sensors are at the far end of its "
            f"lines ({resistance:.3g} Pa.s/m3), the drop along a line is up to {drop:.2g} Pa, and the "
            f"resistances are {100 * bias:.2g} % too large."
        )


def _flow_without_pressure(solution: Solution, row: int) -> tuple[float, float]:
    """Flow by the zeros of all sensors in one equation, and its standard deviation."""
    by_zero = solution.parts[0].linear.g[:, row, 0, 0]  # the law is linear: the same at all points
    contrast = np.zeros(len(solution.covariance))
    for k, sensor in enumerate(solution.limits, len(solution.fit.names)):
        contrast[k] = by_zero[list(SIGNALS).index(sensor)]
    values = np.array([*np.zeros(len(solution.fit.names)), *(v for v, _ in solution.zeros.values())])
    return float(contrast @ values), math.sqrt(contrast @ solution.covariance @ contrast)


def _linearity_remarks(solution: Solution, p: SteadyPoints) -> Iterator[str]:
    """A sentence on each significant quadratic term; one sentence if there is none."""
    terms = quadratic_terms(solution, p)
    clear = {n: t for n, t in terms.items() if abs(t[0]) > SIGNIFICANT * t[1]}
    for n, (value, sd, largest) in clear.items():
        yield (
            f"The flows have {QUADRATIC_TERMS[n]}: {value * largest:.2g} +- {sd * largest:.1g} L/min at "
            "most, which the laminar law of eqs. (11), (12) neglects."
        )
    if not clear:
        visible = max(SIGNIFICANT * sd * largest for _, sd, largest in terms.values()) * LITRE
        percent = 100 * visible / np.abs(p.means[2:]).max()
        yield (
            f"The leakage is linear: a quadratic part would be significant from {percent:.2g} % of the "
            "largest flow on."
        )
