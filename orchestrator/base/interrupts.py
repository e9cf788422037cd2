"""Every way to end a command early is an interrupt, so that nothing is left behind.

Ctrl-C during a run: noted when it comes, obeyed between two steps.

Python would raise KeyboardInterrupt in whatever Python code runs next. That may be the logger that an FMU
calls, and from there no exception finds its way back through the FMU.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any


@contextmanager
def ends_clean() -> Iterator[None]:
    """A request to end, or a closed terminal, is an interrupt: children are stopped, folders removed."""

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    there = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    usual = [number for number in there if signal.getsignal(number) is signal.SIG_DFL]
    if threading.current_thread() is not threading.main_thread():
        usual = []  # only the main thread may say what a signal does
    for number in usual:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in usual:
            signal.signal(number, signal.SIG_DFL)


NAMES = ("SIGINT", "SIGTERM", "SIGHUP")


class Interrupts:
    """While it is entered, what signals do that Python code handles happens in `look` only.

    A second signal is obeyed at once: the FMU may never come back.
    """

    def __init__(self) -> None:
        self._usual: dict[int, Any] = {}
        self._noted: tuple[int, FrameType | None] | None = None

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():  # only it may say what a signal does
            for number in (getattr(signal, name) for name in NAMES if hasattr(signal, name)):
                handler = signal.getsignal(number)
                if callable(handler):
                    self._usual[number] = handler
                    signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None
    ) -> None:
        for number, handler in self._usual.items():
            signal.signal(number, handler)
        if kind is None:
            self.look()

    def look(self) -> None:
        """Obey what was noted, which usually raises KeyboardInterrupt."""
        if self._noted:
            (number, frame), self._noted = self._noted, None
            self._usual[number](number, frame)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self._noted:
            self.look()
        self._noted = number, frame
