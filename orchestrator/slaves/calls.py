"""The functions of one FMU instance, bound to their arguments and judged by the status they return."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NoReturn

from orchestrator.errors import Problem
from orchestrator.slaves.library import Library
from orchestrator.slaves.log import FATAL, STATUS, WARNING, Log
from orchestrator.slaves.slave import Call


def ready(argument: Any) -> Any:
    """An argument in the form that ctypes passes on as it is, which halves the cost of a call."""
    if isinstance(argument, ctypes.Array):
        return ctypes.byref(argument)
    if isinstance(argument, ctypes._SimpleCData):
        return type(argument).from_param(argument.value)
    return argument


class Calls:
    """Calls into one instance; they raise, naming variables and time, when the FMU fails.

    handle  the instance, once there is one
    worst   the worst status that any call returned
    """

    def __init__(self, library: Library, prefix: str, log: Log) -> None:
        """prefix: of all function names, such as fmi2."""
        self._library, self._prefix, self._log = library, prefix, log
        self.handle = ctypes.c_void_p()
        self.worst = 0

    def function(self, name: str, result: Any = ctypes.c_int) -> Callable[..., Any]:
        """A function with the instance as its first argument."""
        return partial(self._library.function(self._prefix + name, result), ready(self.handle))

    def bound(self, name: str, *arguments: Any, of: Sequence[str] = ()) -> Call:
        """A call with all arguments fixed; `of` are the variables it is about."""
        call = partial(self.function(name), *map(ready, arguments))
        about = f" of {', '.join(of[:3])}{', ...' * (len(of) > 3)}" if of else ""
        what = f"{self._prefix}{name}{about}"

        def bound() -> None:
            status = call()
            if status:
                self.judge(status, what)

        return bound

    def call(self, name: str, *arguments: Any, of: Sequence[str] = ()) -> None:
        """Call once."""
        self.bound(name, *arguments, of=of)()

    def judge(self, status: int, what: str, more: str = "") -> None:
        """Let warnings pass, raise on anything worse."""
        self.worst = max(self.worst, status)
        if status != WARNING:
            label = STATUS[status] if 0 <= status < len(STATUS) else str(status)
            self.fail(f"{what} failed", f"with status {label}{more}")

    def fail(self, what: str, more: str) -> NoReturn:
        """Raise with component, time and what the FMU says."""
        when = f" at t = {self._log.time:.9g} s" if self._log.time == self._log.time else ""
        raise Problem(f"{self._log.component}: {what}{when} {more}{self._log.last()}")

    def unless_fatal(self, call: Call) -> None:
        """After a fatal error nothing of the FMU may be called any more."""
        if self.worst < FATAL:
            call()
