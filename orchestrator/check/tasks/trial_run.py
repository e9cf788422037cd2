"""One simulation run of the FMU that a probe works on, the same for Co-Simulation and Model Exchange.

Model Exchange is integrated with the explicit Runge-Kutta method of Bogacki and Shampine, order 3(2) with
step-size control and four stages. The last stage of a step is the first stage of the next one.
"""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orchestrator.base.numerals import integer
from orchestrator.base.processes import FLOAT64
from orchestrator.check.tasks.runner import InstanceOptions, Trial
from orchestrator.fmi.calls import address
from orchestrator.fmi.clocks import ClockCalls, Schedule
from orchestrator.fmi.description import FLOATS, MAX_LOCALS, Entry, FmuVariable, ModelDescription
from orchestrator.fmi.instance import MAX_EVENT_ITERATIONS, CallFailed, FmuInstance, Unsettled, settle
from orchestrator.fmi.library import Library
from orchestrator.fmi.messages import DISCARD, ERROR

Vector = NDArray[np.float64]
Rows = Sequence[Vector]
MAX_INNER_STEPS = 12  # integrator steps per communication step: enough to change the states of a stiff model
TOLERANCE = 1e-4  # relative tolerance of the integrator
PATTERN = np.array([1.0, -0.5, 0.25, -1.0, 0.5, 0.0, 0.75, -0.25])  # perturbation of the inputs, step by step
PERTURBATION = 1e-3  # relative to the magnitude of an input: small, because the valid range is unknown
ROUNDING = 1e-13  # relative to nominal; smaller outputs are read as zero
MAX_LISTED = 5  # inputs listed in a message
TOLERANCE_OF_TIME = 1e-11  # of an event [s], as in a run


# ---- variables and default experiment


def numeric(description: ModelDescription, *causalities: str) -> list[FmuVariable]:
    """Numeric variables of these causalities that belong to no clock: they can be read at any time."""
    return [v for v in description.of(*causalities) if v.is_number and not v.clocked]


def observed(description: ModelDescription) -> list[FmuVariable]:
    """The outputs; if there are none, local variables that change during a run."""
    local = [v for v in numeric(description, "local") if v.variability in ("continuous", "discrete")]
    return numeric(description, "output") or local[:MAX_LOCALS]


def continuous_inputs(description: ModelDescription) -> list[FmuVariable]:
    """Real inputs that may be set at any time."""
    inputs = numeric(description, "input")
    return [v for v in inputs if v.is_continuous]


def inner_step(description: ModelDescription) -> float:
    """The fixed internal step [s], by which the time inside the FMU may lag; 0 if unknown."""
    return description.interfaces.get("CoSimulation", Entry()).number("fixedInternalStepSize") or 0.0


def usual_step(description: ModelDescription) -> float:
    """Communication step [s]: as declared, else a 500th of the default experiment, else 10 ms."""
    start, stop = (description.experiment.number(name) for name in ("startTime", "stopTime"))
    length = 1e-2 if stop is None or not stop > (start or 0.0) else (stop - (start or 0.0)) / 500
    return description.experiment.number("stepSize") or inner_step(description) or length


# ---- values of variables


class VariableValues:
    """Values of some numeric variables of an instance, read and set together; arrays are flattened."""

    def __init__(self, trial: Trial, instance: FmuInstance, variables: Sequence[FmuVariable]) -> None:
        self.trial, self.instance, self.variables = trial, instance, list(variables)
        self.names, self.elements = scalars(variables), flat(variables)
        types = [v.function_type for v in variables]
        self._groups: list[tuple[str, NDArray[np.intp], NDArray[Any], tuple[Any, ...]]] = []
        for type_ in dict.fromkeys(types):
            references = [v.reference for v, t in zip(variables, types, strict=True) if t == type_]
            places = np.flatnonzero(np.repeat(np.equal(types, type_), [v.size for v in variables]))
            buffer = np.zeros(len(places), instance.types[type_])
            values = instance.values(address(buffer), len(places))
            self._groups.append((type_, places, buffer, (*instance.references(references), *values)))

    @cached_property
    def nominal(self) -> Vector:
        """Nominal value of each element."""
        return np.array([v.magnitude for v in self.elements])

    @cached_property
    def scale(self) -> Vector:
        """Typical magnitude of each element."""
        return np.array([v.scale for v in self.elements])

    def get(self) -> Vector:
        """Values in the order of the variables."""
        result = np.zeros(len(self.names))
        for type_, places, buffer, arguments in self._groups:
            self.instance.call(f"Get{type_}", *arguments)
            result[places] = buffer
        return result

    def set(self, values: ArrayLike) -> None:
        """Set all values; those of integers and booleans are truncated."""
        if not self.names:
            return
        x = np.asarray(values, float)
        pairs = zip(self.names, x.tolist(), strict=True)
        self.trial.activity.inputs(", ".join(f"{name} = {value:.6g}" for name, value in pairs))
        for type_, places, buffer, arguments in self._groups:
            buffer[:] = x[places] if type_ in FLOATS else np.trunc(x[places])
            self.instance.call(f"Set{type_}", *arguments)


