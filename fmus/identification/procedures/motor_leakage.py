"""Leakage of the swing motor, its shaft locked (section 4(d), eqs. (11), (12), Fig. 8), ports stepped.

    drain_flow = (P_1 + P_2)/R_ex              flow_a = (P_1 - P_2)/R_in + P_1/R_ex

Pressures are relative to that of the tank. Both flows are linear in the conductances 1/R, which are estimated
together from means over steady stretches. Quadratic parts are tested, not used. Validity: laminar leakage,
steady pressures, pressure sensors at the motor: at the far end of lines with the resistance R_l, both
resistances are too large by the share R_l (1/R_in + 1/R_ex), 1e-5 in this machine.
"""

from typing import Any

import numpy as np

from fmus.identification.balance import samples_of
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.procedure import (
    Fit,
    Parts,
    Procedure,
    Quantity,
    Recordings,
    Tested,
    law_of,
)
from fmus.identification.results import BAR, LITRES_PER_MINUTE, Panel

MOTOR = {"pressure_a": "Pa", "pressure_b": "Pa", "flow_a": "m3/s", "drain_flow": "m3/s"}
EQUATIONS = {"internal": "(11)", "external": "(12)"}
QUADRATIC = {  # what the laminar law neglects, and its size at the highest pressures
    "square_in": Tested(
        "a quadratic part of the internal leakage", lambda a, b, *_: np.abs(a - b).max() ** 2
    ),
    "square_ex": Tested(
        "a quadratic part of the external leakage",
        lambda a, b, *_: np.abs(a * np.abs(a) + b * np.abs(b)).max(),
    ),
}
GUESS = 1e-12  # m3/(s.Pa), start of the search for a conductance; the law is linear
MIN_POINTS = 3  # two directions and one more
UNITS = BAR, LITRES_PER_MINUTE


def leakage(a: Any, b: Any, flow_a: Any, drain: Any, u: Any, _: Any) -> Any:
    """Eqs. (11), (12), with quadratic parts."""
    through = u.internal * (a - b) + u.square_in * (a - b) * abs(a - b)
    at_a, at_b = (u.external * p + u.square_ex * p * abs(p) for p in (a, b))
    return ((flow_a - through - at_a, drain - at_a - at_b),)


def _steady(tests: Recordings, _: Any) -> Parts:
    ports = "pressure_a", "pressure_b"
    every, along = data.steady_means(tests, MOTOR, ports, MIN_POINTS, data.tank_pressure)
    law, points = law_of(leakage, len(MOTOR), (*EQUATIONS, *QUADRATIC)), every[every.good]
    return [(samples_of(law, MOTOR, points.means, points.errors), along)]


def _positive(fit: Fit) -> None:
    """Refuse a negative leakage, and a drain that falls with the pressures."""
    a, b, _, drain = fit.solution.samples[0].raw
    slope, covariance = np.polyfit(a + b, drain, 1, cov=True)
    found = [(n, fit[n], fit.sd(n)) for n in EQUATIONS] + [("external", slope[0], covariance[0, 0] ** 0.5)]
    fit.expect_positive(
        ((f"{n} leakage", value, sd) for n, value, sd in found),
        "change the sign of flow_a (positive into port A) or of drain_flow (positive out of the motor)",
    )


MOTOR_LEAKAGE = Procedure(
    name="motor_leakage",
    title="Leakage of the swing motor: flow over pressure",
    figure=8,
    signals=MOTOR,
    law="The linear law",
    known=lambda tests, _: data.check_conditions(tests, shaft=["locked"]),
    samples=_steady,
    start=lambda _: dict.fromkeys(EQUATIONS, GUESS) | dict.fromkeys(QUADRATIC, 0.0),
    limits=lambda tests: data.zero_limits(tests, MOTOR),
    tested=tuple(QUADRATIC),
    estimates=lambda _: [
        Quantity(f"{n}_leakage_resistance", "Pa.s/m3", n, f"eq. {equation}, steady pressures", inverse=True)
        for n, equation in EQUATIONS.items()
    ],
    panels=lambda fit: (
        *fit.line(Panel("P_1 - P_2", "internal leakage", (), "", *UNITS), "internal", 0),
        *fit.line(Panel("P_1 + P_2", "external leakage", (), "", *UNITS), "external", 1),
    ),
    findings=lambda fit: fit.effects(QUADRATIC, LITRES_PER_MINUTE),
    drift={n: f"the {n} leakage" for n in EQUATIONS},
    check=_positive,
)
