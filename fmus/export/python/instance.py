"""An instance of a model in Python: variables, inputs over a step, checks, FMU states.

The class is the counterpart of native/core.c, instance.c, step.c and values.c for Co-Simulation, with the
same messages.

A saved state is a header that identifies the model, a SHA-256 checksum, and one double per value. So a
restored state is bit-identical in another instance or process and on another machine.

Inputs inside a step are Taylor polynomials around the values that were set. The derivatives of an input come
from `fmi2SetRealInputDerivatives` if it was called for the step, else from its rate input, the input that is
its time derivative (docs/design.md, "Inputs inside a step").
"""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fmus.export.interface import Variable
from fmus.export.python.user_model import Array, InputPolynomials, UserModel
from orchestrator.base.errors import Problem

INSTANTIATED, INITIALIZATION, STEP_MODE, STEP_FAILED, TERMINATED = 1, 2, 4, 8, 16
MOST_WARNINGS = 3  # of one variable, as in native/core.c
WARNING_MARGIN = 1e-5  # relative excess over a limit without a warning, as in native/core.c
ANY = INSTANTIATED | INITIALIZATION | STEP_MODE | STEP_FAILED | TERMINATED
PHASES = {  # phase -> state of the FMI state machine
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
    "OUTPUT": "it is an output",
}


# ---- state -------------------------------------------------------------------------------------------

_MAGIC = b"FMUstate python 1 "


@dataclass
class InstanceState:
    """The state of an instance; all members are stored as doubles, with the names of native/core.h.

    x, p, u             states, parameters, inputs at the current time
    last_set            inputs as last set: their values at the start of the next step
    input_derivatives   derivatives of order 1 to 3 that were set for the next step, shape (n, 3)
    has_derivatives     inputs for which such derivatives were set
    beyond              1 for watched variables above their limit, -1 for those below, by value reference
    warnings            that were logged of each variable
    time, start_time, stop_time   [s]; stop_time is infinite if it is not defined
    initial             1 until the initialisation is over: the states are computed from their start values
    phase               state of the FMI state machine, a key of `PHASES`
    """

    x: Array
    p: Array
    u: Array
    last_set: Array
    input_derivatives: Array
    has_derivatives: NDArray[np.bool_]
    beyond: NDArray[np.int_]
    warnings: NDArray[np.int_]
    time: float = 0.0
    start_time: float = 0.0
    stop_time: float = np.inf
    initial: float = 1.0
    phase: float = 1.0

    def to_bytes(self, guid: str) -> bytes:
        """The state as bytes; the GUID identifies the model."""
        content = b"".join(np.asarray(v, dtype="<f8").tobytes() for v in vars(self).values())
        return _header(guid) + hashlib.sha256(content).digest() + content

    def from_bytes(self, guid: str, data: bytes) -> InstanceState:
        """The state in these bytes; `self` is any state of the model and supplies the array shapes."""
        header, size = _header(guid), len(self.to_bytes(guid))
        if not data.startswith(header):
            raise Problem(f'the saved state belongs to another model, expected GUID "{guid}"')
        if len(data) != size:
            raise Problem(f"the saved state has {len(data)} bytes, expected {size}")
        digest, content = data[len(header) : len(header) + 32], data[len(header) + 32 :]
        if hashlib.sha256(content).digest() != digest:
            raise Problem("the saved state is damaged: its checksum differs")
        remaining, values = np.frombuffer(content, dtype="<f8"), dict[str, Any]()
        for f in fields(self):
            like = np.asarray(getattr(self, f.name))
            part, remaining = remaining[: like.size], remaining[like.size :]
            values[f.name] = part.reshape(like.shape).astype(like.dtype) if like.shape else float(part[0])
        return InstanceState(**values)


def _header(guid: str) -> bytes:
    return _MAGIC + guid.encode() + b"\0"


# ---- inputs inside a step ----------------------------------------------------------------------------


