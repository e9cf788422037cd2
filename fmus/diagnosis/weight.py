"""Payload by all cylinders, by Lagrange's equations with the energies T and V of the arm, behind a lag T_w:

    tau - e_0 = m e_m + sum(d_i e_i) + x_q (F sign(x') + D x' + Z) + h H    e = d(V - T)/dq + (p - p_late)/T_w

e_0 of the empty arm, e_m of a kilogram of payload, e_i of a kilogram of mass i of the arm; p = dT/dq', so no
acceleration is needed. T contains the slewing, whose centrifugal force lifts the arm. x_q = dx/dq. The tare
are the masses d_i that the arm has beyond the known ones, and the friction of its cylinders, dry F and viscous
D, with the force Z that the zeros of their pressures make. It is learned without payload. Not near the ends
of a stroke.

H is a horizontal force at the tip, with its lever h = dr/dq, r the radius of the tip. A head that swings has
one of half its weight, and it acts on all cylinders at once; so equations count less along h, by its mean
square (generalised least squares with the covariance s^2 I + H^2 h h^T). Its mean is zero, as what hangs
pulls down; if not, a pressure or an angle is wrong, or the machine stands on a slope. Gravity on a slope of a
small angle is that of an arm turned by this angle in its plane, which varies with the slewing angle s:

    H = f + k (a cos(s) + b sin(s))        k = sum(h d(e_0 + m e_m)/dq_1) / sum(h^2)

f is what is left. Without slewing they cannot be told apart, and the deviation of f says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.contract import Scalar, Subsystem, flat, nested, quantities
from fmus.controller.arm import ControlledAxis
from fmus.diagnosis.estimates import FEWEST, QUICK, Equations, Fit, Prior, States, Told, judged, whether
from fmus.diagnosis.readings import Axis
from fmus.diagnosis.unknowns import FRICTION, Unknown, masses_of, reference
from fmus.parameters import values

TORQUE, FORCE, HUNDRED = 1e4, 1e3, 100.0  # N.m, N, kg: scales
LAG = 0.25  # s, of torques: half a period of an arm on its oil; after 1.5 s less than 1 % of a change is left
SLOW = 5e-3  # m/s, over which the sign of a speed is rounded
LEFT = 0.05  # of a torque at the end of a stroke
NOISE = 200.0  # N.m, s: of a torque
CHANGED = 0.6  # hundred kg, from which a payload is another one
FOLLOWED = 20.0  # s, in which the mean square of H follows
STEADY, SWINGING = 30.0, 300.0  # N, root of that mean square: at least, and at the start
JUMPED = (
    9.0  # times the mean square: what counts of a larger force, as a payload that changes seems to be one
)
STROKE = 6.0  # lags, for which an error of the force lasts
END = 0.01  # m, from the end of a stroke
NEVER = 1e-9  # 1/s, a weight of nothing
ERROR = 5.0  # kg, what masses that are off add to a deviation: 1 % of the arm, after the tare
TARE_MEMORY = 300.0  # s, all of the healthy work from which it is learned
BALANCE_MEMORY = 30.0  # s, some strokes of the swing, which tells a slope from a sensor

Efforts = Mapping[str, tuple[Scalar, Scalar, Scalar]]  # by "empty", "payload", names of masses
OfReadings = Callable[[Any], Mapping[str, Efforts]]  # by axis


def efforts_of(manipulator: Subsystem, axes: Sequence[ControlledAxis]) -> OfReadings:
    """Efforts at each joint of the arm, by the mechanics of a machine with the values of its parameters.

    Torque d(V - T)/dq [N.m] of weight and motion, momentum dT/dq' [N.m.s], and the change of the torque of the
    weight with a turn of the arm in its plane [N.m/rad]: of the empty arm, of a kilogram of payload, and of a
    kilogram more of each of its masses.
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
            a.name: {n: tuple(now[3 * k + j, i] for j in range(3)) for i, n in enumerate(columns)}  # type: ignore[misc]
            for k, a in enumerate(arm)
        }

    return efforts


