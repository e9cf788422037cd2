"""FMU instance for Model Exchange: states and time are set, time derivatives are read.

The linearisation needs Model Exchange because the states of an FMU for Co-Simulation cannot be set.
"""

from __future__ import annotations

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.fmi.calls import Buffer, address
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.fmi.description import read_interface

MAX_EVENT_ITERATIONS = 100  # limit of the event iterations at the start


class ExchangeFmu(RunningFmu):
    """A running FMU for Model Exchange."""

    exchange = True

    def exit(self) -> None:
        """Leave initialisation mode, iterate the events of the start and enter continuous-time mode."""
        super().exit()
        for _ in range(MAX_EVENT_ITERATIONS):
            if not self.fmu.update_discrete_states()[0]:
                self.fmu.call("EnterContinuousTimeMode")
                return
        raise Problem(f"{self._label}: the discrete states do not settle at the start")

    def set_states(self, states: Buffer) -> None:
        """Set the continuous states, shape (n,)."""
        self.fmu.vector("SetContinuousStates", address(states), len(states))

    def set_time(self, time: float) -> None:
        """Set the time [s]."""
        self.fmu.set_time(time)


def open_exchange(name: str, fmu: Location | None) -> ExchangeFmu:
    """Open the FMU of a component for Model Exchange; raise Problem if the FMU does not support it."""
    if fmu is None:
        raise Problem(f"{name}: expected an FMU file, got none")
    interface = read_interface(fmu, exchange=True)
    if not (interface.states or interface.stateless):
        raise Problem(f"{name} ({fmu}): expected a list of its continuous states, got none")
    return ExchangeFmu(name, interface, fmu)
