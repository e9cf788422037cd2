"""The functions of one FMU instance, bound to their arguments and judged by the status they return."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from orchestrator.errors import Discarded, Ended, Problem
from orchestrator.slaves.library import Library
from orchestrator.slaves.log import DISCARD, FATAL, STATUS, WARNING, Log
from orchestrator.slaves.slave import Call


def ready(argument: Any) -> Any:
    """An argument in the form that ctypes passes on as it is, which halves the cost of a call."""
    if isinstance(argument, ctypes.Array):
        return ctypes.byref(argument)
    if isinstance(argument, ctypes._SimpleCData):
        return type(argument).from_param(argument.value)
    return argument


def label(status: int) -> str:
    """What a status is called."""
    return STATUS[status] if 0 <= status < len(STATUS) else str(status)


class Bound:
    """A call with all its arguments fixed; `judge` raises on a status that does not do."""

    __slots__ = ("_call", "judge")

    def __init__(self, call: Callable[[], int], judge: Callable[[int], None]) -> None:
        self._call, self.judge = call, judge

    def __call__(self) -> None:
        status = self._call()
        if status:
            self.judge(status)


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

    def address(self, name: str) -> int:
        """Where a function is in memory, for calls from C."""
        return self._library.address(self._prefix + name)

    def bound(self, name: str, *arguments: Any, of: Sequence[str] = ()) -> Bound:
        """A call with all arguments fixed; `of` are the variables it is about."""
        call = partial(self.function(name), *map(ready, arguments))
        about = f" of {', '.join(of[:3])}{', ...' * (len(of) > 3)}" if of else ""
        what = f"{self._prefix}{name}{about}"
        return Bound(call, lambda status: self.judge(status, what))

    def call(self, name: str, *arguments: Any, of: Sequence[str] = ()) -> None:
        """Call once."""
        self.bound(name, *arguments, of=of)()

    def judge(self, status: int, what: str) -> None:
        """Let warnings pass, raise on anything worse."""
        self.worst = max(self.worst, status)
        if status != WARNING:
            raise Problem(self.told(f"{what} failed", f"with status {label(status)}"))

    def told(self, what: str, more: str) -> str:
        """A message with component, time and what the FMU says."""
        when = f" at t = {self._log.time:.9g} s" if self._log.time == self._log.time else ""
        return f"{self._log.component}: {what}{when} {more}{self._log.last()}"

    def unless_fatal(self, call: Call) -> None:
        """After a fatal error nothing of the FMU may be called any more."""
        if self.worst < FATAL:
            call()


def stopped(calls: Calls, status: int, reached: float, ended: bool) -> Discarded | Ended:
    """What to raise when an FMU did not do a step to its end."""
    if ended:
        text = f"asks to end the simulation at t = {reached:.9g} s"
        problem: Discarded | Ended = Ended(calls.told("the step", f"is the last: the FMU {text}"))
    else:
        far = f" (the FMU got as far as t = {reached:.9g} s)" if status == DISCARD else ""
        problem = Discarded(calls.told("the step failed", f"with status {label(status)}{far}"))
        calls.worst = max(calls.worst, status)
    problem.reached = reached
    return problem
