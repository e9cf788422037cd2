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
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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
    clock      last communication point, and beginning of the last step [s]
    label      component and file of the FMU
    """

    function: int
    fmi: int
    label: bytes
    _fields_ = [
        ("function", ctypes.c_int32),
        ("fmi", ctypes.c_int32),
        ("clock", ctypes.c_double * 2),
        ("label", ctypes.c_char * 488),
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


def function_number(name: str) -> int:
    """The number of an FMI function, given by its name without prefix."""
    return _NUMBERS.get(name, len(FUNCTIONS) - 1)


def share_calls(file: Path) -> mmap.mmap:
    """Keep the slots in a new file, before the first instance of this process; returns its map."""
    global _slots
    with file.open("w+b") as opened:
        opened.write(bytes(CALLS_SIZE))  # a full disk is an error now, not a signal later
        opened.flush()
        memory = mmap.mmap(opened.fileno(), CALLS_SIZE)
    _slots = _Slots.from_buffer(memory)
    return memory


def new_slot(label: str, fmi: int) -> CallSlot:
    """A slot for an instance; freed by setting `fmi` to 0."""
    slot = next((slot for slot in _slots if not slot.fmi), None) or CallSlot()
    slot.function, slot.fmi, slot.label = 0, fmi, label.encode()[: CallSlot.label.size - 1]  # type: ignore[attr-defined]
    slot.clock[:] = math.nan, math.nan
    return slot


@contextmanager
def in_progress(label: str, fmi: int, function: str) -> Iterator[None]:
    """Context of a call that no instance makes, such as LOADING."""
    slot = new_slot(label, fmi)
    slot.function = function_number(function)
    try:
        yield
    finally:
        slot.function = slot.fmi = 0


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

_HEAD = struct.Struct("<Qd64s")
_TEXT = 512
ACTIVITY_SIZE = _HEAD.size + _TEXT


@dataclass(frozen=True)
class Activity:
    """The last activity of a worker.

    count    number of calls
    time     simulation time [s]; NaN before the first step
    call     name of the last function
    inputs   last inputs; if a case is under test, the case in round brackets and the values set in it
    """

    count: int
    time: float
    call: str
    inputs: str

    def __str__(self) -> str:
        where = f"in {self.call}" if self.call else "before the first call"
        when = f" at t = {self.time:.9g} s" if self.time == self.time else ""
        if self.inputs.startswith("("):  # the case under test
            return f"{where}{when} {self.inputs}"
        return f"{where}{when}" + (f", last inputs {self.inputs}" if self.inputs else "")


NONE = _HEAD.pack(0, float("nan"), b"") + bytes(_TEXT)


def activity_in(file: bytes) -> Activity:
    """The activity in a file; none if it is incomplete, or if an FMU has written to it."""
    count, time, call = _HEAD.unpack_from(file if len(file) == ACTIVITY_SIZE else NONE)
    if not call.rstrip(b"\0").decode("latin-1").isprintable():
        return activity_in(NONE)
    return Activity(count, time, _text(call), _text(file[_HEAD.size :]))


class ActivityRecord:
    """The activity file, for the child."""

    def __init__(self, path: Path, keep: Callable[[mmap.mmap], mmap.mmap] = lambda memory: memory) -> None:
        """keep: see `Channel.keep`."""
        path.write_bytes(NONE)
        with path.open("r+b") as file:
            self._memory = keep(mmap.mmap(file.fileno(), ACTIVITY_SIZE))
        self._count, self._case = 0, ""

    def clear(self) -> None:
        """Forget the last activity."""
        self._memory[:] = NONE

    def call(self, name: str, time: float = float("nan")) -> None:
        """Store the function that is called next, and the simulation time [s]."""
        self._count += 1
        _HEAD.pack_into(self._memory, 0, self._count, time, name.encode())

    def case(self, text: str) -> None:
        """Store the case under test; values that are set afterwards follow it."""
        self._case = f"({text})"
        self._write(self._case)

    def inputs(self, text: str) -> None:
        """Store the values that were set last."""
        self._write(f"{self._case}, last values {text}" if self._case else text)

    def _write(self, text: str) -> None:
        raw = text.encode()[:_TEXT]
        self._memory[_HEAD.size : _HEAD.size + len(raw)] = raw
        self._memory[_HEAD.size + len(raw) :] = bytes(_TEXT - len(raw))

    def read(self) -> Activity:
        """Read the last activity."""
        return activity_in(self._memory[:])


def _text(raw: bytes) -> str:
    return raw.rstrip(b"\0").decode(errors="replace")
