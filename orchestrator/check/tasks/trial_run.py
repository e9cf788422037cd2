"""One run of an FMU under trial, Co-Simulation and Model Exchange alike.

In Model Exchange an explicit integrator with step control moves the model: Bogacki and Shampine, order 3(2),
of four stages, the last of which is the first of the next step.
"""

from __future__ import annotations

import ctypes
import math
import struct
import time
from collections.abc import Sequence
from typing import Any

from orchestrator.check.tasks.runner import Trial
from orchestrator.fmi.instance import CallFailed, FmuInstance
from orchestrator.fmi.messages import DISCARD, ERROR
from orchestrator.fmi.raw_description import FLOATS, DeclaredVariable, ModelDescription

Rows = list[list[float]]
INNER = 12  # inner steps of model exchange per advance: enough to move, whatever the stiffness
TOLERANCE = 1e-4  # of the inner steps
EVENTS = 100  # rounds of one event iteration
PATTERN = (1.0, -0.5, 0.25, -1.0, 0.5, 0.0, 0.75, -0.25)  # inputs move like this, step by step
PUSH = 1e-3  # of the magnitude of an input: small, because nobody knows what is allowed
ROUNDING = 1e-13  # of the nominal value: less is zero
LOCALS = 100  # variables that are watched where there is no output
SHOWN = 5  # inputs in a message


# ---- what an FMU declares, as far as running it needs


def numeric(description: ModelDescription, *causalities: str) -> list[DeclaredVariable]:
    """Numeric variables of these causalities."""
    return [v for v in description.of(*causalities) if v.is_number]


def watched(description: ModelDescription) -> list[DeclaredVariable]:
    """The outputs; without any, the local variables that change."""
    local = [v for v in numeric(description, "local") if v.variability in ("continuous", "discrete")]
    return numeric(description, "output") or local[:LOCALS]


def movable(description: ModelDescription) -> list[DeclaredVariable]:
    """Inputs that may be set at any time."""
    inputs = numeric(description, "input")
    return [v for v in inputs if v.is_float and v.variability == "continuous"]


def experiment(description: ModelDescription, name: str) -> float | None:
    """A number of the default experiment."""
    found = description.experiment
    return float(found.get(name)) if found and name in found.attributes else None


def inner_step(description: ModelDescription) -> float:
    """The fixed step [s] inside, by which the FMU's time may be late; 0 when unknown."""
    found = description.interfaces.get("CoSimulation")
    return float(found.get("fixedInternalStepSize", "0")) if found else 0.0


def usual_step(description: ModelDescription) -> float:
    """Communication step [s]: as declared, else a 500th of the default experiment, else 10 ms."""
    start, stop = (experiment(description, name) for name in ("startTime", "stopTime"))
    length = 1e-2 if stop is None or not stop > (start or 0.0) else (stop - (start or 0.0)) / 500
    return experiment(description, "stepSize") or inner_step(description) or length


# ---- rows of values


class VariableRow:
    """Some numeric variables of an instance, read and set together; arrays lie flat."""

    def __init__(self, trial: Trial, instance: FmuInstance, variables: Sequence[DeclaredVariable]) -> None:
        self.trial, self.instance, self.variables = trial, instance, list(variables)
        self.names = scalars(variables)
        groups: dict[str, tuple[list[int], list[int]]] = {}  # type -> value references, places of scalars
        place = 0
        for v in variables:
            whole = "Integer" if instance.fmi == 2 else "Int64"  # what enumerations are read as
            references, places = groups.setdefault(whole if v.type == "Enumeration" else v.type, ([], []))
            references.append(v.reference or 0)
            places += range(place, place + v.size)
            place += v.size
        self._groups = [self._group(type_, *group) for type_, group in groups.items()]

    def _group(self, type_: str, references: list[int], places: list[int]) -> tuple[str, list[int], Any, Any]:
        """Type, places, buffer, and the arguments of a call."""
        buffer = (self.instance.types[type_] * len(places))()
        given = *self.instance.references(references), *self.instance.values(buffer, len(places))
        return type_, places, buffer, given

    def get(self) -> list[float]:
        """Values in the order of the variables."""
        result = [0.0] * len(self.names)
        for type_, places, buffer, given in self._groups:
            self.instance.call(f"Get{type_}", *given)
            for place, value in zip(places, buffer, strict=True):
                result[place] = float(value)
        return result

    def set(self, values: Sequence[float]) -> None:
        """Set all; whole numbers and booleans are rounded."""
        if not self.names:
            return
        shown = zip(self.names, values, strict=True)
        self.trial.beacon.inputs(", ".join(f"{n} = {x:.6g}" for n, x in shown))
        for type_, places, buffer, given in self._groups:
            for i, place in enumerate(places):
                buffer[i] = values[place] if type_ in FLOATS else int(values[place])
            self.instance.call(f"Set{type_}", *given)


