"""What is particular to FMI 2.0: names, arguments, and what a step says about itself.

What is particular to FMI 3.0: names, arguments, and what a step says about itself.

Instances run without event mode, early return and intermediate update.

What differs between versions of FMI, as one interface.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from orchestrator.base.errors import Problem
from orchestrator.fmi.calls import Calls, ready, stopped
from orchestrator.fmi.description import Interface
from orchestrator.fmi.library import DISCARD, ERROR, WARNING, Environment, Library, Log, callbacks2, logger3

LAST_TIME, TERMINATED = 2, 3  # fmi2StatusKind
TYPES2: dict[str, Any] = {
    "Real": ctypes.c_double,
    "Integer": ctypes.c_int,
    "Boolean": ctypes.c_int,
    "String": ctypes.c_char_p,
}


class Fmi2:
    """See `orchestrator.fmi.versions.Standard`.

    kind   of the instance: 0 for model exchange, 1 for co-simulation
    """

    kind = 1
    prefix, state, thaw, slopes = "fmi2", "FMUstate", "DeSerialize", "GetRealOutputDerivatives"
    types = TYPES2
    results: tuple[Any, ...] = ()
    flags = ctypes.c_uint32(0)
    places: tuple[int, ...] = ()

    def __init__(self, interface: Interface, log: Log) -> None:
        self._interface, self._name = interface, log.component.encode()
        self._environment = Environment(log)
        self._callbacks = callbacks2(self._environment)
        self.release = self._environment.release

    def instantiate(self, library: Library, folder: Path, verbose: bool) -> int | None:
        """The handle of a new instance."""
        create = library.function("fmi2Instantiate", ctypes.c_void_p)
        resources = (folder / "resources").as_uri().encode()
        guid, callbacks = self._interface.guid.encode(), ctypes.byref(self._callbacks)
        given = self.kind, guid, resources, callbacks, 0, int(verbose)
        handle: int | None = create(self._name, *given)
        return handle

    def array(self, address: ctypes.c_void_p, _: int) -> tuple[Any, ...]:
        """Values as arguments of a call."""
        return (address,)

    def setup(self, calls: Calls, start: float, stop: float, tolerance: float | None) -> None:
        """Announce the experiment."""
        number = ctypes.c_double
        defined = ctypes.c_int(tolerance is not None)
        times = number(start), ctypes.c_int(1), number(stop)
        calls.call("SetupExperiment", defined, number(tolerance or 0.0), *times)

    def enter(self, calls: Calls) -> None:
        """Enter initialisation mode."""
        calls.call("EnterInitializationMode")

    def stepped(self, calls: Calls, status: int) -> None:
        """Judge a step whose status is not OK."""
        if status == ERROR:
            raise stopped(calls, status, float("nan"), False)
        if status != DISCARD:
            return calls.judge(status, "the step")
        reached, ended = ctypes.c_double(float("nan")), ctypes.c_int(0)
        with suppress(Problem):
            calls.function("GetRealStatus")(LAST_TIME, ctypes.byref(reached))
        with suppress(Problem):
            calls.function("GetBooleanStatus")(TERMINATED, ctypes.byref(ended))
        raise stopped(calls, status, reached.value, bool(ended.value))


EVENT, TERMINATE, EARLY = range(3)  # bytes of `flags`
TYPES3: dict[str, Any] = {
    "Float64": ctypes.c_double,
    "Float32": ctypes.c_float,
    "Boolean": ctypes.c_bool,
    "String": ctypes.c_char_p,
    **{f"{u}Int{n}": getattr(ctypes, f"c_{u.lower()}int{n}") for u in ("", "U") for n in (8, 16, 32, 64)},
}


class Fmi3:
    """See `orchestrator.fmi.versions.Standard`."""

    prefix, state, thaw, slopes = "fmi3", "FMUState", "Deserialize", "GetOutputDerivatives"
    types = TYPES3

    def __init__(self, interface: Interface, log: Log) -> None:
        self._interface, self._log = interface, log
        self._experiment: tuple[Any, ...] = ()
        self._environment = Environment(log, {v.reference: v.name for v in interface.variables.values()})
        self.release = self._environment.release
        self.flags, self._reached = ctypes.c_uint32(0), ctypes.c_double(float("nan"))
        first = ctypes.addressof(self.flags)
        booleans = [first + byte for byte in (EVENT, TERMINATE, EARLY)]
        self.places = *booleans, ctypes.addressof(self._reached)
        self.results = tuple(ready(ctypes.c_void_p(place)) for place in self.places)

    def instantiate(self, library: Library, folder: Path, verbose: bool) -> int | None:
        """The handle of a new instance."""
        create = library.function("fmi3InstantiateCoSimulation", ctypes.c_void_p)
        resources = folder / "resources"
        path = os.fsencode(f"{resources}{os.sep}") if resources.is_dir() else None
        off, on = ctypes.c_bool(False), ctypes.c_bool(verbose)
        names = self._log.component.encode(), self._interface.guid.encode()
        no_variables, no_update = (None, ctypes.c_size_t(0)), None
        environment = ctypes.c_void_p(self._environment.key), logger3
        given = *names, path, off, on, off, off, *no_variables, *environment, no_update
        handle: int | None = create(*given)
        return handle

    def array(self, address: ctypes.c_void_p, count: int) -> tuple[Any, ...]:
        """Values as arguments of a call."""
        return address, ctypes.c_size_t(count)

    def setup(self, _: Calls, start: float, stop: float, tolerance: float | None) -> None:
        """Keep the experiment until initialisation mode is entered."""
        number, yes = ctypes.c_double, ctypes.c_bool
        accuracy = yes(tolerance is not None), number(tolerance or 0.0)
        times = number(start), yes(True), number(stop)
        self._experiment = *accuracy, *times

    def enter(self, calls: Calls) -> None:
        """Enter initialisation mode."""
        calls.call("EnterInitializationMode", *self._experiment)

    def stepped(self, calls: Calls, status: int) -> None:
        """Judge a step whose status is not OK or which wants something."""
        event, terminate, early, _ = bytes(self.flags)
        self.flags.value = 0
        if status in (DISCARD, ERROR) or terminate:
            reached = self._reached.value if status != ERROR else float("nan")
            raise stopped(calls, status, reached, bool(terminate) and status != ERROR)
        if status:
            calls.judge(status, "the step")
        if early:
            where = f"t = {self._reached.value:.9g} s"
            raise Problem(calls.told("the step", f"ended early at {where}, which was not allowed"))
        if event:
            self._log.add(WARNING, "the FMU asks for event handling, which it was told to do itself")


class Standard(Protocol):
    """One version of FMI.

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


Open: TypeAlias = Callable[[Interface, Log], Standard]
STANDARDS: Mapping[int, Open] = {2: Fmi2, 3: Fmi3}
