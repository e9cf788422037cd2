"""Events of the FMUs of a run: a step ends at an event, and all components go through it in one instant.

FMUs have event mode between steps if they stop at their events (FMI 3.0 for Co-Simulation) or are for Model
Exchange. Steps end at announced events, and where all FMUs of a system can go back to the beginning of a
step, it is repeated until it ends at its first event (`native/events.c`). Otherwise an FMU that stops inside
of a step goes through its event alone (`RunningFmu.event_inside`), and others take part at the end of the
step. Beside an FMU with a fixed step announced events wait for the end of the step, too.

In an instant all FMUs with event mode enter it. There values are copied along all connections, and discrete
states are updated, until nothing changes. Afterwards inputs, extrapolations and predictions begin anew. A
jump of a continuous input is an event (FMI 3.0.2, 4.1).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from ctypes import c_double
from functools import partial
from math import ulp
from typing import Any

import numpy as np

from orchestrator.base.errors import Ended, Problem
from orchestrator.base.text import first_names
from orchestrator.data.trace_writer import TraceSink
from orchestrator.engine.clocks import Clocks
from orchestrator.engine.coupling_inputs import CouplingInputs
from orchestrator.engine.job import Job
from orchestrator.engine.network import Network
from orchestrator.engine.result import Event
from orchestrator.engine.stepped_fmu import SteppedFmu
from orchestrator.engine.time_grid import TIME_TOLERANCE
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.fmi.instance import MAX_EVENT_ITERATIONS, Chatter, Unsettled, settle
from orchestrator.ssp.dependencies import divides_at_events

SHARE_OF_STEP = 1e-6  # of the step: tolerance of the time of an event, if less than TIME_TOLERANCE


class Instants:
    """The events of a run in which FMUs have event mode.

    happened   the events so far
    """

    def __init__(self, network: Network, inputs: CouplingInputs, job: Job, sink: TraceSink) -> None:
        """sink: receives each event at once, as an FMU may end the process later."""
        self._sink, self._state = sink, network.binding.simulation.events
        self._network, self._times, self._scenario = network, job.times, job.scenario
        self._state.divides, self._late = divides_at_events(job.system), False
        self._members: dict[str, RunningFmu] = {
            name: slave
            for name, slave in network.slaves.items()
            if isinstance(slave, RunningFmu) and slave.event_mode
        }
        for slave in self._members.values():
            if isinstance(slave, SteppedFmu):
                slave.stops = slave.interface.declares_events
        for name, component in network.components.items():
            struct, interface = component.struct, component.slave.interface
            struct.events = name in self._members
            lower = [s for i in component.inputs if (s := inputs.inputs[i]).fmu_degree < inputs.h.DEGREE]
            held = any(s.requested_degree and not s.fmu_degree for s in lower)
            struct.locates = isinstance(component.slave, SteppedFmu) or (interface.early_return and not held)
            exact, near = inputs.h.EXACT, inputs.h.NEAR_EVENT
            states = interface.model.structure["derivatives"]
            for s in lower:
                s.at_end = interface.event_mode and (near if s.fmu_degree and states else exact)
        sources = {c.target: str(c.source) for c in network.connections}
        self._discrete = [sources.get(p, str(p)) for ports, _ in network.discrete.values() for p in ports]
        self.happened = list[Event]()
        self._changed = dict[str, None]()  # the signals, not continuous, that change in this instant
        self._updates = {name: slave.update for name, slave in self._members.items()}
        self._progress, self._latest = Chatter(job.times.start), deque[str](maxlen=10)
        self._clocks: Clocks | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """A note if events waited for the end of a step, and on FMUs that ask for events after all steps."""
        components = self._network.components
        fixed = [name for name, c in components.items() if not c.slave.interface.variable_step]
        late = f"{first_names(fixed)}: the FMU has a fixed step: events inside of a step act at its end"
        restless = [name for name, c in components.items() if c.struct.restless]
        asks = "asks for event mode after each step, however short: its events are at the end of steps"
        return (late,) * self._late + tuple(f"{name}: {asks}" for name in restless)

    def fill(self) -> None:
        """Fill the structures for C."""
        sim, state = self._network.binding.simulation, self._state
        state.used, state.located, state.next = True, bool(sim.rollback), np.inf
        rounding = 8 * ulp(max(abs(self._times.start), abs(self._times.stop)))
        state.tolerance = max(min(TIME_TOLERANCE, SHARE_OF_STEP * self._times.step), rounding)

    def begin(self) -> None:
        """The first instant, at the start, from which on clocks tick."""
        if any(slave.interface.has_clocks for slave in self._members.values()):
            self._clocks = Clocks(self._network, self._times.start)
        self._instant(self._times.start)

    def saved(self) -> list[Any]:
        """The events so far, for a saved run."""
        events, last = [(e.time, e.causes) for e in self.happened], self._progress
        clocks = self._clocks.saved() if self._clocks else []
        return [last.time, last.close, self._late, events, clocks]

    def resume(self, saved: Sequence[Any]) -> None:
        """Go on from a saved run."""
        self._progress.time, self._progress.close, self._late, events, clocks = saved
        if self._clocks:
            self._clocks.resume(clocks)
        self.happened = [Event(time, tuple(causes)) for time, causes in events]

    def __call__(self, t: float, never: bool) -> None:
        """An instant at a time [s]; never: an FMU stops at other times whenever the step is repeated."""
        asked = [name for name, c in self._network.components.items() if c.struct.asked]
        asked += self._jumping(t)
        announced = {name: slave.next_event for name, slave in self._members.items()}
        self._late |= not self._state.divides and self._next < t - self._state.tolerance
        if never:
            got = "expected an event at one time when a step is repeated, got different times"
            raise Problem(f"{', '.join(asked)}: after t = {t:.9g} s: {got}")
        asked += [n for n, time in announced.items() if time <= t + self._state.tolerance and n not in asked]
        changed = self._changed = dict[str, None]()
        try:
            self._instant(t)
        except Ended:
            self._append(t, [*asked, *changed])
            raise
        for name in announced.keys() & asked:  # one at the beginning of a step that changes nothing is later
            struct = self._network.components[name].struct
            struct.locates = struct.locates and (bool(changed) or t > self._progress.time)
        self._append(t, [*asked, *changed])
        self._latest.extend(changed or asked)
        self._progress.check(self._latest, t, self._times.step)

    def inside(self, name: str, t: float) -> None:
        """The event of one FMU at a time [s] inside of a step that is not repeated."""
        self._members[name].event_inside(t)
        self._announce()

    def _announce(self) -> None:
        for name, slave in self._members.items():
            self._network.components[name].struct.announced = slave.next_event
        self._state.next = self._next

    @property
    def _next(self) -> float:
        """Time of the next announced event or tick [s]; infinite without one."""
        times = [slave.next_event for slave in self._members.values()]
        return min([*times, self._clocks.next if self._clocks else np.inf])

    def _jumping(self, t: float) -> list[str]:
        """The continuous inputs whose column of the scenario jumps at a time [s]."""
        driven = self._network.driven
        if not (driven and self._scenario and t in self._times.jumps):
            return []
        before, after = self._scenario.table.at(t, before=True), self._scenario.table.at(t)
        columns = {port: self._scenario.columns[port][0] for port in driven.continuous}
        return [str(port) for port, k in columns.items() if before[k] != after[k]]

    def _append(self, t: float, causes: Sequence[str]) -> None:
        self.happened.append(Event(t, tuple(dict.fromkeys(causes))))
        self._sink.append_events(self.happened[-1:])

    def _instant(self, t: float) -> None:
        """Take all members through event mode; `_changed` gets the signals, not continuous, that change.

        Ticks at one time that are not due together, as those after a countdown of 0, follow each other.
        """
        if not self._clocks:
            return self._once(t)
        state = self._state
        for _ in range(MAX_EVENT_ITERATIONS):
            due = self._clocks.begin(t, state.tolerance)
            self._changed |= dict.fromkeys(map(str, due))
            self._once(t)
            if self._clocks.next > t + state.tolerance:
                return None
        names = ", ".join(map(str, due))
        raise Unsettled(
            f"{names}: t = {t:.9g} s: expected time to pass between ticks, got {MAX_EVENT_ITERATIONS}"
        )

    def _once(self, t: float) -> None:
        for slave in self._members.values():
            slave.enter_events()
        where = f"{self._network.system.name}: t = {t:.9g} s"
        ended, times = settle(where, self._updates, partial(self._copied, t))
        if self._clocks:
            self._clocks.finish()
        for slave in self._members.values():
            slave.leave_events()
        if ended:
            self._state.ends = True
            raise self._members[ended].ended_at(t)
        for name, time in times.items():
            if not time > t:
                raise Problem(f"{name}: expected the next event after t = {t:.9g} s, got {time:.9g} s")
        self._announce()

    def _copied(self, t: float) -> list[str]:
        """Copy values along all connections; returns the signals, not continuous, that have changed."""
        network, texts = self._network, len(self._network.texts.changes)
        network.binding.call("event_exchange", c_double(t))
        found = [self._discrete[place] for place in network.changes[: self._state.changed].tolist()]
        if found or t <= self._times.start:  # FMUs may have gone through events of their own before
            for call in network.instant_calls:
                call()
        if self._clocks:
            found += self._clocks.propagate()
        found += [name for _, name, _ in network.texts.changes[texts:]]
        self._changed |= dict.fromkeys(found)
        return found
