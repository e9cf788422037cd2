"""FMU instance for Model Exchange, in which states and time can be set.

Linearisation and monolithic solution need Model Exchange, because the states of an FMU for Co-Simulation
cannot be set. Time derivatives of states are variables, which `RunningFmu.reader` reads.
"""

from __future__ import annotations

import ctypes

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.fmi.calls import Buffer, address
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.fmi.description import read_interface


class ExchangeFmu(RunningFmu):
    """A running FMU for Model Exchange: in event mode after `exit`."""

    exchange = True

    def enter_event_mode(self) -> None:
        """From continuous-time mode."""
        self.fmu.call("EnterEventMode")

    def enter_continuous_time_mode(self) -> None:
        """From event mode."""
        self.fmu.call("EnterContinuousTimeMode")

    def completed_step(self) -> tuple[bool, bool]:
        """Tell that a step of the solver is accepted: (event needed, end of the simulation)."""
        if not self.interface.completed_step:
            return False, False
        event, ends = self.fmu.flag(), self.fmu.flag()
        results = ctypes.byref(event), ctypes.byref(ends)
        self.fmu.call("CompletedIntegratorStep", self.fmu.flag(True), *results)
        return bool(event.value), bool(ends.value)

    def get_event_indicators(self, into: Buffer) -> None:
        """Get the event indicators, shape (n,)."""
        self.fmu.vector("GetEventIndicators", address(into), len(into))

    def set_states(self, states: Buffer) -> None:
        """Set the continuous states, shape (n,)."""
        self.fmu.vector("SetContinuousStates", address(states), len(states))

    def set_time(self, time: float) -> None:
        """Set the time [s]."""
        self.fmu.set_time(time)


def open_exchange(name: str, fmu: Location | None) -> ExchangeFmu:
    """Open the FMU of a component for Model Exchange.

    Raises Problem if there is no FMU file, or if the FMU does not support Model Exchange or does not list all
    its continuous states.
    """
    if fmu is None:
        raise Problem(f"{name}: expected an FMU file, got none")
    interface = read_interface(fmu, exchange=True)
    if not (interface.states or interface.stateless):
        raise Problem(
            f"{name} ({fmu}): expected a modelDescription.xml that lists all continuous states and their"
            " derivatives, got none or an incomplete list"
        )
    return ExchangeFmu(name, interface, fmu)
