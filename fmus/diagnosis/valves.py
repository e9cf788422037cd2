"""The map of the valve of one function, in motion, and its edges.

**Edges.** The opening of the return edge, by its flow and drop, over that of the edge into the other chamber
depends on the valve alone, neither on commands nor on hysteresis: e of each direction. Healthy valves keep
it to a tenth. Not of compensated sections, whose counterbalance valves are in series.

**Map.** The flow into the chamber that is filled, the drop over its edge and the hose in series give the
opening, and this the command v that a healthy valve needs for it:

    a = q/(K sqrt(dP - dp(q))), of a compensated section q/q_0        v = D + a (U - D)
    v = s |u| - d - h m - T |u|'

with the drop dp of the hose, warm or cold (`hose.Friction`), which the return edge has in series, too, the
command u behind the lag of the readings, its gain s, the dead band D + d, half the hysteresis h, the sign m
of its last change and a lag T; s and d of each direction. It counts if u has moved on by `TRAVEL` since it
turned, the edge is open, no anti-cavitation valve is, and the drop over it is not small. Of compensated
sections the least drop of all that are open counts: they share the flow of a pump that cannot give more. Gain
and dead band are judged together, by the mean of v over all samples of a direction. The lag is a mean over a
minute of motion, since a filter clogs slowly; the hysteresis is told by such a mean, too. Samples that are
`valve_memory` apart count as independent.
"""

from __future__ import annotations

from itertools import product

import casadi as ca

from fmus.components.play import play_rate
from fmus.contract import Scalar
from fmus.diagnosis.estimates import FEWEST, Equations, Fit, Prior, Solution, Told, judged, whether
from fmus.diagnosis.losses import CALM
from fmus.diagnosis.readings import LEAST_DROP, Axis
from fmus.diagnosis.unknowns import EDGES, MAP, of_axis

TRAVEL = 0.8  # V, command after a reversal from which a valve follows: 8 % of full command
REGULATED = 1.8e6  # Pa, drop from which a compensated section holds its flow: 0.9 of the margin of the pump
WINDOW = 0.15  # s, in which the command is one sample: five lags
SLOW_MEMORY = 60.0  # s, a minute of work
HYSTERESIS, DELAY = MAP[4:]
MEANS = {HYSTERESIS: 0.1, DELAY: 0.01}  # V, s: deviation that is one sample of a mean
APART = tuple((f"{n}_up", f"{m}_down") for n, m in product(("gain", "dead_band"), repeat=2))


def command_of(a: Axis) -> None:
    """The command behind the lag of the readings, and behind a play."""
    a.late_command = a.m.lag("late_command", a.command, 2 * a.p.lag, "Command", "V")
    a.trailing = a.m.state("trailing", "That behind a play", "V", a.command)
    a.m.moves("trailing", play_rate(a.late_command, a.trailing, TRAVEL, 50.0, TRAVEL / 10))


def _map_equation(a: Axis) -> tuple[Scalar, Equations]:
    """Weight 0 or 1, and the equation [V]."""
    v, late = a.actuator.valve, a.late_command
    up = whether(late > 0)
    flow, drop, full = (
        ca.if_else(up > 0, one, other) for one, other in zip(a.edge(0), a.edge(1), strict=True)
    )
    filled = ca.if_else(up > 0, *a.pressures)  # at low pressure an anti-cavitation valve fills it as well
    share, size, gone = flow / full, ca.fabs(late), (late - a.trailing) / TRAVEL
    counts = (
        whether(size > v.dead_band + 0.3)
        * whether(size < 0.95 * v.full_command)
        * whether(share > 0.02)
        * whether(share < 0.95)
        * whether(drop > ca.if_else(a.compensated > 0, REGULATED, LEAST_DROP))
        * whether(filled > CALM)
        * whether(ca.fabs(gone) > 0.9)
        * (1 - a.closed)
        * ca.if_else(up > 0, *a.full)
    )
    way = 2 * up - 1
    change = way * (a.command - late) / (2 * a.p.lag)
    columns = [up * size, -up, (1 - up) * size, up - 1, -way * ca.sign(gone), -change]
    return counts, [(columns, v.dead_band + share * (v.full_command - v.dead_band))]


