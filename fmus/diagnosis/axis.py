"""What is broken in one function of a machine. Neither masses nor loads are needed but for the weight.

The oil in a chamber follows from its piston and its pressure alone:

    q = A x' + C P'                      flow into a chamber, with the opposite sign of A for the rod side

**Leaks**, from `settling` after a valve has closed and while no relief, counterbalance or anti-cavitation
valve of the chamber is open. c is the leakage of the closed valve, g that of the seals, k = C_d A sqrt(2/rho)
that of an opening of area A to the outside, s the share of air in the volume V, which has the volume a(P) at a
pressure. Each rest, and each part of a long one, is one equation of each chamber, over its time:

    int c (P_s + P_t - 2 P_h) - q_h dt = g int P_h - P_r dt + k_h int sqrt(P_h) dt - s V [a(P_h)]
    int c (P_s + P_t - 2 P_r) - q_r dt = -g int P_h - P_r dt + k_r int sqrt(P_r) dt - s V [a(P_r)]

g, k_h and k_r are not negative. g is that of the oil as it is now. An equation is uncertain by the readings at
both ends, by a flow, and by the capacitance times the change of the pressure. The air is told from an own fit
with a longer memory.

**Valve**, in motion. The flow into the chamber that is filled, the drop over its edge and the hose in series
give the opening, and this the command v that a healthy valve needs for it:

    a = q/(K sqrt(dP - C_R q^2)), of a compensated section q/q_0        v = D + a (U - D)
    v = s |u| - d - h m - T |u|'

with the command u behind the lag of the readings, its gain s, the dead band D + d, half the hysteresis h, the
sign m of its last change and a lag T; s and d of each direction. It counts if u has moved on by
`valve_travel` since it turned, the edge is open, and its drop is no small one. Gain and dead band are judged
together, by the mean of v over all samples of a direction.

**Spool.** It does not follow if the flow stays below `response` of the least that the commands of the last
time ask for, if a load-sensing pump stands by although they ask for flow, or if oil passes the closed valve,
in on one side and out on the other.

**Burst.** What a chamber loses beyond what its valve can let out, unless the other side gains it:

    -q - `outlet` K a(u) sqrt(P - P_t) - `burst_margin`        P < P_s: no relief valve is open

u: the largest command of the last time. The margin falls after a while at rest, so a leak is found that
empties a chamber before its size is known. A chamber at less than `lost_pressure` that does not fill although
its valve is open has a burst hose, too.

**Sensors.** A reading outside of its range; one that stands still while another one of the function says that
it should not. What has no reading, or a wrong one, is not examined.

**Weight**, of cylinders, by Lagrange's equations with the energies T and V of the arm, behind the lag T_w:

    tau - d(V - T)/dq - (p - p_late)/T_w = m (the same of a kilogram of payload)        p = dT/dq'

The momentum p needs no acceleration. Not near the ends of a stroke.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from fmus.components.chamber import ATMOSPHERE
from fmus.components.play import play_rate
from fmus.components.spool_valve import opening
from fmus.contract import Quantity, Scalar, Subsystem, flat, nested, quantities
from fmus.controller.arm import ControlledAxis
from fmus.controller.valve import Actuator
from fmus.diagnosis.estimates import (
    FEWEST,
    QUICK,
    Equations,
    Fit,
    Prior,
    Solution,
    Told,
    counted,
    either,
    gathered,
    judged,
    latched,
    shown,
    whether,
)
from fmus.diagnosis.settings import LITRE, OF_VALVE, REFERENCES
from fmus.parameters import values
from fmus.smooth import positive

PRESSURE = 1e7  # Pa, scale of pressures in the normal equations
TORQUE = 1e4  # N.m, scale of torques
HUNDRED = 100.0  # kg, scale of weights
SMALL = 1e4  # Pa, over which the root of a pressure is rounded
LEAST_DROP = 1e6  # Pa, over an edge whose flow tells its opening
EMPTY = 0.0  # Pa, below which a chamber may be empty: at -1 bar, with a zero that is off
FILLED = 2e5  # Pa above the return line, in a chamber that oil flows into
BLIND = 0.1  # s, for which flows are not known after a chamber was empty
END = 0.01  # m, from the end of a stroke
LONG, LONGER = 0.6, 1.5  # s, after which a chamber is at rest, and its arm as well
SHORTEST, PART = 0.15, 1.0  # s, a rest that counts, and a part of a long one
STILL = (1e-5, 1e-6, 2e3, 2e3)  # rad, rad/s, Pa: distance from its lag at which a reading stands still
MOVES = 0.015  # rad/s, at which a joint moves: five times the noise of angle and speed
LIVELY = 5e3  # Pa, from the lag of a pressure that changes
EMPTIED = 0.25  # of the same, of an empty chamber: it has to be filled first
WAITING = 0.4  # of the time without response, if the pump waits: it needs longer than a valve
EXPONENT = 1.4  # of the air

# prior standard deviations: a seal that is gone [L/min at 100 bar]; a valve that is another one; foam
LEAKS = {"seal": 10.0, "head": 10.0, "rod": 10.0, "air": 0.02}  # in L/min at 100 bar
FEWEST_RESTS = 3.0  # equations, from which a leak is told
VALVE = dict(zip(OF_VALVE, (0.5, 0.5, 0.5, 0.5, 1.0, 0.1), strict=True))
APART = frozenset(
    frozenset((f"{n}_up", f"{m}_down")) for n in ("gain", "dead_band") for m in ("gain", "dead_band")
)
SEAL, AIR = "seal_leakage", "air"


@dataclass(frozen=True)
class Effort:
    """Of a joint: torque d(V - T)/dq [N.m] of weight and motion, and momentum dT/dq' [N.m.s]."""

    torque: Scalar
    momentum: Scalar


