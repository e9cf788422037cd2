"""An FMU for Model Exchange as a component of a co-simulation: a solver integrates it over each step.

Its continuous inputs are polynomials of time inside a step; the master gives their values and derivatives, or
the inputs that the FMU declares as their time derivatives do.
The method restarts at each step, and at the events of the FMU. When an input that is not continuous changes,
at a communication point, there is an event, too. If all components of the system go through events together,
a step ends before an event (`AtEvent`); else events take place inside of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import AtEvent, Problem
from orchestrator.base.files import Location
from orchestrator.data.table import Array
from orchestrator.engine.c_library import Binding
from orchestrator.engine.integration import Integration, Solver, known
from orchestrator.engine.plant import Plant
from orchestrator.engine.radau import Radau
from orchestrator.fmi.calls import Buffer, Call
from orchestrator.fmi.interface import CAPABILITIES
from orchestrator.fmi.model_exchange import ExchangeFmu, check_states
from orchestrator.ssp.system import Component, System

DEGREE = 3  # of the polynomial of an input, at most
TOLERANCE = 1e-8  # of the solver, relative, if neither the user nor the FMU has one
SAME_TIME = 1e-9  # of a step: an event that is closer to its end takes place there


@dataclass
class SavedState:
    """What an FMU goes back to.

    fmu      its own saved state; None if it has no function for that
    events   number of those that took place inside of steps so far
    sides    see `_Stepped`
    """

    fmu: Any
    time: float
    x: Array
    v: Array
    next_event: float
    events: int
    sides: NDArray[np.bool_]


class SteppedFmu(ExchangeFmu):
    """A running FMU for Model Exchange that masters step like one for Co-Simulation.

    stops   steps end before an event
    """

    event_mode, stops = True, False

    def __init__(self, component: Component, fmu: Location) -> None:
        face = component.interface
        check_states(component.name, fmu, face)
        binding = Binding()
        super().__init__(component.name, face, fmu, binding.restore_environment)
        system = System(component.name, {component.name: component})
        self._plant = Plant(system, running={self.name: self}, binding=binding)
        self._saves = face.model.interfaces[face.kind].declares(*CAPABILITIES["rollback"])
        self._course = np.zeros((DEGREE + 1, len(self._plant.inputs)))  # coefficients of the inputs
        self._row = {port.variable: i for i, port in enumerate(self._plant.inputs)}
        self._rates = [*self._declared_rates()]
        self._integration: _Stepped | None = None

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment; times in [s]."""
        super().setup(start, stop, tolerance)
        self._start, self._tolerance = start, tolerance or TOLERANCE

    def exit(self) -> None:
        """Leave initialisation mode, with the first event; ends in continuous-time mode."""
        super().exit()
        self._plant.begin(self._start)
        self._time, self.next_event = self._start, self._plant.next_event
        self._integration = _Stepped(self, self._plant, self._tolerance, self._course)

    # ---- variables

    def _declared_rates(self) -> Iterator[tuple[int, int, int]]:
        """Order of a derivative, its input, and the input that is the derivative."""
        rate_of = self.interface.rate_inputs
        for name, row in self._row.items():
            rate, order = rate_of.get(name), 1
            while rate in self._row and order <= DEGREE:
                yield order, row, self._row[rate]
                rate, order = rate_of.get(rate), order + 1

    def input_degree(self, variable: str, degree: int) -> int:
        """The highest degree, up to `degree`, of a polynomial that the FMU accepts as input."""
        return degree if variable in self._row else 0

    def outputs_with_derivatives(self, outputs: Sequence[str]) -> Sequence[str]:
        """None: masters take differences."""
        return outputs[:0]

    def input_derivative_writer(
        self, variables: Sequence[str], derivatives: Buffer, orders: Sequence[int] = ()
    ) -> Call:
        """A call that sets time derivatives of inputs from the next step on; orders: default all 1."""
        orders = orders or [1] * len(variables)
        places = np.array(orders), np.array([self._row[v] for v in variables])
        divisors = np.array([factorial(order) for order in orders])
        self._rates = [rate for rate in self._rates if rate[1] not in places[1]]

        def set_derivatives() -> None:
            self._course[places] = derivatives / divisors

        return set_derivatives

    # ---- steps

    def step(self, t: float, h: float) -> None:
        """Advance from t to t + h [s]; raises Ended with the time at which the FMU ends the simulation."""
        integration = self._running
        self._begin_course()
        # an event may have taken place a rounding error after the end of the last step
        try:
            self._time = integration.over(max(t, self._time), t, h)
        except AtEvent as stop:
            self._time = stop.reached
            raise
        if self._plant.ended:
            raise self.ended_at(self._time)

    @property
    def _running(self) -> _Stepped:
        """The integration; raises Problem if the FMU is closed, whose functions C must not call."""
        self.fmu.check_open()
        assert self._integration is not None
        return self._integration

    def _begin_course(self) -> None:
        """Read the inputs, which masters set in the FMU."""
        self._plant.read()
        self._course[0] = self._plant.v
        for order, of, rate in self._rates:
            self._course[order, of] = self._plant.v[rate] / factorial(order)

    # ---- event mode

    def update(self) -> tuple[bool, bool, float]:
        """One event iteration, see `FmuInstance.update_discrete_states`."""
        result = super().update()
        self._plant.next_event = self.next_event
        return result

    def leave_events(self) -> None:
        """Leave event mode, ready for a step."""
        self._plant.leave_events()
        self._plant.read()
        self.in_events = False
        self._running.restart()

    def event_alone(self, write: Call) -> None:
        """An event of this FMU alone, in which variables are set."""
        self._plant.read()
        self._running.happened.append((self._time, ()))
        super().event_alone(write)

    @property
    def happened(self) -> Sequence[float]:
        """Times of the events that took place inside of steps, or of this FMU alone [s]."""
        return [t for t, _ in self._integration.happened] if self._integration else []

    # ---- rollback

    def save(self, state: SavedState | None = None) -> SavedState:
        """Save the state, over an earlier one if there is one; free it with `free_state`."""
        integration = self._running
        plant, before = self._plant, state.fmu if state else None
        plant.read()
        return SavedState(
            self.fmu.save(before) if self._saves else None,
            *(self._time, plant.x.copy(), plant.v.copy()),
            *(plant.next_event, len(integration.happened), integration.sides),
        )

    def restore(self, state: SavedState) -> None:
        """Restore a saved state."""
        integration = self._running
        if self._saves:
            self.fmu.restore(state.fmu)
        elif len(integration.happened) != state.events:
            expected = "expected an FMU that can save its state, to repeat a step with an event"
            raise Problem(self.log.error_message("going back", expected))
        self._time, self._plant.next_event = state.time, state.next_event
        self.next_event, integration.sides = state.next_event, state.sides
        del integration.happened[state.events :]
        self._course[0], self._course[1:] = state.v, 0.0
        integration.evaluate(state.time, state.x)

    def saved(self) -> dict[str, Any]:
        """Its state and that of its integration, as arrays, for another process."""
        integration, radau = self._running, self._running.radau
        parts = {f"memory_{k}": part for k, part in enumerate(self._plant.memory())}
        parts |= {f"radau_{n}": v for n, v in vars(radau).items() if n != "_of"} if radau else {}
        mine = {"time": self._time, "course": self._course, "sides": integration.sides}
        happened = {"happened": np.array(self.happened, float), "next_of_plant": self._plant.next_event}
        return {**super().saved(), **parts, **mine, **happened}

    def resume(self, saved: Mapping[str, Any]) -> None:
        """Go on from a state of `saved`."""
        super().resume(saved)
        integration = self._running
        for k, part in enumerate(self._plant.memory()):
            part[:] = saved[f"memory_{k}"].view(part.dtype)
        self._time, self._course[:] = float(saved["time"]), saved["course"]
        self._plant.next_event = float(saved["next_of_plant"])
        integration.restart()
        integration.sides = saved["sides"]
        integration.happened[:] = [(t, ()) for t in saved["happened"].tolist()]
        radau = {n.removeprefix("radau_"): v for n, v in saved.items() if n.startswith("radau_")}
        if radau:
            integration.radau = Radau(integration)
            vars(integration.radau).update({n: v if v.ndim else v.item() for n, v in radau.items()})

    def free_state(self, state: Any) -> None:
        """Free a saved state."""
        if self._saves:
            super().free_state(state.fmu)


