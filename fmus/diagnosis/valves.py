"""The valve of one function, its edges, and hoses that burst.

**Spool.** It does not follow if the flow stays below `response` of the least that the commands of the last
time ask for while the return edge does not say that it is open, if a load-sensing pump stands by although
they ask for flow, or if oil passes the closed valve, in on one side and out on the other.

**Edges.** The opening of the return edge, by its flow and drop, over that of the edge into the other chamber
depends on the valve alone, neither on commands nor on hysteresis: e of each direction. Healthy valves keep
it to a tenth. Not of compensated sections, whose counterbalance valves are in series.

**Burst.** What a chamber loses beyond what its valve can let out, unless the other side gains it:

    -q - `outlet` e K a(u) sqrt(P - P_t) - `burst_margin`        P < P_s: no relief valve is open

u: the largest command of the last time. The margin falls after a while at rest, so a leak is found that
empties a chamber before its size is known. Or what an open valve lets in and does not arrive, as open as the
return edge says by the flow q_r and the drop dP_r over it:

    min(q_r/(e K sqrt(dP_r)), a(u)) K sqrt(dP)/`outlet` - q - `rest_margin`

A chamber at less than `lost_pressure` that does not fill has a burst hose, too, if the pressure or the flow
of the other side says that its valve is open.

**Map**, in motion. The flow into the chamber that is filled, the drop over its edge and the hose in series
give the opening, and this the command v that a healthy valve needs for it:

    a = q/(K sqrt(dP - dp(q))), of a compensated section q/q_0        v = D + a (U - D)
    v = s |u| - d - h m - T |u|'

with the drop dp of the hose, warm or cold (`hose.Friction`), which the return edge has in series, too, the
command u behind the lag of the readings, its gain s, the dead band D + d, half the hysteresis h, the sign m
of its last change and a lag T; s and d of each direction. It counts if u has moved on by
`valve_travel` since it turned, the edge is open, no anti-cavitation valve is, and the drop over it is not
small. Of compensated sections the least drop of all that are open counts: they share the flow of a pump that
cannot give more. Gain and dead band are judged together, by the mean of v over all samples of a direction.
The lag is a mean over a minute of motion, since a filter clogs slowly; the hysteresis is told by such a mean,
too. Samples that are `valve_memory` apart count as independent.
"""

from __future__ import annotations

import casadi as ca

from fmus.components.play import play_rate
from fmus.contract import Quantity, Scalar
from fmus.controller.arm import ControlledAxis
from fmus.diagnosis.axis import (
    BLIND,
    FILLED,
    LONG,
    LONGER,
    SMALL,
    Axis,
    Finding,
    chambers_of,
    of_both,
    of_chambers,
)
from fmus.diagnosis.estimates import (
    FEWEST,
    FORGOTTEN,
    QUICK,
    Equations,
    Fit,
    Told,
    counted,
    either,
    gathered,
    judged,
    latched,
    shown,
    whether,
)
from fmus.diagnosis.settings import OF_EDGES, OF_VALVE
from fmus.smooth import positive

LEAST_DROP = 1e6  # Pa, over an edge whose flow tells its opening
RESTING = 3.0  # weight of oil that is lost at rest, where only a load that changes moves some
SOFT = 4.0  # capacitances of a chamber: what a tenth of air adds in 10 L at 100 bar; a load moves that oil
WAITING = 0.4  # of the time without response, if the pump waits: it needs longer than a valve
EMPTIED = 0.25  # of the same, of an empty chamber: it has to be filled first
# prior standard deviations: a valve that is another one
MAP = dict(zip(OF_VALVE, (0.5, 0.5, 0.5, 0.5, 1.0, 0.1), strict=True))
HYSTERESIS, DELAY = OF_VALVE[4:]
MEANS = {HYSTERESIS: 0.1, DELAY: 0.01}  # V, s: deviation that is one sample of a mean
APART = frozenset(
    frozenset((f"{n}_up", f"{m}_down")) for n in ("gain", "dead_band") for m in ("gain", "dead_band")
)


def findings(axis: ControlledAxis) -> dict[str, Finding]:
    """Bursts, spool, map."""
    loss = Finding("m3/s", "Loss beyond that of the valve at {end} of the {{}}", 1e-3, "{} hose")
    found = of_both(axis, "burst", loss)
    found["spool"] = Finding("1", "1: the {} spool does not follow its command", 1.0, "{} valve")
    texts = (
        "Gain of the positive {} command",
        "Dead band of the positive {} command, more than known",
        "Gain of the negative {} command",
        "Dead band of the negative {} command, more than known",
        "Half of the hysteresis of the {} valve",
        "Lag of the {} valve with that of the readings",
    )
    for name, text, unit in zip(OF_VALVE, texts, ("1", "V", "1", "V", "V", "s"), strict=True):
        found[name] = Finding(unit, text, 0.1, "{} valve")
    for name, sign in zip(OF_EDGES, ("positive", "negative"), strict=True):
        text = f"Opening of the return edge over that of the other one, {sign} {{}} command"
        found[name] = Finding("1", text, 1.0, "{} valve")
    return found


