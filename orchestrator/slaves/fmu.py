"""A running co-simulation FMU, FMI 2.0 or 3.0.

Readers and writers are bound once to value references and a slice of a NumPy array; calling one is a
single call into the FMU without any allocation (types other than Float64 and Int32 are converted).
"""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from orchestrator.errors import Problem
from orchestrator.files.archive import Location
from orchestrator.slaves.access import Access, Derivative, Stepping, fitting
from orchestrator.slaves.calls import Calls
from orchestrator.slaves.fmi2 import Fmi2
from orchestrator.slaves.fmi3 import Fmi3
from orchestrator.slaves.library import Library
from orchestrator.slaves.log import ERROR, FATAL, WARNING, Log
from orchestrator.slaves.rehearsal import Rehearsal
from orchestrator.slaves.slave import Buffer, access
from orchestrator.slaves.values import address, packed, unpacked
from orchestrator.system.interface import Interface, Value

LOGGED = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")


class Standard(Protocol):
    """What differs between versions of FMI.

    prefix, state, thaw, slopes   how functions are called
    types                         word in a function's name -> ctypes type
    results, places               further arguments of fmiXDoStep, for what it says about a step; addresses
    flags                         not zero after a step that wants something
    """

    prefix: str
    state: str
    thaw: str
    slopes: str
    types: dict[str, Any]
    results: tuple[Any, ...]
    places: tuple[int, ...]
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

    def __init__(
        self, name: str, interface: Interface, fmu: Location, start: Mapping[str, Value] | None = None
    ) -> None:
        """start: values for instances that only try what the FMU does; this one gets its own by `set`."""
        self.name, self.interface, self.log = name, interface, Log(name)
        self._label, self._source, self._start = f"{name} ({fmu})", fmu, start or {}
        self._rehearsal = Rehearsal(self._another)
        self._cubic: bool | None = None
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
        self._rehearsal.end()
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
        self._rehearsal.end()
        if self._stepping and self.calls.worst < ERROR:
            self._stepping = False
            with suppress(Problem):
                self.calls.call("Terminate")
        self._undo.close()

    # ---- values

    def _references(self, variables: Sequence[str]) -> NDArray[np.uint32]:
        return np.array([self.interface.variables[v].reference for v in variables], np.uint32)

    def _listed(self, variables: Sequence[str]) -> tuple[Any, Any]:
        """Value references as the first arguments of a call."""
        found = [self.interface.variables[v].reference for v in variables]
        return (ctypes.c_uint * len(found))(*found), ctypes.c_size_t(len(found))

    def _access(
        self, name: str, variables: Sequence[str], values: Buffer, word: str, orders: Sequence[int] = ()
    ) -> Access:
        """The call of a function that gets or sets a row of variables of the type `word`."""
        count, kind = len(variables), self._fmi.types[word]
        own = fitting(values, count, kind)
        given = [(ctypes.c_int * count)(*orders)] if orders else []
        arguments = *self._listed(variables), *given, *self._fmi.array(address(own), count)
        return Access(
            call=self.calls.bound(name, *arguments, of=variables),
            address=self.calls.address(name),
            component=self.calls.handle.value or 0,
            fmi=self.interface.fmi,
            references=self._references(variables),
            orders=np.array(orders, np.int32) if orders else None,
            own=own,
            values=values[:count],
            sets=name.startswith("Set"),
            names=variables,
        )

    def reader(self, variables: Sequence[str], into: Buffer) -> Access:
        """A call that reads the variables into `into`, shape (n,)."""
        word = access(self.interface.variables[variables[0]])
        return self._access(f"Get{word}", variables, into, word)

    def writer(self, variables: Sequence[str], values: Buffer) -> Access:
        """A call that sets the variables to what stands in `values`, shape (n,)."""
        word = access(self.interface.variables[variables[0]])
        return self._access(f"Set{word}", variables, values, word)

    def slope_reader(self, variables: Sequence[str], into: Buffer) -> Access:
        """A call that reads the first time derivatives of outputs into `into`, shape (n,)."""
        return self._access(self._fmi.slopes, variables, into, self._real, [1] * len(variables))

    def slope_writer(self, variables: Sequence[str], slopes: Buffer, orders: Sequence[int] = ()) -> Access:
        """A call that gives inputs the time derivatives in `slopes`, shape (n,), for the next step.

        orders   of each derivative; default: all 1
        FMI 3.0 has no function for it; there the inputs that carry the derivatives are set.
        """
        orders = orders or [1] * len(variables)
        if self.interface.interpolates:
            return self._access("SetRealInputDerivatives", variables, slopes, self._real, orders)
        for v, order in zip(variables, orders, strict=True):
            if v not in self.interface.sloped or order != 1:
                raise Problem(f"{self.name}: {v}: the FMU takes no derivative of order {order} of this input")
        return self.writer([self.interface.rates[v] for v in variables], slopes)

    @property
    def _real(self) -> str:
        return "Real" if self.interface.fmi == 2 else "Float64"

    def derivative(self, of: Sequence[str], by: Sequence[str], seed: Buffer, into: Buffer) -> Derivative:
        """A call that puts into `into` the directional derivative of `of` when `by` move along `seed`."""
        name, given = "GetDirectionalDerivative", (*self._listed(of), *self._listed(by))
        seed, into = fitting(seed, len(by), ctypes.c_double), fitting(into, len(of), ctypes.c_double)
        seeds = self._fmi.array(address(seed), len(by))
        changes = self._fmi.array(address(into), len(of))
        return Derivative(
            call=self.calls.bound(name, *given, *seeds, *changes, of=of),
            address=self.calls.address(name),
            component=self.calls.handle.value or 0,
            fmi=self.interface.fmi,
            of=self._references(of),
            by=self._references(by),
            seed=seed,
            into=into,
        )

    def follows(self, variable: str, degree: int) -> int:
        """The highest degree of a polynomial, up to `degree`, that an input can be given: 0, 1 or 3."""
        if variable not in self.interface.sloped or degree == 0:
            return 0
        if degree == 1 or not self.interface.interpolates:
            return 1
        if self._cubic is None:  # FMI 2.0 has no declaration for it
            ask = partial(
                FmuSlave.slope_writer, variables=[variable] * 3, slopes=np.zeros(3), orders=[1, 2, 3]
            )
            self._cubic = self._rehearsal.passes(ask) or False
        return 3 if self._cubic else 1

    def tells(self, outputs: Sequence[str]) -> Sequence[str]:
        """Those of the outputs whose first time derivatives the FMU tells; some tell only those of states."""
        if self.interface.slopes < 1:
            return []

        def refused(names: Sequence[str]) -> bool:
            ask = partial(FmuSlave.slope_reader, variables=names, into=np.zeros(len(names)))
            return self._rehearsal.passes(ask) is False

        return [y for y in outputs if not refused([y])] if refused(outputs) else outputs

    def _another(self) -> FmuSlave:
        """One more instance, ready for its first step."""
        if self.interface.only_one:
            raise Problem(f"{self._label}: the FMU can be instantiated only once per process")
        other = FmuSlave(self.name, self.interface, self._source)
        try:
            other.setup(0.0, 1.0, None)
            for variable, value in self._start.items():
                other.set(variable, value)
            other.enter()
            other.exit()
        except Problem:
            other.close()
            raise
        return other

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
        self.calls.call(verb + word, *self._listed([variable]), *array, of=[variable])

    # ---- steps

    def step(self, t: float, h: float) -> None:
        """Advance from t to t + h [s]; raises Discarded and Ended, which say how far it got."""
        self.log.begin_step(t)
        began = perf_counter()
        status = self._step(ctypes.c_double(t), ctypes.c_double(h), self._final, *self._results)
        self.busy += perf_counter() - began
        if status or self._flags.value:
            self._fmi.stepped(self.calls, status)

    def stepping(self, rolls: bool) -> Stepping:
        """What it takes to step from C; rolls: the state is to be saved and restored, too."""
        state, prefix = self._fmi.state, self._fmi.prefix
        return Stepping(
            component=self.calls.handle.value or 0,
            fmi=self.interface.fmi,
            do_step=self.calls.address("DoStep"),
            get_state=self.calls.address(f"Get{state}") if rolls else 0,
            set_state=self.calls.address(f"Set{state}") if rolls else 0,
            results=self._fmi.places,
            flags=ctypes.addressof(self._flags) if self._fmi.places else 0,
            judge=lambda status: self._fmi.stepped(self.calls, status),
            judge_get=lambda status: self.calls.judge(status, f"{prefix}Get{state}"),
            judge_set=lambda status: self.calls.judge(status, f"{prefix}Set{state}"),
            clock=self.log.clock,
        )

    # ---- rollback

    def save(self, state: ctypes.c_void_p | None = None) -> ctypes.c_void_p:
        """A snapshot of the FMU's state, written over an earlier one if given; give it back with `forget`."""
        self._final = 0
        state = ctypes.c_void_p() if state is None else state
        self.calls.call(f"Get{self._fmi.state}", ctypes.byref(state))
        return state

    def restore(self, state: ctypes.c_void_p) -> None:
        """Go back to a snapshot."""
        self.calls.call(f"Set{self._fmi.state}", state)

    def resume(self) -> None:
        """Forget what the FMU said and returned in a step that is going to be repeated from a saved state."""
        self.log.withdraw()
        if self.calls.worst < FATAL:
            self.calls.worst = min(self.calls.worst, WARNING)

    def forget(self, state: ctypes.c_void_p) -> None:
        """Free a snapshot; after an error it is only tried."""
        free = self.calls.bound(f"Free{self._fmi.state}", ctypes.byref(state))
        with suppress(Problem) if self.calls.worst >= ERROR else nullcontext():
            self.calls.unless_fatal(free)

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
