"""One function of a machine, as its readings show it: what all checks of it share.

The oil in a chamber follows from its piston and its pressure alone:

    q = A x' + C P'                      flow into a chamber, with the opposite sign of A for the rod side

Neither masses nor loads are needed. What has no reading, or a wrong one, is not examined.

A check is a module with these functions; names of findings and states are those without the axis:

    findings(axis)   what may be broken, in the order of the outputs
    states(axis)     filters, clocks, latches
    fits(axis)       sums of least squares; not of all checks
    rates(a)         of the states and sums
    told(a)          of each finding: size, deviation, state
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from fmus.components.spool_valve import opening
from fmus.contract import Quantity, Scalar
from fmus.controller.arm import ControlledAxis
from fmus.controller.valve import Actuator
from fmus.diagnosis.estimates import QUICK, Fit, Prior, Solution, counted, either, whether
from fmus.diagnosis.settings import REFERENCES
from fmus.smooth import positive

PRESSURE = 1e7  # Pa, scale of pressures in the normal equations
SMALL = 1e4  # Pa, over which the root of a pressure is rounded
FILLED = 2e5  # Pa above the return line, in a chamber that oil flows into
RELIEVING = 1.1  # times the supply pressure: a relief valve of a chamber is open
RELIEVED = 0.15  # of the supply pressure, by which a counterbalance valve may open below it
NO_DROP = 1e9  # Pa, of a valve that fills nothing
BLIND = 0.1  # s, for which flows are not known after a chamber was empty
MOVES = 0.015  # rad/s, at which a joint moves: five times the noise of angle and speed
LONG, LONGER = 0.6, 1.5  # s, after which a chamber is at rest, and its arm as well


@dataclass(frozen=True)
class Effort:
    """Of a joint: torque d(V - T)/dq [N.m] of weight and motion, and momentum dT/dq' [N.m.s].

    Of the empty arm, of a kilogram of payload, and of a kilogram more of each of its masses. tilt is the
    change of the torque of its weight with a turn of the arm in its plane [N.m/rad].
    """

    torque: Scalar
    momentum: Scalar
    tilt: Scalar = 0


Efforts = Mapping[str, Effort]  # by "empty", "payload", names of masses


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


def chambers_of(axis: ControlledAxis) -> tuple[tuple[str, str], tuple[str, str]]:
    """Words for both chambers; how the names of their findings are made."""
    if axis.turns:
        return ("line A", "line B"), ("{}_a", "{}_b")
    return ("the head side", "the rod side"), ("head_{}", "rod_{}")


def of_both(axis: ControlledAxis, kind: str, finding: Finding) -> dict[str, Finding]:
    """A finding of each chamber; `{end}` in its text is the words for the chamber."""
    return {
        mark.format(kind): replace(finding, text=finding.text.format(end=end))
        for end, mark in zip(*chambers_of(axis), strict=True)
    }


def of_chambers(axis: ControlledAxis, *rows: tuple[str, str, str]) -> dict[str, Quantity]:
    """A state of each chamber, from name, unit and text."""
    nominal = {"V": 10.0, "Pa": 1e7, "m3": 1e-3, "m3/s": 1e-3}
    return {
        f"{n}_{k}": Quantity(unit, f"{text}: {end} of the {axis.name}", nominal.get(unit, 1.0))
        for k, end in enumerate(("head side or line A", "rod side or line B"))
        for n, unit, text in rows
    }


def signals_of(axis: ControlledAxis) -> tuple[str, ...]:
    """Readings of an axis: coordinate, speed, both pressures."""
    return (axis.coordinate[0], axis.speed[0], axis.sides[0][0], axis.sides[1][0])


def shared_states(axis: ControlledAxis) -> dict[str, Quantity]:
    """What all checks share."""
    units = (*axis.units, "Pa", "Pa")
    found = {
        f"late_{k}": Quantity(unit, f"{n} behind the lag", 1e7 if unit == "Pa" else 1.0)
        for k, (n, unit) in enumerate(zip(signals_of(axis), units, strict=True))
    }
    found |= of_chambers(
        axis,
        ("most", "V", "Largest command that fills it, of the last time"),
        ("least", "V", "Least command that fills it, of the last time"),
        ("void", "s", "Time since it was empty, counted down"),
    )
    for n, unit, text in (
        ("shut", "s", "Time for which the valve is closed, limited"),
        ("usable", "1", "1: the readings are usable"),
    ):
        found[n] = Quantity(unit, f"{text}: {axis.name}")
    return found


@dataclass(frozen=True)
class Axis:
    """One axis at one instant.

    lever    dx/dq
    lines    1: the readings of both lines are usable
    speeds   1: those of all speeds are
    effort   of weights and motion
    radial   dr/dq of the tip, r its radius; 0 of the column [m or 1]
    margin   least drop of supply pressure to a chamber that is filled, of all axes [Pa]
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
    effort: Efforts
    radial: Scalar = 0
    margin: Scalar = 0

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

    @property
    def connected(self) -> Scalar:
        """1: there is a reading now, 0: in a gap of them."""
        return 1 - whether(self.u.gap > 0)

    def behind(self, k: int) -> Scalar:
        """Distance of a reading from its lag."""
        return self.reading(k) - getattr(self, f"late_{k}")

    def rate(self, k: int) -> Scalar:
        """Of a reading, behind the lag."""
        return self.behind(k) / self.p.lag

    @property
    def outside(self) -> list[Scalar]:
        """1: a reading is out of its range; a coordinate, which may count turns, jumps."""
        p, fast = self.p, whether(ca.fabs(self.reading(1)) > self.p.largest_speed)
        known = getattr(p, f"{self.axis.speed[0]}_fitted") * (1 - fast)
        moved = self.behind(0) - known * p.lag * self.reading(1)
        far = [whether(ca.fabs(moved) > p.largest_jump), fast]
        return far + [outside(v, p) for v in self.pressures]

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
        return self.lines * (1 - either(angle, head, rod)) * self.connected

    # ---- oil

    @property
    def compensated(self) -> Scalar:
        """1: its valve is a compensated section."""
        return whether(self.actuator.section_flows[0] > 0)

    @property
    def capacitances(self) -> tuple[Scalar, Scalar]:
        """Of both chambers [m3/Pa]."""
        return self.actuator.head_capacitance, self.actuator.rod_capacitance

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
        """1: a chamber is empty, its sensor at the end of its range, or a relief valve of the axis open."""
        relieved = whether(ca.fmax(*self.pressures) > RELIEVING * self.p.nominal_supply_pressure)
        return either(
            whether(pressure < self.p.zero_limit), whether(pressure > self.p.highest_reading), relieved
        )

    @property
    def least_drop(self) -> Scalar:
        """From the supply to a chamber that its valve may be filling [Pa]."""
        filled = zip(self.pair("most"), self.pressures, strict=True)
        drops = (
            ca.if_else(most > self.p.closed_command, self.u.supply_pressure - v, NO_DROP)
            for most, v in filled
        )
        return ca.fmin(*drops)

    @property
    def tight(self) -> Scalar:
        """Pressure up to which no valve opens by itself: a counterbalance valve does at a high load [Pa]."""
        return self.p.nominal_supply_pressure * (1 - RELIEVED * self.compensated)

    @property
    def closed(self) -> Scalar:
        """1: the command closes the valve."""
        return whether(ca.fabs(self.command) < self.p.closed_command)

    def edge(self, direction: int) -> tuple[Scalar, Scalar, Scalar]:
        """Of the chamber that is filled: flow, drop over the edge, and flow at full opening [m3/s].

        Compensated sections share a supply that is not enough for all, so each has the least drop of all.
        """
        a, flow = self.actuator, self.flows[direction]
        drop = self.u.supply_pressure - self.pressures[direction]
        drop = ca.if_else(self.compensated > 0, ca.fmin(drop, self.margin), drop)
        inside = positive(drop - a.hose.drop(flow), SMALL)
        full = ca.if_else(self.compensated > 0, a.section_flows[direction], a.gain * ca.sqrt(inside))
        return flow, drop, full

    def opened(self, direction: int, command: Scalar, sign: int) -> Scalar:
        """Largest (sign 1) or least (-1) opening at a command, by the healthy machine."""
        v, way = self.actuator.valve, ("up", "down")[direction]
        names = f"gain_{way}", f"dead_band_{way}", "half_hysteresis"
        gain, band, half = (self.reference(n) for n in names)
        moved = gain * command - band + sign * (half + self.p.valve_margin)
        return ca.fmin(opening(moved, v.dead_band, v.full_command, v.command_rounding), 1)

    def reference(self, name: str) -> Scalar:
        """Of the healthy machine."""
        return getattr(self.p, f"{self.axis.name}_{name}_reference", 0)

    def solved(
        self,
        fit: Fit,
        deviations: Mapping[str, float],
        least: float,
        rough: float,
        most: float = math.inf,
        rare: int = 0,
    ) -> tuple[Solution, list[Scalar]]:
        """Sizes of a fit, with the deviations of their priors by name; and their references."""
        known = [self.reference(n) if n in REFERENCES else 0 for n in deviations]
        return fit.solved(self, Prior([*deviations.values()], known, least, rough, most), rare), known

    @property
    def burst_told(self) -> Scalar:
        """1: a hose is burst."""
        return whether(ca.fmax(*self.pair("burst")) > 0)

    def rates(self) -> dict[str, Scalar]:
        """Of the states that all checks share."""
        found = {"usable": (self.sound - self.usable) / QUICK}
        for k in range(4):  # without a lag in a gap of readings
            found[f"late_{k}"] = ca.if_else(self.connected > 0, self.rate(k), self.behind(k) / QUICK)
        for k, sign in enumerate((1, -1)):
            now, most, least = sign * self.command, self.pair("most")[k], self.pair("least")[k]
            found[f"most_{k}"] = (now - most) / ca.if_else(now > most, QUICK, self.p.closing)
            found[f"least_{k}"] = (now - least) / ca.if_else(now < least, QUICK, self.p.closing)
            void, blind = self.pair("void")[k], self._blind(self.pressures[k])
            falling = ca.if_else(void > 0, -1, 0)
            found[f"void_{k}"] = ca.if_else(blind > 0, (2 * BLIND - void) / QUICK, falling)
        found["shut"] = counted(self.shut, self.closed * self.sound, whether(self.shut < 2 * LONGER))
        return found


def outside(pressure: Scalar, p: Any) -> Scalar:
    """1: a pressure is no reading."""
    return either(whether(pressure < p.lowest_pressure), whether(pressure > p.highest_pressure))
