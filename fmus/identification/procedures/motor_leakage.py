"""Motor leakage procedure (section 4(d), eqs. (11), (12), Fig. 8): shaft locked, port pressures stepped.

    drain_flow = (P_1 + P_2)/R_ex              flow_a = (P_1 - P_2)/R_in + P_1/R_ex

Pressures are relative to that of the tank. Both flows are linear in the conductances 1/R, which are estimated
together from means over steady stretches. Quadratic parts are tested, not used.

Validity: laminar leakage, steady pressures, pressure sensors at the motor: at the far end of lines with the
resistance R_l, both resistances are too large by the share R_l (1/R_in + 1/R_ex), 1e-5 in this machine.
"""

import math
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from fmus.identification import balance
from fmus.identification.balance import SIGNIFICANT
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.fit import Fit, Procedure, Quantity
from fmus.identification.results import BAR, LITRES_PER_MINUTE, Finding, Panel, ProcedureResult
from fmus.parameters import Number
from orchestrator.base.errors import Problem
from orchestrator.data.recording import Recording
from orchestrator.data.table import Array

SIGNALS = {"pressure_a": "Pa", "pressure_b": "Pa", "flow_a": "m3/s", "drain_flow": "m3/s"}
EQUATIONS = {"internal": "(11)", "external": "(12)"}
QUADRATIC = {  # what the laminar law neglects
    "square_in": "a quadratic part of the internal leakage",
    "square_ex": "a quadratic part of the external leakage",
}
MIN_POINTS = 3
GUESS = 1e-12  # m3/(s.Pa), start of the search for a conductance; the law is linear
RESISTANCES = [
    Quantity(f"{n}_leakage_resistance", "Pa.s/m3", n, f"eq. {equation}, steady pressures", inverse=True)
    for n, equation in EQUATIONS.items()
]


def leakage_law() -> balance.Law:
    """Both equations; pressures above the tank pressure."""
    z = ca.SX.sym("z", 4)
    a, b, flow_a, drain = ca.vertsplit(z)
    d = a - b
    u = {name: ca.SX.sym(name) for name in (*EQUATIONS, *QUADRATIC)}
    square_a, square_b = u["square_ex"] * a * ca.fabs(a), u["square_ex"] * b * ca.fabs(b)
    through = u["internal"] * d + u["square_in"] * d * ca.fabs(d)
    at_a, at_b = u["external"] * a + square_a, u["external"] * b + square_b
    return balance.law(z, u, ca.SX.sym("none"), ca.vertcat(flow_a - through - at_a, drain - at_a - at_b))


def identify(recordings: Sequence[Recording], _parameters: Mapping[str, Number]) -> ProcedureResult:
    """Internal and external leakage resistance."""
    tests = data.training_recordings(recordings, "motor_leakage", SIGNALS)
    for test in tests:
        if "shaft" in test.conditions:
            data.condition(test, "shaft", ["locked"])
    points = data.steady_points(tests, SIGNALS, ("pressure_a", "pressure_b"), MIN_POINTS)
    points.means[:2] -= np.array([data.tank_pressure(r) for r in tests])[points.recording]
    start = dict.fromkeys(EQUATIONS, GUESS) | dict.fromkeys(QUADRATIC, 0.0)
    samples = balance.samples_of(leakage_law(), SIGNALS, points.means, points.errors)
    limits = data.zero_limits(tests, SIGNALS)
    solution = balance.solve([samples], start, "motor_leakage", limits, tested=tuple(QUADRATIC))
    fit = Fit("motor_leakage", tests, SIGNALS, solution, [points.along])
    _check_signs(fit, points.means[0] + points.means[1], points.means[3])
    a, b = points.means[:2]
    sizes = np.abs(a - b).max() ** 2, np.abs(a * np.abs(a) + b * np.abs(b)).max()
    values, covariance = solution.effects(np.array([solution.column(n) for n in QUADRATIC]))
    litre = LITRES_PER_MINUTE[1]
    quadratic = [
        Finding(
            "model",
            balance.probability(value, sd),
            f"motor_leakage: {text} of {value * size / litre:.2g} +- {sd * size / litre:.1g} L/min",
        )
        for text, value, sd, size in zip(
            QUADRATIC.values(), values, np.sqrt(np.diag(covariance)), sizes, strict=True
        )
    ]
    units = BAR, LITRES_PER_MINUTE
    return ProcedureResult(
        procedure="motor_leakage",
        title="Leakage of the swing motor: flow over pressure",
        figure=8,
        estimates=fit.estimates(RESISTANCES),
        panels=(
            *fit.line(Panel("P_1 - P_2", "internal leakage", (), "", *units), "internal", 0),
            *fit.line(Panel("P_1 + P_2", "external leakage", (), "", *units), "external", 1),
        ),
        remarks=tuple(fit.remarks(RESISTANCES, "The linear law")),
        others=tuple(
            fit.estimate(Quantity(f"conductance, {n} leakage", "m3/(s.Pa)", n, "1/R")) for n in EQUATIONS
        ),
        findings=(*quadratic, *fit.findings({n: f"the {n} leakage" for n in EQUATIONS})),
    )


def _check_signs(fit: Fit, pressures: Array, drain: Array) -> None:
    """Refuse a negative leakage, and a drain that falls with the pressures."""
    slope, covariance = np.polyfit(pressures, drain, 1, cov=True)
    found = [(n, fit[n], fit.sd(n)) for n in EQUATIONS] + [
        ("external", slope[0], math.sqrt(covariance[0, 0]))
    ]
    for name, value, sd in found:
        if value < -SIGNIFICANT * sd:
            raise Problem(
                f"motor_leakage: the {name} leakage is {value:.3g} m3/(s.Pa), expected positive: change "
                "the sign of flow_a (positive into port A) or of drain_flow (positive out of the motor)"
            )


MOTOR_LEAKAGE = Procedure("motor_leakage", SIGNALS, identify)
