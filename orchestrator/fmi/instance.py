"""FMU instance with one interface to the C functions of FMI 2.0 and 3.0, Co-Simulation and Model Exchange.

Functions have the names of FMI 3.0, without prefix. Instances run without event mode, early return and
intermediate update unless these are requested. This module needs only the standard library.
"""

from __future__ import annotations

import ctypes
import gc
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from orchestrator.base.errors import Problem
from orchestrator.fmi.library import Library, callbacks2, logger3, register_log, unregister_log
from orchestrator.fmi.messages import DISCARD, ERROR, FATAL, WARNING, Log, status_label
from orchestrator.worker.calls import free_slot, function_number, new_slot

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
TYPES: dict[int, dict[str, Any]] = {  # FMI version -> type in the name of a function -> type in C
    2: {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int, "String": ctypes.c_char_p},
    3: {
        "Float64": ctypes.c_double,
        "Float32": ctypes.c_float,
        "Boolean": ctypes.c_bool,
        "String": ctypes.c_char_p,
        "Binary": ctypes.c_char_p,
        **{f"{u}Int{n}": getattr(ctypes, f"c_{u.lower()}int{n}") for u in ("", "U") for n in (8, 16, 32, 64)},
    },
}
LAST_TIME, TERMINATED = 2, 3  # fmi2StatusKind
STEP = function_number("DoStep")
EVENT_FLAGS = ("needed", "terminate", "nominals", "values", "defined")
MAX_EVENT_ITERATIONS = 100  # at one event
CLOSE = 1e-6  # of a step: events that are closer follow each other without progress
MOST_CLOSE_EVENTS = 200  # in a row
MAX_STATE, MAX_VALUES = 2 << 30, 64 << 20  # bytes that an FMU returns: a state, and the values of a variable
GUARD_BYTES = 64  # after the buffer of a serialised state, to detect a write beyond its end
CallHook = Callable[[str, float], None]
AfterCall = Callable[["FmuInstance"], None] | None


class CallFailed(Problem):
    """A call ended with a status worse than a warning; the message contains call, time and reason."""

    def __init__(self, message: str, status: int = ERROR) -> None:
        self.status = status
        super().__init__(message)


class Unsettled(CallFailed):
    """Discrete states that still change after many event iterations."""


class Crashed(Exception):
    """A crash of a call, which Windows reports as an exception."""


