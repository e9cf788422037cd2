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

**Balance.** A valve is open between a_- and a_+, by its least and largest command of the last time. With the
flow q_- that comes into the chamber at least while it is filled, q_+ that goes out at most, and e of the
return edge over the other one,

    q_- = a_-(u) K sqrt(P_s - P)/`OUTLET`, of a compensated section a_-(u) q_0/`OUTLET`
    q_+ = `OUTLET` K e a_+(-u) sqrt(P - P_t)

a chamber has lost, or a void has grown by less than nothing,

    V' = q_- - q_+ - q - A |x_q| `CREEP` - (`SOFT` C - s V da/dP) |P'|        V >= 0 unless it is empty

with the air s of the healthy machine, and without what the other chamber gains beyond its valve, which are
seals or the valve. In an empty chamber the margins count after the void is closed only. It is a burst hose
above A |x_q| times `TURN` and the resolution of the angle: the sum of flows is as certain as it. A loss
counts below the supply pressure, and from that through `LEAST_OPENING` on. q_- counts while the return edge
lets oil out, or if that is not known, if the pressure has changed since the valve was closed, and was below
`BEARING` then.

**Spool.** It does not follow if the same volume does not come: `RESPONSE` q_- without q, while the return
edge is closed, or if that is not known, while the pressure stays where no burst hose would hold it, or where
one would let it rise; or if `PASSING` of it passes beyond what its edges let in and out.

**Other side.** The opening of a valve that is certainly open follows from flow and drop of the other chamber
better than from its command: an edge lets through a share sqrt(dP/dP_o) of that flow, times e or over it,
with zeros of sensors on the safe side. It counts for an empty chamber, whose own pressure shows nothing.

**None** is told of a burst hose for some time after one of `LEAST_OPENING` would have been told: what its jet
loses is more than what may come and go through the valve unseen. Of a spool after one that stands still would
have been told in both directions.

A relief valve that opens, a pressure that jumps up, a supply that changes, an impact, and a gap of readings
make volumes uncertain: no loss counts for `CALMED`, and an empty chamber has a void of `CREDIT` of what the
other one holds by its pressure.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca

from fmus.components.chamber import ATMOSPHERE
from fmus.contract import Scalar
from fmus.diagnosis.estimates import FEWEST, FORGOTTEN, QUICK, Fit, Told, either, judged, shown, whether
from fmus.diagnosis.readings import ENDS, LEAST_DROP, NO_DROP, PRESSURE, RELIEVING, SMALL, Axis
from fmus.diagnosis.unknowns import EDGES, LITRE, TABLE, chambers_of

HOLDING = 0.8  # s, settling of a compensated section, whose counterbalance valves close last
SHORTEST, PART = 0.15, 1.0  # s, a rest that counts, and a part of a long one
PUSHED = 2.5e-4  # m3/s of oil that a load moves while the valve is closed: another valve is open
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
RESPONSE = 0.5  # of the least flow, at least: a valve 20 % smaller, with oil of -10 degC
WAITING = 0.4  # of the flow, if the pump waits: it needs longer than a valve
TURN = 0.008  # rad or m of a joint, whose oil is lost: what lags and zeros of a healthy machine add up to
MISSING = 1.5e-5  # m3, that does not come: a shock moves less
PASSING = 3.0  # times this volume, through a closed valve: an arm that sways on its oil, at 20 Hz
CREEP = 0.012  # rad/s or m/s of a joint, that is no flow: below `MOVES`
SOFT = 0.3  # of the flow by a change of pressure, for hoses that are not known
LEAST_FLOW = 1e-4  # m3/s, through a return edge that tells whether it is open, or past a closed valve
BEARING = 1.5e6  # Pa: a burst hose cannot hold it behind a closed valve
LEAST_OPENING, LARGEST = 1e-5, 6e-5  # m2, of a burst hose
NOMINAL_OVER_LEAST = 1.5  # flow of the known valve over the least one: `MARGIN` and `OUTLET`
RISE = 5e4  # Pa, and a resolution: five times the noise of a pressure
DRIFT = 3e5  # Pa/s, of a pressure below `BEARING` by leakage: past a motor, through a valve that stays closed
FILLING = 0.08  # s, with pressure, from which there is no void: flows are behind a lag and a bus
SHOCK = 5e6  # Pa, by which a pressure is above its lag: an arm that is stopped hard, by an obstacle or an end
SAG = 2e6  # Pa, by which the supply is off its lag: a pump that is overrun, or starts
END = 0.02  # m, from the end of a stroke
IMPACT = 0.5  # rad/s or m/s, by which a speed is off its lag: 17 rad/s2, three times what a valve does
CALMED = 0.15  # s: a relief valve closes, and flows have left their lag
CREDIT = 2.0  # of the oil that a chamber takes up to the supply pressure: a shock reaches twice as much
STANDBY, STOPPED = 3.5e6, 1e6  # Pa, up to which a load-sensing pump stands by; below which the engine stands