def states(axis: ControlledAxis) -> dict[str, Quantity]:
    """Volumes, clocks, latches."""
    found = of_chambers(
        axis,
        ("passed", "m3", "Oil that came through the closed valve"),
        ("lost", "m3", "Oil lost beyond its valve"),
        ("hidden", "s", "Time for which it does not fill although its valve is open"),
        ("burst", "m3/s", "Largest loss beyond its valve"),
    )
    for n, unit, text in (
        ("missing", "s", "Time for which the valve does not follow"),
        ("spool", "1", "1: the spool does not follow"),
        ("late_command", "V", "Command behind the lag"),
        ("trailing", "V", "That behind a play of `valve_travel`"),
    ):
        found[n] = Quantity(unit, f"{text}: {axis.name}", 10.0 if unit == "V" else 1.0)
    return found


def fits(_: ControlledAxis) -> dict[str, Fit]:
    """The map, and the edges."""
    return {
        "valve": Fit("valve", tuple(MAP), APART),
        "edges": Fit("edges", OF_EDGES, frozenset({frozenset(OF_EDGES)})),
        **{n: Fit(f"mean_{n}", ("size",)) for n in MEANS},
    }


def _of_spool(a: Axis) -> dict[str, Scalar]:
    p, found = a.p, dict[str, Scalar]()
    supply, tank = a.u.supply_pressure, a.u.tank_pressure
    idle = whether(supply < p.standby_pressure) * whether(supply > p.stopped_pressure)
    missing, passed = [], [whether(v > p.passed_volume) for v in a.pair("passed")]
    for k, area in enumerate((a.actuator.head_area, -a.actuator.rod_area)):
        flow, drop, full = a.edge(k)
        by_speed = area * a.lever * a.reading(1) * (1 - a.faulty[1])
        moved, opened = ca.fmax(flow, by_speed), a.opened(k, a.pair("least")[k], -1)
        late = whether(opened * full > p.response_flow) * whether(moved < p.response * opened * full)
        waits, late = WAITING * idle * late, late * whether(drop > LEAST_DROP)
        late *= ca.if_else(a.full[k] > 0, 1, EMPTIED)
        # an open valve lets the pressure of the other side down; a motor that stands has none, and a hose
        # of a compensated section has none from the load
        returned, known = _return_edge(a, k)
        passing = whether(returned > p.response * opened * a.reference(OF_EDGES[k])) * known
        held = a.full[1 - k] * whether(a.pressures[1 - k] - tank > p.lost_pressure) * (1 - passing)
        late *= 1 - passing * a.full[k]
        low = 0
        if not a.axis.turns:
            low = whether(a.pressures[k] < p.lost_pressure) * (1 - held) * (1 - a.compensated)
        missing += [late * (1 - low), waits]
        hidden = late * low * a.sound
        found[f"hidden_{k}"] = counted(a.pair("hidden")[k], whether(hidden > 0), hidden, FORGOTTEN)
        closed = whether(a.pair("most")[k] < p.closed_command) * whether(a.pressures[k] - tank > FILLED)
        soft = [SOFT * c * ca.fabs(a.rate(2 + side)) for side, c in enumerate(a.capacitances)]
        through = ca.fmin(flow - soft[k], -a.flows[1 - k] - soft[1 - k]) - p.rest_margin
        closed *= whether(ca.fmax(*a.pressures) < a.tight)  # a relief valve passes oil, too
        counts = closed * a.sound * a.full[0] * a.full[1]
        found[f"passed_{k}"] = gathered(a.pair("passed")[k], through, counts)
    wrong = either(*missing) * a.sound
    told = either(whether(a.missing > p.response_time), *passed) * (1 - a.burst_told)
    found["missing"] = counted(a.missing, wrong, wrong, FORGOTTEN)
    return found | {"spool": latched(a.spool, told, a.u.reset)}


