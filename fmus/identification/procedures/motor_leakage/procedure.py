"""Leakage of the swing motor (section 4(d), eqs. (11), (12), Fig. 8): shaft locked, port pressures stepped.

    drain_flow = (P_1 + P_2)/R_ex              flow_a = (P_1 - P_2)/R_in + P_1/R_ex

with pressures above that of the tank. Both flows are linear in the conductances 1/R, which are found together
by least squares over the means of the steps, weighted with their errors; those of the pressures count by the
slope. Quadratic terms and zeros of the meters are tested, not used.

Validity: laminar leakage, steady pressures, pressure sensors at the motor (the line between is told of).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fmus.identification.finding import Estimate, Finding
from fmus.identification.procedures.motor_leakage import points as leakage_points
from fmus.identification.procedures.motor_leakage.panels import panels
from fmus.identification.procedures.motor_leakage.points import Points, points
from fmus.identification.procedures.shared.given import training, value
from fmus.identification.procedures.shared.regression import Regression, linear, misfit_remark
from fmus.identification.recordings.recording import Recording
from fmus.parameters import Number

Array = NDArray[np.float64]
SIGNALS: Mapping[str, str] = leakage_points.SIGNALS
UNIT = "Pa.s/m3"
LITRES = 1e-3 / 60  # m3/s in one L/min
SURE = 3.7  # standard deviations from which on a term is said to be seen: 1 in 1000 by chance, for four terms
# what else could be in the flows
TESTED = {
    "square_in": "a quadratic part of the internal leakage",
    "square_ex": "a quadratic part of the external leakage",
    "zero_a": "a zero of the meter in line A",
    "zero_drain": "a zero of the drain meter",
}


def identify(recordings: Sequence[Recording], known: Mapping[str, Number]) -> Finding:
    """Internal and external leakage resistance."""
    own = training(recordings, "motor_leakage")
    steady = points(own)
    fit = conductances(steady)
    return Finding(
        procedure="motor_leakage",
        title="Leakage of the swing motor: flow over pressure",
        figure=8,
        estimates=tuple(_resistance(fit, which, len(steady.total)) for which in ("internal", "external")),
        panels=panels(steady, fit["internal"], fit["external"], [r.title for r in own]),
        remarks=(
            f"{len(steady.total)} stretches with steady pressures in {len(own)} recordings are used.",
            *misfit_remark(fit, "The linear law"),
            *_tested(steady),
            _line(fit, steady, value(known, "swing.line_resistance")),
        ),
        others=tuple(
            fit.estimate(f"conductance, {which} leakage", "m3/(s.Pa)", "1/R", which)
            for which in ("internal", "external")
        ),
    )


def conductances(p: Points, tested: Sequence[str] = ()) -> Regression:
    """Both equations over all points, flows in line A first; `tested` are names of TESTED."""
    y = np.concatenate([p.flow_a, p.drain])
    columns = _columns(p)
    used = {n: columns[n] for n in ("internal", "external", *tested)}
    meters = np.concatenate([p.flow_a_error, p.drain_error])
    fit = linear(y, used, meters)
    g_in, g_ex = fit["internal"], fit["external"]
    by_a = np.concatenate([(g_in + g_ex) * p.pressure_a_error, g_ex * p.pressure_a_error])
    by_b = np.concatenate([g_in * p.pressure_b_error, g_ex * p.pressure_b_error])
    return linear(y, used, np.sqrt(meters**2 + by_a**2 + by_b**2))


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
            f"The flows have {TESTED[n]}: {fit[n] * largest[n] / LITRES:.2g} +- "
            f"{fit.sd(n) * largest[n] / LITRES:.1g} L/min at most, which the laminar law of eqs. (11), (12) "
            "does not have."
            for n in chosen
        )
    seen = max(SURE * conductances(p, [n]).sd(n) * largest[n] for n in TESTED)
    share = 100 * seen / max(np.abs(p.flow_a).max(), np.abs(p.drain).max())
    return (
        "The leakage is linear: no quadratic part and no zero of a meter is seen; each would be from "
        f"{share:.2g} % of the largest flow on.",
    )


def _ratio(fit: Regression, name: str) -> float:
    """A term over its standard deviation."""
    return abs(fit[name]) / fit.sd(name)


def _line(fit: Regression, p: Points, resistance: float) -> str:
    """How much the line between sensor and motor matters."""
    flow = np.abs(p.flow_a).max()
    share = resistance * (fit["internal"] + fit["external"])
    return (
        f"The pressures are taken as those at the motor. If the sensors are at the far end of its lines, "
        f"{resistance:.3g} Pa.s/m3, up to {resistance * flow:.2g} Pa lie between, {100 * share:.2g} % of the "
        "pressure, which is negligible."
    )
