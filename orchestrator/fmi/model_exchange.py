"""FMU instance for Model Exchange, in which states and time can be set.

The linearisation needs Model Exchange because the states of an FMU for Co-Simulation cannot be set. Time
derivatives of states are variables, which `RunningFmu.reader` reads.
"""

from __future__ import annotations

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.fmi.calls import Buffer, address
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.fmi.description import read_interface

MAX_EVENT_ITERATIONS = 100  # most event iterations after the initialisation


class ExchangeFmu(RunningFmu):
    """A running FMU for Model Exchange."""

    exchange = True

    def exit(self) -> None:
        """Leave initialisation mode, iterate the events, enter continuous-time mode."""
        super().exit()
        for _ in range(MAX_EVENT_ITERATIONS):
            if not self.fmu.update_discrete_states()[0]:
                self.fmu.call("EnterContinuousTimeMode")
                return
        expected = f"expected at most {MAX_EVENT_ITERATIONS} event iterations after the initialisation"
        raise Problem(f"{self._label}: {expected}, got more: the discrete states do not settle")

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