@dataclass(frozen=True)
class Balance:
    """Of one cylinder, behind the lag [N.m].

    counts    1: it is usable
    torque    beyond that of the empty arm
    columns   torque per size: payload, masses of the arm, friction
    lever     of a horizontal force at the tip [m], 0 if it does not count
    tilts     torque by a slope per rad: of the empty arm, of a kilogram of payload
    """

    counts: Scalar
    torque: Scalar
    columns: Mapping[str, Scalar]
    lever: Scalar
    tilts: tuple[Scalar, Scalar]


def balance(a: Axis, efforts: Efforts) -> Balance:
    """Of the function."""
    m, speed, columns = a.m, a.lever * a.readings[1], dict[str, Scalar]()
    stroke = getattr(a.p, a.axis.name).stroke
    blocked = m.state("blocked", "Share of the torque from a time at an end of the stroke")
    free = whether(a.position > END) * whether(a.position < stroke - END)
    m.moves("blocked", ca.if_else(free > 0, -blocked / LAG, (1 - blocked) / QUICK))
    for n, (torque, momentum, _) in efforts.items():
        late = m.lag(f"{n}_torque", torque, LAG, f"Torque of {n}, and its weight", "N.m")
        columns[n] = (
            late + (momentum - m.lag(f"{n}_momentum", momentum, LAG, f"Momentum of {n}", "N.m.s")) / LAG
        )
    shapes = a.lever * speed / ca.sqrt(speed**2 + SLOW**2), a.lever * speed, a.lever
    for n, shape in zip(FRICTION, shapes, strict=True):
        columns[f"{a.axis.name}_{n}"] = m.lag(f"late_{n}", shape, LAG, f"Torque per size of {n}")
    tilts = [
        m.lag(f"{n}_tilt", efforts[n][2], LAG, f"Torque by a slope, {n}", "N.m/rad")
        for n in ("empty", "payload")
    ]
    force = a.lever * a.actuator.force(*a.pressures)
    torque = m.lag("torque", force, LAG, "Torque of the cylinder", "N.m") - columns.pop("empty")
    counts = a.sound * a.speeds * whether(blocked < LEFT)
    lever = m.lag("late_arm", a.radial, LAG, "Lever of a horizontal force at the tip", "m")
    return Balance(counts, torque, columns, counts * lever, (tilts[0], tilts[1]))


def without_horizontal(equations: Equations, levers: Sequence[Scalar], square: Scalar) -> Equations:
    """Equations in which a horizontal force at the tip counts as little as its mean square [N2] demands."""
    length = sum(h**2 for h in levers) + 1e-9
    share = (1 - 1 / ca.sqrt(1 + square * length / NOISE**2)) / length
    h: Any = ca.vertcat(*levers)
    table = ca.vertcat(*(ca.horzcat(*c, y) for c, y in equations))
    calm = ca.densify(table - share * h @ (h.T @ table))
    rows = (ca.horzsplit(row) for row in ca.vertsplit(calm))
    return [(columns, right) for *columns, right in rows]


