"""The map of the valve of one function, in motion, and its edges.

**Edges.** The opening of the return edge, by its flow and drop, over that of the edge into the other chamber
depends on the valve alone, neither on commands nor on hysteresis: e of each direction. Healthy valves keep
it to a tenth. Not of compensated sections, whose counterbalance valves are in series.

**Map.** The flow into the chamber that is filled, the drop over its edge and the hose in series give the
opening, and this the command v that a healthy valve needs for it:

    a = q sqrt(1 + Q_t/q)/(K sqrt(dP - f dp(q))), of a compensated section q/q_0        v = D + a (U - D)
    v = s |u| - d - h m - T |u|'

with the flow Q_t at which an edge turns laminar (orifice.py), 2 to 4 % of q with oil of -8 degC, the drop dp
of the hose, warm or cold (`hose.Friction`), which the return edge has in series, too, the command u behind
the lag of the readings, its gain s, the dead band D + d, half the hysteresis h, the sign m of its last change
and a lag T; s and d of each direction. f is the share of the hose that lies between valve and sensor; v is
linear in it. Strokes of one temperature hardly tell it from s and d, so priors count by the scatter that v
turns out to have. A sample counts if u has moved on by `TRAVEL` since it turned, the edge is open, no anti-
cavitation valve is, and the drop over it is not small. It counts less by the error of v that the largest zero
p_0 of a sensor makes, a (U - D) p_0/(2 (dP - f dp)): v is off by half of the share of a pressure in the drop.
Of compensated sections the least drop of all that are open counts: they share the flow of a pump that cannot
give more. They do not count while the pump is at its highest pressure, where its margin is gone.

Gain and dead band are judged together, by the mean of v over all samples of a direction. What is wrong in a
single stroke may be its model, so it is a fault in the second stroke at whose end it is one. The lag is a
mean over a minute of motion, since a filter clogs slowly. Samples that are `MEMORY` apart count as
independent.
"""

from __future__ import annotations

import math

import casadi as ca

from fmus.contract import Scalar
from fmus.diagnosis.estimates import FEWEST, QUICK, Equations, Fit, Told, judged, whether
from fmus.diagnosis.losses import CALM
from fmus.diagnosis.readings import LEAST_DROP, PRESSURE, TRAVEL, Axis
from fmus.diagnosis.unknowns import EDGES, LITRE, MAP, of_axis

REGULATED = 1.8e6  # Pa, drop from which a compensated section holds its flow: 0.9 of the margin of the pump
CUT_OFF = 0.95  # of the nominal supply pressure, from which a load-sensing pump has no margin for certain
ROUGH = 0.15  # V, deviation of the command of an opening
WHOLE = 1.0  # of the drop over the edge, up to which that of a hose counts in linear terms
TRANSITION = 10.0  # Reynolds number of an edge at which both laws cross: 9.6 to 15.6, see orifice.py
WINDOW = 0.15  # s, in which the command is one sample: five lags
MEMORY = 2.0  # s of motion, over which older readings fade: some ten strokes
SLOW_MEMORY = 60.0  # s, a minute of work
HYSTERESIS, HOSE, DELAY = MAP[4:]
STROKES = 2  # of one direction
DELAYS = 0.01  # s, deviation that is one sample of the mean lag


def _map_equation(a: Axis, healthy: Scalar) -> tuple[Scalar, Equations]:
    """Weight 0 to 1, and the equation [V]; zeros of pressures count where the drop is small."""
    v, late = a.actuator.valve, a.late_command
    up = whether(late > 0)
    flow, drop, full, hose, nearness = (
        ca.if_else(up > 0, one, other) for one, other in zip(a.edge(0), a.edge(1), strict=True)
    )
    filled = ca.if_else(up > 0, *a.pressures)  # at low pressure an anti-cavitation valve fills it as well
    share, size, gone = flow / full, ca.fabs(late), (late - a.trailing) / TRAVEL
    size_of = ca.sqrt(math.pi / 4 * v.area * ca.fmax(share, 0))
    laminar = TRANSITION * a.p.kinematic_viscosity * size_of * (1 - a.compensated)  # Q_t
    share *= ca.sqrt(1 + laminar / ca.fmax(flow, LITRE))
    counts = (
        whether(size > v.dead_band + 0.3)
        * whether(size < 0.95 * v.full_command)
        * whether(share > 0.02)
        * whether(share < 0.95)
        * whether(hose < WHOLE)
        * whether(drop > ca.if_else(a.compensated > 0, REGULATED, LEAST_DROP))
        * whether(filled > CALM)
        * (1 - a.compensated * whether(a.u.supply_pressure > CUT_OFF * a.p.nominal_supply_pressure))
        * whether(ca.fabs(gone) > 0.9)
        * (1 - a.closed)
        * ca.if_else(up > 0, *a.full)
    )
    way = 2 * up - 1
    change = way * (a.command - late) / (2 * a.p.lag)
    opened = share * (v.full_command - v.dead_band)
    more = opened * hose / 2  # by all of the friction of the hose
    by_pressure = opened * nearness / 2
    counts *= healthy
    counts /= 1 + (by_pressure * a.p.zero_limit / PRESSURE / ROUGH) ** 2
    columns = [up * size, -up, (1 - up) * size, up - 1, -way * ca.sign(gone), -more, -change]
    right = v.dead_band + opened - a.reference(HOSE) * more
    expected = sum(c * a.reference(n) for c, n in zip(columns, MAP, strict=True))
    a.compared = counts, opened, nearness, right - expected
    return counts, [(columns, right)]