def scalars(variables: Sequence[FmuVariable]) -> list[str]:
    """Names of the scalar elements of some variables."""
    return [name for v in variables for name in v.elements]


def flat(variables: Sequence[FmuVariable]) -> list[FmuVariable]:
    """For each scalar element its variable."""
    return [v for v in variables for _ in range(v.size)]


def not_finite(names: Sequence[str], rows: Rows) -> str:
    """Message about the first value that is not finite; empty if all are."""
    suspects = (row for row in rows if not np.isfinite(row).all())
    values = ((n, x) for row in suspects for n, x in zip(names, row, strict=True))
    return next((f"{n} is {x:g}" for n, x in values if not math.isfinite(x)), "")


def difference(trial: Trial, expected: Rows, rows: Rows) -> str:
    """Message about the first difference of bits between two runs; empty if there is none."""
    names = scalars(observed(trial.description))
    inputs = scalars(continuous_inputs(trial.description)) if trial.perturbable else []
    more = f" and {len(inputs) - MAX_LISTED} more" if len(inputs) > MAX_LISTED else ""
    changing = f", while {', '.join(inputs[:MAX_LISTED])}{more} changed" if inputs else ""
    for n, (a, b) in enumerate(zip(map(np.asarray, expected), map(np.asarray, rows), strict=False), 1):
        different = np.flatnonzero(a.view(np.int64) != b.view(np.int64))
        if len(different):
            i = different[0]
            return f"{names[i]} is {b[i]:.17g} instead of {a[i]:.17g} after step {n}{changing}"
    return f"{len(rows)} steps instead of {len(expected)}{changing}" if len(expected) != len(rows) else ""


def severity(trial: Trial, expected: Rows, rows: Rows) -> str:
    """ "error" if two runs differ by more than the tolerance of the FMU, "warning" if by less."""
    if len(expected) != len(rows):
        return "error"
    x, nominal = np.array(expected), [v.magnitude for v in flat(observed(trial.description))]
    tolerance = trial.description.experiment.number("tolerance") or TOLERANCE
    near = np.abs(x - np.array(rows)) <= tolerance * np.maximum(np.abs(x), nominal)
    return "warning" if near.all() else "error"


# ---- model exchange