def scalars(variables: Sequence[DeclaredVariable]) -> list[str]:
    """Names of the scalars of some variables."""
    return [v.name if v.size == 1 else f"{v.name}[{i}]" for v in variables for i in range(v.size)]


def flat(variables: Sequence[DeclaredVariable]) -> list[DeclaredVariable]:
    """For each scalar its variable."""
    return [v for v in variables for _ in range(v.size)]


def bits(rows: Sequence[Sequence[float]]) -> bytes:
    """All bits of some rows, to compare: NaN equals NaN."""
    return b"".join(struct.pack(f"<{len(r)}d", *r) for r in rows)


def not_finite(names: Sequence[str], rows: Sequence[Sequence[float]]) -> str:
    """The first value that is not finite, in words; empty when there is none."""
    found = (f"{n} is {x:g}" for row in rows for n, x in zip(names, row, strict=True) if not math.isfinite(x))
    return next(found, "")


def difference(trial: Trial, first: Rows, second: Rows) -> str:
    """In words: where two runs differ first, and which inputs were moved; empty when they do not."""
    names = scalars(watched(trial.description))
    moved = scalars(movable(trial.description)) if trial.pokes else []
    more = f" and {len(moved) - SHOWN} more" if len(moved) > SHOWN else ""
    moving = f", while {', '.join(moved[:SHOWN])}{more} moved" if moved else ""
    for n, (a, b) in enumerate(zip(first, second, strict=False), 1):
        for name, x, y in zip(names, a, b, strict=True):
            if bits([[x]]) != bits([[y]]):
                return f"{name} is {y:.17g} in place of {x:.17g} after step {n}{moving}"
    return f"{len(second)} steps in place of {len(first)}{moving}" if len(first) != len(second) else ""


# ---- model exchange


