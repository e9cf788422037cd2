"""Payload by all cylinders, by Lagrange's equations with the energies T and V of the arm, behind a lag T_w:

    tau - e_0 = m e_m + sum(d_i e_i) + x_q (F sign(x') + D x' + Z) + h H    e = d(V - T)/dq + (p - p_late)/T_w

e_0 of the empty arm, e_m of a kilogram of payload, e_i of a kilogram of mass i of the arm; p = dT/dq', so no
acceleration is needed. x_q = dx/dq. The tare are the masses d_i that the arm has beyond the known ones, and
the friction of its cylinders, dry F and viscous D, with the force Z that the
zeros of their pressures make. It is learned without payload. Not near the ends of a
stroke.

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

from fmus.contract import Quantity, Scalar, Subsystem, flat, nested, quantities
from fmus.controller.arm import Arm, ControlledAxis
from fmus.diagnosis.axis import Axis, Effort, Efforts, Finding
from fmus.diagnosis.estimates import FEWEST, QUICK, Equations, Fit, Prior, Solution, Told, judged, whether
from fmus.diagnosis.settings import number
from fmus.parameters import values

TORQUE = 1e4  # N.m, scale of torques
HUNDRED = 100.0  # kg, scale of weights
FORCE, DAMPING = 1e3, 1e4  # N, N.s/m, scales of friction
SLOW = 5e-3  # m/s, over which the sign of a speed is rounded
LEFT = 0.05  # of a torque at the end of a stroke
NOISE = 200.0  # N.m, s: of a torque
CHANGED = 0.6  # hundred kg, from which a payload is another one
FOLLOWED = 20.0  # s, in which the mean square of H follows
STEADY, SWINGING = 30.0, 300.0  # N, root of that mean square: at least, and at the start
JUMP = 9.0  # times the mean square: what counts of a larger force, as a payload that changes seems to be one
THOUSAND = 1e3  # N, scale of H, and its deviation that is one sample
STROKE = 6.0  # lags, for which an error of the force lasts
END = 0.01  # m, from the end of a stroke
NEVER = 1e-9  # 1/s, a weight of nothing
FRICTION = ("dry_friction", "damping", "zero_force")

PAYLOAD, WEIGHING = Fit("payload", ("mass",)), Fit("weighing", ("force", "pitch", "roll"))
TILTED = ("empty", "payload")  # whose torque a slope changes

OfReadings = Callable[[Any], Mapping[str, Efforts]]  # by axis


def masses_of(manipulator: Subsystem) -> list[str]:
    """Masses of the arm."""
    return [n for n, q in quantities(manipulator.parameters).items() if q.unit == "kg"]


def _of_loads(axis: ControlledAxis, loads: Mapping[str, str]) -> dict[str, Quantity]:
    """States of loads, from words for each: torque and momentum."""
    found = dict[str, Quantity]()
    for n, text in loads.items():
        per = "" if n == "empty" else "/kg"
        for kind, unit in (("torque", f"N.m{per}"), ("momentum", f"N.m.s{per}")):
            what = f"{kind.capitalize()} of {text}, behind the lag: {axis.name}"
            found[f"{n}_{kind}"] = Quantity(unit, what, TORQUE)
    return found


def states(axis: ControlledAxis) -> dict[str, Quantity]:
    """Torques and momenta behind the lag, without those of `Tare.states`."""
    if axis.turns:
        return {}
    rows = (
        *((f"{n}_tilt", "N.m", f"Torque by a slope, {n}, per rad, behind the lag", TORQUE) for n in TILTED),
        ("torque", "N.m", "Torque of the cylinder, behind the lag", TORQUE),
        ("late_dry_friction", "m", "Lever with the sign of the speed, behind the lag", 1.0),
        ("late_damping", "m2/s", "Lever times the speed of the piston, behind the lag", 1.0),
        ("late_zero_force", "m", "Lever of the piston, behind the lag", 1.0),
        ("late_arm", "m", "Lever of a horizontal force at the tip, behind the lag", 1.0),
        ("blocked", "1", "Share of the torque from a time at an end of the stroke", 1.0),
    )
    found = {n: Quantity(unit, f"{text}: {axis.name}", size) for n, unit, text, size in rows}
    return found | _of_loads(axis, {"empty": "the empty arm", "payload": "a kilogram of payload"})


def efforts_of(manipulator: Subsystem, axes: Sequence[ControlledAxis]) -> OfReadings:
    """From the mechanics of a machine, with the values of its parameters."""
    known, arm, names = values(manipulator), [a for a in axes if not a.turns], masses_of(manipulator)
    masses = ca.SX.sym("masses", len(names))
    given = {**known.p, **dict(zip(names, ca.vertsplit(masses), strict=True))}
    p, still = nested(manipulator.parameters, given), nested(manipulator.inputs, known.u)
    rest = dict.fromkeys(quantities(manipulator.states), 0.0)
    inputs = [n for a in axes for n in (a.coordinate[0], a.speed[0])]
    readings, payload = ca.SX.sym("readings", len(inputs)), ca.SX.sym("payload")
    at = dict(zip(inputs, ca.vertsplit(readings), strict=True))
    x = nested(manipulator.states, rest | at | {"held_mass": payload})
    seen = flat(manipulator.observe(x, still, p))
    kinetic, potential, rows = seen["kinetic_energy"], seen["potential_energy"], list[Scalar]()
    first = arm[0].coordinate[0]
    for a in arm:
        tilt = ca.jacobian(ca.gradient(potential, at[a.coordinate[0]]), at[first])
        rows += [
            ca.gradient(potential - kinetic, at[a.coordinate[0]]),
            ca.gradient(kinetic, at[a.speed[0]]),
            tilt if arm[0].units[0] == "rad" else 0,
        ]
    loads = ca.vertcat(payload, masses)
    found = ca.vertcat(*rows)
    table = ca.horzcat(found, ca.jacobian(found, loads))  # linear in all masses
    empty = ca.vertcat(0, *(known.p[n] for n in names))
    function = ca.Function("efforts", [readings], [ca.densify(ca.substitute(table, loads, empty))])

    def efforts(u: Any) -> Mapping[str, Efforts]:
        now = function(ca.vertcat(*(getattr(u, n) for n in inputs)))
        columns = ("empty", "payload", *names)
        return {
            a.name: {n: Effort(*(now[3 * k + j, i] for j in range(3))) for i, n in enumerate(columns)}
            for k, a in enumerate(arm)
        }

    return efforts


def start(a: Axis) -> dict[str, Scalar]:
    """States at the readings."""
    if a.axis.turns:
        return {}
    speed = a.lever * a.reading(1)
    found: dict[str, Scalar] = {
        "torque": a.lever * a.actuator.force(*a.pressures),
        "late_dry_friction": a.lever * speed / ca.sqrt(speed**2 + SLOW**2),
        "late_damping": a.lever * speed,
        "late_zero_force": a.lever,
        "late_arm": a.radial,
    }
    for n, effort in a.effort.items():
        found |= {f"{n}_torque": effort.torque, f"{n}_momentum": effort.momentum}
    return found | {f"{n}_tilt": a.effort[n].tilt for n in TILTED}


def column(a: Axis, name: str) -> Scalar:
    """Torque behind the lag: of weights and motion, or of friction and zeros per their sizes."""
    if name in FRICTION:
        return getattr(a, f"late_{name}")
    return (
        getattr(a, f"{name}_torque")
        + (a.effort[name].momentum - getattr(a, f"{name}_momentum")) / a.p.weighing_lag
    )


def balance(a: Axis) -> tuple[Scalar, Scalar]:
    """Torque beyond that of the empty arm [N.m], and whether it counts."""
    return a.torque - column(a, "empty"), a.sound * a.speeds * whether(a.blocked < LEFT)


def rates(a: Axis) -> dict[str, Scalar]:
    """Lags."""
    if a.axis.turns:
        return {}
    p, lag = a.p, a.p.weighing_lag
    found = {n: (v - getattr(a, n)) / lag for n, v in start(a).items()}
    stroke = getattr(p, a.axis.name).stroke
    free = whether(a.position > END) * whether(a.position < stroke - END)
    found["blocked"] = ca.if_else(free > 0, -a.blocked / lag, (1 - a.blocked) / QUICK)
    return found


@dataclass(frozen=True)
class Load:
    """What hangs at the tip, by all cylinders at one instant.

    axes      those with cylinders
    x, p      states and parameters of the diagnosis
    slewing   those with motors
    """

    axes: Sequence[Axis]
    x: Any
    p: Any
    slewing: Sequence[Axis] = ()

    @staticmethod
    def states() -> dict[str, Quantity]:
        """The mean square of H; the sums are those of `PAYLOAD` and `WEIGHING`."""
        text = "Mean square of a horizontal force at the tip"
        return {"horizontal_square": Quantity("N2", text, THOUSAND**2, minimum=0.0)}

    @property
    def _balances(self) -> list[tuple[Scalar, Scalar]]:
        return [balance(a) for a in self.axes]

    @property
    def count(self) -> Scalar:
        """How many cylinders count."""
        return sum(counts for _, counts in self._balances)

    @property
    def levers(self) -> list[Scalar]:
        """h of each cylinder [m], 0 of one that does not count."""
        return [c * a.late_arm for a, (_, c) in zip(self.axes, self._balances, strict=True)]

    def _slope(self) -> tuple[Scalar, Scalar]:
        """Parts of a slope in the plane of the arm: cosine and sine of the slewing angle."""
        angle = next((a.reading(0) for a in self.slewing), 0)
        return ca.cos(angle), ca.sin(angle)

    def equations(self, tilt: Scalar) -> Equations:
        """Of the payload, in hundred kg, for each cylinder; all zero of one that does not count.

        tilt   of the arm by a slope [rad]
        """
        found = list[tuple[Sequence[Scalar], Scalar]]()
        for a, (torque, counts) in zip(self.axes, self._balances, strict=True):
            for n in list(a.effort)[2:]:  # masses of the arm
                torque -= number(f"{n}_off", self.p) * column(a, n)
            for n in FRICTION:
                torque -= number(f"{a.axis.name}_{n}", self.p) * column(a, n)
            torque -= tilt * a.empty_tilt
            load = column(a, "payload") + tilt * a.payload_tilt
            found.append(([counts * HUNDRED * load / TORQUE], counts * torque / TORQUE))
        return found

    def without_horizontal(self, equations: Equations) -> Equations:
        """Equations in which a horizontal force at the tip counts as little as its size demands."""
        levers, square = self.levers, ca.fmax(self.x.horizontal_square, STEADY**2)
        length = sum(h**2 for h in levers) + 1e-9
        share = (1 - 1 / ca.sqrt(1 + square * length / NOISE**2)) / length

        h: Any = ca.vertcat(*levers)
        table = ca.vertcat(*(ca.horzcat(*c, y) for c, y in equations))
        calm = ca.densify(table - share * h @ (h.T @ table))
        rows = (ca.horzsplit(row) for row in ca.vertsplit(calm))
        return [(columns, right) for *columns, right in rows]

    def rates(self) -> dict[str, Scalar]:
        """Of the sums, and of the mean square of H."""
        x, p, lag, count = self.x, self.p, self.p.weighing_lag, self.count
        along = self._slope()
        _, *parts = self._forces().sizes
        plain = self.equations(0)
        calm = self.without_horizontal(self.equations(sum(c * v for c, v in zip(along, parts, strict=True))))
        known = sum(c**2 for (c,), _ in calm) + 1e-9
        size, off = self._payload()
        change = sum(c * y for (c,), y in calm) / known - size
        fading = (1 + change**2 / (CHANGED**2 + (NOISE / TORQUE) ** 2 / known)) / p.weighing_memory
        memory = 1 / ca.fmin(ca.if_else(count > 0, fading, 1 / p.weighing_memory), 1 / lag)
        any_counts = whether(count > 0)
        found = PAYLOAD.rates(x, any_counts / lag + NEVER, calm, memory, any_counts)  # fades always
        levers, left = self.levers, [TORQUE * (y - size * c) for (c,), y in plain]
        length = sum(h**2 for h in levers) + 1e-9
        force = sum(h * t for h, t in zip(levers, left, strict=True)) / length
        by_payload = sum(h * c for h, ((c,), _) in zip(levers, plain, strict=True)) * TORQUE / length
        several = whether(count > 1)  # one cylinder alone cannot tell it from a payload
        square = ca.fmin(force**2, JUMP * ca.fmax(x.horizontal_square, STEADY**2))
        found["horizontal_square"] = several * (square - x.horizontal_square) / FOLLOWED
        variance = NOISE**2 / length + (by_payload * off) ** 2
        weight = several / (1 + variance / THOUSAND**2) / (STROKE * lag)
        by_tilt = (a.empty_tilt + HUNDRED * size * a.payload_tilt for a in self.axes)
        share = sum(h * t for h, t in zip(levers, by_tilt, strict=True)) / length / THOUSAND
        columns = [1, *(share * c for c in along)]
        return found | WEIGHING.rates(x, weight, [(columns, force / THOUSAND)], p.balance_memory)

    def _forces(self) -> Solution:
        """Mean of H [kN], and the slope [rad]."""
        return WEIGHING.solved(self.x, Prior((20, *[self.p.slope] * 2), (0, 0, 0), 0.01, 0.5))

    def _payload(self) -> tuple[Scalar, Scalar]:
        """In hundred kg."""
        prior = Prior((20.0,), (0.0,), NOISE / TORQUE, 0.1)
        ((size, off),) = PAYLOAD.solved(self.x, prior)
        return size, ca.sqrt(off**2 + (self.p.weighing_error / HUNDRED) ** 2)

    def payload(self) -> tuple[Scalar, Scalar]:
        """With its deviation [kg]."""
        size, off = self._payload()
        return HUNDRED * size, HUNDRED * off

    def weighing(self) -> Told:
        """Mean of H [N]."""
        fitted = self._forces()
        size, off = (THOUSAND * v for v in next(iter(fitted)))
        told = whether(fitted.samples > FEWEST)
        return size, off, judged(ca.fabs(size), off, self.p.weighing_limit, told)


@dataclass(frozen=True)
class Tare:
    """Masses of an arm beyond the known ones, and friction of its cylinders; learned without payload.

    cylinders   names of their axes
    masses      names of the masses
    known       the masses [kg]
    damping     viscous friction of the cylinders in the mechanics [N.s/m]
    """

    cylinders: tuple[str, ...]
    masses: tuple[str, ...]
    known: tuple[float, ...]
    damping: tuple[float, ...]

    @staticmethod
    def of(arm: Arm, manipulator: Subsystem) -> Tare:
        """Of a machine."""
        masses, p = masses_of(manipulator), values(manipulator).p
        cylinders = tuple(a.name for a in arm.axes if not a.turns)
        damping = tuple(float(p.get(f"{n}_piston_damping", 0.0)) for n in cylinders)
        return Tare(cylinders, tuple(masses), tuple(float(p[n]) for n in masses), damping)

    def states(self, axis: ControlledAxis) -> dict[str, Quantity]:
        """Of an axis: torques and momenta of the masses behind the lag."""
        loads = {n: f"a kilogram more of {n}" for n in self.masses}
        return {} if axis.turns else _of_loads(axis, loads)

    @property
    def findings(self) -> dict[str, Finding]:
        """Gauges: no size of them is a fault."""
        found = {
            f"{n}_off": Finding("kg", f"{n.replace('_', ' ').capitalize()} beyond the known one", 1.0, "tare")
            for n in self.masses
        }
        for a in self.cylinders:
            found[f"{a}_dry_friction"] = Finding("N", f"Dry friction of the {a} cylinder", 30.0, "tare")
            found[f"{a}_damping"] = Finding("N.s/m", f"Viscous friction of the {a} cylinder", DAMPING, "tare")
            found[f"{a}_zero_force"] = Finding("N", f"Force by zeros of the {a} pressures", FORCE, "tare")
        return found

    @property
    def references(self) -> dict[str, float]:
        """If no healthy machine was measured."""
        known = zip(self.cylinders, self.damping, strict=True)
        return dict.fromkeys(self.findings, 0.0) | {f"{n}_damping": d for n, d in known}

    @property
    def fit(self) -> Fit:
        """Of all of them."""
        return Fit("tare", tuple(self.findings))

    @property
    def _scales(self) -> list[float]:
        return [HUNDRED] * len(self.masses) + [FORCE, DAMPING, FORCE] * len(self.cylinders)

    def rates(self, load: Load) -> dict[str, Scalar]:
        """Of the sums; an equation of each cylinder."""
        equations, p = list[tuple[Sequence[Scalar], Scalar]](), load.p
        for a in load.axes:
            torque, counts = balance(a)
            columns = [column(a, n) for n in self.masses]
            for name in self.cylinders:
                columns += [column(a, n) if name == a.axis.name else 0 for n in FRICTION]
            scaled = [counts * s * c / TORQUE for s, c in zip(self._scales, columns, strict=True)]
            equations.append((scaled, counts * torque / TORQUE))
        calm, count = load.without_horizontal(equations), load.count
        return self.fit.rates(load.x, whether(count > 0) / p.weighing_lag, calm, p.tare_memory, count)

    def told(self, x: Any, p: Any) -> dict[str, Told]:
        """Sizes; not known before some samples."""
        deviations = [
            *(max(0.1 * m, 1.0) for m in self.known),
            *[2 * FORCE, 3 * DAMPING, 3 * FORCE] * len(self.cylinders),
        ]
        prior = Prior(
            [d / s for d, s in zip(deviations, self._scales, strict=True)],
            [number(n, p) / s for n, s in zip(self.findings, self._scales, strict=True)],
            NOISE / TORQUE,
            0.1,
        )
        solution = self.fit.solved(x, prior, weighed=True)
        told = ca.if_else(solution.samples > FEWEST, 0, -1)
        sized = zip(self.findings, solution, self._scales, strict=True)
        return {n: (s * size, s * off, told) for n, (size, off), s in sized}
