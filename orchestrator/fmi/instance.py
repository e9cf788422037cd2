"""One instance of a co-simulation FMU: how it is loaded, initialised and freed.

How the variables of an FMU are read and set.

Readers and writers are bound once to value references and a slice of a NumPy array; calling one is a
single call into the FMU without any allocation (types other than Float64 and Int32 are converted).

What the description of an FMU leaves open, found out on an instance that nobody uses.
"""

from __future__ import annotations

import ctypes
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.fmi.calls import (
    Access,
    Buffer,
    Call,
    Calls,
    Derivative,
    access,
    address,
    fitting,
    packed,
    unpacked,
)
from orchestrator.fmi.description import Interface, Value
from orchestrator.fmi.library import ERROR, Library, Log
from orchestrator.fmi.versions import STANDARDS, Open

if TYPE_CHECKING:
    from orchestrator.fmi.cosimulation import FmuSlave

LOGGED = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")


class Instance:
    """An instance from its instantiation to its end.

    standards   how each version of FMI is spoken; another kind of instance has its own
    """

    standards: ClassVar[Mapping[int, Open]] = STANDARDS

    def __init__(self, name: str, interface: Interface, fmu: Location) -> None:
        self.name, self.interface, self.log = name, interface, Log(name)
        self._label, self._stepping = f"{name} ({fmu})", False
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
        self._fmi = self.standards[self.interface.fmi](self.interface, self.log)
        self.calls = Calls(library, self._fmi.prefix, self.log)
        self._undo.callback(self.calls.unless_fatal, library.close)
        self._undo.callback(self._fmi.release)
        handle = self._fmi.instantiate(library, folder, False) or self._fmi.instantiate(library, folder, True)
        if not handle:  # the second, verbose try made it say what is wrong
            raise Problem(f"{self._label}: the FMU could not be instantiated{self.log.last()}")
        self.calls.handle = ctypes.c_void_p(handle)
        self._undo.callback(self.calls.unless_fatal, self.calls.function("FreeInstance", None))
        self._listen()

    def _listen(self) -> None:
        """Ask for warnings and errors, not for the rest."""
        wanted = [c.encode() for c in LOGGED if c in self.interface.categories]
        if wanted:
            array = (ctypes.c_char_p * len(wanted))(*wanted)
            on = self._fmi.types["Boolean"](1)
            with suppress(Problem):  # an FMU that cannot choose its messages still runs
                self.calls.function("SetDebugLogging")(on, ctypes.c_size_t(len(wanted)), array)

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


class BoundInstance(Instance):
    """An instance with calls for rows of variables, and for single ones."""

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

    # ---- single variables

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


class Rehearsal:
    """Tries calls; an instance that refused one is given up, because an error may have broken it."""

    def __init__(self, fresh: Callable[[], FmuSlave]) -> None:
        """fresh: makes an instance that is ready for its first step, or raises Problem."""
        self._fresh, self._able = fresh, True
        self._instance: FmuSlave | None = None

    def passes(self, ask: Callable[[FmuSlave], Call]) -> bool | None:
        """Does the FMU do this without a complaint? None: there is no instance to try it on."""
        instance = self._ready()
        if instance is None:
            return None
        try:
            ask(instance)()
        except Problem:
            self.end()
            return False
        return instance.calls.worst == 0

    def _ready(self) -> FmuSlave | None:
        if self._instance is None and self._able:
            try:
                self._instance = self._fresh()
            except Problem:
                self._able = False
        return self._instance

    def end(self) -> None:
        """Free the instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None
