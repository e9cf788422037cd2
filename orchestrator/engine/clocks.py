"""Clocks of FMI 3.0 for Co-Simulation: which tick in an instant, and the variables that belong to them.

Tick k of a periodic clock is at start + shift + k interval, in fractions of the decimal numbers of the FMU:
clocks meet exactly and none drifts. Clocks that are due together tick in one instant. A triggered input clock
ticks with the output clock that is connected to it, before discrete states are updated. Variables of a clock
are set and read only while it ticks; in between others see their last values.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from orchestrator.base.errors import Problem
from orchestrator.base.numerals import integer
from orchestrator.base.text import grouped
from orchestrator.engine.network import Network
from orchestrator.fmi.cosimulation import APERIODIC, CHANGED, UNKNOWN, RunningFmu
from orchestrator.fmi.description import FmuVariable
from orchestrator.fmi.instance import MAX_EVENT_ITERATIONS, Unsettled
from orchestrator.ssp.system import Port


@dataclass(eq=False)
class Timed:
    """An input clock that ticks by time.

    interval, next   its interval and its next tick [s], exact; None: not known
    time             of the next tick [s]; infinite if it is not known
    """

    port: Port
    slave: RunningFmu
    clock: FmuVariable
    interval: Fraction | None = None
    next: Fraction | None = None
    time: float = np.inf

    def schedule(self, tick: Fraction | None) -> None:
        """Set its next tick [s]."""
        self.next, self.time = tick, np.inf if tick is None else float(tick)

    @property
    def kind(self) -> str:
        """The variability of its interval."""
        return self.clock.get("intervalVariability")

    def is_asked(self, ticked: bool) -> bool:
        """Is the FMU asked for its interval after an instant? A declared one may change after a tick only."""
        if self.kind == "changing":
            return ticked or self.next is None
        is_open = self.kind == "tunable" and (ticked or self.clock.fraction("interval") is None)
        return is_open or self.kind == "countdown"


class Clocks:
    """The clocks of a run."""

    def __init__(self, network: Network, start: float) -> None:
        self._network, self._start, system = network, Fraction(repr(start)), network.system
        self._timed, self._outputs = list[Timed](), list[Port]()
        variables = dict[Port, list[Port]]()  # clock -> variables that belong to it
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
            of_component = component.interface.variables.values()
            clocks = {v.reference: Port(name, v.name) for v in of_component if v.kind == "Clock"}
            for v in of_component:
                own = Port(name, v.name)
                if v.kind == "Clock" or not v.clocked:
                    continue
                driven = own in network.held_values and own not in self._sources
                if component.has_start(v.name) and not driven:  # until its clock ticks
                    network.store(own, component.value(v.name))
                if v.causality in ("input", "output") or own in recorded:
                    for port in (clocks[r] for r in v.clocks if r in clocks):
                        variables.setdefault(port, []).append(own)
            for port in clocks.values():
                clock, slave = system.variable(port), network.slaves[name]
                if clock.causality == "output":
                    self._outputs.append(port)
                elif clock.causality == "input" and clock.get("intervalVariability") != "triggered":
                    assert isinstance(slave, RunningFmu)
                    self._timed.append(self._begun(port, slave, clock))
        self._programs = {clock: self._sets_and_reads(ports) for clock, ports in variables.items()}
        self._joined = dict[tuple[Port, ...], list[Any]]()

    def _sets_and_reads(self, ports: list[Port]) -> tuple[Any, Any]:
        """The programs that set the inputs among variables from their sources, and read the others."""
        network, inputs = self._network, {*ports} & self._network.held_values
        variables = {port: network.system.variable(port) for port in ports}
        others = [port for port, variable in variables.items() if variable.causality != "input"]
        sets = network.copies([c for c in network.connections if c.target in inputs])
        sets += network.set_calls(inputs)
        sets += [partial(self._set_text, p) for p in sorted(inputs) if not variables[p].is_number]
        reads: list[Any] = [*network.get_calls({*others})]
        reads += [partial(self._read_text, p) for p in others if not variables[p].is_number]
        return network.binding.program(sets), network.binding.program(reads)

    def _set_text(self, port: Port) -> None:
        wire = self._sources.get(port)
        value = self._network.texts.last.get(wire.source if wire else port)
        if value is not None:  # one that its clock has given
            self._network.slaves[port.component].set(port.variable, value)
            self._network.store(port, value)

    def _read_text(self, port: Port) -> None:
        self._network.store(port, self._network.slaves[port.component].get(port.variable))

    def _begun(self, port: Port, slave: RunningFmu, clock: FmuVariable) -> Timed:
        """A clock with its first tick; an aperiodic one may tell it later."""
        begun = Timed(port, slave, clock)
        interval, shift = slave.first_ticks.get(clock.name, (None, Fraction(0)))
        if interval is None and begun.kind not in APERIODIC:
            interval, shift = clock.fraction("interval"), clock.fraction("shift") or shift
        if interval is not None:
            self._set_interval(begun, interval)
            begun.schedule(self._start + shift)
        return begun

    def _set_interval(self, c: Timed, interval: Fraction) -> None:
        if interval < 0 or (interval == 0 and c.kind not in APERIODIC):
            least = "0 s or more" if c.kind in APERIODIC else "above 0 s"
            raise Problem(f"{c.port}: expected an interval {least}, got {float(interval):.9g} s")
        c.interval = interval

    @property
    def next(self) -> float:
        """Time of the next tick [s]; infinite if there is none."""
        return min((c.time for c in self._timed), default=np.inf)

    def begin(self, t: float, tolerance: float) -> list[Port]:
        """The clocks that are due first at a time [s], all at the same one, are to tick."""
        due = [c for c in self._timed if c.time <= t + tolerance]
        first = min((c.next for c in due if c.next is not None), default=None)
        self._due = [c for c in due if c.next == first]
        self._now = Fraction(t) if first is None else first
        self.pending = {c.port for c in self._due}
        return [c.port for c in self._due]

    def finish(self) -> None:
        """After an instant: when do its clocks tick next?"""
        for c in self._timed:
            ticked, goes_on, changed = c in self._due, c.kind != "countdown", False
            if c.is_asked(ticked):
                qualifier, interval = c.slave.interval(c.clock)
                goes_on = goes_on and not (c.kind == "changing" and qualifier == UNKNOWN)
                changed = qualifier == CHANGED and (c.kind != "tunable" or interval != c.interval)
                if changed:
                    self._set_interval(c, interval)
            if c.interval is not None and (changed or (ticked and goes_on)):
                c.schedule(self._now + c.interval)  # a new interval begins now
            elif ticked:
                c.schedule(None)

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
            changed = bool(self._active) and self._copy(sorted(self._active))
            for port in self._outputs:
                if port not in self._active and self._slave(port).ticks(port.variable):
                    self._active.add(port)
                    ticked.append(port)
                    changed |= port in self._programs  # which are read in the next round
                    self.pending |= {c.target for c in self._wires.get(port, ())}
        raise Unsettled(
            f"{self._network.system.name}: the clocks do not settle: {', '.join(map(str, ticked[-3:]))}"
        )

    def _slave(self, port: Port) -> RunningFmu:
        slave = self._network.slaves[port.component]
        assert isinstance(slave, RunningFmu)
        return slave

    def _copy(self, active: list[Port]) -> bool:
        """Set inputs of clocks that tick from their sources, then read the others.

        Returns whether one has changed that may feed an input of a clock.
        """
        network = self._network
        programs = self._joined.get(key := tuple(active))
        if programs is None:
            pairs = [self._programs[clock] for clock in active if clock in self._programs]
            parts = [[pair[k] for pair in pairs] for k in (0, 1)]
            parts = parts if self._chained else [[*parts[0], *parts[1]]]
            programs = self._joined[key] = [network.binding.joined(part) for part in parts]
        network.binding.run(programs[0])
        if not self._chained:
            return False
        values, texts = (network.reals.values, network.integers.values), len(network.texts.changes)
        before = [array.copy() for array in values]
        network.binding.run(programs[1])
        same = all(np.array_equal(*pair, equal_nan=True) for pair in zip(values, before, strict=True))
        return not same or len(network.texts.changes) > texts

    def saved(self) -> list[Any]:
        """Intervals and next ticks, for a saved run."""
        return [[str(c.interval), str(c.next)] for c in self._timed]

    def resume(self, saved: list[Any]) -> None:
        """Go on from a saved run."""
        for c, texts in zip(self._timed, saved, strict=True):
            parts = (text != "None" and [*map(integer, text.split("/"))] for text in texts)
            c.interval, tick = (Fraction(*numbers) if numbers else None for numbers in parts)
            c.schedule(tick)