def _of_bursts(a: Axis) -> dict[str, Scalar]:
    p, tank, found = a.p, a.u.tank_pressure, dict[str, Scalar]()
    margin = ca.if_else(a.shut > LONG, p.rest_margin, p.burst_margin)
    still = whether(ca.fabs(a.actuator.head_area * a.lever * a.rate(0)) < p.rest_margin)
    margin = ca.if_else(still * whether(a.shut > LONGER) > 0, p.slow_margin, margin)
    for k, (flow, pressure) in enumerate(zip(a.flows, a.pressures, strict=True)):
        other, lost, burst = 1 - k, a.pair("lost")[k], a.pair("burst")[k]
        most, usable = a.opened(other, a.pair("most")[other], 1), a.sound * a.full[k]
        # what leaves it beyond the return edge; flows are behind a lag, so is the pressure
        highest = ca.fmax(pressure, getattr(a, f"late_{2 + k}"))
        outlet = p.outlet * a.reference(OF_EDGES[other]) * most
        out = outlet * a.actuator.gain * ca.sqrt(positive(highest - tank, SMALL))
        loss = -flow - out - ca.fmax(a.flows[other], 0) * whether(a.pressures[other] - tank > FILLED)
        # a relief valve that closes late: the pressure that was a moment ago
        before = pressure - ca.if_else(a.shut > LONGER, BLIND * a.rate(2 + k), 0)
        tight = ca.if_else(a.compensated > 0, ca.fmin(a.u.supply_pressure, a.tight), a.u.supply_pressure)
        counts = whether(ca.fmax(pressure, before) < tight) * usable
        emptied = whether(a.shut > LONG) * whether(pressure < p.lost_pressure) * (1 - a.compensated)
        excess = (1 + (RESTING - 1) * emptied) * (loss - margin) * counts
        # what comes through the edge into it, as open as the return edge says, and does not arrive
        (returned, known), (_, drop, full) = _return_edge(a, k), a.edge(k)
        open_by = ca.fmin(returned / a.reference(OF_EDGES[k]), a.opened(k, a.pair("most")[k], 1))
        driven = whether(a.pair("least")[k] > p.closed_command) * known * whether(drop > LEAST_DROP)
        starved = (open_by * full / p.outlet - flow) * driven
        excess = ca.fmax(excess, (starved - p.rest_margin) * usable)
        found[f"lost_{k}"] = gathered(lost, excess, either(counts, whether(starved > 0) * usable))
        loss = ca.fmax(loss, starved)
        hidden = whether(a.pair("hidden")[k] > p.response_time)
        size = ca.fmax(whether(lost > p.burst_volume) * loss, hidden * p.burst_margin)
        rise = ca.fmax(size - burst, 0) * (1 - a.spool) * a.sound
        found[f"burst_{k}"] = (rise - burst * a.u.reset) / QUICK
    return found


def _map_equation(a: Axis) -> tuple[Scalar, Equations]:
    """Weight 0 or 1, and the equation [V]."""
    p, v, late = a.p, a.actuator.valve, a.late_command
    up = whether(late > 0)
    flow, drop, full = (ca.if_else(up > 0, a, b) for a, b in zip(a.edge(0), a.edge(1), strict=True))
    filled = ca.if_else(up > 0, *a.pressures)  # at low pressure an anti-cavitation valve fills it as well
    share, size, gone = flow / full, ca.fabs(late), (late - a.trailing) / p.valve_travel
    counts = (
        whether(size > v.dead_band + 0.3)
        * whether(size < 0.95 * v.full_command)
        * whether(share > 0.02)
        * whether(share < 0.95)
        * whether(drop > ca.if_else(a.compensated > 0, p.regulated_drop, LEAST_DROP))
        * whether(filled > p.calm_pressure)
        * whether(ca.fabs(gone) > 0.9)
        * (1 - a.closed)
        * ca.if_else(up > 0, *a.full)
    )
    way = 2 * up - 1
    change = way * (a.command - late) / (2 * p.lag)
    columns = [up * size, -up, (1 - up) * size, up - 1, -way * ca.sign(gone), -change]
    return counts, [(columns, v.dead_band + share * (v.full_command - v.dead_band))]


def _return_edge(a: Axis, k: int) -> tuple[Scalar, Scalar]:
    """Opening of the return edge while chamber k is filled, and whether it is known."""
    drop = a.pressures[1 - k] - a.u.tank_pressure
    flow = -a.flows[1 - k]
    full = a.actuator.gain * ca.sqrt(positive(drop - a.actuator.hose.drop(flow), SMALL))
    return flow / full, whether(drop > LEAST_DROP) * a.full[1 - k] * (1 - a.compensated)


