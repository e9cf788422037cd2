"""A running FMI 2.0 co-simulation FMU.

Readers and writers are bound once to value references and a slice of a NumPy array; calling one is a
single call into the FMU without any allocation.
"""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from orchestrator.archive import Location
from orchestrator.errors import Problem
from orchestrator.interface import Interface, Value
from orchestrator.library import Callbacks, Library
from orchestrator.log import DISCARD, ERROR, FATAL, STATUS, WARNING, Log
from orchestrator.slave import Buffer, Call, access

CTYPES: dict[str, Any] = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int}
LOGGED = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")


class FmuSlave:
    """One instance of an FMI 2.0 co-simulation FMU."""

    def __init__(self, name: str, interface: Interface, fmu: Location) -> None:
        self.name, self.interface, self.log = name, interface, Log(name)
        self._label = f"{name} ({fmu})"
        self._worst, self._stepping, self._repeatable = 0, False, False
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
        self._library = Library(folder, self.interface.identifier, self._label)
        self._undo.callback(self._unless_fatal, self._library.close)
        self._callbacks = Callbacks(self.log)
        self._undo.callback(self._callbacks.release)
        handle = self._instantiate(folder, 0) or self._instantiate(folder, 1)
        if not handle:
            raise Problem(f"{self._label}: the FMU could not be instantiated{self.log.last()}")
        self._component = ctypes.c_void_p(handle)
        free = partial(self._library.function("fmi2FreeInstance", None), self._component)
        self._undo.callback(self._unless_fatal, free)
        types = ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int
        self._step = partial(self._function("DoStep", *types), self._component)
        self._listen()

    def _instantiate(self, folder: Path, verbose: int) -> int | None:
        """The FMU's handle; a second, verbose try makes it say what is wrong."""
        instantiate = self._library.function("fmi2Instantiate", ctypes.c_void_p)
        name, guid = self.name.encode(), self.interface.guid.encode()
        resources = (folder / "resources").as_uri().encode()
        handle: int | None = instantiate(
            name, 1, guid, resources, ctypes.byref(self._callbacks.struct), 0, verbose
        )
        return handle

    def _listen(self) -> None:
        """Ask for warnings and errors, not for the rest."""
        wanted = [c.encode() for c in LOGGED if c in self.interface.categories]
        if wanted:
            array = (ctypes.c_char_p * len(wanted))(*wanted)
            with suppress(Problem):  # an FMU that cannot choose its messages still runs
                choose = self._function("SetDebugLogging")
                choose(self._component, ctypes.c_int(1), ctypes.c_size_t(len(wanted)), array)

    def _unless_fatal(self, call: Call) -> None:
        """After a fatal error nothing of the FMU may be called any more."""
        if self._worst < FATAL:
            call()

    # ---- calls and their status

    def _function(self, name: str, *arguments: Any) -> Callable[..., int]:
        return self._library.function("fmi2" + name, ctypes.c_int, *arguments)

    def _bound(self, name: str, *arguments: Any, of: Sequence[str] = ()) -> Call:
        """A call with all arguments fixed; it raises, naming the variables, when the FMU fails."""
        call = partial(self._function(name), self._component, *arguments)
        what = f"fmi2{name}" + (f" of {', '.join(of[:3])}{', ...' * (len(of) > 3)}" if of else "")

        def bound() -> None:
            status = call()
            if status:
                self._judge(status, what)

        return bound

    def _call(self, name: str, *arguments: Any, of: Sequence[str] = ()) -> None:
        self._bound(name, *arguments, of=of)()

    def _judge(self, status: int, what: str) -> None:
        """Let warnings pass, raise on anything worse."""
        self._worst = max(self._worst, status)
        if status != WARNING:
            self._fail(status, what)

    def _fail(self, status: int, what: str, more: str = "") -> NoReturn:
        label = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        when = f" at t = {self.log.time:.9g} s" if self.log.time == self.log.time else ""
        raise Problem(f"{self.name}: {what} failed{when} with status {label}{more}{self.log.last()}")

    # ---- life

    def setup(self, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment; times in [s]."""
        self.log.time = start
        number = ctypes.c_double
        self._call(
            "SetupExperiment",
            *(ctypes.c_int(tolerance is not None), number(tolerance or 0.0)),
            *(number(start), ctypes.c_int(1), number(stop)),
        )

    def enter(self) -> None:
        """Enter initialisation mode."""
        self._call("EnterInitializationMode")

    def exit(self) -> None:
        """Leave initialisation mode; steps may follow."""
        self._call("ExitInitializationMode")
        self._stepping = True

    def close(self) -> None:
        """Terminate and free the instance, unload the library, remove the unpacked files. May be repeated."""
        if self._stepping and self._worst < ERROR:
            self._stepping = False
            with suppress(Problem):
                self._call("Terminate")
        self._undo.close()

    # ---- values

    def _references(self, variables: Sequence[str]) -> tuple[str, Any, Any]:
        found = [self.interface.variables[v] for v in variables]
        references = (ctypes.c_uint * len(found))(*[v.reference for v in found])
        return access(found[0]), references, ctypes.c_size_t(len(found))

    def reader(self, variables: Sequence[str], into: Buffer) -> Call:
        """A call that reads the variables into `into`, shape (n,)."""
        kind, references, count = self._references(variables)
        return self._bound(f"Get{kind}", references, count, pointer(into, len(variables)), of=variables)

    def writer(self, variables: Sequence[str], values: Buffer) -> Call:
        """A call that sets the variables to what stands in `values`, shape (n,)."""
        kind, references, count = self._references(variables)
        return self._bound(f"Set{kind}", references, count, pointer(values, len(variables)), of=variables)

    def slope_reader(self, variables: Sequence[str], into: Buffer) -> Call:
        """A call that reads the first time derivatives of outputs into `into`, shape (n,)."""
        return self._slopes("GetRealOutputDerivatives", variables, into)

    def slope_writer(self, variables: Sequence[str], slopes: Buffer) -> Call:
        """A call that gives inputs the first time derivatives in `slopes`, shape (n,), for the next step."""
        return self._slopes("SetRealInputDerivatives", variables, slopes)

    def _slopes(self, name: str, variables: Sequence[str], values: Buffer) -> Call:
        _, references, count = self._references(variables)
        orders = (ctypes.c_int * len(variables))(*[1] * len(variables))
        address = pointer(values, len(variables))
        return self._bound(name, references, count, orders, address, of=variables)

    def get(self, variable: str) -> Value:
        """The value of one variable."""
        known = self.interface.variables[variable]
        _, references, count = self._references([variable])
        cell: Any = (ctypes.c_char_p if known.kind == "String" else CTYPES[access(known)])()
        self._call(f"Get{access(known)}", references, count, ctypes.byref(cell), of=[variable])
        value: Value = cell.value if known.kind != "String" else (cell.value or b"").decode(errors="replace")
        return bool(value) if known.kind == "Boolean" else value

    def set(self, variable: str, value: Value) -> None:
        """Set one variable of any kind."""
        known = self.interface.variables[variable]
        _, references, count = self._references([variable])
        raw: Any = (ctypes.c_char_p * 1)(str(value).encode())
        if known.kind != "String":
            kind = CTYPES[access(known)]
            raw = kind(float(value) if known.is_real else int(value))
            raw = ctypes.byref(raw)
        self._call(f"Set{access(known)}", references, count, raw, of=[variable])

    # ---- steps

    def step(self, t: float, h: float) -> None:
        """Advance from t to t + h [s]."""
        self.log.time = t
        status = self._step(t, h, 0 if self._repeatable else 1)
        if status:
            self._stepped(status)

    def _stepped(self, status: int) -> None:
        if status == DISCARD:
            self._worst = max(self._worst, DISCARD)
            self._fail(status, "the step", self._how_far())
        self._judge(status, "the step")

    def _how_far(self) -> str:
        """What a discarded step says about itself."""
        reached, ended = ctypes.c_double(float("nan")), ctypes.c_int(0)
        with suppress(Problem):
            self._function("GetRealStatus")(self._component, 2, ctypes.byref(reached))
        with suppress(Problem):
            self._function("GetBooleanStatus")(self._component, 3, ctypes.byref(ended))
        if ended.value:
            return f" (the FMU asks to end the simulation at t = {reached.value:.9g} s)"
        return f" (the FMU got as far as t = {reached.value:.9g} s)"

    # ---- rollback

    def save(self) -> ctypes.c_void_p:
        """A snapshot of the FMU's state; give it back with `forget`."""
        self._repeatable = True
        state = ctypes.c_void_p()
        self._call("GetFMUstate", ctypes.byref(state))
        return state

    def restore(self, state: ctypes.c_void_p) -> None:
        """Go back to a snapshot."""
        self._call("SetFMUstate", state)

    def forget(self, state: ctypes.c_void_p) -> None:
        """Free a snapshot."""
        self._call("FreeFMUstate", ctypes.byref(state))


def pointer(values: Buffer, count: int) -> ctypes.c_void_p:
    """The address of a contiguous slice of at least `count` elements; the caller keeps the array alive."""
    if len(values) < count or not values.flags.c_contiguous or values.dtype not in (np.float64, np.int32):
        raise ValueError(f"expected {count} contiguous values, got shape {values.shape} of {values.dtype}")
    return ctypes.c_void_p(values.ctypes.data)
