"""One instance of an FMU by its C interface: FMI 2.0 and 3.0, Co-Simulation and Model Exchange alike.

Functions have the names of FMI 3.0, without prefix. Instances run without event mode; early return and
intermediate update only where somebody asks for them. Nothing here needs more than the standard library.
"""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.fmi.library import Library, callbacks2, logger3, register_log, unregister_log
from orchestrator.fmi.messages import DISCARD, ERROR, FATAL, WARNING, Log, status_label

FMI2_NAMES = {  # FMI 3.0 -> FMI 2.0
    "GetFMUState": "GetFMUstate",
    "SetFMUState": "SetFMUstate",
    "FreeFMUState": "FreeFMUstate",
    "SerializedFMUStateSize": "SerializedFMUstateSize",
    "SerializeFMUState": "SerializeFMUstate",
    "DeserializeFMUState": "DeSerializeFMUstate",
    "GetContinuousStateDerivatives": "GetDerivatives",
    "GetOutputDerivatives": "GetRealOutputDerivatives",
    "UpdateDiscreteStates": "NewDiscreteStates",
}
TYPES: dict[int, dict[str, Any]] = {  # word in the name of a function -> what it reads or sets
    2: {
        "Real": ctypes.c_double,
        "Integer": ctypes.c_int,
        "Boolean": ctypes.c_int,
        "String": ctypes.c_char_p,
    },
    3: {
        "Float64": ctypes.c_double,
        "Float32": ctypes.c_float,
        "Boolean": ctypes.c_bool,
        "String": ctypes.c_char_p,
        **{f"{u}Int{n}": getattr(ctypes, f"c_{u.lower()}int{n}") for u in ("", "U") for n in (8, 16, 32, 64)},
    },
}
LAST_TIME, TERMINATED = 2, 3  # fmi2StatusKind
GUARD_BYTES = 64  # bytes behind a serialised state that the FMU must leave alone
CallHook = Callable[[str, float], None]


class CallFailed(Problem):
    """A call that ended with a status worse than a warning; the text says which one, when, and why."""

    def __init__(self, text: str, status: int = ERROR) -> None:
        self.status = status
        super().__init__(text)


class Crashed(Exception):
    """A crash that this platform turns into an exception (Windows)."""


