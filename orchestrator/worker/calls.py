"""What a worker process stores for its parent in files that it maps into its memory, readable after a crash.

Calls in progress: each FMU instance has a slot with its label, the function that is being called, and its
communication points. Python and the C engine write the number of the function before a call and 0 after it.
The slots of a worker process are in a file; those of any other process are in its own memory.

Last activity, of a process of `check`: number of calls, simulation time [s], name of the last call, last
inputs as text.
"""

import ctypes
import math
import mmap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

# ---- calls in progress

SLOTS = 256  # instances with a slot in the file; further ones have one in the memory of the process
FIRST = ("", "DoStep", "GetFMUState", "SetFMUState")  # STEP, SAVE and RESTORE in engine.h
FUNCTIONS_2 = {  # of FMI 2.0, by interface type; "": of both
    "": """GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment
    EnterInitializationMode ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString
    SetReal SetInteger SetBoolean SetString GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize
    SerializeFMUstate DeSerializeFMUstate GetDirectionalDerivative""",
    "ModelExchange": """EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep
    SetTime SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates
    GetNominalsOfContinuousStates""",
    "CoSimulation": """SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus
    GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus""",
}
FUNCTIONS_3 = """GetVersion SetDebugLogging InstantiateModelExchange InstantiateCoSimulation
    InstantiateScheduledExecution FreeInstance EnterInitializationMode ExitInitializationMode
    EnterEventMode Terminate Reset GetNumberOfVariableDependencies GetVariableDependencies
    GetFMUState SetFMUState FreeFMUState SerializedFMUStateSize SerializeFMUState
    DeserializeFMUState GetDirectionalDerivative GetAdjointDerivative EnterConfigurationMode
    ExitConfigurationMode GetIntervalDecimal GetIntervalFraction GetShiftDecimal GetShiftFraction
    SetIntervalDecimal SetIntervalFraction SetShiftDecimal SetShiftFraction EvaluateDiscreteStates
    UpdateDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime SetContinuousStates
    GetContinuousStateDerivatives GetEventIndicators GetContinuousStates
    GetNominalsOfContinuousStates GetNumberOfEventIndicators GetNumberOfContinuousStates
    EnterStepMode GetOutputDerivatives DoStep ActivateModelPartition
    GetFloat32 GetFloat64 GetInt8 GetUInt8 GetInt16 GetUInt16 GetInt32 GetUInt32 GetInt64 GetUInt64
    GetBoolean GetString GetBinary GetClock SetFloat32 SetFloat64 SetInt8 SetUInt8 SetInt16 SetUInt16
    SetInt32 SetUInt32 SetInt64 SetUInt64 SetBoolean SetString SetBinary SetClock"""
LOADING, UNLOADING, UNKNOWN = "loading its library", "unloading its library", "another function"
_NAMES = " ".join([*FUNCTIONS_2.values(), FUNCTIONS_3]).split()
FUNCTIONS = tuple(dict.fromkeys([*FIRST, *_NAMES, LOADING, UNLOADING, UNKNOWN]))
_NUMBERS = {name: number for number, name in enumerate(FUNCTIONS)}


class CallSlot(ctypes.Structure):
    """The call in progress of one instance.

    function   number of the FMI function, see FUNCTIONS; 0: none
    fmi        2 or 3; 0: the slot is free
    clock      last communication point, beginning and end of the last step [s]
    label      component and file of the FMU
    """

    function: int
    fmi: int
    label: bytes
    _fields_ = [
        ("function", ctypes.c_int32),
        ("fmi", ctypes.c_int32),
        ("clock", ctypes.c_double * 3),
        ("label", ctypes.c_char * 480),
    ]

    def __str__(self) -> str:
        """The call, such as `fmi2DoStep at t = 0.5 s`."""
        name, t = FUNCTIONS[self.function], self.clock[0]
        text = name if " " in name else f"fmi{self.fmi}{name}"
        return text + (f" at t = {t:.9g} s" if t == t else "")

    @property
    def instance(self) -> str:
        """Component and file of the FMU."""
        return self.label.decode(errors="replace")


_Slots: Any = CallSlot * SLOTS
CALLS_SIZE = ctypes.sizeof(_Slots)
OUTSIDE = "outside of the FMUs"
_slots = _Slots()
_free = [*_slots][::-1]


def function_number(name: str) -> int:
    """The number of an FMI function, given by its name without prefix."""
    return _NUMBERS.get(name, len(FUNCTIONS) - 1)


