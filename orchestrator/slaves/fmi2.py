"""What is particular to FMI 2.0: names, arguments, and what a step says about itself."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from pathlib import Path
from typing import Any

from orchestrator.errors import Problem
from orchestrator.slaves.callbacks import Environment, callbacks2
from orchestrator.slaves.calls import Calls, stopped
from orchestrator.slaves.library import Library
from orchestrator.slaves.log import DISCARD, ERROR, Log
from orchestrator.system.interface import Interface

LAST_TIME, TERMINATED = 2, 3  # fmi2StatusKind
TYPES: dict[str, Any] = {
    "Real": ctypes.c_double,
    "Integer": ctypes.c_int,
    "Boolean": ctypes.c_int,
    "String": ctypes.c_char_p,
}


class Fmi2:
    """See `orchestrator.slaves.standard.Standard`.

    kind   of the instance: 0 for model exchange, 1 for co-simulation
    """

    kind = 1
    prefix, state, thaw, slopes = "fmi2", "FMUstate", "DeSerialize", "GetRealOutputDerivatives"
    types = TYPES
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