class EventInfo(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = [*((name, ctypes.c_int) for name in EVENT_FLAGS), ("next", ctypes.c_double)]


class EventFlags(ctypes.Structure):
    """The results of fmi3UpdateDiscreteStates, in their order."""

    _fields_ = [*((name, ctypes.c_bool) for name in EVENT_FLAGS), ("next", ctypes.c_double)]


@dataclass(frozen=True)
class StepEnd:
    """Results of a step that an FMU reports besides the status.

    event       the FMU needs event handling
    terminate   the FMU requests the end of the simulation
    early       early return
    reached     last successful time [s]; NaN if the FMU does not report it
    """

    event: bool = False
    terminate: bool = False
    early: bool = False
    reached: float = math.nan


def as_parameter(argument: Any) -> Any:
    """An argument in a form that ctypes passes without conversion, which halves the time of a call."""
    if isinstance(argument, ctypes.Array):
        return ctypes.byref(argument)
    if isinstance(argument, ctypes._SimpleCData):
        return type(argument).from_param(argument.value)
    return argument


class BoundCall:
    """A call with fixed arguments; `check_status` raises an exception for a status worse than a warning.

    function       name in FMI 3.0, without prefix
    instance       the instance that it belongs to
    slot, number   where the number of the function is while the call is in progress, see `worker.calls`
    """

    __slots__ = ("_call", "check_status", "function", "instance", "number", "slot")

    def __init__(
        self, instance: FmuInstance, function: str, call: Callable[[], int], description: str
    ) -> None:
        self.instance, self.function, self._call = instance, function, call
        self.slot, self.number = instance.slot, function_number(instance.name(function))
        self.check_status = partial(instance.check_status, description=description)

    def for_c(self) -> dict[str, Any]:
        """The members that all structures for a call in engine.h have."""
        return {
            "function": self.instance.address(self.function),
            "instance": self.instance.handle.value or 0,
            "fmi": self.instance.fmi,
            "call": ctypes.addressof(self.slot),
            "function_number": self.number,
        }

    def __call__(self) -> None:
        self.instance.check_open()
        collects = self.instance.begin_call(self.number)
        status = self._call()
        self.instance.end_call(collects)
        if status:
            self.check_status(status)


class FmuInstance:
    """An FMU instance. A failed call raises CallFailed with component, variables and time.

    exchange   True for Model Exchange, False for Co-Simulation
    before     called before each function, with its name and the time [s]
    after      called after each function that Python calls
    slot       the call in progress
    handle     NULL before `instantiate` and after `free`
    events     event mode of Co-Simulation is used
    worst      the worst status of all calls
    flags      FMI 3.0: event, terminate and early return of the last step; 0 if none of them is set
    reached    FMI 3.0: last successful time [s]
    results    FMI 3.0: addresses of event, terminate, early return and last successful time
    """

    def __init__(
        self,
        library: Library,
        log: Log,
        exchange: bool = False,
        before: CallHook | None = None,
        label: str = "",
        after: AfterCall = None,
    ) -> None:
        """`label`: component and file of the FMU, for messages after a crash."""
        self.library, self.log, self.exchange, self.before = library, log, exchange, before
        self.after, self._closed = after, False
        self.fmi, self.types = library.fmi, TYPES[library.fmi]
        self.handle, self.worst, self.events = ctypes.c_void_p(), 0, False
        self._environment: int = register_log(log)
        self.slot = new_slot(label or log.component, library.fmi)
        log.clock = self.slot.clock
        self._experiment: tuple[Any, ...] = ()
        self.flags, self.reached = ctypes.c_uint32(0), ctypes.c_double(math.nan)
        first = ctypes.addressof(self.flags)
        addresses = (first, first + 1, first + 2, ctypes.addressof(self.reached))
        self.results = addresses if self.fmi == 3 else ()
        self._results = tuple(as_parameter(ctypes.c_void_p(address)) for address in self.results)
        self._step: Callable[..., int] = partial(self.status, "DoStep")

    # ---- calls

    def name(self, function: str) -> str:
        """The name of a function in the version of the FMU, without prefix."""
        return FMI2_NAMES.get(function, function) if self.fmi == 2 else function

    def address(self, function: str) -> int:
        """Address of a function, for calls from C."""
        return self.library.address(self.name(function))

    def check_open(self) -> None:
        """Raise Problem after `free`: a call would end the process."""
        if self._closed:
            raise Problem(f"{self.log.component}: expected an FMU that runs, got one that is closed")

    def begin_call(self, function: int) -> bool:
        """Before a call; True if garbage has to be collected again after it.

        A collection runs code of other libraries, which a trap that the FMU has switched on would end.
        """
        collects = self.after is not None and gc.isenabled()
        if collects:
            gc.disable()
        self.slot.function = function
        return collects

    def end_call(self, collects: bool) -> None:
        """After a call."""
        self.slot.function = 0
        if self.after:
            self.after(self)
        if collects:
            gc.enable()

    def _call(self, name: str, *arguments: Any, result: Any = ctypes.c_int) -> Any:
        self.check_open()
        function = self.library.function(name, result)
        if self.before:
            self.before(self.library.prefix + name, self.log.time)
        collects = self.begin_call(function_number(name))
        try:
            return function(*arguments)
        except OSError as error:
            raise Crashed(f"{error} in {self.library.prefix}{name}") from None
        finally:
            self.end_call(collects)

    def status(self, function: str, *arguments: Any) -> int:
        """Call a function and return its status."""
        status: int = self._call(self.name(function), self.handle, *arguments)
        return status

    def call(self, function: str, *arguments: Any, variables: Sequence[str] = ()) -> None:
        """Call a function and check its status; `variables`: names for the message."""
        status = self.status(function, *arguments)
        if status:
            self.check_status(status, self.describe_call(function, variables))

    def bound(self, function: str, *arguments: Any, variables: Sequence[str] = ()) -> BoundCall:
        """A call with fixed arguments."""
        self.check_open()
        name, description = self.name(function), self.describe_call(function, variables)
        call = partial(self.library.function(name), as_parameter(self.handle), *map(as_parameter, arguments))
        if self.before:
            call = partial(self._call, name, self.handle, *arguments)
        return BoundCall(self, function, call, description)

    def describe_call(self, function: str, variables: Sequence[str] = ()) -> str:
        """A call in words, for messages: fmi2GetReal of a, b, c, ..."""
        names = f" of {', '.join(variables[:3])}{', ...' * (len(variables) > 3)}" if variables else ""
        return f"{self.library.prefix}{self.name(function)}{names}"

    def check_status(self, status: int, description: str, hint: str = "") -> None:
        """Raise CallFailed for a status worse than a warning."""
        self.worst = max(self.worst, status)
        if status != WARNING:
            details = f"with status {status_label(status)}{hint}"
            raise CallFailed(self.log.error_message(f"{description} failed", details), status)

    def flag(self, value: bool = False) -> Any:
        """A boolean of this version of FMI."""
        return self.types["Boolean"](value)

    # ---- life cycle

    def instantiate(
        self,
        token: str,
        resources: str | None,
        name: str = "",
        verbose: bool = False,
        update: Any = None,
        early: bool = False,
        required: Sequence[int] = (),
        events: bool = False,
    ) -> bool:
        """Instantiate the FMU; False if the FMU returns no instance.

        token       GUID (FMI 2.0) or instantiation token (FMI 3.0)
        resources   location of the resources: a URI in FMI 2.0, a path in FMI 3.0
        verbose     debug logging
        update      FMI 3.0: intermediate update callback, which may get the variables `required`
        early       FMI 3.0: the FMU may return early, also where the callback requests it
        events      FMI 3.0: event mode is used
        """
        texts, self.events = ((name or self.log.component).encode(), token.encode()), events
        location = None if resources is None else os.fsencode(resources)
        if self.fmi == 2:
            function, fmu_type = "Instantiate", 0 if self.exchange else 1
            self._callbacks = callbacks2(self._environment)
            callbacks = ctypes.byref(self._callbacks)
            arguments = [texts[0], fmu_type, texts[1], location, callbacks, 0, int(verbose)]
        else:
            function = f"Instantiate{'ModelExchange' if self.exchange else 'CoSimulation'}"
            arguments = [*texts, location, self.flag(False), self.flag(verbose)]
            if not self.exchange:
                references = (ctypes.c_uint * len(required))(*required) if required else None
                arguments += [self.flag(events), self.flag(early), references, ctypes.c_size_t(len(required))]
            arguments += [ctypes.c_void_p(self._environment), logger3]
            arguments += [] if self.exchange else [update]
        self.handle = ctypes.c_void_p(self._call(function, *arguments, result=ctypes.c_void_p))
        if self.before is None and self.library.has("DoStep"):  # the fastest way to call
            self._step = partial(self.library.function("DoStep"), as_parameter(self.handle))
        return bool(self.handle)

    def setup(self, start: float, stop: float | None = None, tolerance: float | None = None) -> None:
        """Set up the experiment; times in [s]. FMI 3.0 receives it when it enters initialisation mode."""
        self.log.time, double = start, ctypes.c_double
        tolerance_arguments = self.flag(tolerance is not None), double(tolerance or 0.0)
        times = double(start), self.flag(stop is not None), double(stop or 0.0)
        self._experiment = (*tolerance_arguments, *times)
        if self.fmi == 2:
            self.call("SetupExperiment", *self._experiment)

    def enter(self) -> None:
        """Enter initialisation mode."""
        self.call("EnterInitializationMode", *(self._experiment if self.fmi == 3 else ()))

    def leave(self) -> None:
        """Leave initialisation mode."""
        self.call("ExitInitializationMode")

    def free(self) -> None:
        """Free the instance, except after a fatal error. May be repeated."""
        if self.handle and self.worst < FATAL:
            self._call("FreeInstance", self.handle, result=None)
        if not self._closed:
            self.slot = free_slot(self.slot)
        self.handle, self._closed = ctypes.c_void_p(), True
        self._step = partial(self.status, "DoStep")
        self.log.clock = self.slot.clock
        unregister_log(self._environment)

    # ---- values

    def references(self, references: Sequence[int]) -> tuple[Any, Any]:
        """Value references and their number as arguments of a call."""
        return (ctypes.c_uint * len(references))(*references), ctypes.c_size_t(len(references))

    def values(self, values: Any, count: int) -> tuple[Any, ...]:
        """Values as arguments of a call, in FMI 3.0 followed by their number."""
        return (values, ctypes.c_size_t(count)) if self.fmi == 3 else (values,)

    def read_doubles(self, function: str, *arguments: Any, count: int) -> list[float]:
        """Call a function whose last argument is an array of doubles; return the array, shape (count,)."""
        result = (ctypes.c_double * count)()
        self.call(function, *arguments, *self.values(result, count))
        return list(result)

    def directional(self, unknowns: Sequence[int], known: int) -> list[float]:
        """Derivatives of the unknowns with respect to one known, by value references."""
        references = *self.references(unknowns), *self.references([known])
        seed = self.values((ctypes.c_double * 1)(1.0), 1)
        return self.read_doubles("GetDirectionalDerivative", *references, *seed, count=len(unknowns))

    def adjoint(self, unknown: int, knowns: Sequence[int]) -> list[float]:
        """Derivatives of one unknown with respect to the knowns (FMI 3.0)."""
        references = *self.references([unknown]), *self.references(knowns)
        seed = self.values((ctypes.c_double * 1)(1.0), 1)
        return self.read_doubles("GetAdjointDerivative", *references, *seed, count=len(knowns))

    def output_derivatives(self, references: Sequence[int]) -> list[float]:
        """First time derivatives of outputs, by value references."""
        count = len(references)
        orders = (ctypes.c_int32 * count)(*[1] * count)
        return self.read_doubles("GetOutputDerivatives", *self.references(references), orders, count=count)

    # ---- steps

    def step(self, t: float, h: float, final: bool = True) -> int:
        """Advance from t to t + h [s] and return the status; `final`: no state before t will be restored."""
        self.log.begin_step(t, h)
        times = ctypes.c_double(t), ctypes.c_double(h)
        collects = self.begin_call(STEP)
        status = self._step(*times, self.flag(final), *self._results)
        self.end_call(collects)
        return status

    def step_end(self, status: int) -> StepEnd:
        """Results of the last step, which returned `status`."""
        if self.fmi == 3:
            event, terminate, early, _ = map(bool, bytes(self.flags))
            self.flags.value = 0
            return StepEnd(event, terminate, early, self.reached.value)
        if status != DISCARD:
            return StepEnd()
        reached, ended = ctypes.c_double(math.nan), ctypes.c_int(0)
        for type_, status_kind, result in (("Real", LAST_TIME, reached), ("Boolean", TERMINATED, ended)):
            with suppress(Problem):  # these functions are optional
                self.status(f"Get{type_}Status", status_kind, ctypes.byref(result))
        return StepEnd(terminate=bool(ended.value), reached=reached.value)

    # ---- FMU state

    def save(self, state: ctypes.c_void_p | None = None) -> ctypes.c_void_p:
        """Save the FMU state, in a new object or over an earlier one; free it with `free_state`."""
        state = ctypes.c_void_p() if state is None else state
        self.call("GetFMUState", ctypes.byref(state))
        return state

    def restore(self, state: ctypes.c_void_p) -> None:
        """Restore a saved FMU state."""
        self.call("SetFMUState", state)

    def free_state(self, state: ctypes.c_void_p) -> None:
        """Free a saved FMU state."""
        self.call("FreeFMUState", ctypes.byref(state))

    def check_size(self, what: str, size: int, most: int = MAX_VALUES) -> None:
        """Refuse a size that the FMU has chosen [bytes], before memory is taken for it."""
        if size > most:
            raise CallFailed(self.log.error_message(what, f"has more than {most / 1e6:.0f} MB"))

    def serialize(self, state: ctypes.c_void_p) -> bytes:
        """Serialise a saved FMU state, for another process."""
        size = ctypes.c_size_t()
        self.call("SerializedFMUStateSize", state, ctypes.byref(size))
        self.check_size("a serialised state", size.value, MAX_STATE)
        buffer = (ctypes.c_ubyte * (size.value + GUARD_BYTES))()
        ctypes.memset(ctypes.byref(buffer, size.value), 0xA5, GUARD_BYTES)
        self.call("SerializeFMUState", state, buffer, size)
        if bytes(buffer[size.value :]) != b"\xa5" * GUARD_BYTES:
            raise CallFailed(f"serialising a state: more is written than the announced {size.value} bytes")
        return ctypes.string_at(buffer, size.value)

    def deserialize(self, data: bytes) -> ctypes.c_void_p:
        """Restore a saved FMU state from the bytes of `serialize`; free it with `free_state`."""
        state, count = ctypes.c_void_p(), max(len(data), 1)
        buffer = (ctypes.c_ubyte * count).from_buffer_copy(data or b"\0")
        self.call("DeserializeFMUState", buffer, ctypes.c_size_t(len(data)), ctypes.byref(state))
        return state

    # ---- model exchange

    def set_time(self, t: float) -> None:
        """Set the time [s]."""
        self.log.time = t
        self.call("SetTime", ctypes.c_double(t))

    def vector(self, function: str, values: Any, count: int) -> None:
        """Get or set an array of states, derivatives, nominal values or event indicators, shape (count,)."""
        if count:
            self.call(function, values, ctypes.c_size_t(count))

    def update_discrete_states(self) -> tuple[bool, bool, float]:
        """One event iteration: (another iteration needed, end of the simulation, next time event [s])."""
        call, info = self._event_update
        ctypes.memset(ctypes.byref(info), 0, ctypes.sizeof(info))
        call()
        return bool(info.needed), bool(info.terminate), info.next if info.defined else math.inf

    @cached_property
    def _event_update(self) -> tuple[BoundCall, Any]:
        """A bound call of UpdateDiscreteStates, and its results."""
        info = EventInfo() if self.fmi == 2 else EventFlags()
        places = (
            [0] if self.fmi == 2 else [getattr(EventFlags, name).offset for name in (*EVENT_FLAGS, "next")]
        )
        return self.bound("UpdateDiscreteStates", *(ctypes.byref(info, place) for place in places)), info


class Chatter:
    """Refuses events without progress; time: of the last one [s], close: how many such in a row."""

    def __init__(self, time: float) -> None:
        self.time, self.close = time, 0

    def check(self, names: Iterable[str], t: float, step: float) -> None:
        """After an event of these FMUs in steps of a length [s]."""
        self.close = self.close + 1 if abs(t - self.time) <= CLOSE * step else 0
        self.time = t
        if self.close >= MOST_CLOSE_EVENTS:
            expected = f"expected time to pass between events, got {self.close} events without progress"
            raise Problem(f"{', '.join(dict.fromkeys(names))}: t = {t:.9g} s: {expected} (chattering)")


EventUpdate = Callable[[], tuple[bool, bool, float]]


def settle(
    where: str, updates: Mapping[str, EventUpdate], copied: Callable[[], Sequence[str]] = tuple
) -> tuple[str, dict[str, float]]:
    """Copy values and update discrete states of FMUs in event mode until nothing changes.

    where     begins a message
    updates   component -> `update_discrete_states`
    copied    copies values between the FMUs; returns the signals that are not continuous and have changed

    Returns the component that requests the end of the simulation, if there is one, and the time of the next
    time event of each component [s], infinite if there is none.
    """
    ended, settled, restless = "", False, list[str]()
    for count in range(MAX_EVENT_ITERATIONS + 1):
        changed = copied()
        if settled and not changed:
            break
        if count == MAX_EVENT_ITERATIONS:
            names = ", ".join(dict.fromkeys([*changed, *restless]))
            expected = f"expected at most {MAX_EVENT_ITERATIONS} event iterations, got more"
            raise Unsettled(f"{where}: {expected}: the discrete states do not settle: {names}")
        results = {name: update() for name, update in updates.items()}
        restless = [name for name, (needed, _, _) in results.items() if needed]
        ended = next((name for name, (_, ends, _) in results.items() if ends), ended)
        settled = bool(ended) or not restless
    return ended, {name: time for name, (_, _, time) in results.items()}


def resources_location(folder: Path, fmi: int) -> str | None:
    """Location of the resources of an unpacked FMU, as its FMI version requires; None without resources."""
    resources = folder / "resources"
    if fmi == 2:
        return resources.as_uri()
    return f"{resources}{os.sep}" if resources.is_dir() else None
