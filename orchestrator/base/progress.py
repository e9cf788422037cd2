"""What a call does: one updating line on a terminal or in a notebook, else a line for what takes long."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
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
        self._text, self._ended, self._teller = text, Event(), Thread(target=self._tell, daemon=True)
        self._overwrites = overwrites(self._stream)
        if not self._overwrites:
            self._teller.start()
        self.update(text)

    def update(self, text: str) -> None:
        """Replace the text of the line."""
        self._text = text
        if _in_notebook(self._stream):
            self._write(f"\r{text[:WIDTH]:{WIDTH}}")
        elif self._overwrites:
            self._write(f"{ERASE}{text[: shutil.get_terminal_size().columns - 1]}")

    def end(self) -> None:
        """Erase the line."""
        self._ended.set()
        if self._overwrites:
            self._write(f"\r{'':{WIDTH}}\r" if _in_notebook(self._stream) else ERASE)
        else:
            self._teller.join()

    def _tell(self) -> None:
        """Print the text every `LONG` seconds unless it was printed last."""
        told = ""
        while not self._ended.wait(LONG):
            if (text := self._text) != told:
                told = text
                self._write(f"{text} ...\n")

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


@contextmanager
def doing(text: str) -> Iterator[Doing]:
    """Show what is done inside the block, such as "drawing 3 figures"."""
    line = Doing(text)
    try:
        yield line
    finally:
        line.end()