class Integrator:
    """Model Exchange: the continuous states of an instance, its events, and explicit integration steps.

    ended        the FMU asked to end the simulation
    next_event   time of the next time event [s]
    step_size    of the next integrator step [s]; 0 before the first one
    """

    def __init__(self, instance: FmuInstance, description: ModelDescription) -> None:
        self.instance, self.ended = instance, False
        self.count = len(description.structure["derivatives"])
        self.indicators = integer(description.get("numberOfEventIndicators", "0"))
        if instance.fmi == 3:
            self.count = self._size("GetNumberOfContinuousStates")
            self.indicators = self._size("GetNumberOfEventIndicators")
        self.time, self.next_event, self.step_size = 0.0, math.inf, 0.0
        self.nominal = np.ones(self.count)

    def _size(self, function: str) -> int:
        value = ctypes.c_size_t(0)
        self.instance.call(function, ctypes.byref(value))
        self.instance.check_size(f"a vector by {function}", FLOAT64 * value.value)
        return value.value

    def begin(self, time: float) -> None:
        """Leave the event mode after initialisation and enter continuous-time mode."""
        self.time = time
        self._iterate()
        nominals = np.abs(self.nominals())
        self.nominal = np.where(nominals == 0, 1.0, nominals)

    def _vector(self, function: str, count: int) -> Vector:
        """The vector that a function returns, shape (count,)."""
        result = np.zeros(count)
        self.instance.vector(function, address(result), count)
        return result

    def nominals(self) -> Vector:
        """Nominal values of the states."""
        return self._vector("GetNominalsOfContinuousStates", self.count)

    def _iterate(self) -> None:
        """Update discrete states until none changes, and enter continuous-time mode."""
        update = {"the FMU": self.instance.update_discrete_states}
        ended, times = settle("the event iteration does not end", update)
        self.ended, self.next_event = self.ended or bool(ended), times["the FMU"]
        self.instance.call("EnterContinuousTimeMode")

    # ---- the state vector

    def states(self) -> Vector:
        """The continuous states."""
        return self._vector("GetContinuousStates", self.count)

    def set_time_and_states(self, time: float, x: Vector) -> None:
        """Set time and continuous states."""
        self.instance.set_time(time)
        self.set_states(x)

    def set_states(self, x: Vector) -> None:
        """Set the continuous states."""
        self.instance.vector("SetContinuousStates", address(x), self.count)

    def derivatives_at(self, time: float, x: Vector) -> Vector:
        """Derivatives of the continuous states at a time and at states."""
        self.set_time_and_states(time, x)
        return self._vector("GetContinuousStateDerivatives", self.count)

    def _signs(self) -> bytes:
        """Signs of the event indicators."""
        return (self._vector("GetEventIndicators", self.indicators) > 0).tobytes()

    # ---- steps

    def advance(self, length: float, max_steps: int) -> None:
        """Integrate over `length` [s], but at most `max_steps` integrator steps."""
        end = self.time + length
        for _ in range(max_steps):
            if self.ended or self.time >= end:
                return
            signs = self._signs()
            self._step(max(min(end, self.next_event) - self.time, 0.0))
            event, terminate = self.instance.flag(), self.instance.flag()
            results = ctypes.byref(event), ctypes.byref(terminate)
            self.instance.call("CompletedIntegratorStep", self.instance.flag(True), *results)
            self.ended = bool(terminate.value)
            if event.value or self.time >= self.next_event or signs != self._signs():
                self.instance.call("EnterEventMode")
                self._iterate()

    def _step(self, limit: float) -> None:
        """One accepted step of at most `limit` [s]."""
        x = self.states()
        if not self.count or limit == 0.0:
            self.time += limit
            self.set_time_and_states(self.time, x)
            return
        h = min(limit, self.step_size or 1e-3 * limit)
        while True:
            new, error = self._try(x, h)
            growth = 0.9 * error ** (-1 / 3) if error > 0 else 5.0
            if error <= 1.0:
                break
            h *= max(0.1, min(growth, 0.5))
            if h < 1e-14 * max(limit, abs(self.time)):
                raise CallFailed("the integration with explicit steps fails: no step is short enough", ERROR)
        self.step_size = h * min(5.0, growth)
        self.time = limit + self.time if h == limit else self.time + h
        self.set_time_and_states(self.time, new)

    def _try(self, x: Vector, h: float) -> tuple[Vector, float]:
        """States after h, and error over tolerance: infinite if not finite or if the FMU discards a call."""
        try:
            k1 = self.derivatives_at(self.time, x)
            k2 = self.derivatives_at(self.time + 1 / 2 * h, x + 1 / 2 * h * k1)
            k3 = self.derivatives_at(self.time + 3 / 4 * h, x + 3 / 4 * h * k2)
            new = x + h / 9 * (2 * k1 + 3 * k2 + 4 * k3)
            k4 = self.derivatives_at(self.time + h, new)
        except CallFailed as failure:
            if failure.status != DISCARD:
                raise
            return x, math.inf
        difference = np.abs(h / 72 * (-5 * k1 + 6 * k2 + 8 * k3 - 9 * k4))
        error = float(np.max(difference / (TOLERANCE * np.maximum(np.abs(x), self.nominal))))
        return new, error if math.isfinite(error) else math.inf


# ---- event mode of co-simulation


