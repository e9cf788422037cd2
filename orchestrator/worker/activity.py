"""What the child is doing right now, in memory shared with its parent: it outlives a crash of the child.

Layout: number of calls so far, time [s], name of the call, last inputs as text.
"""

from __future__ import annotations

import mmap
import struct
from dataclasses import dataclass
from pathlib import Path

_HEAD = struct.Struct("<Qd64s")
_TEXT = 512
SIZE = _HEAD.size + _TEXT


@dataclass(frozen=True)
class Activity:
    """The last sign of life; `time` [s] is NaN before the first step."""

    count: int
    time: float
    call: str
    inputs: str

    def __str__(self) -> str:
        where = f"in {self.call}" if self.call else "before the first call"
        when = f" at t = {self.time:.9g} s" if self.time == self.time else ""
        if self.inputs.startswith("("):  # not inputs, but what is tried
            return f"{where}{when} {self.inputs}"
        return f"{where}{when}" + (f", last inputs {self.inputs}" if self.inputs else "")


class ActivityRecord:
    """The writing end, and the reading end, of one file."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            path.write_bytes(_HEAD.pack(0, float("nan"), b"") + bytes(_TEXT))
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), SIZE)
        self._count = 0

    def call(self, name: str, time: float = float("nan")) -> None:
        """Note which function is called next, at which time of the simulation [s]."""
        self._count += 1
        _HEAD.pack_into(self._memory, 0, self._count, time, name.encode())

    def inputs(self, text: str) -> None:
        """Note what was set last; in brackets what is tried."""
        raw = text.encode()[:_TEXT]
        self._memory[_HEAD.size : _HEAD.size + len(raw)] = raw
        self._memory[_HEAD.size + len(raw) :] = bytes(_TEXT - len(raw))

    def read(self) -> Activity:
        """What was noted last."""
        count, time, call = _HEAD.unpack_from(self._memory, 0)
        text = self._memory[_HEAD.size :]
        return Activity(count, time, _text(call), _text(text))

    def close(self) -> None:
        """Let go of the file."""
        self._memory.close()


def _text(raw: bytes) -> str:
    return raw.rstrip(b"\0").decode(errors="replace")