def air_volume(pressure: Scalar) -> Scalar:
    """Of air at a gauge pressure [Pa], over that at the atmosphere."""
    return (ATMOSPHERE / ca.fmax(pressure + ATMOSPHERE, 0.1 * ATMOSPHERE)) ** (1 / EXPONENT)


def root(drop: Scalar) -> Scalar:
    """Of a pressure drop, without a root of nothing [Pa^0.5]."""
    return ca.sqrt(ca.fmax(drop, SMALL / 2))


def air_limit(healthy: Scalar, p: Any) -> Scalar:
    """Air more than that of a healthy machine above which it is told; 0: none was measured."""
    known = p.air_limit + CHANGES * ca.fmax(healthy, 0)
    return ca.if_else(healthy == 0, UNLEARNED * p.air_limit, known)


def _rests(a: Axis) -> tuple[Any, Scalar, Scalar]:
    """Losses of both chambers in a rest, over their uncertainty; how many count; 1: it ends now."""
    m, p, actuator = a.m, a.p, a.actuator
    pushed = whether(ca.fabs(a.speed) > PUSHED)  # a load moves the arm on its oil
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

    unit = math.sqrt(PRESSURE)
    difference = over("difference", "Difference of both pressures", "Pa.s", a.pressures[0] - a.pressures[1])
    leakage = ca.if_else(a.compensated > 0, 0, actuator.valve.leakage)
    level, areas = a.u.supply_pressure + a.u.tank_pressure, (actuator.head_area, actuator.rod_area)
    rows, count = list[tuple[list[Scalar], Scalar]](), 0
    for k, (v, c) in enumerate(zip(a.pressures, a.capacitances, strict=True)):
        sign, lost, end = 1 - 2 * k, leakage * (level - 2 * v) - a.flows[k], ENDS[k]
        oil = over(f"oil_{k}", f"Loss but through the closed valve, {end}", "m3", lost)
        pressed = over(f"pressed_{k}", f"Change of its pressure, {end}", "Pa", a.rate[2 + k])
        jet = over(f"jet_{k}", f"Root of its pressure, {end}", "s", root(v) / unit)
        inlet, outlet = (root(d) / unit for d in (a.u.supply_pressure - v, v - a.u.tank_pressure))
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


