"""What a call does: one updating line on a terminal or in a notebook, else a line for what takes long."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock, Timer
from typing import TextIO

LONG = 5.0  # [s]; a reader of a log waits as long without a line
ERASE = "\r\x1b[K"  # carriage return, erase to the end of the line (ECMA-48)
WIDTH = 100  # characters of a line in a notebook, which is erased by spaces


def overwrites(stream: TextIO) -> bool:
    """Can a line be replaced: on a terminal and in a Jupyter notebook?"""
    return stream.isatty() or _in_notebook(stream)


def _in_notebook(stream: TextIO) -> bool:
    return type(stream).__module__.startswith("ipykernel")


class Doing:
    """The line of one activity, on standard error.

    `update` replaces its text. On a terminal the line is replaced at once and erased at the end. Elsewhere,
    such as in a log, the text is looked at every `LONG` seconds and printed if it is not yet.
    """

    def __init__(self, text: str, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._text, self._lock, self._timer = text, Lock(), None if overwrites(self._stream) else _timer(self)
        self._ended, self._told = False, ""
        self.update(text)

    def update(self, text: str) -> None:
        """Replace the text of the line."""
        self._text = text
        if self._timer is None:
            if _in_notebook(self._stream):
                self._write(f"\r{text[:WIDTH]:{WIDTH}}")
                return
            width = shutil.get_terminal_size().columns
            self._write(f"{ERASE}{text[: width - 1]}")

    def end(self) -> None:
        """Erase the line."""
        if self._timer is None:
            self._write(f"\r{'':{WIDTH}}\r" if _in_notebook(self._stream) else ERASE)
            return
        with self._lock:
            self._ended = True
            self._timer.cancel()

    def tell(self) -> None:
        """Print the text unless it was printed last, and look again after `LONG` seconds; for the timer."""
        with self._lock:
            if self._ended:
                return
            if self._text != self._told:
                self._told = self._text
                self._write(f"{self._text} ...\n")
            self._timer = _timer(self)

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


def _timer(line: Doing) -> Timer:
    timer = Timer(LONG, line.tell)
    timer.daemon = True
    timer.start()
    return timer


@contextmanager
def doing(text: str) -> Iterator[Doing]:
    """Show what is done inside the block, such as "drawing 3 figures"."""
    line = Doing(text)
    try:
        yield line
    finally:
        line.end()
