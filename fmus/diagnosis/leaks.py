"""Leaks of one function, and air in its oil: from `settling` after its valve has closed.

No relief, counterbalance or anti-cavitation valve of the chamber may be open. c is the leakage of the closed
valve, g that of the seals, k = C_d A sqrt(2/rho) that of an opening of area A to the outside, s the share of
air in the volume V, which has the volume a(P) at a pressure. Each rest, and each part of a long one, is one
equation of each chamber, over its time:

    int c (P_s + P_t - 2 P_h) - q_h dt = g int P_h - P_r dt + k_h int sqrt(P_h) dt - s V [a(P_h)]
    int c (P_s + P_t - 2 P_r) - q_r dt = -g int P_h - P_r dt + k_r int sqrt(P_r) dt - s V [a(P_r)]

A valve that stays open after a stroke, by k_v, lets oil into the chamber that was filled last, and out of the
other one: -k_v int sqrt(P_s - P) dt and k_v int sqrt(P - P_t) dt are added to the right sides. g and each k
are not negative, and at most two of them are not zero. g is that of the oil as it is now. An equation is
uncertain by the readings at both ends, by a flow, and by a share of the capacitance times the change of the
pressure. The air is told from a fit of its own with a longer memory, of all functions together: they have the
same oil. That of one function alone, after a hose was changed, is told above twice the limit.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from fmus.components.chamber import ATMOSPHERE
from fmus.contract import Quantity, Scalar
from fmus.controller.arm import ControlledAxis
from fmus.diagnosis.axis import PRESSURE, SMALL, Axis, Finding, chambers_of, of_both, of_chambers
from fmus.diagnosis.estimates import FEWEST, QUICK, Equations, Fit, Told, counted, either, judged, whether
from fmus.diagnosis.settings import LITRE
from fmus.smooth import positive

SHORTEST, PART = 0.15, 1.0  # s, a rest that counts, and a part of a long one
FEWEST_RESTS = 3.0  # equations, from which a leak is told
MOST = 3.0  # deviations by which equations differ unless the machine changes
SWAYING = 4.0  # of the limit, for a motor: the column swings on its oil for long
CHANGES = 1.2  # of the air that the hoses of a healthy machine seem to have: rests differ
ALONE = 2.0  # limits of the air of one function
EXPONENT = 1.4  # of the air
ROUNDED = 1 / 6  # variance of the difference of two rounded readings, over the square of their resolution
SEAL, OPEN, AIR = "seal_leakage", "valve_opening", "air"
# prior standard deviations: a seal or fitting that is gone [L/min at 100 bar]; air; hoses of a motor, foam
LEAKS, AIRY, FOAM = dict.fromkeys(("seal", "head", "rod", "valve"), 10.0), {AIR: 0.005}, {AIR: 0.02}


def findings(axis: ControlledAxis) -> dict[str, Finding]:
    """Of a motor without seals, whose lines have one pressure on level ground, and without air."""
    leak = Finding("m2", "Opening to the outside at {end} of the {{}}", 1e-6, "{} hose")
    found = of_both(axis, "leak", leak)
    found[OPEN] = Finding("m2", "Opening of the {} valve at rest", 1e-6, "{} valve")
    if axis.turns:
        return found
    seal = Finding("m3/(s.Pa)", "Leakage past the seals of the {}", 1e-12, "{} seals")
    air = Finding("1", "Share of undissolved air in the oil of the {}", 0.01, "air")
    return {SEAL: seal, **found, AIR: air}


def states(axis: ControlledAxis) -> dict[str, Quantity]:
    """Sums over a rest."""
    found = of_chambers(
        axis,
        ("missing_oil", "m3", "Oil that left in another way than through the closed valve, in this rest"),
        ("pressed", "Pa", "Change of its pressure in this rest"),
        ("root", "s", "Integral of the root of its pressure over this rest"),
        ("through", "s", "Integral of the root of the drop over the edge that was open last, in this rest"),
        ("spoiled", "1", "1: another valve was open at the begin of this rest"),
    )
    found["settled"] = Quantity(
        "s", f"Time for which the valve is closed, and no load opens a counterbalance valve: {axis.name}"
    )
    found["rest"] = Quantity("s", f"Length of this rest, or of its present part: {axis.name}")
    text = f"Integral of the difference of both pressures over this rest: {axis.name}"
    return found | {"difference": Quantity("Pa.s", text, 1e7)}


def fits(axis: ControlledAxis) -> dict[str, Fit]:
    """Leaks, and the air alone."""
    found = {"leaks": Fit("leaks", (*LEAKS, AIR))}
    return found if axis.turns else found | {"trapped": Fit("trapped", (AIR,))}


def air_volume(pressure: Scalar) -> Scalar:
    """Of air at a gauge pressure [Pa], over that at the atmosphere."""
    return (ATMOSPHERE / ca.fmax(pressure + ATMOSPHERE, 0.1 * ATMOSPHERE)) ** (1 / EXPONENT)


def air_limit(reference: Scalar, p: Any) -> Scalar:
    """Air more than that of a healthy machine above which it is told; 0: none was measured."""
    known = p.air_limit + CHANGES * ca.fmax(reference, 0)
    return ca.if_else(reference == 0, p.air_unlearned_limit, known)


def _pushed(a: Axis) -> Scalar:
    """1: a load moves the arm on its oil."""
    return whether(ca.fabs(a.actuator.head_area * a.lever * a.rate(0)) > a.p.burst_margin)


def _calm(a: Axis) -> list[Scalar]:
    """1: no relief or anti-cavitation valve of a chamber is open, and nothing pushes the arm."""
    low, high = a.p.calm_pressure, a.tight
    return [whether(v > low) * whether(v < high) * (1 - _pushed(a)) for v in a.pressures]


def _resting(a: Axis) -> tuple[Scalar, Scalar]:
    """1: this rest goes on; 1: it ends now, and counts."""
    spoils = either(*((1 - c) * (1 - s) for c, s in zip(_calm(a), a.pair("spoiled"), strict=True)))
    settling = a.p.settling + a.compensated * (a.p.holding - a.p.settling)
    whole = a.closed * a.sound * whether(a.settled > settling) * whether(a.rest < PART)
    goes_on = whole * (1 - spoils * whether(a.rest > 0))
    return goes_on, (1 - goes_on) * whether(a.rest > SHORTEST) * a.usable * (1 - a.spool)


def _equations(a: Axis) -> tuple[Equations, Scalar]:
    """Losses of both chambers in this rest, over their uncertainty; how many count."""
    p, found, count = a.p, [], 0
    areas = a.actuator.head_area, a.actuator.rod_area
    for k, (c, area) in enumerate(zip(a.capacitances, areas, strict=True)):
        names = ("missing_oil", "pressed", "root", "through", "spoiled")
        oil, pressed, root, through, spoiled = (a.pair(n)[k] for n in names)
        late, sign = getattr(a, f"late_{2 + k}"), 1 - 2 * k
        air = c * p.bulk_modulus * (air_volume(late) - air_volume(late - pressed))
        rounded = ROUNDED * ((area * a.lever * p.angle_resolution) ** 2 + (c * p.pressure_resolution) ** 2)
        known = (p.rest_flow * a.rest) ** 2 + (p.softness * c * pressed) ** 2
        off = ca.sqrt(p.end_volume**2 + rounded + known)
        columns = [sign * a.difference / PRESSURE, (1 - k) * root, k * root, through, -air / LITRE]
        scale = (1 - spoiled) / off
        found.append(([scale * LITRE * v for v in columns], scale * oil))
        count += 1 - spoiled
    return found, count


def rates(a: Axis) -> dict[str, Scalar]:
    """Sums over a rest, which count at its end and are forgotten then."""
    (goes_on, ends), p = _resting(a), a.p
    leakage = ca.if_else(a.compensated > 0, 0, a.actuator.valve.leakage)
    level = a.u.supply_pressure + a.u.tank_pressure
    growth: dict[str, Scalar] = {"rest": 1, "difference": a.pressures[0] - a.pressures[1]}
    for k, (flow, v) in enumerate(zip(a.flows, a.pressures, strict=True)):
        growth[f"missing_oil_{k}"] = leakage * (level - 2 * v) - flow
        growth[f"pressed_{k}"] = a.rate(2 + k)
        growth[f"root_{k}"] = ca.sqrt(positive(v, SMALL) / PRESSURE)
        filled_last = (1 - 2 * k) * a.trailing > 0
        drop = ca.if_else(filled_last, a.u.supply_pressure - v, v - a.u.tank_pressure)
        growth[f"through_{k}"] = ca.if_else(filled_last, -1, 1) * ca.sqrt(positive(drop, SMALL) / PRESSURE)
    found = {n: ca.if_else(goes_on > 0, v, -getattr(a, n) / QUICK) for n, v in growth.items()}
    settled = a.closed * a.sound * (1 - _pushed(a) * a.compensated)  # its counterbalance valves open then
    found["settled"] = counted(a.settled, settled, whether(a.settled < 2 * p.holding))
    kept = goes_on * whether(a.rest > 0)
    for k, (calm, spoiled) in enumerate(zip(_calm(a), a.pair("spoiled"), strict=True)):
        found[f"spoiled_{k}"] = ca.if_else(kept > 0, 0, (1 - calm - spoiled) / QUICK)
    equations, count = _equations(a)
    for name, fit in fits(a.axis).items():
        memory = {"leaks": p.memory, "trapped": p.air_memory}[name]
        own = [(columns[-len(fit.columns) :], right) for columns, right in equations]
        gone = QUICK / (1 - ca.exp(-1 / memory))
        found |= fit.rates(a, ends / QUICK, own, gone, count)
    return found


def told(a: Axis) -> dict[str, Told]:
    """Sizes above their limits by three deviations."""
    of, jet = fits(a.axis), a.actuator.gain / a.actuator.valve.area * math.sqrt(PRESSURE)
    usable = a.usable * (1 - a.spool)
    leaks, _ = a.solved(of["leaks"], LEAKS | (FOAM if a.axis.turns else AIRY), 1.0, 2.0, MOST, len(LEAKS))
    known = usable * (1 - a.burst_told) * whether(leaks.samples > FEWEST_RESTS)
    names = (SEAL, *(m.format("leak") for m in chambers_of(a.axis)[1]), OPEN)
    scales = (LITRE / PRESSURE, *[LITRE / jet] * 3)
    limit = a.p.leak_limit / LITRE * (SWAYING if a.axis.turns else 1)
    found = {
        n: (scale * size, scale * off, judged(size, off, limit, known))
        for n, (size, off), scale in zip(names, leaks, scales, strict=False)
    }
    if a.axis.turns:
        return {n: t for n, t in found.items() if n != SEAL}
    air, (reference,) = a.solved(of["trapped"], FOAM, 1.0, 4.0)
    ((share, off),) = air
    enough = usable * whether(air.samples > 2 * FEWEST)
    more, limit = share - ca.fmax(reference, 0), ALONE * air_limit(reference, a.p)
    return found | {AIR: (share, off, judged(more, off, limit, enough))}