class EventInfo(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = [
        *((n, ctypes.c_int) for n in ("needed", "terminate", "nominals", "values", "defined")),
        ("next", ctypes.c_double),
    ]


@dataclass(frozen=True)
class StepEnd:
    """What an FMU says about a step: it wants event handling or the end of the run, or ended the step early.

    reached   [s]; NaN where it does not say
    """

    event: bool = False
    terminate: bool = False
    early: bool = False
    reached: float = math.nan


def as_parameter(argument: Any) -> Any:
    """An argument in the form that ctypes passes on as it is, which halves the cost of a call."""
    if isinstance(argument, ctypes.Array):
        return ctypes.byref(argument)
    if isinstance(argument, ctypes._SimpleCData):
        return type(argument).from_param(argument.value)
    return argument


class BoundCall:
    """A call with all its arguments fixed; `check_status` raises on a status that does not do."""

    __slots__ = ("_call", "check_status")

    def __init__(self, call: Callable[[], int], check_status: Callable[[int], None]) -> None:
        self._call, self.check_status = call, check_status

    def __call__(self) -> None:
        status = self._call()
        if status:
            self.check_status(status)


class FmuInstance:
    """An instance; its calls raise CallFailed, with component, variables and time, when the FMU fails.

    exchange   for Model Exchange, else for Co-Simulation
    before     is called before each function, with its name and the time [s]
    handle     NULL before `instantiate` and after `free`
    worst      the worst status that any call returned
    flags      FMI 3.0: not zero after a step that wants something; `reached` is how far it got [s]
    results    FMI 3.0: addresses of what it says about a step: event, terminate, early, last time
    """

    def __init__(
        self, library: Library, log: Log, exchange: bool = False, before: CallHook | None = None
    ) -> None:
        self.library, self.log, self.exchange, self.before = library, log, exchange, before
        self.fmi, self.types = library.fmi, TYPES[library.fmi]
        self.handle, self.worst = ctypes.c_void_p(), 0
        self._environment: int = register_log(log)
        self._experiment: tuple[Any, ...] = ()
        self.flags, self.reached = ctypes.c_uint32(0), ctypes.c_double(math.nan)
        first = ctypes.addressof(self.flags)
        places = (first, first + 1, first + 2, ctypes.addressof(self.reached))
        self.results = places if self.fmi == 3 else ()
        self._results = tuple(as_parameter(ctypes.c_void_p(place)) for place in self.results)
        self._step: Callable[..., int] = partial(self.status, "DoStep")

    # ---- calls

    def name(self, function: str) -> str:
        """A function as the FMU calls it, without prefix."""
        return FMI2_NAMES.get(function, function) if self.fmi == 2 else function

    def address(self, function: str) -> int:
        """Where a function is in memory, for calls from C."""
        return self.library.address(self.name(function))

    def _call(self, name: str, *arguments: Any, result: Any = ctypes.c_int) -> Any:
        function = self.library.function(name, result)
        if self.before:
            self.before(self.library.prefix + name, self.log.time)
        try:
            return function(*arguments)
        except OSError as error:
            raise Crashed(f"{error} in {self.library.prefix}{name}") from None

    def status(self, function: str, *arguments: Any) -> int:
        """Call, and return the status."""
        status: int = self._call(self.name(function), self.handle, *arguments)
        return status

    def call(self, function: str, *arguments: Any, of: Sequence[str] = ()) -> None:
        """Call and judge; `of` are the variables that it is about."""
        status = self.status(function, *arguments)
        if status:
            self.check_status(status, self.describe_call(function, of))

    def bound(self, function: str, *arguments: Any, of: Sequence[str] = ()) -> BoundCall:
        """A call with all arguments fixed."""
        name, what = self.name(function), self.describe_call(function, of)
        call = partial(self.library.function(name), as_parameter(self.handle), *map(as_parameter, arguments))
        if self.before:
            call = partial(self._call, name, self.handle, *arguments)
        return BoundCall(call, lambda status: self.check_status(status, what))

    def describe_call(self, function: str, of: Sequence[str] = ()) -> str:
        """A call in words: fmi2GetReal of a, b, c, ..."""
        about = f" of {', '.join(of[:3])}{', ...' * (len(of) > 3)}" if of else ""
        return f"{self.library.prefix}{self.name(function)}{about}"

    def check_status(self, status: int, what: str) -> None:
        """Let warnings pass, raise on anything worse."""
        self.worst = max(self.worst, status)
        if status != WARNING:
            raise CallFailed(
                self.log.error_message(f"{what} failed", f"with status {status_label(status)}"), status
            )

    def flag(self, value: bool = False) -> Any:
        """A boolean of this version of FMI."""
        return self.types["Boolean"](value)

    # ---- life

    def instantiate(
        self,
        token: str,
        resources: str | None,
        name: str = "",
        verbose: bool = False,
        update: Any = None,
        early: bool = False,
        required: Sequence[int] = (),
    ) -> bool:
        """Make the instance; False where the FMU gives none.

        resources   their location: a URI in FMI 2.0, a path in FMI 3.0
        update      callback inside a step (FMI 3.0): may read `required` and, with `early`, end the step
        """
        texts = (name or self.log.component).encode(), token.encode()
        place = None if resources is None else os.fsencode(resources)
        if self.fmi == 2:
            function, kind = "Instantiate", 0 if self.exchange else 1
            self._callbacks = callbacks2(self._environment)
            callbacks = ctypes.byref(self._callbacks)
            arguments = [texts[0], kind, texts[1], place, callbacks, 0, int(verbose)]
        else:
            function = f"Instantiate{'ModelExchange' if self.exchange else 'CoSimulation'}"
            arguments = [*texts, place, self.flag(False), self.flag(verbose)]
            if not self.exchange:
                inner = (ctypes.c_uint * len(required))(*required) if required else None
                arguments += [self.flag(False), self.flag(early), inner, ctypes.c_size_t(len(required))]
            arguments += [ctypes.c_void_p(self._environment), logger3]
            arguments += [] if self.exchange else [update]
        self.handle = ctypes.c_void_p(self._call(function, *arguments, result=ctypes.c_void_p))
        if self.before is None and self.library.has("DoStep"):  # the shorter way
            self._step = partial(self.library.function("DoStep"), as_parameter(self.handle))
        return bool(self.handle)

    def setup(self, start: float, stop: float | None = None, tolerance: float | None = None) -> None:
        """Announce the experiment; times in [s]. FMI 3.0 gets it when initialisation mode is entered."""
        self.log.time, number = start, ctypes.c_double
        accuracy = self.flag(tolerance is not None), number(tolerance or 0.0)
        times = number(start), self.flag(stop is not None), number(stop or 0.0)
        self._experiment = (*accuracy, *times)
        if self.fmi == 2:
            self.call("SetupExperiment", *self._experiment)

    def enter(self) -> None:
        """Enter initialisation mode."""
        self.call("EnterInitializationMode", *(self._experiment if self.fmi == 3 else ()))

    def leave(self) -> None:
        """Leave initialisation mode."""
        self.call("ExitInitializationMode")

    def free(self) -> None:
        """Free the instance, unless it ended with a fatal error; may be repeated."""
        if self.handle and self.worst < FATAL:
            self._call("FreeInstance", self.handle, result=None)
        self.handle = ctypes.c_void_p()
        unregister_log(self._environment)

    # ---- values

    def references(self, references: Sequence[int]) -> tuple[Any, Any]:
        """Value references as arguments of a call."""
        return (ctypes.c_uint * len(references))(*references), ctypes.c_size_t(len(references))

    def values(self, values: Any, count: int) -> tuple[Any, ...]:
        """Values as arguments of a call: FMI 3.0 has their number, too."""
        return (values, ctypes.c_size_t(count)) if self.fmi == 3 else (values,)

    def read_doubles(self, function: str, *arguments: Any, count: int) -> list[float]:
        """What a function writes behind its other arguments, shape (count,)."""
        result = (ctypes.c_double * count)()
        self.call(function, *arguments, *self.values(result, count))
        return list(result)

    def directional(self, unknowns: Sequence[int], known: int) -> list[float]:
        """Derivatives of the unknowns with respect to one known, by value references."""
        given = *self.references(unknowns), *self.references([known])
        seed = self.values((ctypes.c_double * 1)(1.0), 1)
        return self.read_doubles("GetDirectionalDerivative", *given, *seed, count=len(unknowns))

    def adjoint(self, unknown: int, knowns: Sequence[int]) -> list[float]:
        """Derivatives of one unknown with respect to the knowns (FMI 3.0)."""
        given = *self.references([unknown]), *self.references(knowns)
        seed = self.values((ctypes.c_double * 1)(1.0), 1)
        return self.read_doubles("GetAdjointDerivative", *given, *seed, count=len(knowns))

    def output_derivatives(self, references: Sequence[int]) -> list[float]:
        """First time derivatives of outputs."""
        count = len(references)
        orders = (ctypes.c_int32 * count)(*[1] * count)
        return self.read_doubles("GetOutputDerivatives", *self.references(references), orders, count=count)

    # ---- steps

    def step(self, t: float, h: float, final: bool = True) -> int:
        """Advance from t to t + h [s]; `final`: no state of before t will be restored. Returns the status."""
        self.log.begin_step(t)
        times = ctypes.c_double(t), ctypes.c_double(h)
        return self._step(*times, self.flag(final), *self._results)

    def step_end(self, status: int) -> StepEnd:
        """What the FMU says about a step that returned this status."""
        if self.fmi == 3:
            event, terminate, early, _ = map(bool, bytes(self.flags))
            self.flags.value = 0
            return StepEnd(event, terminate, early, self.reached.value)
        if status != DISCARD:
            return StepEnd()
        reached, ended = ctypes.c_double(math.nan), ctypes.c_int(0)
        for function, what, answer in (("Real", LAST_TIME, reached), ("Boolean", TERMINATED, ended)):
            with suppress(Problem):  # an FMU need not have these functions
                self.status(f"Get{function}Status", what, ctypes.byref(answer))
        return StepEnd(terminate=bool(ended.value), reached=reached.value)

    # ---- states of the FMU

    def save(self, state: ctypes.c_void_p | None = None) -> ctypes.c_void_p:
        """A snapshot of the FMU's state, written over an earlier one if given; give it back with `forget`."""
        state = ctypes.c_void_p() if state is None else state
        self.call("GetFMUState", ctypes.byref(state))
        return state

    def restore(self, state: ctypes.c_void_p) -> None:
        """Go back to a snapshot."""
        self.call("SetFMUState", state)

    def free_state(self, state: ctypes.c_void_p) -> None:
        """Free a snapshot."""
        self.call("FreeFMUState", ctypes.byref(state))

    def serialize(self, state: ctypes.c_void_p) -> bytes:
        """A snapshot as bytes, for another process."""
        size = ctypes.c_size_t()
        self.call("SerializedFMUStateSize", state, ctypes.byref(size))
        room = (ctypes.c_ubyte * (size.value + GUARD_BYTES))(*[0] * size.value, *[0xA5] * GUARD_BYTES)
        self.call("SerializeFMUState", state, room, size)
        if bytes(room[size.value :]) != b"\xa5" * GUARD_BYTES:
            raise CallFailed(f"serialising a state: more is written than the announced {size.value} bytes")
        return bytes(room[: size.value])

    def deserialize(self, data: bytes) -> ctypes.c_void_p:
        """The snapshot in bytes that `pack` made; give it back with `forget`."""
        state, room = ctypes.c_void_p(), (ctypes.c_ubyte * max(len(data), 1)).from_buffer_copy(data or b"\0")
        self.call("DeserializeFMUState", room, ctypes.c_size_t(len(data)), ctypes.byref(state))
        return state

    # ---- model exchange

    def set_time(self, t: float) -> None:
        """Set the time [s]."""
        self.log.time = t
        self.call("SetTime", ctypes.c_double(t))

    def vector(self, function: str, values: Any, count: int) -> None:
        """Get or set states, their derivatives or nominal values, or event indicators, shape (count,)."""
        if count:
            self.call(function, values, ctypes.c_size_t(count))

    def update_discrete_states(self) -> tuple[bool, bool, float]:
        """A round of event iteration: is another needed, does the run end, the next time event [s]."""
        if self.fmi == 2:
            info = EventInfo()
            self.call("UpdateDiscreteStates", ctypes.byref(info))
            return bool(info.needed), bool(info.terminate), info.next if info.defined else math.inf
        flags, following = [self.flag() for _ in range(5)], ctypes.c_double()
        self.call("UpdateDiscreteStates", *map(ctypes.byref, flags), ctypes.byref(following))
        return flags[0].value, flags[1].value, following.value if flags[4].value else math.inf


def resources_location(folder: Path, fmi: int) -> str | None:
    """The location of the resources of an unpacked FMU, in the form of its version; None: it has none."""
    there = folder / "resources"
    if fmi == 2:
        return there.as_uri()
    return f"{there}{os.sep}" if there.is_dir() else None
