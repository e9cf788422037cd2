"""Clocks of FMI 3.0 for Co-Simulation: which tick in an instant, and the variables that belong to them.

Tick k of a periodic clock is at start + shift + k interval, in fractions of the decimal numbers of the FMU:
clocks meet exactly and none drifts. Clocks that are due together tick in one instant. A triggered input clock
ticks with the output clock that is connected to it, before discrete states are updated. Variables of a clock
are set and read only while it ticks; in between others see their last values.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.text import grouped
from orchestrator.engine.network import Network
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.instance import MAX_EVENT_ITERATIONS, Unsettled
from orchestrator.ssp.system import Port

CHANGED = 2  # fmi3IntervalChanged
ASKED = ("tunable", "changing", "countdown")  # clocks whose interval may change in a run


@dataclass
class Timed:
    """An input clock that ticks by time: its interval and its next tick [s]; None: not known."""

    port: Port
    slave: RunningFmu
    clock: FmuVariable
    interval: Fraction | None
    next: Fraction | None


class Clocks:
    """The clocks of a run."""

    def __init__(self, network: Network, start: float) -> None:
        self._network, self._start, system = network, Fraction(repr(start)), network.system
        self._timed, self._outputs = list[Timed](), list[Port]()
        self._variables: dict[Port, list[Port]] = {}  # clock -> variables that belong to it
        self.pending, self._active = set[Port](), set[Port]()
        self._wires = grouped(
            [c for c in system.connections if system.variable(c.source).kind == "Clock"], lambda c: c.source
        )
        self._sources = {c.target: c for c in system.connections}
        variable, recorded = system.variable, {*network.reals.index, *network.integers.index}
        self._chained = any(
            variable(c.source).clocked and variable(c.target).clocks for c in system.connections
        )
        for name, component in system.components.items():
            variables = component.interface.variables.values()
            clocks = {v.reference: Port(name, v.name) for v in variables if v.kind == "Clock"}
            for v in variables:
                own = Port(name, v.name)
                if v.kind == "Clock" or not v.clocked:
                    continue
                driven = own in network.held_values and own not in self._sources
                if component.has_start(v.name) and not driven:  # until its clock ticks
                    network.store(own, component.value(v.name))
                if v.causality in ("input", "output") or own in recorded:
                    for port in (clocks[r] for r in v.clocks if r in clocks):
                        self._variables.setdefault(port, []).append(own)
            for port in clocks.values():
                clock, slave = system.variable(port), network.slaves[name]
                if clock.causality == "output":
                    self._outputs.append(port)
                elif clock.causality == "input" and clock.get("intervalVariability") != "triggered":
                    assert isinstance(slave, RunningFmu)
                    self._timed.append(self._begun(port, slave, clock))

    def _begun(self, port: Port, slave: RunningFmu, clock: FmuVariable) -> Timed:
        """A clock with its first tick; those of a countdown are told in event mode."""
        if clock.get("intervalVariability") == "countdown":
            return Timed(port, slave, clock, None, None)
        interval, shift = clock.fraction("interval"), clock.fraction("shift") or Fraction(0)
        if interval is None:
            interval, shift = slave.first_ticks[clock.name]
        self._check(port, interval, interval > 0)
        return Timed(port, slave, clock, interval, self._start + shift)

    def _check(self, port: Port, interval: Fraction, right: bool) -> None:
        if not right:
            least = (
                "0 s or more"
                if self._network.system.variable(port).get("intervalVariability") == "countdown"
                else "above 0 s"
            )
            raise Problem(f"{port}: expected an interval {least}, got {float(interval):.9g} s")

    @property
    def next(self) -> float:
        """Time of the next tick [s]; infinite if there is none."""
        return min((float(c.next) for c in self._timed if c.next is not None), default=np.inf)

    def begin(self, t: float, tolerance: float) -> list[Port]:
        """The clocks that are due first at a time [s], all at the same one, are to tick."""
        due = [c for c in self._timed if c.next is not None and float(c.next) <= t + tolerance]
        first = min((c.next for c in due if c.next is not None), default=None)
        self._due = [c for c in due if c.next == first]
        self._now = Fraction(t) if first is None else first
        self.pending = {c.port for c in self._due}
        return [c.port for c in self._due]

    def finish(self) -> None:
        """After an instant: when do its clocks tick next?"""
        for c in self._timed:
            kind, ticked = c.clock.get("intervalVariability"), c in self._due
            if kind in ASKED and (ticked or kind == "countdown"):
                qualifier, interval = c.slave.interval(c.clock)
                if qualifier == CHANGED:
                    self._check(c.port, interval, interval > 0 or (kind == "countdown" and interval == 0))
                    c.interval = interval
                    c.next = self._now + interval if kind == "countdown" else c.next
                elif kind == "countdown":
                    c.next = None if ticked else c.next
            if ticked and kind != "countdown" and c.next is not None and c.interval is not None:
                c.next += c.interval

    def propagate(self) -> list[str]:
        """Let clocks tick until no other one does, with their variables; returns the names of the clocks."""
        ticked, changed = list[Port](), True
        self._active.clear()
        for _ in range(MAX_EVENT_ITERATIONS):
            if not (changed or self.pending):
                return [*map(str, ticked)]
            for port in sorted(self.pending - self._active):
                self._slave(port).tick(port.variable)
                ticked.append(port)
            self._active |= self.pending
            self.pending = set()
            changed = self._copy(sorted(self._active)) and self._chained
            for port in self._outputs:
                if port not in self._active and self._slave(port).ticks(port.variable):
                    self._active.add(port)
                    ticked.append(port)
                    changed |= port in self._variables  # which are read in the next round
                    self.pending |= {c.target for c in self._wires.get(port, ())}
        raise Unsettled(
            f"{self._network.system.name}: the clocks do not settle: {', '.join(map(str, ticked[-3:]))}"
        )

    def _slave(self, port: Port) -> RunningFmu:
        slave = self._network.slaves[port.component]
        assert isinstance(slave, RunningFmu)
        return slave

    def _copy(self, active: list[Port]) -> bool:
        """Set inputs of clocks that tick from their sources, then read their outputs; has one changed?"""
        found, network = False, self._network
        ports = dict.fromkeys(p for clock in active for p in self._variables.get(clock, ()))
        variables = {port: network.system.variable(port) for port in ports}
        for port, variable in variables.items():
            if port in network.held_values:
                wire = self._sources.get(port)
                value = network.stored(wire.source if wire else port)
                if value is None:  # a text that its clock has not given yet
                    continue
                value = wire.carried(value, variable) if wire else value
                network.slaves[port.component].set(port.variable, value)
                network.store(port, value)
        for port, variable in variables.items():
            if variable.causality != "input":
                found |= network.store(port, network.slaves[port.component].get(port.variable))
        return found

    def saved(self) -> list[Any]:
        """Intervals and next ticks, for a saved run."""
        return [[str(c.interval), str(c.next)] for c in self._timed]

    def resume(self, saved: list[Any]) -> None:
        """Go on from a saved run."""
        for c, texts in zip(self._timed, saved, strict=True):
            c.interval, c.next = (None if text == "None" else Fraction(text) for text in texts)
