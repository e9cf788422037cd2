"""Interrupts while compiled code runs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def held() -> Iterator[None]:
    """An interrupt waits until the block is over.

    CasADi asks for signals inside the equations. CVODES takes what that raises for equations that fail: it
    tries a smaller step and goes on, so that the interrupt is lost, or gives up with an error of its own.
    """
    if threading.current_thread() is not threading.main_thread():  # only the main thread gets signals
        yield
        return
    pressed: list[int] = []

    def wait(number: int, _: Any) -> None:
        pressed.append(number)

    names = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    # what is not handled in Python ends the process at once anyway
    usual = {n: signal.getsignal(n) for n in names if callable(signal.getsignal(n))}
    for number in usual:
        signal.signal(number, wait)
    try:
        yield
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)
    for number in pressed[:1]:
        signal.raise_signal(number)