class EventMode:
    """Co-Simulation of FMI 3.0 with event mode: the events of an instance, and ticks of clocks by time.

    sampled     name -> latest value of the outputs of these clocks, which are read at a tick only
    announced   time of the next event that the FMU has announced [s]
    """

    def __init__(self, trial: Trial, instance: FmuInstance, start: float) -> None:
        """In initialisation mode, at its end."""
        self._instance, self._calls = instance, ClockCalls(instance, "the FMU")
        self._schedule, self._outputs = Schedule(start), dict[FmuVariable, VariableValues]()
        self._calls.ask(trial.description.of("input"))
        outputs = [v for v in trial.description.of("output") if v.is_number]
        for clock in (v for v in trial.description.of("input") if v.kind == "Clock"):
            self._schedule.add(clock, self._calls, clock)
            of_clock = [v for v in outputs if clock.reference in v.clocks]
            self._outputs[clock] = VariableValues(trial, instance, of_clock)
        self.sampled, self.announced = dict[str, float](), math.inf

    @property
    def next(self) -> float:
        """Time of the next event that the FMU has announced, or of the next tick [s]."""
        return min(self.announced, self._schedule.next)

    def pass_through(self, time: float) -> bool:
        """An event at the end of a step, or of initialisation; True if the FMU ends the simulation."""
        for _ in range(MAX_EVENT_ITERATIONS):
            for clock in (due := self._schedule.begin(time, TOLERANCE_OF_TIME)):
                self._calls.tick(clock)
            for values in (self._outputs[clock] for clock in due):
                self.sampled |= zip(values.names, values.get().tolist(), strict=True)
            update = {"the FMU": self._instance.update_discrete_states}
            ended, times = settle("the event iteration does not end", update)
            self._schedule.finish()
            self.announced = times["the FMU"]
            self._instance.call("EnterStepMode")
            if ended or self._schedule.next > time + TOLERANCE_OF_TIME:
                return bool(ended)
            self._instance.call("EnterEventMode")
        raise Unsettled(f"t = {time:.9g} s: expected time to pass between ticks, got {MAX_EVENT_ITERATIONS}")

    def bookmark(self) -> list[Any]:
        """What a saved FMU state does not have."""
        return [self.announced, self._schedule.saved()]

    def return_to(self, bookmark: Sequence[Any]) -> None:
        """Go on from a bookmark."""
        self.announced, ticks = bookmark
        self._schedule.resume(ticks)


# ---- a run