class ContinuousStates:
    """The continuous states of an instance for model exchange: events, and steps of an integrator."""

    def __init__(self, instance: FmuInstance, description: ModelDescription) -> None:
        self.instance, self.ended = instance, False
        self.count = len(description.structure["derivatives"])
        self.indicators = int(description.attributes.get("numberOfEventIndicators", "0"))
        if instance.fmi == 3:
            self.count = self._number("GetNumberOfContinuousStates")
            self.indicators = self._number("GetNumberOfEventIndicators")
        self._x, self._dx = (ctypes.c_double * self.count)(), (ctypes.c_double * self.count)()
        self._z = (ctypes.c_double * self.indicators)()
        self.time, self.next, self.trial = 0.0, math.inf, 0.0
        self.nominal = [1.0] * self.count

    def _number(self, function: str) -> int:
        value = ctypes.c_size_t(0)
        self.instance.call(function, ctypes.byref(value))
        return value.value

    def begin(self, time: float) -> None:
        """From event mode, where the initialisation ends, to continuous time."""
        self.time = time
        self._iterate()
        self.nominal = [abs(n) or 1.0 for n in self.nominals()]

    def nominals(self) -> list[float]:
        """Nominal values of the states."""
        self.instance.vector("GetNominalsOfContinuousStates", self._x, self.count)
        return list(self._x)

    def _iterate(self) -> None:
        """Update discrete states until they rest, and go to continuous time."""
        for _ in range(EVENTS):
            needed, terminate, self.next = self.instance.update_discrete_states()
            self.ended = self.ended or terminate
            if not needed or terminate:
                self.instance.call("EnterContinuousTimeMode")
                return
        text = f"the event iteration, {EVENTS} calls: new discrete states are needed for ever"
        raise CallFailed(text, ERROR)

    # ---- the state vector

    def states(self) -> list[float]:
        """Continuous states."""
        self.instance.vector("GetContinuousStates", self._x, self.count)
        return list(self._x)

    def put(self, time: float, x: Sequence[float]) -> None:
        """Set time and continuous states."""
        self.instance.set_time(time)
        self.put_states(x)

    def put_states(self, x: Sequence[float]) -> None:
        """Set the continuous states."""
        self._x[:] = list(x)
        self.instance.vector("SetContinuousStates", self._x, self.count)

    def derivatives(self) -> list[float]:
        """Derivatives of the continuous states, as they are set."""
        self.instance.vector("GetContinuousStateDerivatives", self._dx, self.count)
        return list(self._dx)

    def derivatives_at(self, time: float, x: Sequence[float]) -> list[float]:
        """Derivatives at a time and at states."""
        self.put(time, x)
        return self.derivatives()

    def _signs(self) -> list[bool]:
        self.instance.vector("GetEventIndicators", self._z, self.indicators)
        return [z > 0 for z in self._z]

    # ---- steps

    def advance(self, length: float, most: int) -> None:
        """Over `length`, or `most` inner steps, whatever ends first."""
        end = self.time + length
        for _ in range(most):
            if self.ended or self.time >= end:
                return
            signs = self._signs()
            self._inner(max(min(end, self.next) - self.time, 0.0))
            event, terminate = self.instance.flag(), self.instance.flag()
            answers = ctypes.byref(event), ctypes.byref(terminate)
            self.instance.call("CompletedIntegratorStep", self.instance.flag(True), *answers)
            self.ended = bool(terminate.value)
            if event.value or self.time >= self.next or signs != self._signs():
                self.instance.call("EnterEventMode")
                self._iterate()

    def _inner(self, limit: float) -> None:
        """One accepted step of at most `limit`."""
        x = self.states()
        if not self.count or limit == 0.0:
            self.time += limit
            self.put(self.time, x)
            return
        h = min(limit, self.trial or 1e-3 * limit)
        while True:
            new, error = self._try(x, h)
            growth = 0.9 * error ** (-1 / 3) if error > 0 else 5.0
            if error <= 1.0:
                break
            h *= max(0.1, min(growth, 0.5))
            if h < 1e-14 * max(limit, abs(self.time)):
                raise CallFailed("the integration with explicit steps: no step is short enough", ERROR)
        self.trial = h * min(5.0, growth)
        self.time = limit + self.time if h == limit else self.time + h
        self.put(self.time, new)

    def _try(self, x: Sequence[float], h: float) -> tuple[list[float], float]:
        """States after h, and error over tolerance: infinite when something is not finite or refused."""

        def slope(c: float, k: Sequence[float]) -> list[float]:
            return self.derivatives_at(self.time + c * h, [a + c * h * b for a, b in zip(x, k, strict=True)])

        try:
            k1 = self.derivatives_at(self.time, x)
            k2 = slope(1 / 2, k1)
            k3 = slope(3 / 4, k2)
            new = [a + h / 9 * (2 * b + 3 * c + 4 * d) for a, b, c, d in zip(x, k1, k2, k3, strict=True)]
            k4 = self.derivatives_at(self.time + h, new)
        except CallFailed as failure:
            if failure.status != DISCARD:
                raise
            return list(x), math.inf
        errors = [
            abs(h / 72 * (-5 * b + 6 * c + 8 * d - 9 * e)) / (TOLERANCE * max(abs(a), n))
            for a, b, c, d, e, n in zip(x, k1, k2, k3, k4, self.nominal, strict=True)
        ]
        return new, max(errors) if math.isfinite(sum(errors)) else math.inf


# ---- a run


