"""One instance of a model in plain Python: values, inputs over a step, integration, checks.

It does what native/core.c, instance.c and step.c do, with the same numbers and the same words. It needs no
FMU:

    run = of_subsystem(SWING)
    run.initialise(swing_command=2.0)
    run.advance(1e-3)
    run["swing_torque"]
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import NoReturn

import numpy as np

from fmus.contract import Subsystem
from fmus.export.c_code import DEFAULT_TOLERANCE
from fmus.export.interface import Variable, interface_of
from fmus.export.python import state
from fmus.export.python.state import InstanceState
from fmus.export.python.subsystem_model import RunnableModel, SubsystemFunctions, SubsystemModel
from fmus.parameters import Values, values
from fmus.solver import Array, Unsolved
from orchestrator.base.errors import Problem

LOOSEST_TOLERANCE = 1e-3  # as in native/core.h
INSTANTIATED, INITIALIZATION, STEP_MODE, STEP_FAILED, TERMINATED = 1, 2, 4, 8, 16
ANY = INSTANTIATED | INITIALIZATION | STEP_MODE | STEP_FAILED | TERMINATED
PHASES = {
    INSTANTIATED: "instantiated",
    INITIALIZATION: "initialization mode",
    STEP_MODE: "step complete",
    STEP_FAILED: "failed",
    TERMINATED: "terminated",
}
REASONS = {
    "FIXED": "a fixed parameter can be set only before the initialisation is over",
    "STATE": "a state can be set only before the initialisation is over",
    "CALCULATED_STATE": "its start value is calculated",
    "DERIVATIVE": "it is a derivative",
    "OUTPUT": "it is an output",
}


class Refused(Problem):
    """A call that failed; the message is one line."""


def refuse(text: str) -> NoReturn:
    """Ends a call."""
    raise Refused(text)


def of_subsystem(sub: Subsystem, numbers: Values | None = None) -> Instance:
    """An instance of a subsystem, with the numbers of its parameters.toml or others."""
    return Instance(
        SubsystemModel(SubsystemFunctions(interface_of(sub, numbers or values(sub, derive=False))))
    )


class Instance:
    """Variables go by value reference in `get` and `set`, else by name."""

    def __init__(self, model: RunnableModel, guid: str = "", warn: Callable[[str], object] = str) -> None:
        self.model, self.guid, self.warn, self.variables = model, guid, warn, model.interface.variables
        self.references = {v.name: v.reference for v in self.variables}
        self.ends = np.cumsum([len(group) for group in model.interface.groups]).tolist()
        self.rates = state.rates(model.interface.inputs)
        self._watched = [
            v
            for v in self.variables[self.ends[0] :]
            if v.quantity.warn_above is not None and (v.output or v.kind == "INPUT")
        ]
        self.reset()

    # ---- life

    def reset(self) -> None:
        """Default values of all variables."""
        start = np.array([v.start or 0.0 for v in self.variables[: self.ends[2]]])
        p, u, x = np.split(start, self.ends[:2])
        none = np.zeros(u.size, dtype=bool)
        self.state = InstanceState(
            *(x, p, u, u.copy(), np.zeros(u.size), np.zeros((u.size, 3)), none, none.copy()),
            warned=np.zeros(len(self.variables), dtype=bool),
            tolerance=DEFAULT_TOLERANCE,
            phase=INSTANTIATED,
        )
        self._forget()

    def _forget(self) -> None:
        """What follows from the state is computed anew when it is needed."""
        self._started, self._dx, self._y = False, None, None  # type: tuple[bool, Array | None, Array | None]

    def allowed(self, phases: int) -> None:
        """Refuse a call in other phases than these."""
        if not int(self.state.phase) & phases:
            refuse(f'not allowed in state "{PHASES[int(self.state.phase)]}"')

    def setup(self, start: float = 0.0, stop: float | None = None, tolerance: float | None = None) -> None:
        """Announce the experiment; times in [s]."""
        self.allowed(INSTANTIATED)
        if not math.isfinite(start):
            refuse("the start time is not finite")
        if stop is not None and not stop >= start:
            refuse("the stop time is before the start time")
        if tolerance is not None and not 0.0 < tolerance < 1.0:
            refuse("the tolerance is out of range, expected > 0 and < 1")
        s = self.state
        s.time = s.start_time = start
        s.stop_time = math.inf if stop is None else stop
        s.tolerance = DEFAULT_TOLERANCE if tolerance is None else min(tolerance, LOOSEST_TOLERANCE)

    def enter(self) -> None:
        """Enter initialisation mode."""
        self.allowed(INSTANTIATED)
        self.state.phase = INITIALIZATION

    def exit(self) -> None:
        """Leave initialisation mode; steps may follow."""
        self.allowed(INITIALIZATION)
        self._check()
        self.state.initial, self.state.phase = 0.0, STEP_MODE

    def terminate(self) -> None:
        """End the simulation; values can still be read."""
        self.allowed(STEP_MODE | STEP_FAILED)
        self.state.phase = TERMINATED

    def initialise(self, time: float = 0.0, tolerance: float | None = None, **start: float) -> Instance:
        """All of the above, with start values by name."""
        self.setup(time, None, tolerance)
        self.assign(**start)
        self.enter()
        self.exit()
        return self

    # ---- values

    def __getitem__(self, name: str) -> float:
        return self.get([self.references[name]])[0]

    def assign(self, **given: float) -> None:
        """Set variables by name."""
        self.set([self.references[name] for name in given], list(given.values()))

    def get(self, references: Sequence[int]) -> list[float]:
        """Values of variables."""
        values = [self._value(r) for r in references]
        for r, value in zip(references, values, strict=True):
            if not math.isfinite(value):
                self._not_finite(self.variables[r], value)
        return values

    def _requirements(self) -> Iterator[tuple[str, float]]:
        self._outputs()
        return zip(self.model.statements, self._require.tolist(), strict=True)

    def _violated(self, statement: str, value: float) -> NoReturn:
        when = f"at t = {self.state.time:.9g} s"
        refuse(f'requirement "{statement}" is violated {when}: {value:.6g}, expected > 0')

    def _not_finite(self, v: Variable, value: float) -> NoReturn:
        for statement, margin in self._requirements():  # perhaps the reason is known
            if margin <= 0:
                self._violated(statement, margin)
        refuse(f"{v.name} is {value:g} at t = {self.state.time:.9g} s, expected a finite number")

    def known(self, r: int) -> Variable:
        """The variable with this value reference."""
        if not 0 <= r < len(self.variables):
            refuse(f"value reference {r} is unknown, expected 0 to {len(self.variables) - 1}")
        return self.variables[r]

    def _value(self, r: int) -> float:
        self.known(r)
        s, (np_, nu, nx, ndx, _) = self.state, self.ends
        if r < np_:
            return float(s.p[r])
        if r < nu:
            return float(s.u[r - np_])
        self.start()
        if r < nx:
            return float(s.x[r - nu])
        return float(self.derivatives()[r - nx] if r < ndx else self._outputs()[r - ndx])

    def set(self, references: Sequence[int], given: Sequence[float]) -> None:
        """Change variables: all of them, or none when one value is refused."""
        self.allowed(INSTANTIATED | INITIALIZATION | STEP_MODE)
        for r, value in zip(references, given, strict=True):
            self._check_value(self.known(r), value)
        s, (np_, nu, *_) = self.state, self.ends
        for r, value in zip(references, given, strict=True):
            if r < np_:
                s.p[r] = value
            elif r < nu:
                s.u[r - np_] = s.set[r - np_] = value
            else:
                s.x[r - nu] = value
        self._forget()

    def _check_value(self, v: Variable, value: float) -> None:
        settable = v.kind in ("INPUT", "TUNABLE") or (self.state.initial and v.kind in ("FIXED", "STATE"))
        when, q = f"at t = {self.state.time:.9g} s", v.quantity
        if not settable:
            refuse(f"{v.name} cannot be set to {value:g} {when}: {REASONS[v.kind]}")
        if not math.isfinite(value):
            refuse(f"{v.name} cannot be set to {value:g} {when}, expected a finite number")
        low = -math.inf if q.minimum is None else q.minimum
        high = math.inf if q.maximum is None else q.maximum
        if not low <= value <= high:
            refuse(f"{v.name} cannot be set to {value:.9g} {q.unit} {when}, expected {low:g} to {high:g}")

    # ---- what follows from the state

    def start(self) -> None:
        """Compute the states that follow from others at the start."""
        if self.state.initial and not self._started:
            s = self.state
            s.x, self._started = self.model.start(s.x, s.u, s.p), True

    def derivatives(self) -> Array:
        """Of the states."""
        if self._dx is None:
            s = self.state
            self._dx = self.model.rate(s.x, s.u, s.p).copy()
        return self._dx

    def _outputs(self) -> Array:
        if self._y is None:
            s = self.state
            self._y, self._require = self.model.observe(s.x, s.u, s.p, s.time)
        return self._y

    def _check(self) -> None:
        """Requirements hold and everything is finite; warnings of what is watched."""
        self.start()
        y, s = self._outputs(), self.state
        self._finite(s.x, self.ends[1])
        for statement, value in self._requirements():
            if not value > 0:
                self._violated(statement, value)
        self._finite(y, self.ends[3])
        self._watch()

    def _finite(self, values: Array, first: int) -> None:
        ok = np.isfinite(values)
        if not ok.all():
            i = int(np.argmin(ok))
            self._not_finite(self.variables[first + i], float(values[i]))

    def _watch(self) -> None:
        """One warning per excursion of a watched input or output."""
        s = self.state
        for v in self._watched:
            value, limit, unit = self._value(v.reference), v.quantity.warn_above or 0.0, v.quantity.unit
            above = abs(value) > limit
            if above and not s.warned[v.reference]:
                self.warn(f"{v.name} = {value:.6g} {unit} at t = {s.time:.9g} s is above {limit:g} {unit}")
            s.warned[v.reference] = above

    # ---- steps

    def advance(self, length: float) -> Instance:
        """A step from the current time."""
        self.step(self.state.time, length)
        return self

    def step(self, time: float, length: float) -> None:
        """A communication step from `time` over `length` [s]."""
        self.allowed(STEP_MODE)
        s, end = self.state, time + length
        late = 0.01 * length + _rounding(time)  # more than that is a mistake of the master
        if not (length > 0.0 and math.isfinite(end) and end != time):
            refuse(f"the step size is {length:g} s at t = {time:.15g} s, expected one that advances the time")
        if not abs(time - s.time) <= late:
            refuse(f"the communication point is {time:.15g} s, expected {s.time:.15g} s")
        if end > s.stop_time + late:
            refuse(f"the step ends at {end:.15g} s, after the stop time {s.stop_time:.15g} s")
        # A gap between the master's time and ours becomes part of the step; rounding does not.
        gap = time - s.time
        if abs(gap) > _rounding(time):
            length += gap
        else:
            s.time = time
        s.phase = STEP_FAILED  # until it succeeded
        self._advance(length)
        s.phase = STEP_MODE

    def _advance(self, length: float) -> None:
        s, begin = self.state, self.state.time
        inputs = state.motion(s, self.rates)
        self._forget()
        try:
            s.x, s.memory = self.model.advance(s.x, s.p, inputs, begin, length, s.tolerance, s.memory)
        except Unsolved as problem:
            refuse(self._failure(problem))
        s.time, s.u, s.slope = begin + length, inputs.value(length), inputs.derivative(length)
        s.was_given, s.is_given = s.is_given, np.zeros_like(s.is_given)
        try:
            self._check()
        except Refused:
            s.time = begin
            raise

    def _failure(self, e: Unsolved) -> str:
        v, when = self.variables[self.ends[1] + e.worst], f"t = {self.state.time + e.tau:.9g} s"
        where = f"{v.name} = {e.x[e.worst]:.6g} {v.quantity.unit}"
        if e.why == "not finite":
            return f"the derivative of {v.name} is {e.value:g} at {when} ({where})"
        if e.why == "singular":
            return f"the Jacobian leaves no inner step that can be solved at {when}"
        if e.why == "many":
            return f"more inner steps than allowed at {when}; worst is {where}"
        tolerance = self.state.tolerance
        return (
            f"tolerance {tolerance:g} not reached with an inner step of {e.step:.3g} s at {when}; "
            f"worst is {where}"
        )

    # ---- FMI's functions for derivatives

    def set_input_derivatives(
        self, references: Sequence[int], orders: Sequence[int], given: Sequence[float]
    ) -> None:
        """Derivatives of order 1 to 3 of inputs, valid for the next step."""
        self.allowed(INSTANTIATED | INITIALIZATION | STEP_MODE)
        for r, order, value in zip(references, orders, given, strict=True):
            v = self.known(r)
            if v.kind != "INPUT":
                refuse(f"{v.name} is not an input")
            if not 1 <= order <= 3:
                refuse(f"{v.name} has derivatives of order 1, 2 and 3 only")
            if not math.isfinite(value):
                refuse(f"the derivative of {v.name} is not a finite number")
        for r, order, value in zip(references, orders, given, strict=True):
            state.set_input_derivative(self.state, r - self.ends[0], order, value)

    def directional_derivative(
        self, unknown: Sequence[int], known: Sequence[int], seed: Sequence[float]
    ) -> list[float]:
        """Derivatives of unknowns along a direction of knowns."""
        self.allowed(INITIALIZATION | STEP_MODE | STEP_FAILED | TERMINATED)
        direction = np.zeros(len(self.variables))
        more = ("FIXED", "TUNABLE") if self.state.initial else ("CALCULATED_STATE",)
        for r, value in zip(known, seed, strict=True):
            v = self.known(r)
            if v.kind not in ("INPUT", "STATE", *more):
                refuse(f"{v.name} is not a known, expected an input or a state")
            direction[r] += value
        for r in unknown:
            if self.known(r).kind in ("FIXED", "TUNABLE", "INPUT"):
                refuse(f"{self.variables[r].name} is not an unknown, expected an output or a derivative")
        return self._finite_derivatives(unknown, self._along(direction))

    def output_derivatives(self, references: Sequence[int], orders: Sequence[int]) -> list[float]:
        """Time derivatives of outputs; orders beyond the first are zero: they are not provided."""
        self.allowed(STEP_MODE | STEP_FAILED | TERMINATED)
        direction, (first, last, end, *_) = np.zeros(len(self.variables)), self.ends
        direction[first:last] = [state.slope(self.state, self.rates, i) for i in range(last - first)]
        direction[last:end] = self.derivatives()
        for r, order in zip(references, orders, strict=True):
            v = self.known(r)
            if v.kind not in ("OUTPUT", "STATE", "CALCULATED_STATE"):
                refuse(f"{v.name} is not an output")
            if order < 1:
                refuse(f"the order of the derivative of {v.name} is less than 1")
        first_order = self._finite_derivatives(references, self._along(direction))
        return [0.0 if order > 1 else value for order, value in zip(orders, first_order, strict=True)]

    def _along(self, direction: Array) -> Array:
        """From the directions of parameters, inputs and states those of all variables."""
        self.start()
        s, parts = self.state, np.split(direction, self.ends[:3])
        x, dx, y = self.model.forward(s.x, s.u, s.p, (parts[0], parts[1], parts[2]), bool(s.initial))
        return np.concatenate([parts[0], parts[1], x, dx, y])

    def _finite_derivatives(self, references: Sequence[int], values: Array) -> list[float]:
        for r in references:
            if not math.isfinite(values[r]):
                refuse(f"the derivative of {self.variables[r].name} is not finite")
        return [float(values[r]) for r in references]

    # ---- saved states

    def save(self) -> bytes:
        """Everything that the future depends on."""
        return self.state.to_bytes(self.guid)

    def readable(self, data: bytes) -> InstanceState:
        """The state in these bytes, refused if it is none of this model."""
        return self.state.from_bytes(self.guid, data)

    def restore(self, data: bytes) -> None:
        """Back to a saved state, of this or another instance of the same model."""
        self.state = self.readable(data)
        self._forget()


def _rounding(time: float) -> float:
    """What times in two ways of counting may differ by."""
    return 2 * sys.float_info.epsilon * abs(time)
