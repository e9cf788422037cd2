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
from dataclasses import replace

import casadi as ca
import numpy as np

from fmus.identification import balance
from fmus.identification.balance import SIGNIFICANT, Regression, Solution
from fmus.identification.procedures import experiment_data as data
from fmus.identification.recordings.masks import averages
from fmus.identification.results import (
    BAR,
    LITRES_PER_MINUTE,
    Curve,
    Finding,
    Panel,
    ProcedureResult,
    coverage_factor,
)
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Mask, Recording
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


def leakage_law() -> balance.Law:
    """Both equations; pressures above the tank pressure."""
    z = ca.SX.sym("z", 4)
    a, b, flow_a, drain = ca.vertsplit(z)
    d = a - b
    u = {name: ca.SX.sym(name) for name in (*EQUATIONS, *QUADRATIC_TERMS)}
    square_a, square_b = u["square_ex"] * a * ca.fabs(a), u["square_ex"] * b * ca.fabs(b)
    through = u["internal"] * d + u["square_in"] * d * ca.fabs(d)
    at_a, at_b = u["external"] * a + square_a, u["external"] * b + square_b
    return balance.law(z, u, ca.SX.sym("none"), ca.vertcat(flow_a - through - at_a, drain - at_a - at_b))


def identify(recordings: Sequence[Recording], parameters: Mapping[str, Number]) -> ProcedureResult:
    """Internal and external leakage resistance."""
    tests = data.training_recordings(recordings, "motor_leakage", SIGNALS)
    means, errors, recording, along = steady_points(tests)
    solution = balance.solve(
        [balance.samples_of(leakage_law(), SIGNALS, means, errors)],
        dict.fromkeys(EQUATIONS, GUESS) | dict.fromkeys(QUADRATIC_TERMS, 0.0),
        "motor_leakage",
        data.zero_limits(tests, SIGNALS),
        tested=tuple(QUADRATIC_TERMS),
    )
    fit, terms, count = solution.fit, quadratic_terms(solution), recording.size
    _check_signs(fit, means)
    # a resistance 1/g is only determined if the conductance g is clearly positive
    positive = [name for name in EQUATIONS if fit[name] > SIGNIFICANT * fit.sd(name)]
    resistance = data.parameter_value(parameters, "swing.line_resistance")
    return ProcedureResult(
        procedure="motor_leakage",
        title="Leakage of the swing motor: flow over pressure",
        figure=8,
        estimates=tuple(
            fit.derived(
                f"{name}_leakage_resistance",
                "Pa.s/m3",
                f"eq. {EQUATIONS[name]}, line through {count} steady points",
                name,
                lambda conductance: 1 / conductance,
            )
            for name in positive
        ),
        panels=panels(means, errors, fit, [(r.title, recording == k) for k, r in enumerate(tests)]),
        remarks=(
            f"{count} stretches with steady pressures in {len(tests)} recordings are used.",
            *balance.misfit_remark(fit, "The linear law"),
            *_remarks(solution, terms, positive, resistance),
        ),
        others=tuple(
            fit.estimate(f"conductance, {name} leakage", "m3/(s.Pa)", "1/R", name) for name in EQUATIONS
        ),
        findings=(
            *(
                Finding(
                    "model",
                    balance.probability(value, sd),
                    f"motor_leakage: {QUADRATIC_TERMS[name]} of {value:.2g} +- {sd:.1g} L/min",
                )
                for name, (value, sd) in terms.items()
            ),
            *(
                balance.drift_finding(solution, name, [along], f"motor_leakage: {name} leakage")
                for name in EQUATIONS
            ),
            *balance.zero_findings(solution, "motor_leakage"),
            balance.model_finding(solution, "motor_leakage: the linear law"),
            *data.signal_findings(tests, SIGNALS, "motor_leakage"),
        ),
    )


def _check_signs(fit: Regression, means: Array) -> None:
    """Refuse a negative leakage, and a drain that falls with the pressures."""
    slope, covariance = np.polyfit(means[0] + means[1], means[3], 1, cov=True)
    pairs = {name: (fit[name], fit.sd(name)) for name in EQUATIONS}
    pairs["external"] = min(pairs["external"], (slope[0], math.sqrt(covariance[0, 0])))
    for name, (value, sd) in pairs.items():
        if value < -SIGNIFICANT * sd:
            raise Problem(
                f"motor_leakage: the {name} leakage is {value:.3g} m3/(s.Pa), expected positive: change "
                "the sign of flow_a (positive into port A) or of drain_flow (positive out of the motor)"
            )


def quadratic_terms(solution: Solution) -> dict[str, tuple[float, float]]:
    """Largest flow [L/min] by each quadratic term, and its standard deviation."""
    values, covariance = solution.effects(np.array([solution.column(n) for n in QUADRATIC_TERMS]))
    a, b = solution.samples[0].raw[:2]
    largest = np.array([np.abs(a - b).max() ** 2, np.abs(a * np.abs(a) + b * np.abs(b)).max()]) / LITRE
    rows = np.column_stack([values, np.sqrt(np.diag(covariance))]) * largest[:, None]
    return {n: (value, sd) for n, (value, sd) in zip(QUADRATIC_TERMS, rows.tolist(), strict=True)}


