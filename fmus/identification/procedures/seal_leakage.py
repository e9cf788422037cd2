"""Leakage past the seals of a cylinder, by a hold test with weights.

The cylinder carries a weight, its head side is plugged, its rod side is open to the return line. The piston
sinks by what leaks past its seals and by what the enclosed oil gives way when the weight changes:

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

from fmus.identification.procedures import experiment_data as data
from fmus.identification.procedures.procedure import (
    Parameters,
    Parts,
    Procedure,
    Quantity,
    Recordings,
    law_of,
    window_samples,
)
from fmus.identification.results import BAR, LITRES_PER_MINUTE, Panel

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
