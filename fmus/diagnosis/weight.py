"""Payload by all cylinders, by Lagrange's equations with the energies T and V of the arm, behind a lag T_w:

    tau - e_0 = m e_m + sum(d_i e_i) + x_q (F z + D x' + Z) + h H       e = d(V - T)/dq + (p - p_late)/T_w

e_0 of the empty arm, e_m of a kilogram of payload, e_i of a kilogram of mass i of the arm; p = dT/dq', so no
acceleration is needed. T contains the slewing, whose centrifugal force lifts the arm. x_q = dx/dq. The tare
are the masses d_i that the arm has beyond the known ones, and the friction of its cylinders, dry F and
viscous D, with the force Z that the zeros of their pressures make. z' = x'/`SLIP`, between -1 and 1: a piston
slides after this way. The tare is learned without payload. Not near the ends of a stroke.

H is a horizontal force at the tip, with its lever h = dr/dq, r the radius of the tip. Equations count less
along h, by its variance (generalised least squares with the covariance s^2 I + H^2 h h^T). By the share
w = H^2/(H^2 + `SWINGING`^2) the head hangs: its motion is not that of the tip, so it tells no payload, and
counts with the one known before.

**One fit** has what is left without the tare: the payload m, a force Z_i of each cylinder that its load does
not need, and the slope a, b of the ground. Gravity on a slope of a small angle is that of an arm turned by
this angle in its plane, by a cos(s) + b sin(s) at the slewing angle s, less (a^2 + b^2)/2 of it. The payload
is kept until it changes, by more than single readings scatter: then what is known of it is forgotten, and of
the others two thirds, as it may be the begin of a fault. While nothing can be weighed it is forgotten in
`HELD`, and its deviation grows. So postures in which one payload is carried tell it from a wrong pressure: it
loads all cylinders, each by its own lever. At most one pressure is wrong, that of the largest likelihood
ratio; the payload itself is weighed with pressures that drift by no more than `DRIFT`.

**A head that hangs** (w > 1/2) pulls up and down with twice the frequency of its swing, by as much as it
weighs. Of this a window with smooth ends leaves a hundredth. A time t after a change a reading at r counts

    by (r/t)^n in the fit, then y' = (n + 2) (m - y)/t, z' = (n + 3) (y - z)/t: in all by r^n (t - r)^2

with n = `POWER` and t up to `HELD`. A change is seen behind two lags `SMOOTH`, and t falls to w `PERIOD`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca

from fmus.contract import Scalar, Subsystem, flat, nested, quantities
from fmus.controller.arm import ControlledAxis
from fmus.diagnosis.estimates import (
    FEWEST,
    QUICK,
    SAMPLING,
    Equations,
    Fit,
    States,
    Told,
    either,
    judged,
    whether,
)
from fmus.diagnosis.readings import Axis
from fmus.diagnosis.unknowns import FRICTION, Unknown, masses_of, reference
from fmus.parameters import values

TORQUE, FORCE, HUNDRED = 1e4, 1e4, 100.0  # N.m, N, kg: scales
LAG = 0.25  # s, of torques: half a period of an arm on its oil; after 1.5 s less than 1 % of a change is left
SLIP = 1e-4  # m, from rest until a piston slides, twice after a turn: shear of the lips of its seals
LEFT = 0.05  # of a torque at the end of a stroke
NOISE = 200.0  # N.m, s: of a torque
FOLLOWED = 20.0  # s, in which the variance of H follows
SWINGS = 3.0  # s, in which a head swings: a force that lasts is no scatter, but a wrong pressure or a slope
# N, root of that variance: at least, at the start, w = 1/2 (rigid 250, swinging 1500), at most: half a weight
STEADY, UNKNOWN, SWINGING, LARGEST = 30.0, 300.0, 600.0, 5e3
JUMPED = 9.0  # times the variance: what counts of a larger force, which may be a change of payload
END = 0.01  # m, from the end of a stroke
LEFT_OVER = (
    0.35  # of the deviation by single readings: by the intervals of 16 machines, which hold 93 to 98 %
)
ERROR = 5.0  # kg, what masses that are off add to a deviation: 1 % of the arm, after the tare
POWER = 4  # n: of the payload before less than a hundredth is left after 5 s
HELD = 6.0  # s, for which a payload is kept: some periods of a head that swings
PERIOD = 2.0  # s, of a head whose mass hangs 1 m below its joint: the least window
CHANGED, SCATTERS = 0.3, 2.0  # hundred kg, and deviations, from which a payload is another one
SMOOTH, FOUND = 0.4, 8.0  # s, of means in which it is seen, less than half of a period; in which they scatter
SURE = 1.5  # s, in which a payload is forgotten at that change; of a wrong pressure, until it is told
FADED = 0.05  # of a change, below which it is over
SETTLING = 0.7  # s, three lags, in which the torque of another payload comes
DRIFT, FAULT = 0.05, 10.0  # of FORCE: of a cylinder by its readings, 0.5 bar; by a wrong pressure
TARE_MEMORY = 300.0  # s, all of the healthy work from which it is learned
BALANCE_MEMORY = 30.0  # s, some strokes of the swing, which tell a slope from a sensor

Efforts = Mapping[str, tuple[Scalar, Scalar, Scalar]]  # by "empty", "payload", names of masses
OfReadings = Callable[[Any], Mapping[str, Efforts]]  # by axis


def efforts_of(manipulator: Subsystem, axes: Sequence[ControlledAxis]) -> OfReadings:
    """Efforts at each joint of the arm, by the mechanics of a machine with the values of its parameters.

    Torque d(V - T)/dq [N.m] of weight and motion, momentum dT/dq' [N.m.s], and the change of the torque of
    the weight with a turn of the arm in its plane [N.m/rad]: of the empty arm, of a kilogram of payload, and
    of a kilogram more of each of its masses.
    """
    known, arm, names = values(manipulator), [a for a in axes if not a.turns], masses_of(manipulator)
    masses, payload = ca.SX.sym("masses", len(names)), ca.SX.sym("payload")
    given = {**known.p, **dict(zip(names, ca.vertsplit(masses), strict=True))}
    p, still = nested(manipulator.parameters, given), nested(manipulator.inputs, known.u)
    inputs = [n for a in axes for n in (a.coordinate[0], a.speed[0])]
    readings = ca.SX.sym("readings", len(inputs))
    at = dict(zip(inputs, ca.vertsplit(readings), strict=True))
    rest = dict.fromkeys(quantities(manipulator.states), 0.0)
    x = nested(manipulator.states, rest | at | {"held_mass": payload})
    seen = flat(manipulator.observe(x, still, p))
    kinetic, potential, rows = seen["kinetic_energy"], seen["potential_energy"], list[Scalar]()
    for a in arm:
        q, speed, first = at[a.coordinate[0]], at[a.speed[0]], at[arm[0].coordinate[0]]
        tilt = ca.jacobian(ca.gradient(potential, q), first) if arm[0].units[0] == "rad" else 0
        rows += [ca.gradient(potential - kinetic, q), ca.gradient(kinetic, speed), tilt]
    found, loads = ca.vertcat(*rows), ca.vertcat(payload, masses)
    table = ca.horzcat(found, ca.jacobian(found, loads))  # linear in all masses
    empty = ca.vertcat(0, *(known.p[n] for n in names))
    function = ca.Function("efforts", [readings], [ca.densify(ca.substitute(table, loads, empty))])

    def efforts(u: Any) -> Mapping[str, Efforts]:
        now, columns = function(ca.vertcat(*(getattr(u, n) for n in inputs))), ("empty", "payload", *names)
        return {
            a.name: {n: tuple(now[3 * k + j, i] for j in range(3)) for i, n in enumerate(columns)}
            for k, a in enumerate(arm)
        }

    return efforts


def balance(a: Axis, efforts: Efforts) -> Mapping[str, Scalar]:
    """Of one cylinder, behind the lag [N.m]; all zero if it does not count.

    counts    1: it is usable now
    usable    1: its readings are not known to be wrong
    torque    beyond that of the empty arm
    payload, masses of the arm, friction   per size
    lever     of a horizontal force at the tip [m]
    zero      of a force of its cylinder, its lever [m]
    empty_tilt, payload_tilt   by a slope per rad: of the empty arm, of a kilogram of payload
    moving    of a kilogram of payload, by its motion alone
    """
    m, speed, columns = a.m, a.lever * a.readings[1], dict[str, Scalar]()
    stroke = getattr(a.p, a.axis.name).stroke
    blocked = m.state("blocked", "Share of the torque from a time at an end of the stroke")
    free = whether(a.position > END) * whether(a.position < stroke - END)
    m.moves("blocked", ca.if_else(free > 0, -blocked / LAG, (1 - blocked) / QUICK))
    counts = a.sound * a.speeds * whether(blocked < LEFT)

    def late(name: str, now: Scalar, text: str, unit: str = "N.m", zero: bool = False) -> Scalar:
        """Behind the lag, in the middle of a sample, where the change of a momentum over it is, too."""
        behind = m.lag(name, now, LAG, text, unit, zero)
        return counts * (behind + SAMPLING / (2 * LAG) * (now - behind))

    for n, (torque, momentum, tilt) in efforts.items():
        change = momentum - m.lag(f"{n}_momentum", momentum, LAG, f"Momentum of {n}", "N.m.s")
        moving = counts * change / LAG
        columns[n] = moving + late(f"{n}_torque", torque, f"Torque of {n}, and its weight")
        if n in ("empty", "payload"):
            columns |= {"moving": moving}
            columns[f"{n}_tilt"] = late(f"{n}_tilt", tilt, f"Torque by a slope, {n}", "N.m/rad")
    slip = m.state("slip", "Dry friction over that of a piston that slides")
    m.moves("slip", ca.fmin(ca.fmax(speed / SLIP, (-1 - slip) / QUICK), (1 - slip) / QUICK))
    shapes = a.lever * slip, a.lever * speed, a.lever
    for n, shape in zip(FRICTION, shapes, strict=True):
        text, first = f"Torque per size of {n}", n == FRICTION[0]  # of a state, at which no lag can start
        columns[f"{a.axis.name}_{n}"] = late(f"late_{n}", shape, text, "1", first)
    columns["zero"] = columns[f"{a.axis.name}_{FRICTION[2]}"]
    force = a.lever * a.actuator.force(*a.pressures)
    torque = late("torque", force, "Torque of the cylinder") - columns["empty"]
    lever = late("late_arm", a.radial, "Lever of a horizontal force at the tip", "m")
    return columns | {"counts": counts, "torque": torque, "lever": lever, "usable": a.usable}


def without_horizontal(table: Any, levers: Any, square: Scalar) -> Equations:
    """Rows of equations, the right side last, in which a horizontal force counts by its mean square [N2]."""
    length = ca.sumsqr(levers) + 1e-9
    share = (1 - 1 / ca.sqrt(1 + square * length / NOISE**2)) / length
    calm = ca.densify(table - share * levers @ (levers.T @ table))
    rows = (ca.horzsplit(row) for row in ca.vertsplit(calm))
    return [(columns, right) for *columns, right in rows]


def weighed(
    balances: Sequence[Mapping[str, Scalar]], slewing: Scalar, tare: Mapping[str, Unknown], m: States, p: Any
) -> tuple[tuple[Scalar, Scalar], dict[str, Told]]:
    """Payload with its deviation [kg]; the force of a wrong pressure, and the tare.

    slewing   angle of the column [rad]
    """
    count, cylinders = sum(b["counts"] for b in balances), len(balances)
    torque, h, empty, load, moving, empty_tilt, load_tilt, zero = (
        ca.vertcat(*(b[n] for b in balances))
        for n in ("torque", "lever", "empty", "payload", "moving", "empty_tilt", "payload_tilt", "zero")
    )
    average = m.state("horizontal_square", "Variance of a horizontal force at the tip", "N2", UNKNOWN**2)
    square = ca.fmin(ca.fmax(average, STEADY**2), LARGEST**2)
    free, noise = [(p.slope, 0), (p.slope, 0), (20.0, 0.0)], (NOISE / TORQUE, 0.1)
    of_load = Fit(m, "payload", [*((DRIFT, 0) for _ in range(cylinders)), *free], *noise, weighed=True)
    loose = [*((FAULT, 0) for _ in range(cylinders)), *free]  # the same sums by other priors
    of_fault = Fit(m, "payload", loose, *noise, rare=cylinders, signed=True, weighed=True)
    *_, (a, _), (b, _), (size, off) = of_load.sizes
    off = ca.sqrt((LEFT_OVER * off) ** 2 + (ERROR / HUNDRED) ** 2)
    # the payload, without the tare; what is known of it is forgotten at a change
    rows = ca.vertcat(*(ca.horzcat(*(b.get(n.removesuffix("_off"), 0) for n in tare)) for b in balances))
    swings, less = average / (average + SWINGING**2), (a**2 + b**2) / 2
    left = torque - rows @ ca.vertcat(*(reference(n, p) for n in tare)) + less * empty
    left -= HUNDRED * size * swings * moving
    load -= swings * moving + less * load
    tilt = empty_tilt + HUNDRED * size * load_tilt
    slopes = ca.cos(slewing) * tilt, ca.sin(slewing) * tilt
    table = ca.horzcat(FORCE * ca.diag(zero), *slopes, HUNDRED * load, left) / TORQUE
    calm, sizes = without_horizontal(table, h, square), ca.vertcat(*(v for v, _ in of_load.sizes))
    known = sum(c[-1] ** 2 for c, _ in calm) + 1e-9
    change = sum(c[-1] * (y - ca.dot(ca.vertcat(*c), sizes)) for c, y in calm) / known
    any_counts, both = whether(count > 0), whether(count > 1)
    # a change is more than the scatter of single readings, or of means
    hangs, seen, since = whether(swings > 0.5), change, m.state("since", "Time since a change", "s")
    changed, scatter = (
        m.state("changed", "1: the payload has changed; fades"),
        m.state("scatter", "Variance of means of a change"),
    )
    jumps, fresh = changed / LAG, 1 / ca.fmax(since, 0.1 * PERIOD)
    for k in range(2):
        now, seen = seen, m.state(f"seen_{k}", "Change of the payload, behind lags")
        m.moves(f"seen_{k}", any_counts * (now - seen) / SMOOTH - jumps * seen)
    least = CHANGED**2 + SCATTERS**2 * scatter * (1 + (PERIOD * fresh) ** 2)
    at_once = change**2 / (CHANGED**2 + SCATTERS**2 * of_load.solution[2] / known)
    large = ca.if_else(hangs > 0, seen**2 / least, at_once)
    m.moves("changed", ca.if_else(large > 1, (1 - changed) / QUICK, -changed / SETTLING))
    steady = any_counts * whether(changed < FADED) * whether(since > PERIOD)
    m.moves(
        "scatter", steady * (ca.fmin(seen**2, JUMPED * (scatter + (ERROR / HUNDRED) ** 2)) - scatter) / FOUND
    )
    m.moves("since", any_counts * whether(since < HELD) - jumps * ca.fmax(since - PERIOD * swings, 0))
    gone = 1 / HELD + jumps + large**2 / SURE
    gone = ca.if_else(hangs > 0, ca.if_else(any_counts > 0, POWER * fresh, 1 / HELD), gone)
    # it may be the begin of a fault, so all that was known before counts less
    memory = 1 / (1 / BALANCE_MEMORY + changed / SETTLING)
    of_load.adds(any_counts / LAG, calm, memory, any_counts, ca.fmin(gone, 0.5 / QUICK))
    payload = size
    for k in (2, 3):
        now, payload = payload, m.state(f"mean_{k}", "Mean of the payload")
        m.moves(f"mean_{k}", any_counts * (POWER + k) * fresh * (now - payload))
    payload = ca.if_else(hangs > 0, payload, size)
    # what is left is a horizontal force; one cylinder alone cannot tell it from a payload
    horizontal = TORQUE * ca.dot(h, table @ ca.vertcat(-sizes, 1)) / (ca.sumsqr(h) + 1e-9)
    lasting = m.lag("horizontal", both * horizontal, SWINGS, "Horizontal force at the tip", "N", True)
    off_mean = ca.fmin((horizontal - lasting) ** 2, JUMPED * square)
    m.moves("horizontal_square", both * (off_mean - average) / FOLLOWED)
    wrong = [(ca.fabs(FORCE * v), FORCE * d) for v, d in of_fault.sizes[:cylinders]]
    enough = whether(of_fault.samples > FEWEST)
    known = [enough * b["usable"] for b in balances]
    states = [judged(v, d, p.weighing_limit, k) for (v, d), k in zip(wrong, known, strict=True)]
    force, spread = sum(v for v, _ in wrong), ca.mmax(ca.vertcat(*(d for _, d in wrong)))
    off_force = ca.if_else(force > 0, sum(d * whether(v > 0) for v, d in wrong), spread)
    one = either(*states)
    time = m.sum("wrong_pressure", "Time for which a pressure seems to be wrong", 1, whether(one > 0))
    # at once it may be the begin of another payload; none is wrong: of all cylinders
    state = ca.if_else(one > 0, 2 * whether(time > SURE) - 1, ca.mmin(ca.vertcat(*states)))
    # the tare
    scales = [u.prior for u in tare.values()]
    priors = [(1.0, reference(n, p) / scale) for n, scale in zip(tare, scales, strict=True)]
    of_tare = Fit(m, "tare", priors, NOISE / TORQUE, 0.1, weighed=True)
    table = ca.horzcat(rows @ ca.diag(ca.vertcat(*scales)), torque) / TORQUE
    of_tare.adds(any_counts / LAG, without_horizontal(table, h, square), TARE_MEMORY, count)
    known = whether(of_tare.samples > FEWEST) - 1
    sized = zip(tare, scales, of_tare.sizes, strict=True)
    told = {n: (scale * v, scale * d, known) for n, scale, (v, d) in sized}
    return (HUNDRED * payload, HUNDRED * off), told | {"weighing": (force, off_force, state)}