def balance(a: Axis) -> dict[str, Told]:
    """Hoses that lose oil, and a spool that does not follow."""
    p, m, tank, told = a.p, a.m, a.u.tank_pressure, dict[str, Told]()
    sound = a.sound * (1 - either(*a.doubted[2:]))
    relieved = RELIEVING * p.nominal_supply_pressure
    tight = whether(ca.fmax(*a.pressures) < ca.if_else(a.compensated > 0, a.tight, relieved))
    even = whether(ca.fabs(a.behind[1]) < IMPACT)
    sag = a.u.supply_pressure - m.lag("late_supply", a.u.supply_pressure, p.lag, "Supply pressure", "Pa")
    tight *= whether(ca.fmax(*a.behind[2:]) < SHOCK) * whether(ca.fabs(sag) < SAG) * even
    calm = m.sum("calm", "Time without an open relief valve, a shock, a gap", 1, tight * sound)
    shaken = m.state("shaken", "Time for which an impact is not over", "s")
    m.moves("shaken", ca.if_else(even > 0, -ca.fmin(1, shaken / QUICK), (CALMED - shaken) / QUICK))
    followed = even * whether(shaken < QUICK / 2)
    counts, usable, stuck = sound * tight * whether(calm > CALMED), a.usable * (1 - a.spool), 0
    obeys: Scalar = 1
    lines = zip(a.pressures, a.late[2:], strict=True)
    below = [whether(ca.fmax(*v) < a.u.supply_pressure - 2 * p.zero_limit) for v in lines]
    oil = [_expected(a, k) for k in (0, 1)]
    jet, least = a.actuator.gain / a.actuator.valve.area, RISE + p.pressure_resolution
    for k, (mark, area) in enumerate(zip(chambers_of(a.axis), a.areas, strict=True)):
        flow, pressure, (asked, _, most_in, _, soft) = a.flows[k], a.pressures[k], oil[k]
        other, (_, returned, high, most_of_other, soft_of_other) = a.flows[1 - k], oil[1 - k]
        swept = area * ca.fabs(a.lever)
        limit = swept * (TURN + p.angle_resolution)
        # whether the valve is open: by the return edge, or by the pressure since it opened
        before = m.state(f"before_{k}", f"Pressure before its valve opened, {ENDS[k]}", "Pa", pressure)
        drift = ca.if_else(a.most[k] < p.closed_command, NO_DROP, DRIFT)
        towards = (pressure - before) / FORGOTTEN
        m.moves(f"before_{k}", ca.fmin(ca.fmax(towards, -drift), drift))
        held, change = whether(before > BEARING), ca.fabs(pressure - before)
        known, passing = whether(returned > LEAST_FLOW), whether(-other > returned)
        through = jet * LEAST_OPENING * root(pressure - tank)
        burst = whether(change > least) * whether(asked - flow > through) * (1 - held)
        # what it has lost, a void before
        filling = m.sum(f"filled_{k}", f"Time for which it is not empty, {ENDS[k]}", 1, a.filled[k])
        empty = whether(filling < FILLING)
        gained = ca.fmax(other - high - soft_of_other, 0) * a.filled[1 - k]
        gained *= OUTLET * ca.fmax(area / a.areas[1 - k], 1)
        least_in, most_out = _seen(a, k, empty, oil)
        inflow = ca.fmax(asked * ca.if_else(known > 0, passing, burst), least_in)
        loss = inflow - flow - most_out - gained
        void = ca.if_else(flow > 0, ca.fmax(asked, least_in) - flow, ca.fmax(loss, 0))
        lost = m.state(f"lost_{k}", f"Oil lost beyond its valve, or less than none: a void, {ENDS[k]}", "m3")
        excess = loss - swept * CREEP - soft
        excess *= ca.if_else(excess > 0, below[k] * whether(loss > through * (1 - empty)), 1)
        unknown = -CREDIT * a.capacitances[k] * p.nominal_supply_pressure
        opens = ca.if_else(lost < 0, void, ca.if_else(excess > 0, excess, ca.fmin(void, 0)))
        opens = ca.if_else(counts > 0, opens, ca.fmin(void, (unknown - lost) / FORGOTTEN))
        closes = ca.fmax(excess * counts, -lost / QUICK)
        change_of_oil = ca.if_else(empty > 0, opens, closes)
        m.moves(f"lost_{k}", ca.if_else(sound > 0, change_of_oil, -ca.fmax(lost, 0) / QUICK))
        hidden = most_in + most_out - inflow + swept * CREEP + soft  # what may come and go without being told
        seen = counts * below[k] * (1 - empty) * (through - hidden) / limit
        sees = m.power(f"sees_{k}", f"A burst hose would be told, {ENDS[k]}", seen, 1)
        told[mark.format("burst")] = shown(a.burst[k], usable * sees)
        size = whether(lost > limit) * ca.fmax(loss, LITRE)
        m.latch(f"burst_{k}", a.burst[k], size * (1 - a.spool) * a.sound)
        # what does not come though a valve should be open, and what comes though it is closed
        shows = whether(NOMINAL_OVER_LEAST * asked > jet * LARGEST * ca.sqrt(least))
        shows *= whether(change < least) * whether(lost >= 0)
        shows = either(shows, held * whether(pressure > BEARING) * (1 - empty))
        still = (RESPONSE * asked - ca.fmax(flow, 0)) * ca.if_else(known > 0, 1 - passing, shows)
        # not of an arm that rebounds, also from the end of a stroke
        left = END if a.axis.turns else (getattr(p, a.axis.name).stroke - a.position, a.position)[k]
        asks = sound * followed * whether(left >= END)
        enough = MISSING + swept * p.angle_resolution
        text = f"A spool that does not follow would be told, {ENDS[k]}"
        would = either(known, shows) * RESPONSE * asked * asks / enough
        obeys *= m.power(f"obeys_{k}", text, would, whether(a.most[k] > p.closed_command))
        asks *= whether(ca.fmax(-flow, other) < asked / 2)
        missing = m.sum(f"missing_{k}", f"Oil that does not come, {ENDS[k]}", still, asks, "m3", FORGOTTEN)
        passes = ca.fmin(flow - most_in - soft, -most_of_other - other - soft_of_other) - LEAST_FLOW
        passes *= a.filled[0] * a.filled[1] * below[1 - k]
        text = f"Oil that comes beyond what its valve lets in, {ENDS[k]}"
        passed = m.sum(f"passed_{k}", text, passes, counts, "m3", FORGOTTEN)
        stuck = either(stuck, whether(ca.fmax(missing, passed / PASSING) > enough))
    m.latch("spool", a.spool, stuck * (1 - a.burst_told))
    return told | {"spool": shown(a.spool, a.usable * obeys)}