Efforts = Callable[[Any], Mapping[str, tuple[Effort, Effort]]]
"""Readings -> axis: the empty arm, and what a kilogram of payload adds."""


@dataclass(frozen=True)
class Finding:
    """What may be broken: an output of its size, one of its deviation, one of its state.

    unit, text, nominal   of the size
    repair                what a mechanic looks at
    """

    unit: str
    text: str
    nominal: float
    repair: str


def findings_of(axis: ControlledAxis) -> dict[str, Finding]:
    """Of an axis, by name; the order is that of `Axis.told`."""
    ends = ("line A", "line B") if axis.turns else ("the head side", "the rod side")
    marks = ("{}_a", "{}_b") if axis.turns else ("head_{}", "rod_{}")
    leaks = [
        ("leak", "m2", "Opening to the outside at", 1e-6),
        ("burst", "m3/s", "Loss beyond that of the valve at", 1e-3),
    ]
    found = (
        {}
        if axis.turns
        else {SEAL: Finding("m3/(s.Pa)", "Leakage past the seals of the {}", 1e-12, "{} seals")}
    )
    for kind, unit, text, nominal in leaks:
        for mark, end in zip(marks, ends, strict=True):
            found[mark.format(kind)] = Finding(unit, f"{text} {end} of the {{}}", nominal, "{} hose")
    texts = (
        "Gain of the positive {} command",
        "Dead band of the positive {} command, more than known",
        "Gain of the negative {} command",
        "Dead band of the negative {} command, more than known",
        "Half of the hysteresis of the {} valve",
        "Lag of the {} valve with that of the readings",
    )
    found["spool"] = Finding("1", "1: the {} spool does not follow its command", 1.0, "{} valve")
    for name, text, unit in zip(OF_VALVE, texts, ("1", "V", "1", "V", "V", "s"), strict=True):
        found[name] = Finding(unit, text, 0.1, "{} valve")
    if not axis.turns:
        found[AIR] = Finding("1", "Share of undissolved air in the oil of the {}", 0.01, "air")
        found["weight"] = Finding("kg", "Payload by the {}", 100.0, "pressure sensors of the {}")
    for name in signals_of(axis):
        found[f"{name}_sensor"] = Finding("1", f"1: the reading of {name} is wrong", 1.0, f"{name} sensor")
    return {
        n if n.endswith("_sensor") else f"{axis.name}_{n}": replace(
            f, text=f.text.format(axis.name), repair=f.repair.format(axis.name)
        )
        for n, f in found.items()
    }


def signals_of(axis: ControlledAxis) -> tuple[str, ...]:
    """Readings of an axis: coordinate, speed, both pressures."""
    return (axis.coordinate[0], axis.speed[0], axis.sides[0][0], axis.sides[1][0])


def fits_of(axis: ControlledAxis) -> dict[str, Fit]:
    """By name, without that of the axis."""
    found = {"leaks": tuple(LEAKS), "valve": tuple(VALVE)} | (
        {} if axis.turns else {"trapped": (AIR,), "weight": ("mass",)}
    )
    return {
        n: Fit(f"{axis.name}_{n}", columns, APART if n == "valve" else frozenset())
        for n, columns in found.items()
    }


