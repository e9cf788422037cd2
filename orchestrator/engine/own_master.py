"""Masters of one's own in Python: a function that takes the components of a system over every step.

`run(system, master=Master("mine", step=mine))` calls, in this process and in this order:

    1. all components are initialised, and values are exchanged at the start time
    2. for each communication step  mine(components, time, length),  with its start and its length [s];
       it has to call `step(time, length)` of every component, once or in parts, and may read outputs, set
       inputs, and save and restore states before and after
    3. the engine exchanges all values at the end of the step, sets inputs of the scenario, records

Between 3 and the next 2 nothing is called. Inputs hold their values until something sets them. An exception
ends the run, with what it has recorded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from ctypes import c_double

from orchestrator.engine.network import Network
from orchestrator.fmi.calls import Slave


class Components(Mapping[str, Slave]):
    """The running components of a system by name, for the function of a master; see `Slave`."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def __getitem__(self, name: str) -> Slave:
        return self._network.slaves[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._network.slaves)

    def __len__(self) -> int:
        return len(self._network.slaves)

    def send(self, name: str) -> None:
        """Set the inputs that the outputs of one component feed."""
        for c in self._network.connections:
            if c.source.component == name:
                value = self[name].get(c.source.variable)
                assert not isinstance(value, str)  # texts are not connected
                self[c.target.component].set(c.target.variable, type(value)(c.map(value)))

    def exchange(self, time: float) -> None:
        """Set all connected inputs in the order of their dependence, as the engine does at a point [s]."""
        self._network.binding.call("simulation_exchange", c_double(time))