class _Stepped(Integration):
    """Integration over one step after the other.

    sides   event indicators that were positive at the end of the last step
    """

    def __init__(self, fmu: SteppedFmu, plant: Plant, tolerance: float, course: Array) -> None:
        """course: coefficients of the inputs, by power of time since the start of the step."""
        super().__init__(plant, tolerance, 0.0)
        self._fmu, self._course, self._begin = fmu, course, 0.0
        self.radau: Radau | None = None
        self.sides = self._sides_now()

    def evaluate(self, t: float, x: Array) -> None:
        """Evaluate the plant at a time [s] and a state, with the inputs of that time."""
        self.plant.external[:] = (t - self._begin) ** np.arange(DEGREE + 1) @ self._course
        self.plant.settle_at(t, x)

    def solver(self, t: float, x: Array, target: float) -> Solver:
        """A solver that begins at a time [s] and a state."""
        self.radau = self.radau or Radau(self)
        return self.radau.toward(target, t, x)

    def event(self, t: float, x: Array) -> Array:
        """Event mode at a time; the states after it. The FMU may change magnitudes there."""
        self.radau = None
        if self._fmu.stops:
            self.settle(t, x)
            raise AtEvent(t)
        return super().event(t, x)

    def _step_event(self, t: float, x: Array) -> Array | None:
        """As of any integration; one that changes anything ends the step, as other events do."""
        stops, self._fmu.stops = self._fmu.stops, False
        try:
            after = super()._step_event(t, x)
        finally:
            self._fmu.stops = stops
        if after is not None and stops and not self.plant.ended:
            self.happened.pop()  # it is that of all components
            raise AtEvent(t)
        return after

    def restart(self) -> None:
        """Begin anew after an event of the FMU."""
        self.radau, self._at = None, (np.nan, b"")
        self.sides = self._sides_now()

    def over(self, t: float, begin: float, h: float) -> float:
        """Integrate from t to the end of the step [s]; returns the time there, that of the end at most."""
        self._begin, self.same, self._at = begin, SAME_TIME * h, (np.nan, b"")
        x = self.plant.x.copy()
        if len(self.sides):  # an input may have jumped over a state event
            self.settle(t, x)
            x = self.event(t, x) if (self._sides_now() != self.sides).any() else x
        t, x = self.run(t, x, begin + h)
        self.settle(t, x)
        self.sides = self._sides_now()
        return t

    def _sides_now(self) -> NDArray[np.bool_]:
        return known(self.plant, self._fmu.log.time, self.plant.indicators()) > 0.0
