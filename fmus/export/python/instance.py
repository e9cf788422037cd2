"""Everything that the future of an instance depends on, and its bytes: what a saved state holds.

The bytes are a header that names the model, a check sum, and one double per number, so that a restored
state is the same to the last bit, in another instance, process or on another machine.

What went wrong, in one line, with the place in the user's file.

Inputs inside a step: Taylor polynomials from the values that were set and what carries their derivatives.

Derivatives come from `fmi2SetRealInputDerivatives` if it was called for the step, else from the inputs that
are rates (docs/design.md, "Inputs inside a step").

One instance of a model in plain Python: values, inputs over a step, integration, checks.

It does what native/core.c, instance.c and step.c do, with the same numbers and the same words. It needs no
FMU:

    run = of_subsystem(SWING)
    run.initialise(swing_command=2.0)
    run.advance(1e-3)
    run["swing_torque"]
"""

from __future__ import annotations

import hashlib
import math
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from fmus.contract import Subsystem
from fmus.export.c_code import DEFAULT_TOLERANCE
from fmus.export.interface import Variable, interface
from fmus.export.python.behaviour import Behaviour, Continuous, Functions
from fmus.parameters import Values, values
from fmus.solver import Array, Motion, Unsolved
from orchestrator.base.errors import Problem

_MAGIC = b"FMUstate python 1 "


@dataclass
class State:
    """Numbers only, as in native/core.h.

    memory      of the solver, see `solver.Pace`
    x, p, u     states, parameters, inputs at the current time
    set         inputs as last set: where the next step starts
    slope       time derivatives of the inputs at the end of the last step
    given       input derivatives of order 1 to 3 set for the next step, shape (n, 3), and for which inputs
    was_given   which inputs followed such derivatives in the last step
    warned      which watched variables are above their limit, by value reference
    initial     1 until the initialisation is over: states follow from their start values
    phase       of the state machine, see `instance`
    """

    x: Array
    p: Array
    u: Array
    set: Array
    slope: Array
    given: Array
    is_given: NDArray[np.bool_]
    was_given: NDArray[np.bool_]
    warned: NDArray[np.bool_]
    time: float = 0.0
    start_time: float = 0.0
    stop_time: float = np.inf
    tolerance: float = 0.0
    memory: Array = field(default_factory=lambda: np.zeros(3))
    initial: float = 1.0
    phase: float = 1.0

    def to_bytes(self, guid: str) -> bytes:
        """The state of the model with this GUID."""
        content = b"".join(np.asarray(v, dtype="<f8").tobytes() for v in vars(self).values())
        return _header(guid) + hashlib.sha256(content).digest() + content

    def from_bytes(self, guid: str, data: bytes) -> State:
        """The state that `to_bytes` was called with; this one tells how many numbers there are of each."""
        header, expected = _header(guid), len(self.to_bytes(guid))
        if not data.startswith(header):
            raise Problem(f'the saved state is of another model, expected GUID "{guid}"')
        if len(data) != expected:
            raise Problem(f"the saved state has {len(data)} bytes, expected {expected}")
        seal, content = data[len(header) : len(header) + 32], data[len(header) + 32 :]
        if hashlib.sha256(content).digest() != seal:
            raise Problem("the saved state is damaged: its check sum differs")
        return self._filled(np.frombuffer(content, dtype="<f8"))

    def _filled(self, numbers: Array) -> State:
        found: dict[str, Any] = {}
        for f in fields(self):
            like = np.asarray(getattr(self, f.name))
            part, numbers = numbers[: like.size], numbers[like.size :]
            found[f.name] = part.reshape(like.shape).astype(like.dtype) if like.shape else float(part[0])
        return State(**found)


def _header(guid: str) -> bytes:
    return _MAGIC + guid.encode() + b"\0"


def told(problem: BaseException, folder: Path) -> str:
    """The text of a Problem; of another exception also its kind, file and line.

    The place is the last one in `folder`, where the FMU's own scripts are, else the last one of all.
    """
    text = " ".join(str(problem.msg if isinstance(problem, SyntaxError) else problem).split())
    if isinstance(problem, Problem):
        return text
    kind = type(problem).__name__
    return f"{place(problem, folder)}{kind}: {text}" if text else f"{place(problem, folder)}{kind}"


