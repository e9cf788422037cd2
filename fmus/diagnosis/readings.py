"""One function of a machine, as its readings show it: oil in its chambers, and sensors that are wrong.

The oil in a chamber follows from its piston and its pressure alone:

    q = A x' + C P'                      flow into a chamber, with the opposite sign of A for the rod side

Neither masses nor loads are needed. What has no reading, or a wrong one, is not examined.

**Sensors.** A reading is wrong out of its range, or if it stands still: if it does not leave its lag although
another one of the function says that it should, by more than the resolution of both: angle and speed each
other, pressures each other. A pressure that has done so for `DOUBTED` of the time tells no burst.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from fmus.components.play import play_rate
from fmus.components.spool_valve import opening
from fmus.contract import Scalar
from fmus.controller.arm import ControlledAxis
from fmus.controller.valve import Actuator
from fmus.diagnosis.estimates import QUICK, SAMPLING, States, Told, either, shown, whether
from fmus.diagnosis.unknowns import reference, signals_of

ENDS = "head side or line A", "rod side or line B"
PRESSURE = 1e7  # Pa, scale of pressures in the normal equations
SMALL = 1e4  # Pa, over which the root of a pressure is rounded
FILLED = 2e5  # Pa, and the zero of a sensor: of a chamber that is not empty
RELIEVING = 1.1  # times the supply pressure: a relief valve of a chamber is open
RELIEVED = 0.15  # of the supply pressure, by which a counterbalance valve may open below it
LEAST_DROP = 1e6  # Pa, over an edge whose flow tells its opening
NO_DROP = 1e9  # Pa, of a valve that fills nothing
BLIND = 0.1  # s, for which flows are not known after a chamber was empty
TRAVEL = 0.8  # V, command after a reversal from which a valve follows: 8 % of full command
CLOSING = 0.1  # s, time constant with which a valve opens or closes at the latest: a slow pilot head, a bus
STOPPED = 0.1  # s, for which the valve is closed when a stroke has ended: not within that of a tremor
MARGIN = 0.25  # V, what a command may be off a healthy valve: the machine at another temperature
LOWEST = -5e5  # Pa: a chamber is empty at -1 bar; zeros are off by 3 bar
END = 0.98  # of the highest pressure that is a reading: a sensor at the end of its range
MOVES = 0.015  # rad/s, at which a joint moves: five times the noise of angle and speed
JUMP, FASTEST = 0.06, 9.9  # rad, rad/s: step of an angle beyond its speeds, speed of a gyroscope, at most
STILL = (1e-5, 1e-6, 2e3, 2e3)  # rad, rad/s, Pa: distance from its lag at which a reading stands still
STEADY = 6e-3  # rad/s, three times the noise of a speed: from its lag, at 0.2 rad/s2
LIVELY, STEPS = 5e3, 5  # Pa, and resolutions, from the lag of a pressure that changes
LOADED = 20  # resolutions: a pressure below it may be as even as that of the return line
DOUBTED = 0.5  # of the time for which it stands still: half of the evidence
MOVING = 2 / 3  # of the time for which a pressure stands still: of an angle or a speed


def outside(pressure: Scalar, p: Any) -> Scalar:
    """1: a pressure is no reading."""
    return either(whether(pressure < LOWEST), whether(pressure > p.highest_pressure))


class Axis:
    """One function at one instant.

    lever    dx/dq of its piston
    radial   dr/dq of the tip, r its radius; 0 of the column [m or 1]
    speeds   1: the readings of all speeds are usable
    stopped  1: a stroke has just ended
    doubted  1: of each reading, it may be one that stands still
    compared   of a reading of the valve: weight, part of its command that opens it [V], `PRESSURE` over the
               drop of the edge, what it needs more than the healthy valve [V]
    margin   least drop of the supply pressure to a chamber that is filled, of all functions [Pa]
    """

    compared: tuple[Scalar, Scalar, Scalar, Scalar] = (0, 0, 0, 0)
    speeds: Scalar = 1
    margin: Scalar = NO_DROP
    least_drop: Scalar = NO_DROP

    def __init__(
        self, axis: ControlledAxis, actuator: Actuator, piston: tuple[Scalar, ...], m: States, u: Any, p: Any
    ) -> None:
        self.axis, self.actuator, self.m, self.u, self.p = axis, actuator, m, u, p
        (self.position, self.lever, self.radial), signals = piston, signals_of(axis)
        self.readings = [getattr(u, n) for n in signals]
        self.pressures = self.readings[2:]
        self.command = getattr(u, f"{axis.name}_command")
        self.connected = 1 - whether(u.gap > 0)
        self.fitted = [getattr(p, f"{n}_fitted") for n in signals]
        lag = ca.if_else(self.connected > 0, p.lag, QUICK)  # none in a gap of readings
        named = enumerate(zip(self.readings, signals.items(), strict=True))
        self.late = [m.lag(f"late_{k}", now, lag, *row) for k, (now, row) in named]
        self.behind = [now - late for now, late in zip(self.readings, self.late, strict=True)]
        self.rate = [v / p.lag for v in self.behind]
        text = "1: the reading of {} is wrong, -1: it has not changed yet"
        self._bad = [m.state(f"bad_{k}", text.format(n), start=-1) for k, n in enumerate(signals)]
        fast = whether(ca.fabs(self.readings[1]) > FASTEST)
        moved = self.behind[0] - self.fitted[1] * (1 - fast) * p.lag * self.late[1]
        jump = JUMP + self.fitted[1] * (1 - fast) * p.lag * ca.fabs(
            self.readings[1]
        )  # at an impact a speed turns within the lag
        self.outside = [whether(ca.fabs(moved) > jump), fast, *(outside(v, p) for v in self.pressures)]
        rows = zip(self.outside, self._bad, self.fitted, strict=True)
        self.faulty = [either(out, bad, 1 - known) for out, bad, known in rows]
        # the command behind the lag of the readings, and behind a play
        self.late_command = m.lag("late_command", self.command, 2 * p.lag, "Command", "V")
        self.trailing = m.state("trailing", "That behind a play", "V", self.command)
        m.moves("trailing", play_rate(self.late_command, self.trailing, TRAVEL, 50.0, TRAVEL / 10))
        self.spool = m.state("spool", "1: the spool does not follow")
        texts = (f"Largest loss beyond its valve, {end}" for end in ENDS)
        self.burst = [m.state(f"burst_{k}", text, "m3/s") for k, text in enumerate(texts)]
        self.burst_told = whether(ca.fmax(*self.burst) > 0)
        self._chambers()

    def _chambers(self) -> None:
        """Flows, and what the valve may let through."""
        a, m, p = self.actuator, self.m, self.p
        self.compensated = whether(a.section_flows[0] > 0)
        self.capacitances, speed = (a.head_capacitance, a.rod_capacitance), self.lever * self.rate[0]
        self.areas = a.head_area, a.rod_area
        self.filled = [whether(v > FILLED + p.zero_limit) for v in self.pressures]
        self.speed = a.head_area * speed  # of the oil at the head side [m3/s]
        self.flows = (
            self.speed + a.head_capacitance * self.rate[2],
            -a.rod_area * speed + a.rod_capacitance * self.rate[3],
        )
        # a pressure up to which no valve opens by itself: a counterbalance valve does at a high load
        self.tight = p.nominal_supply_pressure * (1 - RELIEVED * self.compensated)
        self.closed = whether(ca.fabs(self.command) < p.closed_command)
        relieved = whether(ca.fmax(*self.pressures) > RELIEVING * p.nominal_supply_pressure)
        self.most, self.least, self.full = list[Scalar](), list[Scalar](), list[Scalar]()
        for k, (sign, end, pressure) in enumerate(zip((1, -1), ENDS, self.pressures, strict=True)):
            now = sign * self.command
            for held, name, which, way in (
                (self.most, "most", "Largest", 1),
                (self.least, "least", "Least", -1),
            ):
                text = f"{which} command that fills it, of the last time, {end}"
                held.append(m.state(f"{name}_{k}", text, "V"))
                change = now - held[k]
                m.moves(f"{name}_{k}", change / ca.if_else(way * change > 0, QUICK, CLOSING))
            ends = whether(pressure < p.zero_limit), whether(pressure > END * p.highest_pressure)
            seen = 1 - either(*ends, relieved)
            known = m.sum(f"known_{k}", f"Time for which its oil is known, {end}", 1, seen)
            self.full.append(whether(known > BLIND) * seen)
            drop = ca.if_else(self.most[k] > p.closed_command, self.u.supply_pressure - pressure, NO_DROP)
            self.least_drop = ca.fmin(self.least_drop, drop)

    def completed(self, lines: Scalar, speeds: Scalar, margin: Scalar) -> None:
        """What depends on the other functions."""
        m, (angle, _, head, rod) = self.m, self.faulty
        self.speeds, self.margin = speeds, margin
        self.sound = lines * (1 - either(angle, head, rod)) * self.connected
        self.usable = m.lag("usable", self.sound, QUICK, "1: the readings are usable", zero=True)
        self.shut = m.sum("shut", "Time for which the valve is closed", 1, self.closed * self.sound)
        self.stopped = whether(ca.fabs(self.shut - STOPPED) < SAMPLING / 2)

    def edge(self, k: int) -> tuple[Scalar, Scalar, Scalar, Scalar, Scalar]:
        """Of the chamber that is filled: flow, drop over the edge, flow at full opening [m3/s].

        The last two are the drop of the whole hose, and `PRESSURE`, over the drop of the edge itself; 0 of
        compensated sections, whose flow does not depend on it.

        Compensated sections share a supply that is not enough for all, so each has the least drop of all.
        """
        a, flow = self.actuator, self.flows[k]
        drop = self.u.supply_pressure - self.pressures[k]
        drop = ca.if_else(self.compensated > 0, ca.fmin(drop, self.margin), drop)
        inside, hose = self._without_hose(drop, flow)
        full = ca.if_else(self.compensated > 0, a.section_flows[k], a.gain * ca.sqrt(inside))
        plain = (1 - self.compensated) / inside
        return flow, drop, full, plain * hose, plain * PRESSURE

    def _without_hose(self, drop: Scalar, flow: Scalar) -> tuple[Scalar, Scalar]:
        """Drop over the edge, without that of the hose between it and the sensor; drop of the hose [Pa]."""
        hose = self.actuator.hose.drop(flow)
        return ca.fmax(drop - self.reference("hose_friction") * hose, SMALL / 2), hose

    def return_edge(self, k: int) -> tuple[Scalar, Scalar]:
        """Opening of the return edge while chamber k is filled, and whether it is known."""
        drop, flow = self.pressures[1 - k] - self.u.tank_pressure, -self.flows[1 - k]
        full = self.actuator.gain * ca.sqrt(self._without_hose(drop, flow)[0])
        return flow / full, whether(drop > LEAST_DROP) * self.full[1 - k] * (1 - self.compensated)

    def opened(self, k: int, command: Scalar, sign: int) -> Scalar:
        """Largest (sign 1) or least (-1) opening at a command, by the healthy machine."""
        v, way = self.actuator.valve, ("up", "down")[k]
        gain, band = self.reference(f"gain_{way}"), self.reference(f"dead_band_{way}")
        moved = gain * command - band + sign * (self.reference("half_hysteresis") + MARGIN)
        return ca.fmin(opening(moved, v.dead_band, v.full_command, v.command_rounding), 1)

    def reference(self, name: str) -> Scalar:
        """Of the healthy machine."""
        return reference(f"{self.axis.name}_{name}", self.p)

    def sensors(self) -> dict[str, Told]:
        """Readings that are wrong."""
        p, found = self.p, dict[str, Told]()
        moves = MOVES + 2 * p.angle_resolution / p.lag
        turns, goes = (whether(ca.fabs(v) > moves) for v in (self.late[1], self.rate[0]))
        differ = whether(ca.fabs(self.rate[0] - self.late[1]) > moves)
        lively, least = LIVELY + STEPS * p.pressure_resolution, p.zero_limit + LOADED * p.pressure_resolution
        changes = [turns * (1 - self.outside[1]) * differ, goes * (1 - self.outside[0]) * differ]
        steady = whether(ca.fabs(self.behind[1]) < STEADY) * self.fitted[1]
        for pressure, other, way in zip(self.pressures, self.behind[:1:-1], (1, -1), strict=True):
            # an empty chamber has a constant pressure, and one that is emptied at a constant speed may have
            constant = steady * whether(way * self.lever * self.late[1] < -MOVES * ca.fabs(self.lever))
            seen = whether(ca.fabs(other) > lively) * whether(pressure > least)
            changes.append(seen * (1 - constant))
        self.doubted = list[Scalar]()
        for k, n in enumerate(signals_of(self.axis)):
            still = whether(ca.fabs(self.behind[k]) < STILL[k]) * self.connected
            text = f"Time for which {n} stands still although it should change"
            time = self.m.sum(f"still_{k}", text, changes[k], still)
            long = whether(time > p.still_time * (MOVING if k < 2 else 1))
            self.doubted.append(whether(time > DOUBTED * p.still_time))
            wrong = either(self.outside[k] * self.connected, long) * self.fitted[k]
            bad, known = self._bad[k], (1 - still) * self.connected - 1
            self.m.latch(f"bad_{k}", bad, ca.fmax(2 * wrong - 1, known))
            found[f"{n}_sensor"] = shown(ca.fmax(bad, 0), self.fitted[k] * whether(bad > -0.5))
        return found