def states_of(axis: ControlledAxis) -> dict[str, Quantity]:
    """Filters, clocks, latches and sums."""
    found, units = dict[str, Quantity](), (*axis.units, "Pa", "Pa")
    for k, (n, unit) in enumerate(zip(signals_of(axis), units, strict=True)):
        found[f"late_{k}"] = Quantity(unit, f"{n} behind the lag", 1e7 if unit == "Pa" else 1.0)
        found[f"still_{k}"] = Quantity("s", f"Time for which {n} stands still although it should change")
        found[f"bad_{k}"] = Quantity("1", f"1: the reading of {n} is wrong")
    for k, (of, end) in enumerate((("m3", "head side or line A"), ("m3", "rod side or line B"))):
        for n, unit, text in (
            ("missing_oil", of, "Oil that left in another way than through the closed valve, in this rest"),
            ("pressed", "Pa", "Change of its pressure in this rest"),
            ("spoiled", "1", "1: another valve was open at the begin of this rest"),
            ("most", "V", "Largest command that fills it, of the last time"),
            ("least", "V", "Least command that fills it, of the last time"),
            ("void", "s", "Time since it was empty, counted down"),
            ("passed", of, "Oil that came through the closed valve"),
            ("lost", of, "Oil lost beyond its valve"),
            ("hidden", "s", "Time for which it does not fill although its valve is open"),
            ("burst", "m3/s", "Largest loss beyond its valve"),
        ):
            found[f"{n}_{k}"] = Quantity(
                unit, f"{text}: {end} of the {axis.name}", {"V": 10.0, "Pa": 1e7, "1": 1.0}.get(unit, 1e-3)
            )
    for n, unit, text in (
        ("rest", "s", "Length of this rest, or of its present part"),
        ("difference", "Pa.s", "Integral of the difference of both pressures over this rest"),
        ("root_0", "1", "Integral of the root of the first pressure over this rest"),
        ("root_1", "1", "Integral of the root of the second pressure over this rest"),
        ("shut", "s", "Time for which the valve is closed, limited"),
        ("usable", "1", "1: the readings are usable"),
        ("rated", "1", "1: those of all speeds are"),
        ("missing", "s", "Time for which the valve does not follow"),
        ("spool", "1", "1: the spool does not follow"),
        ("late_command", "V", "Command behind the lag"),
        ("trailing", "V", "That behind a play of `valve_travel`"),
        *(
            ()
            if axis.turns
            else (
                ("torque", "N.m", "Torque less that of the empty arm, behind the lag"),
                ("momentum", "N.m.s", "Momentum of the empty arm, behind the lag"),
                ("mass_torque", "N.m/kg", "Torque per payload, behind the lag"),
                ("mass_momentum", "N.m.s/kg", "Momentum per payload, behind the lag"),
            )
        ),
    ):
        found[n] = Quantity(
            unit, f"{text}: {axis.name}", {"N.m": TORQUE, "N.m.s": TORQUE, "V": 10.0}.get(unit, 1.0)
        )
    sums = (n for fit in fits_of(axis).values() for n in fit.states)
    return {f"{axis.name}_{n}": q for n, q in found.items()} | {
        n: Quantity("1", f"Sum of normal equations: {n}") for n in sums
    }


def efforts_of(manipulator: Subsystem, axes: Sequence[ControlledAxis]) -> Efforts:
    """From the mechanics of a machine, with the values of its parameters."""
    known, arm = values(manipulator), [a for a in axes if not a.turns]
    p, still = nested(manipulator.parameters, known.p), nested(manipulator.inputs, known.u)
    rest = dict.fromkeys(quantities(manipulator.states), 0.0)
    names = [n for a in axes for n in (a.coordinate[0], a.speed[0])]
    readings, mass = ca.SX.sym("readings", len(names)), ca.SX.sym("mass")
    at = dict(zip(names, ca.vertsplit(readings), strict=True))
    x = nested(manipulator.states, rest | at | {"held_mass": mass})
    seen = flat(manipulator.observe(x, still, p))
    kinetic, rows = seen["kinetic_energy"], list[Scalar]()
    for a in arm:
        weight = ca.gradient(seen["potential_energy"] - kinetic, at[a.coordinate[0]])
        rows += [weight, ca.gradient(kinetic, at[a.speed[0]])]
    function = ca.Function("efforts", [readings, mass], [ca.vertcat(*rows)])

    def efforts(u: Any) -> Mapping[str, tuple[Effort, Effort]]:
        now = ca.vertcat(*(getattr(u, n) for n in names))
        empty, loaded = (ca.vertsplit(function(now, m)) for m in (0, 1))
        pairs = [(e, one - e) for e, one in zip(empty, loaded, strict=True)]
        return {
            a.name: (
                Effort(pairs[2 * k][0], pairs[2 * k + 1][0]),
                Effort(pairs[2 * k][1], pairs[2 * k + 1][1]),
            )
            for k, a in enumerate(arm)
        }

    return efforts


