"""Leakage procedures: of the swing motor with its shaft locked, and past the seals of a cylinder.

Motor (section 4(d), eqs. (11), (12), Fig. 8), port pressures stepped:

    drain_flow = (P_1 + P_2)/R_ex              flow_a = (P_1 - P_2)/R_in + P_1/R_ex

Pressures are relative to that of the tank. Both flows are linear in the conductances 1/R, which are estimated
together from means over steady stretches. Quadratic parts are tested, not used. Validity: laminar leakage,
steady pressures, pressure sensors at the motor: at the far end of lines with the resistance R_l, both
resistances are too large by the share R_l (1/R_in + 1/R_ex), 1e-5 in this machine.

Seals, a hold test with weights: the cylinder carries a weight, its head side is plugged, its rod side is open
to the return line. The piston sinks by what leaks past its seals and by what the enclosed oil gives way when
the weight changes:

    d/dt (A x + C P_head) = -G (P_head - P_rod)        A = pi bore^2 / 4

x is the position of the piston, positive out of the cylinder, G the conductance of the seals, C the
capacitance of the enclosed oil; both are estimated. Nothing is differentiated: the balance is integrated over
windows. Validity: laminar leakage, no air in the oil, two weights at least: one alone does not tell G from a
zero of the pressures. Only a machine that is built with faults has this leakage (`boom_seal_conductance`), so
it is no parameter of the others. Reference: H. E. Merritt, Hydraulic Control Systems, Wiley 1967, chapter 6
(continuity with leakage past a piston).
"""

import math
from typing import Any

import numpy as np

from fmus.identification.balance import samples_of
from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.procedure import (
    Fit,
    Parameters,
    Parts,
    Procedure,
    Quantity,
    Recordings,
    Tested,
    law_of,
    window_samples,
)
from fmus.identification.results import BAR, LITRES_PER_MINUTE, Panel

# ---- swing motor

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


# ---- seals of a cylinder

CYLINDER = {"position": "m", "pressure_head": "Pa", "pressure_rod": "Pa"}
HALF_WIDTH = 1.0  # s of a window: a piston sinks slowly, so a long one averages more noise
OF_SEALS = {"G": ("m3/(s.Pa)", "leakage past the seals"), "C": ("m3/Pa", "capacitance of the enclosed oil")}


def sinking(x: Any, head: Any, rod: Any, u: Any, area: Any) -> Any:
    """The balance: what leaks, and what is stored."""
    return (-u.G * (head - rod),), (area * x + u.C * head,)


def _area(tests: Recordings, _: Parameters) -> float:
    """Of the piston [m2]; all recordings are of one cylinder."""
    return math.pi / 4 * data.one_size(tests, "bore") ** 2


def _windows(tests: Recordings, area: float) -> Parts:
    law = law_of(sinking, len(CYLINDER), tuple(OF_SEALS))
    return [window_samples(test, CYLINDER, law, HALF_WIDTH, (area,)) for test in tests]


SEAL_LEAKAGE = Procedure(
    name="seal_leakage",
    title="Leakage of a cylinder's seals: flow over pressure",
    figure=0,
    signals=CYLINDER,
    law="The linear law",
    known=_area,
    samples=_windows,
    start=lambda _: {"G": 1e-13, "C": 1e-12},  # linear in both
    limits=lambda tests: data.zero_limits(tests, ("pressure_head", "pressure_rod")),
    others=lambda fit: [
        fit.estimate(Quantity(text, unit, n, "hold test")) for n, (unit, text) in OF_SEALS.items()
    ],
    panels=lambda fit: fit.line(
        Panel("P_head - P_rod", "leakage", (), "Filtered equation", BAR, LITRES_PER_MINUTE), "G"
    ),
    drift={"G": "the leakage"},
    equal=("G",),
    check=lambda fit: fit.expect_positive(
        [("leakage past the seals", fit["G"], fit.sd("G"))],
        "change the sign of the position (positive out of the cylinder), or exchange the two pressures",
    ),
)
