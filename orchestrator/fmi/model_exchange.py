"""FMU instance for Model Exchange, in which states and time can be set.

Linearisation and monolithic solution need Model Exchange, because the states of an FMU for Co-Simulation
cannot be set. Time derivatives of states are variables, which `RunningFmu.reader` reads.
"""

from orchestrator.base.errors import NotExchangeable
from orchestrator.base.files import Location
from orchestrator.fmi.calls import Buffer, ExchangeCall, address
from orchestrator.fmi.cosimulation import RunningFmu
from orchestrator.fmi.instance import AfterCall
from orchestrator.fmi.interface import MODEL_EXCHANGE, FmuInterface, read_interface


class ExchangeFmu(RunningFmu):
    """A running FMU for Model Exchange: in event mode after `exit`."""

    def exchange_call(self, function: str, values: Buffer) -> ExchangeCall:
        """A call of SetTime, CompletedIntegratorStep, or a function of a vector, with these values."""
        return ExchangeCall(self.fmu.bound(function), values)

    def get_nominals(self, into: Buffer) -> None:
        """Get the nominal values of the states, shape (n,)."""
        self.fmu.vector("GetNominalsOfContinuousStates", address(into), len(into))


def open_exchange(name: str, fmu: Location | None, after: AfterCall = None) -> ExchangeFmu:
    """Open the FMU of a component for Model Exchange; `after`: see `FmuInstance`.

    Raises NotExchangeable if there is no FMU file, or if the FMU does not support Model Exchange or does not
    list all its continuous states.
    """
    if fmu is None:
        raise NotExchangeable(f"{name}: expected an FMU file, got none")
    interface = read_interface(fmu, MODEL_EXCHANGE)
    check_states(name, fmu, interface)
    return ExchangeFmu(name, interface, fmu, after)


def check_states(name: str, fmu: Location, interface: FmuInterface) -> None:
    """Raise NotExchangeable if the FMU does not list all its continuous states."""
    if interface.states or interface.stateless:
        return
    states = (interface.model.state_of(v) for v in interface.model.derivatives)
    if array := next((s.name for s in states if s and s.name in interface.unsupported), ""):
        raise NotExchangeable(f"{name} ({fmu}): {array} is {interface.unsupported[array]}, not supported")
    raise NotExchangeable(
        f"{name} ({fmu}): expected a modelDescription.xml that lists all continuous states and their"
        " derivatives, got none or an incomplete list"
    )
