"""Masters of one's own in Python: a function that takes the components of a system over every step.

`run(system, master=Master("mine", step=mine))` calls, in this process and in this order:

    1. all components are initialised, and values are exchanged at the start time
    2. for each communication step  mine(components, time, length),  with its start and its length [s];
       it has to call `step(time, length)` of every component, once or in parts, and may read outputs, set
       inputs, and save and restore states before and after
    3. the engine exchanges all values at the end of the step, sets inputs of the scenario, records

Between 3 and the next 2 nothing is called. Inputs hold their values until something sets them. An exception
ends the run, with what it has recorded; so does a component that is not at the end of the step after 2. An
interrupt is raised in the function. Components that are kept refuse calls after the run.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_double
from functools import partial

import numpy as np

from orchestrator.base.errors import AtEvent, Problem, suggest
from orchestrator.base.interrupts import of_user
from orchestrator.data.trace import SAME_TIME
from orchestrator.engine.network import Network
from orchestrator.fmi.calls import Slave
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.ssp.masters import Master


class Components(dict[str, Slave]):
    """The running components of a system by name, for the function of a master; see `Slave`."""

    def __init__(self, network: Network) -> None:
        super().__init__(network.slaves)
        self._network, self._reached = network, dict.fromkeys(network.slaves, -np.inf)
        for name, slave in network.slaves.items():
            slave.step = partial(self._step, name, slave.step)  # type: ignore[method-assign]
            if isinstance(slave, RunningFmu):
                slave.close = partial(self._refuse, name)  # type: ignore[method-assign]

    def __missing__(self, name: str) -> Slave:
        raise KeyError(f"no component {name!r}{suggest(name, self)}")

    def send(self, name: str) -> None:
        """Set the inputs that the outputs of one component feed, without texts and variables of clocks.

        Those go along at the end of the step, and in `exchange`.
        """
        source, of = self[name], self._network.system.variable
        for c in (c for c in self._network.connections if c.source.component == source.name):
            if of(c.source).clocked or of(c.target).clocked:
                continue
            target, variable = self[c.target.component], c.target.variable
            value = c.carried(source.get(c.source.variable), target.interface.variables[variable])
            target.set(variable, value)

    def exchange(self, time: float) -> None:
        """Set all connected inputs in the order of their dependence, as the engine does at a point [s]."""
        if not self._network.binding.components:
            raise Problem("exchange: expected components that run, got those of a run that has ended")
        self._network.binding.call("simulation_exchange", c_double(time))

    def over(self, master: Master, time: float, length: float) -> None:
        """Take a step with the function of a master; raises Problem if it fails or leaves a component out."""
        assert master.step is not None
        end, where = time + length, f"master {master.name}: the function"
        try:
            of_user(master.step, self, time, length)
        except (Problem, KeyboardInterrupt):
            raise
        except BaseException as error:  # of the user's function, SystemExit too: the rows are kept
            raise Problem(f"{where} failed at t = {time:.9g} s: {error!r}") from error
        if any(isinstance(s, RunningFmu) and s.asks_for_event() for s in self.values()):
            self._network.binding.simulation.events.due = True
        late = [n for n, reached in self._reached.items() if abs(reached - end) > SAME_TIME * length]
        if late:
            raise Problem(f"{where}: expected steps of all components to t = {end:.9g} s, not of {late[0]}")

    def _step(self, name: str, step: Callable[[float, float], None], time: float, length: float) -> None:
        end, least = time + length, SAME_TIME * length
        while True:
            try:
                step(time, length)
                time += length
            except AtEvent as stop:
                if stop.reached - time <= least and length > least:  # it goes back to the beginning
                    length *= 0.5
                    continue
                time = stop.reached if length > least else time + length
                if end - time <= least:
                    self._network.binding.simulation.events.due = True
                else:
                    self._network.binding.inside(name, time)
            if (length := end - time) <= least:
                break
        self._reached[name] = end

    def _refuse(self, name: str) -> None:
        raise Problem(f"{name}: close: expected to leave this to the run, which closes it at the end")
