"""What is particular to FMI 3.0: names, arguments, and what a step says about itself.

Instances run without event mode, early return and intermediate update.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import Any

from orchestrator.errors import Problem
from orchestrator.slaves.callbacks import Environment, logger3
from orchestrator.slaves.calls import Calls, ready, stopped
from orchestrator.slaves.library import Library
from orchestrator.slaves.log import DISCARD, ERROR, WARNING, Log
from orchestrator.system.interface import Interface

EVENT, TERMINATE, EARLY = range(3)  # bytes of `flags`
TYPES: dict[str, Any] = {
    "Float64": ctypes.c_double,
    "Float32": ctypes.c_float,
    "Boolean": ctypes.c_bool,
    "String": ctypes.c_char_p,
    **{f"{u}Int{n}": getattr(ctypes, f"c_{u.lower()}int{n}") for u in ("", "U") for n in (8, 16, 32, 64)},
}


class Fmi3:
    """See `orchestrator.slaves.standard.Standard`."""

    prefix, state, thaw, slopes = "fmi3", "FMUState", "Deserialize", "GetOutputDerivatives"
    types = TYPES

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
