"""Signals that end a command (SIGINT, SIGTERM, SIGHUP), handled as KeyboardInterrupt.

`signals_interrupt` turns each of these signals into a KeyboardInterrupt, so that child processes are stopped
and temporary folders removed. `DeferredInterrupts` delays the signals while compiled code runs. Python would
otherwise raise KeyboardInterrupt in the Python code that runs next: in the logger that an FMU calls, where
the exception would be lost in the FMU, or in CasADi's check for signals, whose exception CVODES reports as
equations that failed. `of_user` calls a function of the user meanwhile, which may never return: a signal is
handled in it at once.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, ParamSpec, TypeVar

POLL_INTERVAL = 0.01  # [s] between two checks for an interrupt: short beside a run of some milliseconds
_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
# Modules with functions that C calls, where an exception would be lost
_CALLED_FROM_C = ("orchestrator.fmi.library", "orchestrator.engine.c_library")


def _in_main_thread() -> bool:
    """True in the main thread, the only one that may set signal handlers."""
    return threading.current_thread() is threading.main_thread()


@contextmanager
def signals_interrupt(received: list[int]) -> Iterator[None]:
    """Context in which SIGTERM and SIGHUP raise KeyboardInterrupt instead of ending the process.

    received   gets their numbers
    """

    def interrupt(number: int, _: object) -> None:
        received.append(number)
        raise KeyboardInterrupt

    unhandled = [n for n in _ENDING if _in_main_thread() and signal.getsignal(n) is signal.SIG_DFL]
    for number in unhandled:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in unhandled:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Context that raises TimeoutError after some processor time, in the main thread of POSIX systems."""

    def late(*_: object) -> None:
        raise TimeoutError(f"not done within {seconds:.3g} s")

    if not (_in_main_thread() and hasattr(signal, "setitimer")):
        yield
        return
    before = signal.signal(signal.SIGPROF, late)
    try:
        signal.setitimer(signal.ITIMER_PROF, seconds, POLL_INTERVAL)  # again, if a library catches the first
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


class DeferredInterrupts:
    """Context that delays signals with a Python handler until `check` is called or the context ends.

    second_at_once   handle a second signal immediately, because the FMU may never return
    """

    def __init__(self, second_at_once: bool = True) -> None:
        self.second_at_once = second_at_once
        self._handlers: dict[int, Any] = {}
        self._pending: tuple[int, FrameType | None] | None = None
        self._frame: FrameType | None = None

    def __enter__(self) -> DeferredInterrupts:
        if _in_main_thread():
            self._frame = sys._getframe(1)
            _active.append(self)
        for number in _ENDING if _in_main_thread() else ():
            handler = signal.getsignal(number)
            if callable(handler):  # the default action ends the process without Python
                self._handlers[number] = handler
                signal.signal(number, self._delay)
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if self._frame:
            self._frame = None
            _active.remove(self)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        if kind is None:
            self.check()

    def check(self) -> None:
        """Handle a pending signal, which usually raises KeyboardInterrupt."""
        if self._pending:
            (number, frame), self._pending = self._pending, None
            self._handlers[number](number, frame)

    def _delay(self, number: int, frame: FrameType | None) -> None:
        second = self._pending is not None and self.second_at_once
        self._pending = self._pending or (number, frame)
        if second or self._in_function_of_user(frame):
            self.check()

    def _in_function_of_user(self, frame: FrameType | None) -> bool:
        """Does this code run in a function that `of_user` has called, and not in one that C called there?"""
        while frame and frame is not self._frame and frame.f_globals.get("__name__") not in _CALLED_FROM_C:
            if frame.f_code is of_user.__code__:
                return True
            frame = frame.f_back
        return False


_active: list[DeferredInterrupts] = []  # contexts of the main thread, the innermost last
P = ParamSpec("P")
T = TypeVar("T")


def of_user(function: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
    """Call a function of the user: a signal raises its exception in it, also one that is pending."""
    if _active and _in_main_thread():
        _active[-1].check()
    return function(*arguments, **options)
