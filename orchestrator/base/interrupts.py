"""Signals that end a command (Ctrl-C, a request to end, a closed terminal) as one interrupt.

`signals_interrupt` turns each of them into a KeyboardInterrupt, so that children are stopped and folders
removed. `DeferredInterrupts` holds them back while compiled code runs. Python would raise KeyboardInterrupt
in whatever code runs next. That may be the logger that an FMU calls, and no exception finds its way back
through the FMU; or CasADi's check for signals, whose exception CVODES takes for equations that failed.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def _in_main_thread() -> bool:
    """Only the main thread may set what a signal does."""
    return threading.current_thread() is threading.main_thread()


@contextmanager
def signals_interrupt() -> Iterator[None]:
    """Inside, SIGTERM and SIGHUP raise KeyboardInterrupt, where they would end the process at once."""

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    unhandled = [n for n in _ENDING if _in_main_thread() and signal.getsignal(n) is signal.SIG_DFL]
    for number in unhandled:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in unhandled:
            signal.signal(number, signal.SIG_DFL)


class DeferredInterrupts:
    """Inside, a signal that Python code handles is noted, and handled in `check` or at the end.

    insist   a second signal is handled at once: the FMU may never return
    """

    def __init__(self, insist: bool = True) -> None:
        self.insist = insist
        self._handlers: dict[int, Any] = {}
        self._noted: tuple[int, FrameType | None] | None = None

    def __enter__(self) -> DeferredInterrupts:
        for number in _ENDING if _in_main_thread() else ():
            handler = signal.getsignal(number)
            if callable(handler):  # any other ends the process without Python
                self._handlers[number] = handler
                signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        if kind is None:
            self.check()

    def check(self) -> None:
        """Handle the signal that was noted, which usually raises KeyboardInterrupt."""
        if self._noted:
            (number, frame), self._noted = self._noted, None
            self._handlers[number](number, frame)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._noted and self.insist:
            self.check()
        self._noted = self._noted or (number, frame)
