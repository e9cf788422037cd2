"""FMI calls in progress in a process, in a file that its parent can read after a crash.

Each FMU instance has a slot with its label, the function that is being called, and its communication points.
Python and the C engine write the number of the function before a call and 0 after it. The slots of a worker
process are in a file that is mapped into its memory; those of any other process are in its own memory.
"""

import ctypes
import math
import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

SLOTS = 256  # instances with a slot in the file; further ones have one in the memory of the process
FIRST = ("", "DoStep", "GetFMUState", "SetFMUState")  # STEP, SAVE and RESTORE in engine.h
TYPES = "Real Integer Boolean String Float64 Float32 Int8 UInt8 Int16 UInt16 Int32 UInt32 Int64 UInt64"
OTHERS = (
    "Instantiate InstantiateCoSimulation InstantiateModelExchange FreeInstance SetDebugLogging"
    " SetupExperiment EnterInitializationMode ExitInitializationMode EnterConfigurationMode"
    " ExitConfigurationMode Terminate Reset GetFMUstate SetFMUstate FreeFMUstate FreeFMUState"
    " SerializeFMUstate SerializeFMUState DeSerializeFMUstate DeserializeFMUState"
    " GetDirectionalDerivative GetAdjointDerivative GetRealOutputDerivatives GetOutputDerivatives"
    " SetRealInputDerivatives GetRealStatus GetBooleanStatus"
    " SetTime SetContinuousStates GetEventIndicators CompletedIntegratorStep"
)
LOADING, UNLOADING, UNKNOWN = "loading its library", "unloading its library", "another function"
FUNCTIONS = (
    *FIRST,
    *OTHERS.split(),
    *(f"{verb}{type_}" for verb in ("Get", "Set") for type_ in TYPES.split()),
    *(LOADING, UNLOADING, UNKNOWN),
)
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
SIZE = ctypes.sizeof(_Slots)
OUTSIDE = "outside of the FMUs"
_slots = _Slots()


def function_number(name: str) -> int:
    """The number of an FMI function, given by its name without prefix."""
    return _NUMBERS.get(name, len(FUNCTIONS) - 1)


def share_calls(file: Path) -> mmap.mmap:
    """Keep the slots in a new file, before the first instance of this process; returns its map."""
    global _slots
    with file.open("w+b") as opened:
        opened.write(bytes(SIZE))  # a full disk is an error now, not a signal later
        opened.flush()
        memory = mmap.mmap(opened.fileno(), SIZE)
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
    if len(file) != SIZE:  # the process has not got that far
        return OUTSIDE
    slots = [
        slot for slot in _Slots.from_buffer_copy(file) if slot.fmi in (2, 3) and slot.instance.isprintable()
    ]
    calls = [f"in {slot} of {slot.instance}" for slot in slots if 0 < slot.function < len(FUNCTIONS)]
    return "; ".join(calls) or OUTSIDE