def weighed(
    balances: Sequence[Balance], slewing: Scalar, tare: Mapping[str, Unknown], m: States, p: Any
) -> tuple[tuple[Scalar, Scalar], dict[str, Told]]:
    """Payload with its deviation [kg]; the horizontal force, and the tare.

    slewing   angle of the column [rad]
    """
    count, several = sum(b.counts for b in balances), len(balances) > 1
    mean = m.state("horizontal_square", "Mean square of a horizontal force at the tip", "N2", SWINGING**2)
    square, levers = ca.fmax(mean, STEADY**2), [b.lever for b in balances]
    length, along = sum(h**2 for h in levers) + 1e-9, (ca.cos(slewing), ca.sin(slewing))
    of_load, of_force, of_tare = (
        Fit(m, "payload", ("mass",)),
        Fit(m, "weighing", ("f", "a", "b")),
        _of_tare(m, tare),
    )
    forces = of_force.solved(Prior((20, p.slope, p.slope), (0, 0, 0), 0.01, 0.5))
    (force, off_force), *slope = forces
    ((size, off),) = of_load.solved(Prior((20.0,), (0.0,), NOISE / TORQUE, 0.1))
    off = ca.sqrt(off**2 + (ERROR / HUNDRED) ** 2)
    tilt = sum(c * v for c, (v, _) in zip(along, slope, strict=True))

    def equations(tilt: Scalar) -> Equations:
        found = list[tuple[Sequence[Scalar], Scalar]]()
        for b in balances:
            left = b.torque - sum(reference(n, p) * b.columns.get(n.removesuffix("_off"), 0) for n in tare)
            load = b.columns["payload"] + tilt * b.tilts[1]
            found.append(
                ([b.counts * HUNDRED * load / TORQUE], b.counts * (left - tilt * b.tilts[0]) / TORQUE)
            )
        return found

    plain, calm = equations(0), without_horizontal(equations(tilt), levers, square)
    known = sum(c**2 for (c,), _ in calm) + 1e-9
    change = sum(c * y for (c,), y in calm) / known - size
    fading = (1 + change**2 / (CHANGED**2 + (NOISE / TORQUE) ** 2 / known)) / p.weighing_memory
    memory = 1 / ca.fmin(ca.if_else(count > 0, fading, 1 / p.weighing_memory), 1 / LAG)
    any_counts = whether(count > 0)
    of_load.adds(any_counts / LAG + NEVER, calm, memory, any_counts)  # fades always
    # the horizontal force, by what the payload leaves; one cylinder alone cannot tell it from a payload
    left = [TORQUE * (y - size * c) for (c,), y in plain]
    horizontal = sum(h * t for h, t in zip(levers, left, strict=True)) / length
    by_payload = sum(h * c for h, ((c,), _) in zip(levers, plain, strict=True)) * TORQUE / length
    both = whether(count > 1) if several else 0
    m.moves("horizontal_square", both * (ca.fmin(horizontal**2, JUMPED * square) - mean) / FOLLOWED)
    variance = NOISE**2 / length + (by_payload * off) ** 2
    by_tilt = sum(
        h * (b.tilts[0] + HUNDRED * size * b.tilts[1]) for h, b in zip(levers, balances, strict=True)
    )
    share = by_tilt / length / FORCE
    weight = both / (1 + variance / FORCE**2) / (STROKE * LAG)
    of_force.adds(weight, [([1, *(share * c for c in along)], horizontal / FORCE)], BALANCE_MEMORY)
    state = judged(
        FORCE * ca.fabs(force), FORCE * off_force, p.weighing_limit, whether(of_force.samples > FEWEST)
    )
    told = {"weighing": (FORCE * force, FORCE * off_force, state)}
    scales, rows = [u.prior for u in tare.values()], list[tuple[Sequence[Scalar], Scalar]]()
    for b in balances:
        columns = [b.columns.get(n.removesuffix("_off"), 0) for n in tare]
        scaled = [b.counts * s * c / TORQUE for s, c in zip(scales, columns, strict=True)]
        rows.append((scaled, b.counts * b.torque / TORQUE))
    of_tare.adds(any_counts / LAG, without_horizontal(rows, levers, square), TARE_MEMORY, count)
    return (HUNDRED * size, HUNDRED * off), told | _tare(of_tare, tare, p)


def _of_tare(m: States, tare: Mapping[str, Unknown]) -> Fit:
    return Fit(m, "tare", tuple(tare))


def _tare(fit: Fit, tare: Mapping[str, Unknown], p: Any) -> dict[str, Told]:
    """Sizes, over their priors; not known before some samples."""
    references = [reference(n, p) / u.prior for n, u in tare.items()]
    solution = fit.solved(Prior([1.0] * len(tare), references, NOISE / TORQUE, 0.1), weighed=True)
    state = ca.if_else(solution.samples > FEWEST, 0, -1)
    sized = zip(tare.items(), solution, strict=True)
    return {n: (u.prior * size, u.prior * off, state) for (n, u), (size, off) in sized}