def _edge_equation(a: Axis) -> tuple[Scalar, Equations]:
    """Weight 0 or 1, and the equation, in tenths of the opening."""
    up, counts, sums = whether(a.late_command > 0), 0, [0, 0, 0]
    for k, way in enumerate((up, 1 - up)):
        (flow, drop, full), (outlet, known) = a.edge(k), a.return_edge(k)
        inlet, driven = flow / full, whether(a.least[k] > a.p.closed_command)
        both = whether(drop > LEAST_DROP) * known * a.full[k] * driven
        counts += way * both * whether(inlet > 0.05) * whether(inlet < 0.95) * whether(outlet > 0.02)
        sums[k], sums[2] = 10 * way * inlet, sums[2] + 10 * way * outlet
    return counts, [(sums[:2], sums[2])]


def valve(a: Axis) -> dict[str, Told]:
    """A change of the map is one of the mean command of a direction, or of the hysteresis."""
    p, m = a.p, a.m
    own = {n.removeprefix(f"{a.axis.name}_"): u for n, u in of_axis(a.axis).items()}

    def solved(fit: Fit, names: tuple[str, ...], least: float, rough: float) -> Solution:
        known = [a.reference(n) for n in names]
        return fit.solved(Prior([own[n].prior for n in names], known, least, rough))

    healthy = a.sound * (1 - a.spool.value) * (1 - a.burst_told)
    usable = a.usable * (1 - a.spool.value)
    of_map, of_edges = Fit(m, "valve", MAP, APART), Fit(m, "edges", EDGES, (EDGES,))
    for fit, (counts, equations) in ((of_map, _map_equation(a)), (of_edges, _edge_equation(a))):
        fit.adds(counts * healthy / WINDOW, equations, p.valve_memory)
    fitted, edges = solved(of_map, MAP, 0.05, 0.15), solved(of_edges, EDGES, 0.1, 0.3)
    enough, references = whether(fitted.samples > FEWEST), [a.reference(n) for n in MAP]
    certain = usable * (1 - a.burst_told) * enough
    limits = [*[p.valve_limit] * 4, p.hysteresis_limit]
    rows = [of_map.centre(k) for k in (1, 1, 3, 3)] + [[0, 0, 0, 0, 1, 0]]
    told = dict[str, Told]()
    for n, (size, off), row, limit in zip(MAP, fitted, rows, limits, strict=False):
        change, spread = fitted.along(*row)
        change -= sum(w * r for w, r in zip(row, references, strict=True))
        change = change if n == HYSTERESIS else ca.fabs(change)  # less of it is no fault
        told[n] = size, off, judged(change, spread, limit, certain)
    now, counts = told[HYSTERESIS], _map_equation(a)[0] * enough * healthy / p.valve_memory
    for n, scale in MEANS.items():
        size, off = [*fitted][MAP.index(n)]
        weight, fit = 1 / ca.sqrt(1 + (off / scale) ** 2), Fit(m, f"mean_{n}", ("size",))
        fit.adds(counts, [([weight], weight * size / scale)], SLOW_MEMORY)
        ((size, off),) = fit.solved(Prior((own[n].prior / scale,), (a.reference(n) / scale,), 0.1, 1.0))
        size, off, known = scale * size, scale * off, usable * whether(fit.samples > 1)
        told[n] = size, off, ca.if_else(known > 0, 0, -1)  # the lag is told of all valves together
        if n == HYSTERESIS:
            told[n] = size, off, judged(size - a.reference(n), off, p.hysteresis_limit, known)
    either_way = (ca.if_else(now[2] > 0, *pair) for pair in zip(now, told[HYSTERESIS], strict=True))
    told[HYSTERESIS] = tuple(either_way)  # type: ignore[assignment]
    known = usable * (1 - a.burst_told) * whether(edges.samples > FEWEST)
    return told | {n: (*one, ca.if_else(known > 0, 0, -1)) for n, one in zip(EDGES, edges, strict=True)}