def _edge_equation(a: Axis) -> tuple[Scalar, Equations]:
    """Weight 0 or 1, and the equation, in tenths of the opening."""
    up, counts, sums = whether(a.late_command > 0), 0, [0, 0, 0]
    for k, way in enumerate((up, 1 - up)):
        (flow, drop, full), (outlet, known) = a.edge(k), _return_edge(a, k)
        inlet, driven = flow / full, whether(a.pair("least")[k] > a.p.closed_command)
        both = whether(drop > LEAST_DROP) * known * a.full[k] * driven
        counts += way * both * whether(inlet > 0.05) * whether(inlet < 0.95) * whether(outlet > 0.02)
        sums[k], sums[2] = 10 * way * inlet, sums[2] + 10 * way * outlet
    return counts, [(sums[:2], sums[2])]


def _mean_equation(a: Axis, name: str) -> tuple[Scalar, Equations]:
    """Weight 0 or 1, and a size of the map as an equation of its mean, by how well it is known."""
    fitted, _ = a.solved(fits(a.axis)["valve"], MAP, 0.05, 0.15)
    size, off = list(fitted)[[*MAP].index(name)]
    certain = 1 / ca.sqrt(1 + (off / MEANS[name]) ** 2)
    return _map_equation(a)[0] * whether(fitted.samples > FEWEST), [([certain], certain * size / MEANS[name])]


def _mean(a: Axis, name: str, usable: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Its size and deviation, and whether it can be told."""
    scale = MEANS[name]
    mean, _ = a.solved(fits(a.axis)[name], {"size": MAP[name] / scale}, 0.1, 1.0)
    ((size, off),) = mean
    return scale * size, scale * off, usable * whether(mean.samples > 1)


def rates(a: Axis) -> dict[str, Scalar]:
    """Of the states, and the sums of the map."""
    p, late = a.p, a.late_command
    found = {
        "late_command": (a.command - late) / (2 * p.lag),
        "trailing": play_rate(late, a.trailing, p.valve_travel, 50.0, p.valve_travel / 10),
    }
    of = fits(a.axis)
    healthy = a.sound * (1 - a.spool) * (1 - a.burst_told)
    for name, (counts, equation), between, memory in (
        ("valve", _map_equation(a), p.valve_window, p.valve_memory),
        ("edges", _edge_equation(a), p.valve_window, p.valve_memory),
        *((n, _mean_equation(a, n), p.valve_memory, p.slow_memory) for n in MEANS),
    ):
        found |= of[name].rates(a, counts * healthy / between, equation, memory)
    return found | _of_spool(a) | _of_bursts(a)


def told(a: Axis) -> dict[str, Told]:
    """A change of the map is one of the mean command of a direction, or of the hysteresis."""
    marks, fit, p = chambers_of(a.axis)[1], fits(a.axis)["valve"], a.p
    fit_edges = fits(a.axis)["edges"]
    usable = a.usable * (1 - a.spool)
    found = {m.format("burst"): shown(b, usable) for m, b in zip(marks, a.pair("burst"), strict=True)}
    found["spool"] = shown(a.spool, a.usable)
    fitted, known = a.solved(fit, MAP, 0.05, 0.15)
    enough = usable * (1 - a.burst_told) * whether(fitted.samples > FEWEST)
    limits = [*[p.valve_limit] * 4, p.hysteresis_limit]
    rows = [fit.centre(a, k) for k in (1, 1, 3, 3)] + [[0, 0, 0, 0, 1, 0]]
    for n, (size, off), row, limit in zip(MAP, fitted, rows, limits, strict=False):
        change, spread = fitted.along(*row)
        off_known = change - sum(w * r for w, r in zip(row, known, strict=True))
        off_known = off_known if n == HYSTERESIS else ca.fabs(off_known)  # less of it is no fault
        found[n] = (size, off, judged(off_known, spread, limit, enough))
    size, off, enough = _mean(a, DELAY, usable)
    found[DELAY] = (size, off, ca.if_else(enough > 0, 0, -1))  # told of all valves together
    size, off, enough = _mean(a, HYSTERESIS, usable)
    mean = (size, off, judged(size - a.reference(HYSTERESIS), off, p.hysteresis_limit, enough))
    now = found[HYSTERESIS]
    size, off, state = (ca.if_else(now[2] > 0, one, other) for one, other in zip(now, mean, strict=True))
    found[HYSTERESIS] = (size, off, state)
    edges, _ = a.solved(fit_edges, dict.fromkeys(OF_EDGES, 0.5), 0.1, 0.3)
    enough = usable * (1 - a.burst_told) * whether(edges.samples > FEWEST)
    return found | {
        n: (size, off, ca.if_else(enough > 0, 0, -1)) for n, (size, off) in zip(OF_EDGES, edges, strict=True)
    }