class Simulation:
    """One run of one instance: begin, move its inputs, advance, read.

    summed      communication points are summed, which drifts, in place of counted
    reached     the time that the FMU says it reached [s]
    ended       the FMU asked to end the simulation
    early       it returned early from the last step
    rest        inputs after initialisation
    exchange    its continuous states, in model exchange
    """

    def __init__(
        self,
        trial: Trial,
        start: float | None = None,
        stop: float | None = None,
        step: float | None = None,
        summed: bool | None = None,
        inputs: Sequence[DeclaredVariable] | None = None,
        kind: str = "",
        **options: Any,
    ) -> None:
        self.trial, description = trial, trial.description
        self.kind = kind or trial.kind
        self.instance = trial.instance(self.kind, **options)
        self.start = experiment(description, "startTime") or 0.0 if start is None else start
        self.stop, self.step = stop, step or usual_step(description)
        self.summed = trial.summed if summed is None else summed
        self.time, self.number, self.reached = self.start, 0, self.start
        self.inputs = self.values(movable(description) if inputs is None else inputs)
        self.outputs = self.values(watched(description))
        self._floors = [ROUNDING * v.nominal for v in flat(self.outputs.variables)]
        self.exchange: ContinuousStates | None = None
        self._ended = self.early = False
        self.rest: list[float] = []

    def values(self, variables: Sequence[DeclaredVariable]) -> VariableRow:
        """Some variables of this instance."""
        return VariableRow(self.trial, self.instance, variables)

    @property
    def ended(self) -> bool:
        return self._ended or (self.exchange is not None and self.exchange.ended)

    def initialise(self) -> Simulation:
        """To where initialisation mode ends, in model exchange: event mode."""
        self.instance.setup(self.start, self.stop)
        self.instance.enter()
        self.instance.leave()
        return self

    def begin(self) -> Simulation:
        """Initialise, and be ready for steps."""
        self.initialise().settle()
        return self

    def settle(self) -> None:
        """After initialisation mode: to where steps are possible."""
        self.time, self.number = self.start, 0
        self.instance.log.time = self.start
        if self.kind == "ModelExchange":
            self.exchange = ContinuousStates(self.instance, self.trial.description)
            self.exchange.begin(self.start)
        self.rest = self.inputs.get()

    def poke(self, number: int | None = None, push: float = PUSH) -> None:
        """Move all inputs a little, by a fixed pattern."""
        n = self.number if number is None else number
        wanted = [
            min(max(x + push * v.scale * PATTERN[(n + 3 * i) % len(PATTERN)], v.minimum), v.maximum)
            for i, (x, v) in enumerate(zip(self.rest, flat(self.inputs.variables), strict=True))
        ]
        self.inputs.set(wanted)

    def do_step(self, time: float, length: float) -> None:
        """One communication step; raises CallFailed unless it was done, or was the last."""
        self.early, status = False, self.instance.step(time, length)
        if self.instance.fmi == 3 or status == DISCARD:
            end = self.instance.step_end(status)
            self._ended, self.early = end.terminate, end.early
            self.reached = end.reached if self.instance.fmi == 3 else time + length
        else:
            self.reached = time + length
        if status and not (status == DISCARD and self._ended):
            self.instance.check_status(status, self.instance.describe_call("DoStep"))

    def advance(self) -> None:
        """One communication step; in model exchange up to INNER inner steps."""
        self.number += 1
        if self.exchange is not None:
            self.exchange.advance(self.step, INNER)
            self.time = self.exchange.time
            return
        self.do_step(self.time, self.step)
        self.time = self.time + self.step if self.summed else self.start + self.number * self.step

    def row(self) -> list[float]:
        """Outputs; what is rounding next to their magnitude is 0, and so is -0."""
        values = zip(self.outputs.get(), self._floors, strict=True)
        return [0.0 if abs(x) <= floor else x for x, floor in values]

    def run(self, count: int, poke: bool = False, seconds: float = math.inf) -> Rows:
        """Rows after each of `count` steps, or of as many as fit into some wall time."""
        rows: Rows = []
        deadline = time.monotonic() + seconds
        while len(rows) < count and not self.ended and (time.monotonic() < deadline or not rows):
            if poke:
                self.poke()
            self.advance()
            rows.append(self.row())
        return rows

    def mark(self) -> tuple[Any, ...]:
        """Where the run is, apart from the FMU: to go on from a saved state."""
        e = self.exchange
        return self.number, self.time, (e.time, e.next, e.trial, e.nominal) if e else None

    def back(self, mark: Sequence[Any]) -> None:
        """Go on from a mark."""
        self.number, self.time, inner = mark
        if self.exchange is not None and inner is not None:
            e = self.exchange
            e.time, e.next, e.trial, e.nominal = inner

    def close(self) -> None:
        """Terminate and free."""
        self.instance.call("Terminate")
        self.instance.free()