def share_calls(file: Path) -> mmap.mmap:
    """Keep the slots in a new file, before the first instance of this process; returns its map."""
    global _slots, _free
    with file.open("w+b") as opened:
        opened.write(bytes(CALLS_SIZE))  # a full disk is an error now, not a signal later
        opened.flush()
        memory = mmap.mmap(opened.fileno(), CALLS_SIZE)
    _slots = _Slots.from_buffer(memory)
    _free = [*_slots][::-1]
    return memory


def new_slot(label: str, fmi: int) -> CallSlot:
    """A slot for an instance."""
    slot = _free.pop() if _free else CallSlot()
    slot.function, slot.fmi, slot.label = 0, fmi, label.encode()[: CallSlot.label.size - 1]  # type: ignore[attr-defined]
    slot.clock[:] = [math.nan] * 3
    return slot


def free_slot(slot: CallSlot) -> CallSlot:
    """Free a slot, which may become that of another instance; returns a copy."""
    slot.function = slot.fmi = 0
    if slot._b_base_ is _slots:
        _free.append(slot)
    return CallSlot.from_buffer_copy(slot)


@contextmanager
def in_progress(label: str, fmi: int, function: str) -> Iterator[None]:
    """Context of a call that no instance makes, such as LOADING."""
    slot = new_slot(label, fmi)
    slot.function = function_number(function)
    try:
        yield
    finally:
        free_slot(slot)


def calls_in(file: bytes) -> str:
    """The calls in progress in a worker process, or at its end, for a message."""
    if len(file) != CALLS_SIZE:  # the process has not got that far
        return OUTSIDE
    slots = [
        slot for slot in _Slots.from_buffer_copy(file) if slot.fmi in (2, 3) and slot.instance.isprintable()
    ]
    calls = [f"in {slot} of {slot.instance}" for slot in slots if 0 < slot.function < len(FUNCTIONS)]
    return "; ".join(calls) or OUTSIDE


# ---- last activity


class Activity(ctypes.Structure):
    """The last activity of a process.

    count   number of calls
    time    simulation time [s]; NaN before the first step
    name    of the last function
    text    last inputs; if a case is under test, the case in round brackets and the values set in it
    """

    count: int
    time: float
    name: bytes
    text: bytes
    _fields_ = [
        ("count", ctypes.c_uint64),
        ("time", ctypes.c_double),
        ("name", ctypes.c_char * 64),
        ("text", ctypes.c_char * 512),
    ]
    _case = ""

    def __str__(self) -> str:
        name, text = (raw.decode(errors="replace") for raw in (self.name, self.text))
        where = f"in {name}" if name else "before the first call"
        when = f" at t = {self.time:.9g} s" if self.time == self.time else ""
        if text.startswith("("):  # the case under test
            return f"{where}{when} {text}"
        return f"{where}{when}" + (f", last inputs {text}" if text else "")

    def clear(self) -> None:
        """Forget the last activity."""
        ctypes.memmove(ctypes.byref(self), NONE, ACTIVITY_SIZE)

    def call(self, name: str, time: float = math.nan) -> None:
        """Store the function that is called next, and the simulation time [s]."""
        self.time, self.name, self.count = time, name.encode()[: Activity.name.size], self.count + 1  # type: ignore[attr-defined]

    def case(self, text: str) -> None:
        """Store the case under test; values that are set afterwards follow it."""
        self._case = f"({text})"
        self._write(self._case)

    def inputs(self, text: str) -> None:
        """Store the values that were set last."""
        self._write(f"{self._case}, last values {text}" if self._case else text)

    def _write(self, text: str) -> None:
        self.text = text.encode()[: Activity.text.size]  # type: ignore[attr-defined]


ACTIVITY_SIZE = ctypes.sizeof(Activity)
NONE = bytes(Activity(time=math.nan))


def activity_in(file: bytes) -> Activity:
    """The activity in a file; none if it is incomplete, or if an FMU has written to it."""
    last = Activity.from_buffer_copy(file if len(file) == ACTIVITY_SIZE else NONE)
    text = (last.name + last.text).decode(errors="replace")
    ours = last.name.isascii() and text.isprintable() and text.count("\ufffd") < 2  # one that was cut
    return last if ours else Activity.from_buffer_copy(NONE)


def share_activity(file: Path, keep: Callable[[mmap.mmap], mmap.mmap] = lambda memory: memory) -> Activity:
    """The activity of this process, in a new file; keep: see `Channel.keep`."""
    file.write_bytes(NONE)
    with file.open("r+b") as opened:
        return Activity.from_buffer(keep(mmap.mmap(opened.fileno(), ACTIVITY_SIZE)))
