"""Oil of one function that leaves its chambers in another way than through an open valve.

**Leaks, and air**: from `settling` after its valve has closed. No relief, counterbalance or anti-cavitation
valve of the chamber may be open. c is the leakage of the closed valve, g that of the seals, k = C_d A
sqrt(2/rho) that of an opening of area A to the outside, s the share of air in the volume V, which has the
volume a(P) at a pressure. Each rest, and each part of a long one, is one equation of each chamber, over its
time:

    int c (P_s + P_t - 2 P_h) - q_h dt = g int P_h - P_r dt + k_h int sqrt(P_h) dt - s V [a(P_h)]
    int c (P_s + P_t - 2 P_r) - q_r dt = -g int P_h - P_r dt + k_r int sqrt(P_r) dt - s V [a(P_r)]

A valve that stays open after a stroke, by k_v, lets oil into the chamber that was filled last, and out of the
other one: -k_v int sqrt(P_s - P) dt and k_v int sqrt(P - P_t) dt are added to the right sides. g and each k
are not negative, and at most one of them is not zero. g is that of the oil as it is now. An equation is
uncertain by the readings at both ends, by a flow, and by a share of the capacitance times the change of the
pressure. The air is told from a fit of its own with a longer memory, of all functions together: they have the
same oil. That of one function alone, after a hose was changed, is told above twice the limit.

**Spool.** It does not follow if the flow stays below `RESPONSE` of the least that the commands of the last
time ask for while the return edge does not say that it is open, if a load-sensing pump stands by although
they ask for flow, or if oil passes the closed valve, in on one side and out on the other.

**Burst.** What a chamber loses beyond what its valve can let out, unless the other side gains it:

    -q - `OUTLET` e K a(u) sqrt(P - P_t) - `burst_margin`        P < P_s: no relief valve is open

u: the largest command of the last time; e: opening of the return edge over that of the other one. The margin
falls after a while at rest, so a leak is found that empties a chamber before its size is known. Or what an
open valve lets in and does not arrive, as open as the return edge says by the flow q_r and the drop dP_r:

    min(q_r/(e K sqrt(dP_r)), a(u)) K sqrt(dP)/`OUTLET` - q - `RESTING` `burst_margin`

A chamber at less than `LOST` that does not fill has a burst hose, too, if the pressure or the flow of the
other side says that its valve is open.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from fmus.components.chamber import ATMOSPHERE
from fmus.contract import Scalar
from fmus.diagnosis.estimates import FEWEST, FORGOTTEN, QUICK, Fit, Told, either, judged, shown, whether
from fmus.diagnosis.readings import BLIND, ENDS, FILLED, LEAST_DROP, LONGER, PRESSURE, SMALL, Axis
from fmus.diagnosis.unknowns import LITRE, TABLE, chambers_of
from fmus.smooth import positive

HOLDING = 0.8  # s, settling of a compensated section, whose counterbalance valves close last
SHORTEST, PART = 0.15, 1.0  # s, a rest that counts, and a part of a long one
CALM = 1e6  # Pa, twice the preload of the return line: below it an anti-cavitation valve may fill a chamber
END_VOLUME = 2.5e-7  # m3, deviation of the oil at an end of a rest: half of the step of an encoder, a boom
REST_FLOW = 5e-7  # m3/s, deviation of the flow in a rest: leakage of a valve that is another one
SOFTNESS = 0.3  # relative deviation of the capacitance of a chamber: hoses that are not known
FEWEST_RESTS = 3.0  # equations, from which a leak is told
MOST = 3.0  # deviations by which equations differ unless the machine changes
SWAYING = 4.0  # of the limit, for a motor: the column swings on its oil for long
EXPONENT = 1.4  # of the air
ROUNDED = 1 / 6  # variance of the difference of two rounded readings, over the square of their resolution
AIR_MEMORY = 100.0  # rests, or parts of a long one: some minutes of work
CHANGES = 1.2  # of the air that the hoses of a healthy machine seem to have: rests differ
UNLEARNED = 12.0  # limits of the air if no healthy machine was measured: more than soft hoses seem to have
ALONE = 2.0  # limits of the air of one function
LEAK, AIRY = 10.0, 0.005  # prior deviations: L/min at 100 bar, a seal or fitting that is gone; air
OUTLET = 1.3  # flow through an edge over that of its known opening, at most: the density of the oil, too
RESTING, SLOW = 1 / 3, 1 / 15  # of the margin of a burst after a while at rest; when the arm is at rest, too
EMPTIED = 3.0  # weight of oil that is lost at rest, where only a load that changes moves some
LONG = 0.6  # s, after which a chamber is at rest
PASSED = 5e-5  # m3 that pass a closed valve: an arm that swings on its oil passes half of it to and fro
SOFT = 4.0  # capacitances of a chamber: what a tenth of air adds in 10 L at 100 bar; a load moves that oil
RESPONSE = 0.3  # flow over that of the known valve, at least: one 20 % smaller, with oil of -10 degC
WAITING = 0.4  # of the time without response, if the pump waits: it needs longer than a valve
EMPTY = 0.25  # of the same, of an empty chamber: it has to be filled first
LOST = 1.5e6  # Pa: the weight of an arm or friction needs more
STANDBY, STOPPED = 3.5e6, 1e6  # Pa, up to which a load-sensing pump stands by; below which the engine stands


def air_volume(pressure: Scalar) -> Scalar:
    """Of air at a gauge pressure [Pa], over that at the atmosphere."""
    return (ATMOSPHERE / ca.fmax(pressure + ATMOSPHERE, 0.1 * ATMOSPHERE)) ** (1 / EXPONENT)


def air_limit(healthy: Scalar, p: Any) -> Scalar:
    """Air more than that of a healthy machine above which it is told; 0: none was measured."""
    known = p.air_limit + CHANGES * ca.fmax(healthy, 0)
    return ca.if_else(healthy == 0, UNLEARNED * p.air_limit, known)


def _rests(a: Axis) -> tuple[Any, Scalar, Scalar]:
    """Losses of both chambers in a rest, over their uncertainty; how many count; 1: it ends now."""
    m, p, actuator = a.m, a.p, a.actuator
    pushed = whether(ca.fabs(a.speed) > p.burst_margin)  # a load moves the arm on its oil
    calm = [whether(v > CALM) * whether(v < a.tight) * (1 - pushed) for v in a.pressures]
    spoiled = [m.state(f"spoiled_{k}", "1: another valve was open at the begin of this rest") for k in (0, 1)]
    settles = a.closed * a.sound * (1 - pushed * a.compensated)  # its counterbalance valves open then
    settled = m.sum("settled", "Time for which the valve is closed, and no load opens another", 1, settles)
    rest = m.state("rest", "Length of this rest, or of its present part", "s")
    spoils = either(*((1 - c) * (1 - s) for c, s in zip(calm, spoiled, strict=True)))
    settling = ca.if_else(a.compensated > 0, HOLDING, p.settling)
    whole = a.closed * a.sound * whether(settled > settling) * whether(rest < PART)
    goes_on = whole * (1 - spoils * whether(rest > 0))
    ends = (1 - goes_on) * whether(rest > SHORTEST) * a.usable * (1 - a.spool)
    m.moves("rest", ca.if_else(goes_on > 0, 1, -rest / QUICK))

    def over(name: str, text: str, unit: str, growth: Scalar) -> Scalar:
        total = m.state(name, f"{text}, in this rest", unit)
        m.moves(name, ca.if_else(goes_on > 0, growth, -total / QUICK))
        return total

    def root(pressure: Scalar) -> Scalar:
        return ca.sqrt(positive(pressure, SMALL) / PRESSURE)

    difference = over("difference", "Difference of both pressures", "Pa.s", a.pressures[0] - a.pressures[1])
    leakage = ca.if_else(a.compensated > 0, 0, actuator.valve.leakage)
    level, areas = a.u.supply_pressure + a.u.tank_pressure, (actuator.head_area, actuator.rod_area)
    rows, count = list[tuple[list[Scalar], Scalar]](), 0
    for k, (v, c) in enumerate(zip(a.pressures, a.capacitances, strict=True)):
        sign, lost, end = 1 - 2 * k, leakage * (level - 2 * v) - a.flows[k], ENDS[k]
        oil = over(f"oil_{k}", f"Loss but through the closed valve, {end}", "m3", lost)
        pressed = over(f"pressed_{k}", f"Change of its pressure, {end}", "Pa", a.rate[2 + k])
        jet = over(f"jet_{k}", f"Root of its pressure, {end}", "s", root(v))
        inlet, outlet = root(a.u.supply_pressure - v), root(v - a.u.tank_pressure)
        growth, text = ca.if_else(sign * a.trailing > 0, -inlet, outlet), "the edge that was open last"
        through = over(f"through_{k}", f"Root of the drop over {text}, {end}", "s", growth)
        change = ca.if_else(goes_on * whether(rest > 0) > 0, 0, 1 - calm[k] - spoiled[k])
        m.moves(f"spoiled_{k}", change / QUICK)
        late = a.late[2 + k]
        air = c * p.bulk_modulus * (air_volume(late) - air_volume(late - pressed))
        rounded = (areas[k] * a.lever * p.angle_resolution) ** 2 + (c * p.pressure_resolution) ** 2
        known = (REST_FLOW * rest) ** 2 + (SOFTNESS * c * pressed) ** 2
        scale = (1 - spoiled[k]) / ca.sqrt(END_VOLUME**2 + ROUNDED * rounded + known)
        columns = [sign * difference / PRESSURE, (1 - k) * jet, k * jet, through, -air / LITRE]
        rows.append(([scale * LITRE * v for v in columns], scale * oil))
        count += 1 - spoiled[k]
    return rows, count, ends


def leaks(a: Axis) -> dict[str, Told]:
    """Sizes above their limits."""
    p, names = a.p, [m.format("leak") for m in chambers_of(a.axis)]
    equations, count, ends = _rests(a)
    usable = a.usable * (1 - a.spool)
    foam, healthy = TABLE["axis"]["air"].prior, a.reference("air")
    airy = foam if a.axis.turns else AIRY  # hoses of a motor
    fit = Fit(a.m, "leaks", [*[(LEAK, 0)] * 4, (airy, 0)], 0.5, 1.0, MOST, rare=4)
    trapped = Fit(a.m, "trapped", [(foam, healthy)], 1.0, 4.0)
    for one, memory, size in ((fit, p.memory, 5), (trapped, AIR_MEMORY, 1)):
        own, time = [(c[-size:], y) for c, y in equations], QUICK / (1 - ca.exp(-1 / memory))
        one.adds(ends / QUICK, own, time, count)
    known = usable * (1 - a.burst_told) * whether(fit.samples > FEWEST_RESTS)
    jet = a.actuator.gain / a.actuator.valve.area * math.sqrt(PRESSURE)
    limit = p.leak_limit / LITRE * (SWAYING if a.axis.turns else 1)
    scales = (LITRE / PRESSURE, *[LITRE / jet] * 3)
    rows = zip(("seal_leakage", *names, "valve_opening"), fit.sizes, scales, strict=False)
    told = {n: (scale * s, scale * d, judged(s, d, limit, known)) for n, (s, d), scale in rows}
    if a.axis.turns:
        return {n: t for n, t in told.items() if n != "seal_leakage"}
    ((share, off),) = trapped.sizes
    enough = usable * whether(trapped.samples > 2 * FEWEST)
    more = share - ca.fmax(healthy, 0)
    return told | {"air": (share, off, judged(more, off, ALONE * air_limit(healthy, p), enough))}


def spool(a: Axis) -> dict[str, Told]:
    """Whether it follows; which chambers do not fill although the valve is open."""
    p, m, supply, tank = a.p, a.m, a.u.supply_pressure, a.u.tank_pressure
    idle = whether(supply < STANDBY) * whether(supply > STOPPED)
    missing, passed = list[Scalar](), list[Scalar]()
    for k, area in enumerate((a.actuator.head_area, -a.actuator.rod_area)):
        flow, drop, full, *_ = a.edge(k)
        by_speed = area * a.lever * a.readings[1] * (1 - a.faulty[1])
        moved, opened = ca.fmax(flow, by_speed), a.opened(k, a.least[k], -1)
        asked = whether(opened * full > RESTING * p.burst_margin)  # creep speed, at least
        late = asked * whether(moved < RESPONSE * opened * full)
        waits, late = WAITING * idle * late, late * whether(drop > LEAST_DROP)
        late *= ca.if_else(a.full[k] > 0, 1, EMPTY)
        # an open valve lets the pressure of the other side down; a motor that stands has none, and a hose
        # of a compensated section has none from the load
        returned, known = a.return_edge(k)
        passing = whether(returned > RESPONSE * opened * a.outlet(k)) * known
        held = a.full[1 - k] * whether(a.pressures[1 - k] - tank > LOST) * (1 - passing)
        late *= 1 - passing * a.full[k]
        low = (not a.axis.turns) * whether(a.pressures[k] < LOST) * (1 - held) * (1 - a.compensated)
        missing += [late * (1 - low), waits]
        hidden = late * low * a.sound
        text = "Time for which it does not fill although its valve is open"
        a.hidden.append(m.sum(f"hidden_{k}", text, hidden, whether(hidden > 0), "s", FORGOTTEN))
        closed = whether(a.most[k] < p.closed_command) * whether(a.pressures[k] - tank > FILLED)
        soft = [SOFT * c * ca.fabs(a.rate[2 + side]) for side, c in enumerate(a.capacitances)]
        through = ca.fmin(a.flows[k] - soft[k], -a.flows[1 - k] - soft[1 - k]) - RESTING * p.burst_margin
        closed *= whether(ca.fmax(*a.pressures) < a.tight)  # a relief valve passes oil, too
        counts = closed * a.sound * a.full[0] * a.full[1]
        text = "Oil that came through the closed valve"
        passed.append(m.sum(f"passed_{k}", text, through, counts, "m3", FORGOTTEN))
    wrong = either(*missing) * a.sound
    text = "Time for which the valve does not follow"
    time = m.sum("missing", text, wrong, whether(wrong > 0), "s", FORGOTTEN)
    told = either(whether(time > p.response_time), *(whether(v > PASSED) for v in passed))
    m.latch("spool", a.spool, told * (1 - a.burst_told))
    return {"spool": shown(a.spool, a.usable)}


def bursts(a: Axis) -> dict[str, Told]:
    """Hoses that lose more than a valve lets out."""
    p, tank, told = a.p, a.u.tank_pressure, dict[str, Told]()
    rest, still = RESTING * p.burst_margin, whether(ca.fabs(a.speed) < RESTING * p.burst_margin)
    margin = ca.if_else(a.shut > LONG, rest, p.burst_margin)
    margin = ca.if_else(still * whether(a.shut > LONGER) > 0, SLOW * p.burst_margin, margin)
    usable = a.usable * (1 - a.spool)
    for k, (mark, flow) in enumerate(zip(chambers_of(a.axis), a.flows, strict=True)):
        pressure, other, sound = a.pressures[k], 1 - k, a.sound * a.full[k] * (1 - a.doubted[2 + k])
        # what leaves it beyond the return edge; flows are behind a lag, so is the pressure
        outlet = OUTLET * a.outlet(other) * a.opened(other, a.most[other], 1)
        highest = positive(ca.fmax(pressure, a.late[2 + k]) - tank, SMALL)
        gained = ca.fmax(a.flows[other], 0) * whether(a.pressures[other] - tank > FILLED)
        loss = -flow - outlet * a.actuator.gain * ca.sqrt(highest) - gained
        # a relief valve that closes late: the pressure that was a moment ago
        before = pressure - ca.if_else(a.shut > LONGER, BLIND * a.rate[2 + k], 0)
        supply = a.u.supply_pressure
        tight = ca.if_else(a.compensated > 0, ca.fmin(supply, a.tight), supply)
        counts = whether(ca.fmax(pressure, before) < tight) * sound
        emptied = whether(a.shut > LONG) * whether(pressure < LOST) * (1 - a.compensated)
        excess = (1 + (EMPTIED - 1) * emptied) * (loss - margin) * counts
        # what comes through the edge into it, as open as the return edge says, and does not arrive
        (returned, known), (_, drop, full, *_) = a.return_edge(k), a.edge(k)
        open_by = ca.fmin(returned / a.outlet(k), a.opened(k, a.most[k], 1))
        driven = whether(a.least[k] > p.closed_command) * known * whether(drop > LEAST_DROP)
        starved = (open_by * full / OUTLET - flow) * driven
        excess = ca.fmax(excess, (starved - rest) * sound)
        counts = either(counts, whether(starved > 0) * sound)
        lost = a.m.sum(f"lost_{k}", "Oil lost beyond its valve", excess, counts, "m3", FORGOTTEN)
        hidden = whether(a.hidden[k] > p.response_time) * p.burst_margin
        size = ca.fmax(whether(lost > p.burst_volume) * ca.fmax(loss, starved), hidden)
        a.m.latch(f"burst_{k}", a.burst[k], size * (1 - a.spool) * a.sound)
        told[mark.format("burst")] = shown(a.burst[k], usable)
    return told