def _derivative(s: InstanceState, rates: Sequence[int], i: int, order: int) -> float:
    """Derivative of the given order of input i; rates: see `Instance`."""
    if s.has_derivatives[i]:
        return float(s.input_derivatives[i, order - 1])
    if rates[i] < 0:
        return 0.0
    return float(s.last_set[rates[i]]) if order == 1 else _derivative(s, rates, rates[i], order - 1)


def input_polynomials(s: InstanceState, rates: Sequence[int]) -> InputPolynomials:
    """The polynomials of all inputs over the next step."""
    terms = (
        [_derivative(s, rates, i, order) / factorial for i in range(s.last_set.size)]
        for order, factorial in ((1, 1), (2, 2), (3, 6))
    )
    return InputPolynomials(np.array([s.last_set, *terms]))


# ---- instance ----------------------------------------------------------------------------------------


class Refused(Problem):
    """A call that failed, has invalid arguments, or is not allowed in the present phase."""


class Instance:
    """One instance of a model; variables by value reference."""

    def __init__(self, model: UserModel, guid: str = "", warn: Callable[[str], object] = str) -> None:
        self.model, self.guid, self.warn, self.variables = model, guid, warn, model.interface.variables
        self.ends = np.cumsum([len(group) for group in model.interface.groups]).tolist()
        index = {v.name: i for i, v in enumerate(model.interface.inputs)}
        # for each input the index of its rate input, or -1
        self.rates = [index.get(v.quantity.rate or "", -1) for v in model.interface.inputs]
        self._watched = [v for v in self.variables[self.ends[0] :] if v.watched]
        self.reset()

    # ---- state machine

    def reset(self) -> None:
        """Return to the phase after instantiation: variables, time and warnings as new."""
        start = np.array([v.start or 0.0 for v in self.variables[: self.ends[2]]])
        p, u, x = np.split(start, self.ends[:2])
        self.state = InstanceState(
            x=x,
            p=p,
            u=u,
            last_set=u.copy(),
            input_derivatives=np.zeros((u.size, 3)),
            has_derivatives=np.zeros(u.size, dtype=bool),
            beyond=np.zeros(len(self.variables), dtype=int),
            warnings=np.zeros(len(self.variables), dtype=int),
            phase=INSTANTIATED,
        )
        self._discard_cache()

    def _discard_cache(self) -> None:
        """Discard the cached initial states and outputs; they are computed on demand."""
        self._started, self._y = False, None  # type: tuple[bool, Array | None]

    def require_phase(self, phases: int) -> None:
        """Refuse the call in any other phase than these."""
        if not int(self.state.phase) & phases:
            raise Refused(f'not allowed in state "{PHASES[int(self.state.phase)]}" of the FMI state machine')

    def setup(self, start: float = 0.0, stop: float | None = None, tolerance: float | None = None) -> None:
        """Define the experiment; times in [s]."""
        self.require_phase(INSTANTIATED)
        if not math.isfinite(start):
            raise Refused("the start time is not finite")
        if stop is not None and not stop >= start:
            raise Refused("the stop time is before the start time")
        if tolerance is not None and not 0.0 < tolerance < 1.0:
            raise Refused("the tolerance is out of range, expected > 0 and < 1")
        s = self.state
        s.time = s.start_time = start
        s.stop_time = math.inf if stop is None else stop

    def enter(self) -> None:
        """Enter initialisation mode."""
        self.require_phase(INSTANTIATED)
        self.state.phase = INITIALIZATION

    def exit(self) -> None:
        """Leave initialisation mode; steps may follow."""
        self.require_phase(INITIALIZATION)
        self._check()
        self.state.initial, self.state.phase = 0.0, STEP_MODE  # all fields are float64, for to_bytes

    def terminate(self) -> None:
        """End the simulation; values can still be read."""
        self.require_phase(STEP_MODE | STEP_FAILED)
        self.state.phase = TERMINATED

    def initialise(self) -> Instance:
        """`setup`, `enter` and `exit`; returns the instance."""
        self.setup()
        self.enter()
        self.exit()
        return self

    # ---- values

    def get(self, references: Sequence[int]) -> list[float]:
        """Values of variables; refused if one is not finite."""
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
        raise Refused(f'requirement "{statement}" is violated {when}: {value:.6g}, expected > 0')

    def _not_finite(self, v: Variable, value: float) -> NoReturn:
        for statement, margin in self._requirements():  # a violated requirement explains the value better
            if margin <= 0:
                self._violated(statement, margin)
        raise Refused(f"{v.name} is {value:g} at t = {self.state.time:.9g} s, expected a finite number")

    def variable(self, r: int) -> Variable:
        """The variable with this value reference."""
        if not 0 <= r < len(self.variables):
            raise Refused(f"value reference {r} is unknown, expected 0 to {len(self.variables) - 1}")
        return self.variables[r]

    def _value(self, r: int) -> float:
        self.variable(r)
        s, (np_, nu, nx, *_) = self.state, self.ends
        if r < np_:
            return float(s.p[r])
        if r < nu:
            return float(s.u[r - np_])
        self.start()
        return float(s.x[r - nu] if r < nx else self._outputs()[r - nx])

    def set(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Set variables; none is changed if one value is refused."""
        self.require_phase(INSTANTIATED | INITIALIZATION | STEP_MODE)
        for r, value in zip(references, values, strict=True):
            self._check_value(self.variable(r), value)
        s, (np_, nu, *_) = self.state, self.ends
        for r, value in zip(references, values, strict=True):
            if r < np_:
                s.p[r] = value
            elif r < nu:
                s.u[r - np_] = s.last_set[r - np_] = value
            else:
                s.x[r - nu] = value
        self._discard_cache()

    def _check_value(self, v: Variable, value: float) -> None:
        settable = v.kind in ("INPUT", "TUNABLE") or (self.state.initial and v.kind in ("FIXED", "STATE"))
        when, q = f"at t = {self.state.time:.9g} s", v.quantity
        if not settable:
            raise Refused(f"{v.name} cannot be set to {value:g} {when}: {REASONS[v.kind]}")
        if not math.isfinite(value):
            raise Refused(f"{v.name} cannot be set to {value:g} {when}, expected a finite number")
        low = -math.inf if q.minimum is None else q.minimum
        high = math.inf if q.maximum is None else q.maximum
        if not low <= value <= high:
            raise Refused(
                f"{v.name} cannot be set to {value:.9g} {q.unit} {when}, expected {low:g} to {high:g}"
            )

    # ---- computed quantities

    def start(self) -> None:
        """Compute the initial states, unless the initialisation is over or they are computed."""
        if self.state.initial and not self._started:
            s = self.state
            s.x, self._started = self.model.start(s.x, s.u, s.p), True

    def _outputs(self) -> Array:
        if self._y is None:
            s = self.state
            self._y, self._require = self.model.observe(s.x, s.u, s.p, s.time)
        return self._y

    def _check(self) -> None:
        """Check that values are finite and requirements hold; warn of watched variables above their limit."""
        self.start()
        y, s = self._outputs(), self.state
        self._finite(s.x, self.ends[1])
        for statement, value in self._requirements():
            if not value > 0:
                self._violated(statement, value)
        self._finite(y, self.ends[2])
        self._watch()

    def _finite(self, values: Array, first: int) -> None:
        finite = np.isfinite(values)
        if not finite.all():
            i = int(np.argmin(finite))
            self._not_finite(self.variables[first + i], float(values[i]))

    def _watch(self) -> None:
        """A warning for each of the first excursions of a watched input or output."""
        s = self.state
        for v in self._watched:
            value, q, unit = self._value(v.reference), v.quantity, v.quantity.unit
            below, beyond, limit = q.warn_below, 0, 0.0
            if below is not None and value < below - WARNING_MARGIN * abs(below):
                beyond, limit = -1, below
            elif q.warn_above is not None and abs(value) > (1 + WARNING_MARGIN) * q.warn_above:
                beyond, limit = 1, q.warn_above
            if beyond and beyond != s.beyond[v.reference] and s.warnings[v.reference] < MOST_WARNINGS:
                s.warnings[v.reference] += 1
                last = s.warnings[v.reference] == MOST_WARNINGS
                end = "; no further warning of it follows" if last else ""
                where = "below" if beyond < 0 else "above"
                meaning = f": {q.meaning}" if q.meaning else ""
                text = f"{v.name} = {value:.6g} {unit} at t = {s.time:.9g} s is {where} {limit:g} {unit}"
                self.warn(text + meaning + end)
            s.beyond[v.reference] = beyond

    # ---- steps

    def advance(self, length: float) -> Instance:
        """A step of `length` [s] from the current time; returns the instance."""
        self.step(self.state.time, length)
        return self

    def step(self, time: float, length: float) -> None:
        """A communication step from `time` over `length` [s]."""
        self.require_phase(STEP_MODE)
        s, end = self.state, time + length
        largest_gap = 0.01 * length + _rounding(time)  # a larger one is an error of the master
        if not (length > 0.0 and math.isfinite(end) and end != time):
            raise Refused(
                f"the step size is {length:g} s at t = {time:.15g} s, expected one that advances the time"
            )
        if not abs(time - s.time) <= largest_gap:
            raise Refused(f"the communication point is {time:.15g} s, expected {s.time:.15g} s")
        if end > s.stop_time + largest_gap:
            raise Refused(f"the step ends at {end:.15g} s, after the stop time {s.stop_time:.15g} s")
        # If the master's time differs from ours by more than rounding, the step covers the gap; else we take
        # over the master's time.
        gap = time - s.time
        if abs(gap) > _rounding(time):
            length += gap
        else:
            s.time = time
        s.phase = STEP_FAILED  # until the step has succeeded
        self._advance(length)
        s.phase = STEP_MODE

    def _advance(self, length: float) -> None:
        s, begin = self.state, self.state.time
        inputs = input_polynomials(s, self.rates)
        self._discard_cache()
        s.x = self.model.advance(s.x, s.p, begin, inputs, length)
        s.time, s.u, s.has_derivatives = (
            begin + length,
            inputs.value(length),
            np.zeros_like(s.has_derivatives),
        )
        try:
            self._check()
        except Refused:
            s.time = begin
            raise

    # ---- derivatives of inputs

    def set_input_derivatives(
        self, references: Sequence[int], orders: Sequence[int], values: Sequence[float]
    ) -> None:
        """Set derivatives of inputs of order 1 to 3 for the next step."""
        self.require_phase(INSTANTIATED | INITIALIZATION | STEP_MODE)
        for r, order, value in zip(references, orders, values, strict=True):
            v = self.variable(r)
            if v.kind != "INPUT":
                raise Refused(f"{v.name} is not an input")
            if not 1 <= order <= 3:
                raise Refused(f"{v.name} has derivatives of order 1, 2 and 3 only")
            if not math.isfinite(value):
                raise Refused(f"the derivative of {v.name} is not a finite number")
        for r, order, value in zip(references, orders, values, strict=True):
            i, s = r - self.ends[0], self.state
            if not s.has_derivatives[i]:  # orders that are not set are zero
                s.input_derivatives[i] = 0.0
            s.has_derivatives[i], s.input_derivatives[i, order - 1] = True, value

    # ---- FMU states

    def save(self) -> bytes:
        """The complete state as bytes."""
        return self.state.to_bytes(self.guid)

    def read_state(self, data: bytes) -> InstanceState:
        """The state in these bytes; refused if it belongs to another model."""
        return self.state.from_bytes(self.guid, data)

    def restore(self, data: bytes) -> None:
        """Restore a saved state of this or another instance of the same model."""
        self.state = self.read_state(data)
        self._discard_cache()


def _rounding(time: float) -> float:
    """Rounding error by which two computations of the same time [s] may differ."""
    return 2 * sys.float_info.epsilon * abs(time)