def _expected(a: Axis, k: int) -> tuple[Scalar, ...]:
    """Least flow into a chamber while it is filled, least out of it, most in, most out; of its pressure."""
    p, other, pressure, supply, tank = a.p, 1 - k, a.pressures[k], a.u.supply_pressure, a.u.tank_pressure
    _, drop, full, *_ = a.edge(k)
    idle = whether(supply < STANDBY) * whether(supply > STOPPED)
    asked = ca.if_else(drop > LEAST_DROP, 1, idle * WAITING) * full * a.opened(k, a.least[k], -1) / OUTLET
    edge, widest = a.reference(EDGES[other]) * a.actuator.gain, a.opened(k, a.most[k], 1)
    highest, lowest = ca.fmax(pressure, a.late[2 + k]), ca.fmin(pressure, a.late[2 + k])
    least = edge * a.opened(other, a.least[other], -1) / OUTLET * (1 - a.compensated)
    least *= root(lowest - tank - 2 * p.zero_limit)
    most = edge * a.opened(other, a.most[other], 1)
    most *= root(highest - tank + 2 * p.zero_limit)
    absolute = ca.fmax(lowest + ATMOSPHERE, ATMOSPHERE)
    air = p.bulk_modulus * ca.fmax(a.reference("air"), 0) * air_volume(lowest) / (EXPONENT * absolute)
    soft = (SOFT + air) * a.capacitances[k] * ca.fabs(a.rate[2 + k])
    return asked, least, OUTLET * full * widest - least, OUTLET * most, soft


def _seen(a: Axis, k: int, empty: Scalar, oil: list[tuple[Scalar, ...]]) -> tuple[Scalar, Scalar]:
    """Least flow into an empty chamber, most out of it, by the opening that the flow of the other shows."""
    known = empty * a.full[1 - k] * (1 - a.compensated) * (1 - a.burst_told)
    off, other = 2 * a.p.zero_limit, a.pressures[1 - k]
    fills, empties = (known * whether(oil[j][0] > 0) for j in (k, 1 - k))
    to_line, from_line, (*_, most_in, most, _) = a.u.supply_pressure - off, a.u.tank_pressure - off, oil[k]
    drops = to_line - a.pressures[k], other - from_line, a.pressures[k] - from_line, to_line - other
    own, of_other = (ca.if_else(fills > 0, *pair) for pair in (drops[::2], drops[1::2]))
    edges = ca.if_else(fills > 0, 1 / (OUTLET * a.reference(EDGES[k])), OUTLET * a.reference(EDGES[1 - k]))
    flow = a.flows[1 - k] * edges * ca.sqrt(ca.fmax(own, 0) / ca.fmax(of_other, SMALL))
    return ca.fmin(-flow, most_in) * fills, ca.if_else(empties > 0, ca.fmin(flow, most), most)