def _edge_equation(a: Axis) -> tuple[Scalar, Equations]:
    """Weight 0 or 1, and the equation, in tenths of the opening."""
    up, counts, sums = whether(a.late_command > 0), 0, [0, 0, 0]
    for k, way in enumerate((up, 1 - up)):
        (flow, drop, full, *_), (outlet, known) = a.edge(k), a.return_edge(k)
        inlet, driven = flow / full, whether(a.least[k] > a.p.closed_command)
        both = whether(drop > LEAST_DROP) * known * a.full[k] * driven
        counts += way * both * whether(inlet > 0.05) * whether(inlet < 0.95) * whether(outlet > 0.02)
        sums[k], sums[2] = 10 * way * inlet, sums[2] + 10 * way * outlet
    return counts, [(sums[:2], sums[2])]


def _confirmed(a: Axis, name: str, state: Scalar, ended: Scalar) -> Scalar:
    """A fault is told after `STROKES` at whose end it was one: what is wrong in one stroke is its model."""
    strokes, fault = a.m.state(f"strokes_{name}", f"Strokes in a row that tell {name}"), whether(state > 0)
    a.m.moves(f"strokes_{name}", ended * (fault - (1 - fault) * strokes) / QUICK)
    return ca.if_else(strokes > STROKES - 0.5, state, ca.fmin(state, 0))


def valve(a: Axis) -> dict[str, Told]:
    """A change of the map is one of the mean command of a direction, or of the hysteresis."""
    p, m, unknowns, told = a.p, a.m, of_axis(a.axis), dict[str, Told]()
    priors = {n: (unknowns[f"{a.axis.name}_{n}"].prior, a.reference(n)) for n in (*MAP, *EDGES)}
    of_map = Fit(m, "valve", [priors[n] for n in MAP], 0.05, ROUGH, weighed=True)
    of_edges = Fit(m, "edges", [priors[n] for n in EDGES], 0.1, 0.3)
    healthy, usable = a.sound * (1 - a.spool) * (1 - a.burst_told), a.usable * (1 - a.spool)
    counts, equations = _map_equation(a, healthy)
    of_map.adds(counts / WINDOW, equations, MEMORY)
    enough = whether(of_map.samples > FEWEST)
    up, sizes = whether(a.trailing > 0), dict(zip(MAP, of_map.sizes, strict=True))
    for names, row, limit, way in (
        (MAP[:2], of_map.centre(1), p.valve_limit, up),
        (MAP[2:4], of_map.centre(3), p.valve_limit, 1 - up),
        (MAP[4:5], [int(n == HYSTERESIS) for n in MAP], p.hysteresis_limit, 1),
    ):
        row[MAP.index(HOSE)] = 0  # a nuisance
        change, spread = of_map.along(*row)
        change -= sum(w * priors[n][1] for w, n in zip(row, MAP, strict=True))
        change = change if HYSTERESIS in names else ca.fabs(change)  # less of it is no fault
        state = judged(change, spread, limit, usable * (1 - a.burst_told) * enough)
        state = _confirmed(a, names[0], state, a.stopped * way)
        told |= {n: (*sizes[n], state) for n in names}
    told[HOSE] = *sizes[HOSE], whether(usable * enough) - 1
    # the lag as a mean, by how well it is known; it is told of all valves together
    (size, off), (prior, known) = sizes[DELAY], priors[DELAY]
    certain = 1 / ca.sqrt(1 + (off / DELAYS) ** 2)
    of_delay = Fit(m, "mean", [(prior / DELAYS, known / DELAYS)], 0.1, 1)
    weight = counts * enough / MEMORY
    of_delay.adds(weight, [([certain], certain * size / DELAYS)], SLOW_MEMORY)
    ((size, off),) = of_delay.sizes
    told[DELAY] = DELAYS * size, DELAYS * off, whether(usable * of_delay.samples > 1) - 1
    counts, equations = _edge_equation(a)
    of_edges.adds(counts * healthy / WINDOW, equations, MEMORY)
    state = whether(usable * (1 - a.burst_told) * of_edges.samples > FEWEST) - 1
    return told | {n: (*one, state) for n, one in zip(EDGES, of_edges.sizes, strict=True)}