def steady_points(recordings: Sequence[Recording]) -> tuple[Array, Array, Array, tuple[Array, str]]:
    """The steady points of all recordings; at least three.

    Means over the stretches, of pressures above the tank's, and their standard errors, each (4, n) as
    `SIGNALS`; index of the recording (n,); the `course`.
    """
    columns, word = [np.empty((10, 0))], ""
    for k, recording in enumerate(recordings):
        if "shaft" in recording.conditions:
            data.condition(recording, "shaft", ["locked"])
        if stretches := data.steady_stretches(recording, PRESSURES):
            means, errors = averages(recording, tuple(SIGNALS), stretches)
            means[:2] -= data.tank_pressure(recording)
            along, word = data.course(recording, stretches)
            columns.append(np.concatenate([means, errors, [np.full(along.size, k), along]]))
    table = np.concatenate(columns, axis=1)
    table = table[:, np.isfinite(table).all(axis=0)]
    if table.shape[1] < MIN_POINTS:
        raise Problem(
            f"{recordings[0].source}: expected {MIN_POINTS} or more stretches of "
            f"{data.SHORTEST_STRETCH:g} s with steady pressures, got {table.shape[1]}"
        )
    return table[:4], table[4:8], table[8], (table[9], word)


def panels(
    means: Array, errors: Array, fit: Regression, recordings: Sequence[tuple[str, Mask]]
) -> tuple[Panel, ...]:
    """Both leakages over pressure with their lines, residuals below; titles and points of the recordings."""
    (a, b, flow_a, drain), (a_error, _, flow_a_error, drain_error) = means, errors
    external, result = fit["external"], list[Panel]()
    for name, pressure, x, y, error in (
        ("internal", "P_1 - P_2", a - b, flow_a - external * a, np.hypot(flow_a_error, external * a_error)),
        ("external", "P_1 + P_2", a + b, drain, drain_error),
    ):
        half = coverage_factor() * error
        measured = tuple(Curve(title, x[m], y[m], error=half[m]) for title, m in recordings)
        panel = Panel(pressure, f"{name} leakage", measured, x_unit=BAR, y_unit=LITRES_PER_MINUTE)
        line, residual = panel.with_line(fit[name], f"line, 1/R = {fit[name]:.4g} m3/(s.Pa)")
        result += [line, replace(residual, y_unit=("mL/min", LITRE / 1000))]
    return tuple(result)


def _remarks(
    solution: Solution,
    terms: Mapping[str, tuple[float, float]],
    positive: Sequence[str],
    resistance: float,
) -> Iterator[str]:
    """Offsets, quadratic terms, leakages too small to be determined, and the lines to the sensors."""
    fit, flows = solution.fit, np.abs(solution.samples[0].raw[2:])
    by_zero = solution.parts[0].linear.g[:, :, 0, 0]  # the law is linear: the same at all points
    for row, (meter, location) in zip(by_zero.T, METERS.items(), strict=True):
        value, sd = solution.every.combination(dict(zip(SIGNALS, row, strict=True)))
        if abs(value) > SIGNIFICANT * sd:
            yield (
                f"Without pressure a flow {location} of {value / LITRE:.2g} +- "
                f"{sd / LITRE:.1g} L/min would remain. It is subtracted as zeros of {meter} and pressures."
            )
    clear = {n: term for n, term in terms.items() if abs(term[0]) > SIGNIFICANT * term[1]}
    for n, (value, sd) in clear.items():
        yield (
            f"The flows have {QUADRATIC_TERMS[n]}: {value:.2g} +- {sd:.1g} L/min at "
            "most, which the laminar law of eqs. (11), (12) neglects."
        )
    if not clear:
        visible = SIGNIFICANT * max(sd for _, sd in terms.values()) * LITRE
        yield (
            f"The leakage is linear: a quadratic part would be significant from "
            f"{100 * visible / flows.max():.2g} % of the largest flow on."
        )
    for name in EQUATIONS:
        if name not in positive:
            bound = max(fit[name], 0.0) + coverage_factor() * fit.sd(name)
            yield (
                f"The {name} leakage is too small to be determined: it is below {bound:.2g} m3/(s.Pa). The "
                "resistance keeps its known value."
            )
    bias = resistance * (fit["internal"] + fit["external"])
    if bias >= balance.NEGLIGIBLE * fit.sd("external") / abs(fit["external"]):
        yield (
            "The pressures are assumed to be those at the motor. If the sensors are at the far end of its "
            f"lines ({resistance:.3g} Pa.s/m3), the drop along a line is up to "
            f"{resistance * flows[0].max():.2g} Pa, and the resistances are {100 * bias:.2g} % too large."
        )
