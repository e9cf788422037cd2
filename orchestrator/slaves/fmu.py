"""A running co-simulation FMU, FMI 2.0 or 3.0.

Readers and writers are bound once to value references and a slice of a NumPy array; calling one is a
single call into the FMU without any allocation (types other than Float64 and Int32 are converted).
"""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.slaves.calls import Calls
from orchestrator.slaves.fmi2 import Fmi2
from orchestrator.slaves.fmi3 import Fmi3
from orchestrator.slaves.library import Library
from orchestrator.slaves.log import ERROR, Log
from orchestrator.slaves.slave import Buffer, Call, access
from orchestrator.slaves.values import address, converted, fitting, packed, pointer, prepared, unpacked
from orchestrator.system.interface import Interface, Value

LOGGED = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")


class Standard(Protocol):
    """What differs between versions of FMI.

    prefix, state, thaw, slopes   how functions are called
    types                         word in a function's name -> ctypes type
    results                       further arguments of fmiXDoStep, for what it says about a step
    flags                         not zero after a step that wants something
    """

    prefix: str
    state: str
    thaw: str
    slopes: str
    types: dict[str, Any]
    results: tuple[Any, ...]
    flags: ctypes.c_uint32
    release: Callable[[], None]

    def instantiate(self, library: Library, folder: Path, verbose: bool) -> int | None: ...
    def array(self, address: ctypes.c_void_p, count: int) -> tuple[Any, ...]: ...
    def setup(self, calls: Calls, start: float, stop: float, tolerance: float | None) -> None: ...
    def enter(self, calls: Calls) -> None: ...
    def stepped(self, calls: Calls, status: int) -> None: ...


STANDARDS: dict[int, Callable[[Interface, Log], Standard]] = {2: Fmi2, 3: Fmi3}