def air_volume(pressure: Scalar) -> Scalar:
    """Of air at a gauge pressure [Pa], over that at the atmosphere."""
    return (ATMOSPHERE / ca.fmax(pressure + ATMOSPHERE, 0.1 * ATMOSPHERE)) ** (1 / EXPONENT)


@dataclass(frozen=True)
class Axis:
    """One axis at one instant.

    lever    dx/dq
    lines    1: the readings of both lines are usable
    speeds   1: those of all speeds are
    effort   of the empty arm, and of a kilogram of payload
    """

    axis: ControlledAxis
    actuator: Actuator
    position: Scalar
    lever: Scalar
    x: Any
    u: Any
    p: Any
    lines: Scalar
    speeds: Scalar
    effort: tuple[Effort, Effort]

    def __getattr__(self, name: str) -> Any:
        """A state of the axis."""
        return getattr(self.x, f"{self.axis.name}_{name}")

    def pair(self, name: str) -> tuple[Scalar, Scalar]:
        """States of both chambers."""
        return getattr(self, f"{name}_0"), getattr(self, f"{name}_1")

    # ---- readings

    def reading(self, k: int) -> Scalar:
        """Coordinate, speed, pressures."""
        return getattr(self.u, signals_of(self.axis)[k])

    @property
    def command(self) -> Scalar:
        """To the valve [V]."""
        return getattr(self.u, f"{self.axis.name}_command")

    @property
    def pressures(self) -> tuple[Scalar, Scalar]:
        """Head, rod [Pa]."""
        return self.reading(2), self.reading(3)

    def behind(self, k: int) -> Scalar:
        """Distance of a reading from its lag."""
        return self.reading(k) - getattr(self, f"late_{k}")

    def rate(self, k: int) -> Scalar:
        """Of a reading, behind the lag."""
        return self.behind(k) / self.p.lag

    @property
    def outside(self) -> list[Scalar]:
        """1: a reading is out of its range; a coordinate, which may count turns, jumps."""
        p = self.p
        far = [
            whether(ca.fabs(self.behind(0)) > p.largest_jump),
            whether(ca.fabs(self.reading(1)) > p.largest_speed),
        ]
        return far + [outside(v, p) for v in self.pressures]

    @property
    def stands(self) -> list[tuple[Scalar, Scalar]]:
        """Of each reading: 1 if it stands still; 1 if another one says that it should not."""
        outside, differ = self.outside, whether(ca.fabs(self.rate(0) - self.reading(1)) > MOVES)
        turns = whether(ca.fabs(self.reading(1)) > MOVES) * (1 - outside[1])
        goes = whether(ca.fabs(self.rate(0)) > MOVES) * (1 - outside[0])
        changes = [turns * differ, goes * differ]
        for k in (2, 3):  # an empty chamber has a constant pressure
            changes.append(whether(ca.fabs(self.behind(5 - k)) > LIVELY) * whether(self.reading(k) > EMPTY))
        still = (whether(ca.fabs(self.behind(k)) < width) for k, width in enumerate(STILL))
        return list(zip(still, changes, strict=True))

    @property
    def faulty(self) -> list[Scalar]:
        """1: a reading is not to be used."""
        return [
            either(out, getattr(self, f"bad_{k}"), 1 - getattr(self.p, f"{n}_fitted"))
            for k, (n, out) in enumerate(zip(signals_of(self.axis), self.outside, strict=True))
        ]

    @property
    def sound(self) -> Scalar:
        """1: coordinate, pressures and lines are usable."""
        angle, _, head, rod = self.faulty
        return self.lines * (1 - either(angle, head, rod))

    # ---- oil

    @property
    def compensated(self) -> Scalar:
        """1: its valve is a compensated section."""
        return whether(self.actuator.section_flows[0] > 0)

    @property
    def flows(self) -> tuple[Scalar, Scalar]:
        """Into both chambers, behind the lag [m3/s]."""
        a, speed = self.actuator, self.lever * self.rate(0)
        return (
            a.head_area * speed + a.head_capacitance * self.rate(2),
            -a.rod_area * speed + a.rod_capacitance * self.rate(3),
        )

    @property
    def full(self) -> list[Scalar]:
        """1: the oil of a chamber follows from its pressure, and has for a while."""
        return [
            whether(void < BLIND) * (1 - self._blind(v))
            for void, v in zip(self.pair("void"), self.pressures, strict=True)
        ]

    def _blind(self, pressure: Scalar) -> Scalar:
        """1: a chamber is empty, or its sensor at the end of its range."""
        return either(whether(pressure < EMPTY), whether(pressure > self.p.highest_reading))

    @property
    def closed(self) -> Scalar:
        """1: the command closes the valve."""
        return whether(ca.fabs(self.command) < self.p.closed_command)

    @property
    def calm(self) -> list[Scalar]:
        """1: no relief or anti-cavitation valve of a chamber is open at its pressure, and nothing pushes the arm."""
        low, high = self.p.calm_pressure, self.p.nominal_supply_pressure
        pushed = whether(ca.fabs(self.actuator.head_area * self.lever * self.rate(0)) > self.p.burst_margin)
        return [whether(v > low) * whether(v < high) * (1 - pushed) for v in self.pressures]

    def _edge(self, direction: int) -> tuple[Scalar, Scalar, Scalar]:
        """Of the chamber that is filled: flow, drop over the edge, and flow at full opening [m3/s]."""
        a, flow = self.actuator, self.flows[direction]
        drop = self.u.supply_pressure - self.pressures[direction]
        inside = positive(drop - a.hose_resistance * flow * ca.fabs(flow), SMALL)
        full = ca.if_else(self.compensated > 0, a.section_flows[direction], a.gain * ca.sqrt(inside))
        return flow, drop, full

    def _opened(self, direction: int, command: Scalar, sign: int) -> Scalar:
        """Largest (sign 1) or least (-1) opening at a command, by the healthy machine."""
        v, way = self.actuator.valve, ("up", "down")[direction]
        names = f"gain_{way}", f"dead_band_{way}", "half_hysteresis"
        gain, band, half = (self._reference(n) for n in names)
        moved = gain * command - band + sign * (half + self.p.valve_margin)
        return ca.fmin(opening(moved, v.dead_band, v.full_command, v.command_rounding), 1)

    # ---- equations

    @property
    def _resting(self) -> tuple[Scalar, Scalar]:
        """1: this rest goes on; 1: it ends now, and counts."""
        spoils = either(*((1 - c) * (1 - before) for c, before in zip(self.calm, self.pair("spoiled"), strict=True)))
        settling = self.p.settling + self.compensated * (self.p.holding - self.p.settling)
        begun, whole = whether(self.rest > 0), self.closed * self.sound * whether(self.shut > settling)
        goes_on = whole * (1 - spoils * begun) * whether(self.rest < PART)
        return goes_on, (1 - goes_on) * whether(self.rest > SHORTEST) * self.usable * (1 - self.spool)

    def _leak_equations(self) -> tuple[Equations, Scalar]:
        """Losses of both chambers in this rest, over their uncertainty; how many count."""
        p, a, found, count = self.p, self.actuator, [], 0
        for k, (oil, pressed, spoiled, end) in enumerate(
            zip(self.pair("missing_oil"), self.pair("pressed"), self.pair("spoiled"), (2, 3), strict=True)
        ):
            late, c = getattr(self, f"late_{end}"), (a.head_capacitance, a.rod_capacitance)[k]
            air = c * p.bulk_modulus * (air_volume(late) - air_volume(late - pressed))
            off = ca.sqrt(p.end_volume**2 + (p.rest_flow * self.rest) ** 2 + (p.softness * c * pressed) ** 2)
            scale, sign = (1 - spoiled) / off, 1 - 2 * k
            through = [sign * self.difference / PRESSURE, (1 - k) * self.root_0, k * self.root_1, -air / LITRE]
            found.append(([scale * LITRE * v for v in through], scale * oil))
            count += 1 - spoiled
        return found, count

    def _of_rest(self) -> dict[str, Scalar]:
        """Sums over a rest, forgotten at its end."""
        goes_on, p = self._resting[0], self.p
        leakage = ca.if_else(self.compensated > 0, 0, self.actuator.valve.leakage)
        level = self.u.supply_pressure + self.u.tank_pressure
        growth: dict[str, Scalar] = {"rest": 1, "difference": self.pressures[0] - self.pressures[1]}
        for k, (flow, v) in enumerate(zip(self.flows, self.pressures, strict=True)):
            growth[f"missing_oil_{k}"] = leakage * (level - 2 * v) - flow
            growth[f"pressed_{k}"] = self.rate(2 + k)
            growth[f"root_{k}"] = ca.sqrt(positive(v, SMALL) / PRESSURE)
        found = {n: ca.if_else(goes_on > 0, v, -getattr(self, n) / QUICK) for n, v in growth.items()}
        for k, (calm, spoiled) in enumerate(zip(self.calm, self.pair("spoiled"), strict=True)):
            found[f"spoiled_{k}"] = ca.if_else(goes_on * whether(self.rest > 0) > 0, 0, (1 - calm - spoiled) / QUICK)
        return found

    def _valve_equation(self) -> tuple[Scalar, Equations]:
        """Weight 0 or 1, and the equation [V]."""
        p, v, late = self.p, self.actuator.valve, self.late_command
        up = whether(late > 0)
        flow, drop, full = (
            ca.if_else(up > 0, a, b) for a, b in zip(self._edge(0), self._edge(1), strict=True)
        )
        share, size, gone = flow / full, ca.fabs(late), (late - self.trailing) / p.valve_travel
        counts = (
            whether(size > v.dead_band + 0.3)
            * whether(size < 0.95 * v.full_command)
            * whether(share > 0.02)
            * whether(share < 0.95)
            * whether(drop > LEAST_DROP)
            * whether(ca.fabs(gone) > 0.9)
            * (1 - self.closed)
            * ca.if_else(up > 0, *self.full)
        )
        way = 2 * up - 1
        change = way * (self.command - late) / (2 * p.lag)
        columns = [up * size, -up, (1 - up) * size, up - 1, -way * ca.sign(gone), -change]
        return counts, [(columns, v.dead_band + share * (v.full_command - v.dead_band))]

    # ---- rates

    def rates(self) -> dict[str, Scalar]:
        """Of the states."""
        p, fits = self.p, fits_of(self.axis)
        found = (
            self._of_sensors() | self._of_oil() | self._of_commands() | self._of_spool() | self._of_bursts()
        )
        ends, (leaks, count) = self._resting[1], self._leak_equations()
        gone = {n: QUICK / (1 - ca.exp(-self.rest / m)) for n, m in (("leaks", p.memory), ("trapped", p.air_memory))}
        sums = fits["leaks"].rates(self.x, ends / QUICK, leaks, gone["leaks"], count)
        counts, equation = self._valve_equation()
        counts *= self.sound * (1 - self.spool) * (1 - self._burst)
        sums |= fits["valve"].rates(self.x, counts / p.valve_window, equation, p.valve_memory)
        if not self.axis.turns:
            alone = [(columns[3:], right) for columns, right in leaks]
            sums |= fits["trapped"].rates(self.x, ends / QUICK, alone, gone["trapped"], count)
            found |= self._of_weight()
            stroke = getattr(self.p, self.axis.name).stroke
            free = whether(self.position > END) * whether(self.position < stroke - END)
            (empty, mass), lag = self.effort, p.weighing_lag
            force = self.torque - (empty.momentum - self.momentum) / lag
            per_mass = self.mass_torque + (mass.momentum - self.mass_momentum) / lag
            weighed = [([HUNDRED * per_mass / TORQUE], force / TORQUE)]
            counts = self.sound * self.speeds * free / lag
            sums |= fits["weight"].rates(self.x, counts, weighed, p.weighing_memory)
        return {f"{self.axis.name}_{n}": rate for n, rate in found.items()} | sums

    def _of_weight(self) -> dict[str, Scalar]:
        """Torques and momenta behind the lag."""
        (empty, mass), now = self.effort, self.lever * self.actuator.force(*self.pressures)
        late = {
            "torque": now - empty.torque,
            "momentum": empty.momentum,
            "mass_torque": mass.torque,
            "mass_momentum": mass.momentum,
        }
        return {n: (v - getattr(self, n)) / self.p.weighing_lag for n, v in late.items()}

    def weighing_start(self) -> dict[str, Scalar]:
        """Of the same."""
        (empty, mass), now = self.effort, self.lever * self.actuator.force(*self.pressures)
        momenta = {"momentum": empty.momentum, "mass_momentum": mass.momentum}
        return momenta | {"torque": now - empty.torque, "mass_torque": mass.torque}

    def _of_sensors(self) -> dict[str, Scalar]:
        found = {"usable": (self.sound - self.usable) / QUICK, "rated": (self.speeds - self.rated) / QUICK}
        signals = signals_of(self.axis)
        for k, (n, (still, changed), out) in enumerate(zip(signals, self.stands, self.outside, strict=True)):
            clock, bad = getattr(self, f"still_{k}"), getattr(self, f"bad_{k}")
            found[f"late_{k}"] = self.rate(k)
            found[f"still_{k}"] = counted(clock, still, changed)
            wrong = either(out, whether(clock > self.p.still_time)) * getattr(self.p, f"{n}_fitted")
            found[f"bad_{k}"] = latched(bad, wrong, self.u.reset)
        return found

    def _of_oil(self) -> dict[str, Scalar]:
        found = self._of_rest()
        for k, (void, pressure) in enumerate(zip(self.pair("void"), self.pressures, strict=True)):
            falling = ca.if_else(void > 0, -1, 0)
            found[f"void_{k}"] = ca.if_else(self._blind(pressure) > 0, (2 * BLIND - void) / QUICK, falling)
        found["shut"] = counted(self.shut, self.closed * self.sound, whether(self.shut < 2 * LONGER))
        return found

    def _of_commands(self) -> dict[str, Scalar]:
        late = self.late_command
        found = {
            "late_command": (self.command - late) / (2 * self.p.lag),
            "trailing": play_rate(late, self.trailing, self.p.valve_travel, 50.0, self.p.valve_travel / 10),
        }
        for k, sign in enumerate((1, -1)):
            now, most, least = sign * self.command, self.pair("most")[k], self.pair("least")[k]
            found[f"most_{k}"] = (now - most) / ca.if_else(now > most, QUICK, self.p.closing)
            found[f"least_{k}"] = (now - least) / ca.if_else(now < least, QUICK, self.p.closing)
        return found

    def _of_spool(self) -> dict[str, Scalar]:
        p, a, found = self.p, self.actuator, dict[str, Scalar]()
        supply, tank = self.u.supply_pressure, self.u.tank_pressure
        idle = whether(supply < p.standby_pressure) * whether(supply > p.stopped_pressure)
        missing, passed = [], [whether(v > p.passed_volume) for v in self.pair("passed")]
        speed = ca.fabs(self.reading(1)) * (1 - self.faulty[1])
        for k, area in enumerate((a.head_area, -a.rod_area)):
            flow, drop, full = self._edge(k)
            by_speed = area * self.lever * self.reading(1) * (1 - self.faulty[1])
            moved, opened = ca.fmax(flow, by_speed), self._opened(k, self.pair("least")[k], -1)
            asked = p.response * opened * full * whether(drop > LEAST_DROP)
            late = whether(asked > p.response * p.response_flow) * whether(moved < asked)
            late *= ca.if_else(self.full[k] > 0, 1, EMPTIED * whether(speed < MOVES))
            # an open valve lets the pressure of the other side down; a motor that stands has none, and a hose
            # of a compensated section has none from the load
            held = self.full[1 - k] * whether(self.pressures[1 - k] - tank > p.lost_pressure)
            low = 0
            if not self.axis.turns:
                low = whether(self.pressures[k] < p.lost_pressure) * (1 - held) * (1 - self.compensated)
            waits = WAITING * idle * whether(opened > 0) * whether(moved < p.response_flow)
            missing += [late * (1 - low), waits]
            hidden = late * low * self.sound
            found[f"hidden_{k}"] = counted(self.pair("hidden")[k], whether(hidden > 0), hidden)
            closed = whether(self.pair("most")[k] < p.closed_command) * whether(
                self.pressures[k] - tank > FILLED
            )
            through = ca.fmin(flow, -self.flows[1 - k]) - p.rest_margin
            counts = closed * self.sound * self.full[0] * self.full[1]
            found[f"passed_{k}"] = gathered(self.pair("passed")[k], through, counts)
        wrong = either(*missing) * self.sound
        told = either(whether(self.missing > p.response_time), *passed) * (1 - self._burst)
        found["missing"] = counted(self.missing, wrong, wrong)
        return found | {"spool": latched(self.spool, told, self.u.reset)}

    @property
    def _burst(self) -> Scalar:
        """1: a hose is burst."""
        return whether(ca.fmax(*self.pair("burst")) > 0)

    def _of_bursts(self) -> dict[str, Scalar]:
        p, tank, found = self.p, self.u.tank_pressure, dict[str, Scalar]()
        margin = ca.if_else(self.shut > LONG, p.rest_margin, p.burst_margin)
        margin = ca.if_else(self.shut > LONGER, p.slow_margin, margin)
        for k, (flow, pressure) in enumerate(zip(self.flows, self.pressures, strict=True)):
            other, lost, burst = 1 - k, self.pair("lost")[k], self.pair("burst")[k]
            most = self._opened(other, self.pair("most")[other], 1)
            out = p.outlet * self.actuator.gain * most * ca.sqrt(positive(pressure - tank, SMALL))
            loss = (
                -flow - out - ca.fmax(self.flows[other], 0) * whether(self.pressures[other] - tank > FILLED)
            )
            before = pressure - ca.if_else(self.shut > LONGER, BLIND * self.rate(2 + k), 0)  # a relief valve closes late
            counts = whether(ca.fmax(pressure, before) < self.u.supply_pressure) * self.sound * self.full[k]
            found[f"lost_{k}"] = gathered(lost, loss - margin, counts)
            hidden = whether(self.pair("hidden")[k] > p.response_time)
            size = ca.fmax(whether(lost > p.burst_volume) * loss, hidden * p.burst_margin)
            rise = ca.fmax(size - burst, 0) * (1 - self.spool) * self.sound
            found[f"burst_{k}"] = (rise - burst * self.u.reset) / QUICK
        return found

    # ---- what is told

    def _solved(
        self, fit: str, least: float, rough: float, positive: int = 0
    ) -> tuple[Solution, list[Scalar]]:
        """Of a fit; and its references."""
        columns = {
            "leaks": LEAKS,
            "valve": VALVE,
            "trapped": {AIR: LEAKS["air"]},
            "weight": {"weight": 20.0},
        }[fit]
        known = [self._reference(n) if n in REFERENCES else 0 for n in columns]
        prior = Prior([*columns.values()], known, least, rough)
        return fits_of(self.axis)[fit].solved(self.x, prior, positive), known

    def _reference(self, name: str) -> Scalar:
        """Of the healthy machine."""
        return getattr(self.p, f"{self.axis.name}_{name}_reference", 0)

    def told(self) -> dict[str, Told]:
        """Of each finding of the axis."""
        p, a, names = self.p, self.actuator, list(findings_of(self.axis))
        usable, jet = self.usable * (1 - self.spool), a.gain / a.valve.area * math.sqrt(PRESSURE)
        whole = usable * (1 - self._burst)
        leaks, _ = self._solved("leaks", 1.0, 2.0, 3)
        known = whole * whether(leaks.samples > FEWEST_RESTS)
        scales = (LITRE / PRESSURE, LITRE / jet, LITRE / jet)
        found = [
            (scale * size, scale * off, judged(size, off, p.leak_limit / LITRE, known))
            for (size, off), scale in zip(leaks, scales, strict=False)
        ]
        found = found[1:] if self.axis.turns else found
        found += [shown(burst, usable) for burst in self.pair("burst")]
        found += [shown(self.spool, self.usable), *self._of_valve(whole)]
        if not self.axis.turns:
            found += [self._of_air(usable), (*self.weight(), ca.if_else(self.weighable > 0, 0, -1))]
        for k, n in enumerate(signals_of(self.axis)):
            found.append(shown(getattr(self, f"bad_{k}"), getattr(p, f"{n}_fitted")))
        return dict(zip(names, found, strict=True))

    def _of_valve(self, usable: Scalar) -> list[Told]:
        p, (fitted, known) = self.p, self._solved("valve", 0.05, 0.15)
        told, found = usable * whether(fitted.samples > FEWEST), list[Told]()
        fit = fits_of(self.axis)["valve"]
        rows = [fit.centre(self.x, k) for k in (1, 1, 3, 3)] + [[0, 0, 0, 0, 1, 0]]
        for k, (size, off) in enumerate(fitted):
            if k == len(rows):  # the lag is told of all valves together
                found.append((size, off, ca.if_else(told > 0, 0, -1)))
                continue
            change, spread = fitted.along(*rows[k])
            # the compensator of a section follows the load, so its flow has a hysteresis of its own
            limit = p.hysteresis_limit * (1 + self.compensated) if k == len(rows) - 1 else p.valve_limit
            off_known = ca.fabs(change - sum(w * r for w, r in zip(rows[k], known, strict=True)))
            found.append((size, off, judged(off_known, spread, limit, told)))
        return found

    def _of_air(self, usable: Scalar) -> Told:
        air, (known,) = self._solved("trapped", 1.0, 4.0)
        ((share, off),) = air
        return (
            share,
            off,
            judged(share - known, off, self.p.air_limit, usable * whether(air.samples > 2 * FEWEST)),
        )

    @property
    def weighable(self) -> Scalar:
        """1: the readings that its weight needs were usable at the last sample."""
        return self.usable * self.rated

    def weight(self) -> tuple[Scalar, Scalar]:
        """Payload [kg] with its deviation, less the weight of the empty arm beyond the known one."""
        ((size, off),) = self._solved("weight", 0.02, 0.1)[0]
        return HUNDRED * size - self._reference("weight"), ca.sqrt(
            (HUNDRED * off) ** 2 + self.p.weighing_error**2
        )


def outside(pressure: Scalar, p: Any) -> Scalar:
    """1: a pressure is no reading."""
    return either(whether(pressure < p.lowest_pressure), whether(pressure > p.highest_pressure))