class Simulation:
    """One run of one instance: initialise, change inputs, advance, read outputs.

    summed           communication points are the sum of the steps, with rounding, instead of start + n h
    reached          the time that the FMU reports after a step [s]
    early            the FMU returned early from the last step
    initial_inputs   values of the inputs after initialisation
    integrator       in Model Exchange, after initialisation
    events           in Co-Simulation with event mode, after initialisation
    """

    def __init__(
        self,
        trial: Trial,
        start: float | None = None,
        stop: float | None = None,
        step: float | None = None,
        summed: bool | None = None,
        inputs: Sequence[FmuVariable] | None = None,
        kind: str = "",
        library: Library | None = None,
        **options: Unpack[InstanceOptions],
    ) -> None:
        """`library`: of another copy of the FMU; `options`: of the instance."""
        self.trial, description = trial, trial.description
        self.kind = kind or trial.kind
        self.instance = trial.instance(self.kind, library, **options)
        self.start = description.experiment.number("startTime") or 0.0 if start is None else start
        self.stop, self.step = stop, step or usual_step(description)
        self.summed = trial.summed if summed is None else summed
        self.time, self.step_count, self.reached = self.start, 0, self.start
        self.inputs = self.values(continuous_inputs(description) if inputs is None else inputs)
        self.outputs = self.values(observed(description))
        self.integrator: Integrator | None = None
        self.events: EventMode | None = None
        self._ended = self.early = self._asks = False
        self.initial_inputs = np.zeros(0)

    def values(self, variables: Sequence[FmuVariable]) -> VariableValues:
        """Access to the values of some variables of this instance."""
        return VariableValues(self.trial, self.instance, variables)

    @property
    def ended(self) -> bool:
        """The FMU asked to end the simulation."""
        return self._ended or (self.integrator is not None and self.integrator.ended)

    def initialise(self) -> Simulation:
        """Enter and leave initialisation mode; Model Exchange is in event mode afterwards."""
        self.instance.setup(self.start, self.stop)
        self.instance.enter()
        self.leave()
        return self

    def leave(self) -> None:
        """Leave initialisation mode; with event mode the FMU is in it afterwards."""
        self.events = EventMode(self.trial, self.instance, self.start) if self.instance.events else None
        self.instance.leave()

    def begin(self) -> Simulation:
        """Initialise, and be ready for steps."""
        self.initialise().begin_steps()
        return self

    def begin_steps(self) -> None:
        """After initialisation mode, be ready for steps."""
        self.time, self.step_count = self.start, 0
        self.instance.log.time = self.start
        if self.kind == "ModelExchange":
            self.integrator = Integrator(self.instance, self.trial.description)
            self.integrator.begin(self.start)
        if self.events:
            self._ended = self.events.pass_through(self.start)
        self.initial_inputs = self.inputs.get()

    def perturb(self, step: int | None = None) -> None:
        """Change all inputs a little, by a fixed pattern over the steps."""
        n = self.step_count if step is None else step
        inputs = self.inputs.elements
        pattern = PATTERN[(n + 3 * np.arange(len(inputs))) % len(PATTERN)]
        perturbed = self.initial_inputs + PERTURBATION * self.inputs.scale * pattern
        low, high = np.reshape([v.bounds for v in inputs], (-1, 2)).T
        self.inputs.set(np.clip(perturbed, low, high))

    def do_step(self, time: float, length: float) -> None:
        """One communication step; raises CallFailed unless the FMU completes it or ends the simulation."""
        self.early, status = False, self.instance.step(time, length)
        if self.instance.fmi == 3 or status == DISCARD:
            end = self.instance.step_end(status)
            self._ended, self.early, self._asks = end.terminate, end.early, end.event
            self.reached = time + length if math.isnan(end.reached) else end.reached
        else:
            self.reached = time + length
        if status and not (status == DISCARD and self._ended):
            self.instance.check_status(status, self.instance.describe_call("DoStep"))

    def advance(self) -> None:
        """One communication step; in Model Exchange at most MAX_INNER_STEPS integrator steps."""
        self.step_count += 1
        if self.integrator is not None:
            self.integrator.advance(self.step, MAX_INNER_STEPS)
            self.time = self.integrator.time
            return
        end = self.time + self.step if self.summed else self.start + self.step_count * self.step
        divides = self.trial.interface.declares("canHandleVariableCommunicationStepSize")
        events = self.events if divides else None
        while events and not self._ended and self.time < events.next < end - TOLERANCE_OF_TIME:
            self._step_to(events.next, events.next - self.time)
        if not self._ended:
            self._step_to(end, self.step if end - self.time > 0.5 * self.step else end - self.time)

    def _step_to(self, end: float, length: float) -> None:
        """One step, and an event at its end, if there is one."""
        self.do_step(self.time, length)
        self.time = end
        if self.events and (self._asks or self.events.next <= end + TOLERANCE_OF_TIME):
            self.instance.call("EnterEventMode")
            self._ended = self.events.pass_through(end) or self._ended

    def row(self) -> Vector:
        """Outputs; values below rounding error relative to nominal are read as 0, and -0 as 0."""
        values = self.outputs.get()
        values[np.abs(values) <= ROUNDING * self.outputs.nominal] = 0.0
        return values

    def run(self, count: int, perturb: bool = False, seconds: float = math.inf) -> list[Vector]:
        """Rows after each of `count` steps, or of as many steps as fit into `seconds` of wall time."""
        rows: list[Vector] = []
        deadline = time.monotonic() + seconds
        while len(rows) < count and not self.ended and (time.monotonic() < deadline or not rows):
            if perturb:
                self.perturb()
            self.advance()
            rows.append(self.row())
        return rows

    def bookmark(self) -> tuple[Any, ...]:
        """The state of the run outside of the FMU, to continue from a saved FMU state."""
        e = self.integrator
        inner = (e.time, e.next_event, e.step_size, e.nominal.tolist()) if e else None
        return self.step_count, self.time, inner, self.events and self.events.bookmark()

    def return_to(self, bookmark: Sequence[Any]) -> None:
        """Continue from a bookmark."""
        self.step_count, self.time, inner, events = bookmark
        if self.events and events is not None:
            self.events.return_to(events)
        if self.integrator is not None and inner is not None:
            e = self.integrator
            e.time, e.next_event, e.step_size, nominal = inner
            e.nominal = np.array(nominal)

    def close(self) -> None:
        """Terminate and free the instance."""
        self.instance.call("Terminate")
        self.instance.free()