def place(problem: BaseException, folder: Path) -> str:
    """File and line of an exception, as "file.py:12: "; empty when it has none."""
    if isinstance(problem, SyntaxError) and problem.filename:
        return f"{Path(problem.filename).name}:{problem.lineno}: "
    frames = traceback.extract_tb(problem.__traceback__)
    own = [f for f in frames if Path(f.filename).parent == folder]
    return "".join(f"{Path(f.filename).name}:{f.lineno}: " for f in (own or frames)[-1:])


def rates(inputs: Sequence[Variable]) -> list[int]:
    """Index of the input with the time derivative of each one, or -1."""
    index = {v.name: i for i, v in enumerate(inputs)}
    return [index[v.quantity.rate] if v.quantity.rate else -1 for v in inputs]


def derivative(s: State, rates: Sequence[int], at: Array, i: int, order: int) -> float:
    """Derivative of an input where the values `at` hold."""
    if s.is_given[i]:
        return float(s.given[i, order - 1])
    if rates[i] < 0:
        return 0.0
    return float(at[rates[i]]) if order == 1 else derivative(s, rates, at, rates[i], order - 1)


def motion(s: State, rates: Sequence[int]) -> Motion:
    """Over the next step."""
    numbers = range(s.set.size)
    terms = (
        [derivative(s, rates, s.set, i, k) / scale for i in numbers] for k, scale in ((1, 1), (2, 2), (3, 6))
    )
    return Motion(np.array([s.set, *terms]))


def slope(s: State, rates: Sequence[int], i: int) -> float:
    """Time derivative of an input at the current time."""
    if s.is_given[i]:
        return float(s.given[i, 0])
    return float(s.slope[i] if rates[i] < 0 or s.was_given[i] else s.u[rates[i]])


def give(s: State, i: int, order: int, value: float) -> None:
    """A derivative of an input for the next step; those of other orders are zero unless given, too."""
    s.given[i] = s.given[i] if s.is_given[i] else 0.0
    s.is_given[i], s.given[i, order - 1] = True, value


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
    """A call that failed, told in one line."""


def refuse(text: str) -> NoReturn:
    """Ends a call."""
    raise Refused(text)


def of_subsystem(sub: Subsystem, numbers: Values | None = None) -> Instance:
    """An instance of a subsystem, with the numbers of its parameters.toml or others."""
    face = interface(sub, numbers or values(sub, derive=False))
    return Instance(Continuous(Functions(face), face.variables))


def _unheard(_: str) -> None:
    """Where warnings go that nobody asked for."""


class Instance:
    """Variables go by value reference in `get` and `set`, else by name."""

    def __init__(self, model: Behaviour, guid: str = "", warn: Callable[[str], None] = _unheard) -> None:
        self.model, self.guid, self.warn, self.variables = model, guid, warn, model.variables
        self.references = {v.name: v.reference for v in self.variables}
        self.ends = np.cumsum(model.sizes).tolist()
        self.rates = rates(self.variables[self.ends[0] : self.ends[1]])
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
        self.state = State(
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
        found = [self._value(r) for r in references]
        for r, value in zip(references, found, strict=True):
            if not math.isfinite(value):
                self._not_finite(self.variables[r], value)
        return found

    def _requirements(self) -> Iterator[tuple[str, float]]:
        self._outputs()
        return zip(self.model.statements, self._require.tolist(), strict=True)

    def _violated(self, statement: str, value: float) -> NoReturn:
        when = f"at t = {self.state.time:.9g} s"
        refuse(f'requirement "{statement}" is violated {when}: {value:.6g}, expected > 0')

    def _not_finite(self, v: Variable, value: float) -> NoReturn:
        for statement, found in self._requirements():  # perhaps the reason is known
            if found <= 0:
                self._violated(statement, found)
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
        inputs = motion(s, self.rates)
        self._forget()
        try:
            s.x, s.memory = self.model.advance(s.x, s.p, inputs, begin, length, s.tolerance, s.memory)
        except Unsolved as problem:
            refuse(self._failure(problem))
        s.time, s.u, s.slope = begin + length, inputs.value(length), inputs.slope(length)
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

    # ---- saved states

    def save(self) -> bytes:
        """Everything that the future depends on."""
        return self.state.to_bytes(self.guid)

    def readable(self, data: bytes) -> State:
        """The state in these bytes, refused if it is none of this model."""
        return self.state.from_bytes(self.guid, data)

    def restore(self, data: bytes) -> None:
        """Back to a saved state, of this or another instance of the same model."""
        self.state = self.readable(data)
        self._forget()


def _rounding(time: float) -> float:
    """What times in two ways of counting may differ by."""
    return 2 * sys.float_info.epsilon * abs(time)
