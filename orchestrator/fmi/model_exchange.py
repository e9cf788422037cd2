"""One instance of an FMU for Model Exchange: states and time are set, time derivatives are read.

Co-Simulation would do for the derivatives alone, but there nobody can choose the states.
"""

from __future__ import annotations

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.fmi.calls import Buffer, address
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.fmi.description import read_interface

MAX_EVENT_ITERATIONS = 100  # of event iteration; a model that wants more never settles


class ExchangeFmu(RunningFmu):
    """An FMU whose states are set from outside; variables are read and set as those of any FMU."""

    exchange = True

    def exit(self) -> None:
        """Leave initialisation mode, handle the events of the start, and be ready to be asked."""
        super().exit()
        for _ in range(MAX_EVENT_ITERATIONS):
            if not self.fmu.update_discrete_states()[0]:
                self.fmu.call("EnterContinuousTimeMode")
                return
        raise Problem(f"{self._label}: its discrete states do not settle at the start")

    def set_states(self, states: Buffer) -> None:
        """Set the continuous states, shape (n,)."""
        self.fmu.vector("SetContinuousStates", address(states), len(states))

    def set_time(self, time: float) -> None:
        """Set the time [s]."""
        self.fmu.set_time(time)


def open_exchange(name: str, fmu: Location | None) -> ExchangeFmu:
    """An instance of a component's FMU for Model Exchange; raises Problem where it is not made for it."""
    if fmu is None:
        raise Problem(f"{name}: has no FMU file")
    face = read_interface(fmu, exchange=True)
    if not (face.states or face.stateless):
        raise Problem(f"{name} ({fmu}): expected a list of its continuous states, got none")
    return ExchangeFmu(name, face, fmu)