class FmuSlave:
    """One instance of a co-simulation FMU."""

    def __init__(self, name: str, interface: Interface, fmu: Location) -> None:
        self.name, self.interface, self.log = name, interface, Log(name)
        self._label = f"{name} ({fmu})"
        self._stepping, self._final = False, 1  # final: no step will be repeated
        self.busy = 0.0
        self._undo = ExitStack()
        try:
            self._open(fmu)
        except BaseException:
            self.close()
            raise

    def _open(self, fmu: Location) -> None:
        folder = fmu.path.resolve() if fmu.is_folder else Path(tempfile.mkdtemp(prefix="fmu-"))
        if not fmu.is_folder:
            self._undo.callback(shutil.rmtree, folder, ignore_errors=True)
            fmu.extract(folder)
        library = Library(folder, self.interface.identifier, self._label, self.interface.fmi)
        self._fmi = STANDARDS[self.interface.fmi](self.interface, self.log)
        self.calls = Calls(library, self._fmi.prefix, self.log)
        self._undo.callback(self.calls.unless_fatal, library.close)
        self._undo.callback(self._fmi.release)
        handle = self._fmi.instantiate(library, folder, False) or self._fmi.instantiate(library, folder, True)
        if not handle:  # the second, verbose try made it say what is wrong
            raise Problem(f"{self._label}: the FMU could not be instantiated{self.log.last()}")
        self.calls.handle = ctypes.c_void_p(handle)
        self._undo.callback(self.calls.unless_fatal, self.calls.function("FreeInstance", None))
        self._step = self.calls.function("DoStep")
        self._flags, self._results = self._fmi.flags, self._fmi.results
        self._listen()

    def _listen(self) -> None:
        """Ask for warnings and errors, not for the rest."""
        wanted = [c.encode() for c in LOGGED if c in self.interface.categories]
        if wanted:
            array = (ctypes.c_char_p * len(wanted))(*wanted)
            on = self._fmi.types["Boolean"](1)
            with suppress(Problem):  # an FMU that cannot choose its messages still runs
                self.calls.function("SetDebugLogging")(on, ctypes.c_size_t(len(wanted)), array)

    # ---- life

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment; times in [s]."""
        self.log.time = start
        self._fmi.setup(self.calls, start, stop, tolerance)

    def enter(self) -> None:
        """Enter initialisation mode."""
        self._fmi.enter(self.calls)

    def exit(self) -> None:
        """Leave initialisation mode; steps may follow."""
        self.calls.call("ExitInitializationMode")
        self._stepping = True

    def close(self) -> None:
        """Terminate and free the instance, unload the library, remove the unpacked files. May be repeated."""
        if self._stepping and self.calls.worst < ERROR:
            self._stepping = False
            with suppress(Problem):
                self.calls.call("Terminate")
        self._undo.close()

    # ---- values

    def _references(self, variables: Sequence[str]) -> tuple[Any, Any]:
        found = [self.interface.variables[v].reference for v in variables]
        return (ctypes.c_uint * len(found))(*found), ctypes.c_size_t(len(found))

    def _access(self, verb: str, variables: Sequence[str], values: Buffer) -> tuple[Call, Buffer]:
        """A call that gets or sets the variables, and the array that it works on."""
        word, count = access(self.interface.variables[variables[0]]), len(variables)
        own = fitting(values, count, self._fmi.types[word])
        arguments = *self._references(variables), *self._fmi.array(address(own), count)
        return self.calls.bound(verb + word, *arguments, of=variables), own

    def reader(self, variables: Sequence[str], into: Buffer) -> Call:
        """A call that reads the variables into `into`, shape (n,)."""
        read, own = self._access("Get", variables, into)
        return read if own is into else converted(read, own, into, variables)

    def writer(self, variables: Sequence[str], values: Buffer) -> Call:
        """A call that sets the variables to what stands in `values`, shape (n,)."""
        write, own = self._access("Set", variables, values)
        return write if own is values else prepared(write, own, values, variables)

    def slope_reader(self, variables: Sequence[str], into: Buffer) -> Call:
        """A call that reads the first time derivatives of outputs into `into`, shape (n,)."""
        return self._slopes(self._fmi.slopes, variables, into)

    def slope_writer(self, variables: Sequence[str], slopes: Buffer) -> Call:
        """A call that gives inputs the first time derivatives in `slopes`, shape (n,), for the next step.

        FMI 3.0 has no function for it; there the inputs that carry the derivatives are set.
        """
        if self.interface.interpolates:
            return self._slopes("SetRealInputDerivatives", variables, slopes)
        for v in variables:
            if v not in self.interface.sloped:
                raise Problem(f"{self.name}: {v}: the FMU takes no derivative of this input")
        return self.writer([self.interface.rates[v] for v in variables], slopes)

    def _slopes(self, name: str, variables: Sequence[str], values: Buffer) -> Call:
        orders = (ctypes.c_int * len(variables))(*[1] * len(variables))
        array = self._fmi.array(pointer(values, len(variables)), len(variables))
        return self.calls.bound(name, *self._references(variables), orders, *array, of=variables)

    def derivative(self, of: Sequence[str], by: Sequence[str], seed: Buffer, into: Buffer) -> Call:
        """A call that puts into `into` the directional derivative of `of` when `by` move along `seed`."""
        given = *self._references(of), *self._references(by)
        seeds = self._fmi.array(pointer(seed, len(by)), len(by))
        changes = self._fmi.array(pointer(into, len(of)), len(of))
        return self.calls.bound("GetDirectionalDerivative", *given, *seeds, *changes, of=of)

    def get(self, variable: str) -> Value:
        """The value of one variable."""
        known = self.interface.variables[variable]
        cell = self._fmi.types[access(known)]()
        self._single("Get", variable, cell)
        return unpacked(known, cell)

    def set(self, variable: str, value: Value) -> None:
        """Set one variable of any kind."""
        known = self.interface.variables[variable]
        cell = packed(known, self._fmi.types[access(known)], value)
        structural = known.causality == "structuralParameter"
        if structural:
            self.calls.call("EnterConfigurationMode")
        self._single("Set", variable, cell)
        if structural:
            self.calls.call("ExitConfigurationMode")

    def _single(self, verb: str, variable: str, cell: Any) -> None:
        array = self._fmi.array(ctypes.c_void_p(ctypes.addressof(cell)), 1)
        word = access(self.interface.variables[variable])
        self.calls.call(verb + word, *self._references([variable]), *array, of=[variable])

    # ---- steps

    def step(self, t: float, h: float) -> None:
        """Advance from t to t + h [s]."""
        self.log.time = t
        began = perf_counter()
        status = self._step(ctypes.c_double(t), ctypes.c_double(h), self._final, *self._results)
        self.busy += perf_counter() - began
        if status or self._flags.value:
            self._fmi.stepped(self.calls, status)

    # ---- rollback

    def save(self) -> ctypes.c_void_p:
        """A snapshot of the FMU's state; give it back with `forget`."""
        self._final = 0
        state = ctypes.c_void_p()
        self.calls.call(f"Get{self._fmi.state}", ctypes.byref(state))
        return state

    def restore(self, state: ctypes.c_void_p) -> None:
        """Go back to a snapshot."""
        self.calls.call(f"Set{self._fmi.state}", state)

    def forget(self, state: ctypes.c_void_p) -> None:
        """Free a snapshot."""
        self.calls.call(f"Free{self._fmi.state}", ctypes.byref(state))

    def pack(self, state: ctypes.c_void_p) -> bytes:
        """A snapshot as bytes, for another process."""
        size = ctypes.c_size_t()
        self.calls.call(f"Serialized{self._fmi.state}Size", state, ctypes.byref(size))
        room = (ctypes.c_ubyte * size.value)()
        self.calls.call(f"Serialize{self._fmi.state}", state, room, size)
        return bytes(room)

    def unpack(self, data: bytes) -> ctypes.c_void_p:
        """The snapshot in bytes that `pack` made; give it back with `forget`."""
        state, room = ctypes.c_void_p(), (ctypes.c_ubyte * len(data))(*data)
        size = ctypes.c_size_t(len(data))
        self.calls.call(f"{self._fmi.thaw}{self._fmi.state}", room, size, ctypes.byref(state))
        return state
