"""Last activity of a worker process, in a file that is mapped into the memory of the child.

The parent can read the file after a crash of the child. Layout of the file: number of calls, simulation
time [s], name of the last call, last inputs as text.
"""

import mmap
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

_HEAD = struct.Struct("<Qd64s")
_TEXT = 512
SIZE = _HEAD.size + _TEXT


@dataclass(frozen=True)
class Activity:
    """The last activity of a worker.

    count    number of calls
    time     simulation time [s]; NaN before the first step
    call     name of the last function
    inputs   last inputs; if a case is under test, the case in round brackets and the values set in it
    """

    count: int
    time: float
    call: str
    inputs: str

    def __str__(self) -> str:
        where = f"in {self.call}" if self.call else "before the first call"
        when = f" at t = {self.time:.9g} s" if self.time == self.time else ""
        if self.inputs.startswith("("):  # the case under test
            return f"{where}{when} {self.inputs}"
        return f"{where}{when}" + (f", last inputs {self.inputs}" if self.inputs else "")


NONE = _HEAD.pack(0, float("nan"), b"") + bytes(_TEXT)


def activity_in(file: bytes) -> Activity:
    """The activity in a file; none if it is incomplete, or if an FMU has written to it."""
    count, time, call = _HEAD.unpack_from(file if len(file) == SIZE else NONE)
    if not call.rstrip(b"\0").decode("latin-1").isprintable():
        return activity_in(NONE)
    return Activity(count, time, _text(call), _text(file[_HEAD.size :]))


class ActivityRecord:
    """The activity file, for the child."""

    def __init__(self, path: Path, keep: Callable[[mmap.mmap], mmap.mmap] = lambda memory: memory) -> None:
        """keep: see `Channel.keep`."""
        path.write_bytes(NONE)
        with path.open("r+b") as file:
            self._memory = keep(mmap.mmap(file.fileno(), SIZE))
        self._count, self._case = 0, ""

    def clear(self) -> None:
        """Forget the last activity."""
        self._memory[:] = NONE

    def call(self, name: str, time: float = float("nan")) -> None:
        """Store the function that is called next, and the simulation time [s]."""
        self._count += 1
        _HEAD.pack_into(self._memory, 0, self._count, time, name.encode())

    def case(self, text: str) -> None:
        """Store the case under test; values that are set afterwards follow it."""
        self._case = f"({text})"
        self._write(self._case)

    def inputs(self, text: str) -> None:
        """Store the values that were set last."""
        self._write(f"{self._case}, last values {text}" if self._case else text)

    def _write(self, text: str) -> None:
        raw = text.encode()[:_TEXT]
        self._memory[_HEAD.size : _HEAD.size + len(raw)] = raw
        self._memory[_HEAD.size + len(raw) :] = bytes(_TEXT - len(raw))

    def read(self) -> Activity:
        """Read the last activity."""
        return activity_in(self._memory[:])


def _text(raw: bytes) -> str:
    return raw.rstrip(b"\0").decode(errors="replace")
