"""Memory that the process of a machine shares with its parent: commands, status, and all frames.

The memory has no name that outlives both processes. On POSIX it is a file that is deleted already (on Linux
one that never was on a disk), handed to the child as an open descriptor; on Windows it is a named mapping,
which goes with its last user.

Each part has one writer. It makes the sequence number odd, writes, and makes it even; a reader that sees it
odd or changed reads again. So nobody waits for anybody, and whoever dies leaves nothing locked. Commands
carry a checksum, too: half of a command must not move a machine.
"""

from __future__ import annotations

import mmap
import os
import secrets
import sys
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from mmap import mmap as mmap_of_mmap
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.realtime.deadlines import BINS
from orchestrator.realtime.setup import Array


class Memory:
    """A piece of shared memory, zero at first.

    address       what `attach` needs in the other process
    descriptors   that the other process has to inherit
    """

    def __init__(self, size: int) -> None:
        self.descriptors: tuple[int, ...] = ()
        if sys.platform == "win32":
            name = f"harvester-{secrets.token_hex(16)}"
            self.address = f"{name}:{size}"
            self.map = mmap.mmap(-1, size, tagname=name)
            return
        descriptor = _nameless()
        os.ftruncate(descriptor, size)
        self.descriptors = (descriptor,)
        self.address = f"{descriptor}:{size}"
        self.map = mmap.mmap(descriptor, size)

    def handed_over(self) -> None:
        """The other process has the descriptor; this one does not need it any more."""
        for descriptor in self.descriptors:
            os.close(descriptor)
        self.descriptors = ()


def attach(address: str) -> mmap.mmap:
    """The memory that another process has made."""
    where, _, size = address.partition(":")
    if sys.platform == "win32":
        return mmap.mmap(-1, int(size), tagname=where)
    descriptor = int(where)
    try:
        return mmap.mmap(descriptor, int(size))
    finally:
        os.close(descriptor)


def _nameless() -> int:
    """A file without a name."""
    if sys.platform == "linux":
        return os.memfd_create("harvester")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


STATES = ("starting", "running", "paused", "ended", "failed")
TEXT = 1 << 20  # bytes
TRIES = 1000  # to read while the other one writes, which takes it microseconds
SEQUENCE, CHECK, PLAYING, SERIAL = range(4)  # of the command, then the speed and the values
STATE, LAST, HEARTBEAT, FRAMES, MISSED, LENGTH = range(1, 7)  # of the status
LOAD, WORST, SLIPPED = range(3)
NUMBER, TIME, HEAD = range(3)  # columns of a frame; axes and signals follow


class Command(NamedTuple):
    """What the machine shall do; serial counts the new values of the axes."""

    playing: bool
    speed: float
    serial: int
    values: Array


class MachineStatus(NamedTuple):
    """What the process says of itself. last: number of the latest frame; heartbeat: counts its loops."""

    state: str
    last: int
    heartbeat: int
    frames: int
    missed: int
    load: float
    worst: float
    slipped: float
    text: str
    latencies: NDArray[np.int64]


def size(axes: int, signals: int, rows: int) -> int:
    """Bytes that a `SharedState` takes."""
    return 8 * (8 + 1 + axes + 16 + 8 + BINS + TEXT // 8 + rows * (HEAD + axes + signals))


class SharedState:
    """Views of one piece of shared memory.

    rows    the latest frames, shape (rows, 2 + axes + signals): frame n is in row n modulo their number
    """

    def __init__(self, memory: mmap_of_mmap, axes: int, signals: int, rows: int) -> None:
        self.axes, self._memory, self._place = axes, memory, 0
        self._command, self._wanted = self._integers(8), self._floats(1 + axes)
        self._counts, self._reals, self.latencies = self._integers(16), self._floats(8), self._integers(BINS)
        self._text = self._integers(TEXT // 8).view(np.uint8)
        self.rows = self._floats(rows * (HEAD + axes + signals)).reshape(rows, -1)

    def _integers(self, count: int) -> NDArray[np.int64]:
        """The next numbers of the memory."""
        self._place += 8 * count
        return np.frombuffer(self._memory, np.int64, count, self._place - 8 * count)

    def _floats(self, count: int) -> Array:
        return self._integers(count).view(np.float64)

    # ---- command

    def write_command(self, command: Command) -> None:
        """Write a command; by the parent only."""
        o = self._command
        o[SEQUENCE] += 1
        o[PLAYING], o[SERIAL] = command.playing, command.serial
        self._wanted[0], self._wanted[1:] = command.speed, command.values
        o[CHECK] = _check(o, self._wanted)
        o[SEQUENCE] += 1

    def read_command(self) -> Command | None:
        """The command; None while it is being written."""
        o = self._command.copy()
        wanted = self._wanted.copy()
        if o[SEQUENCE] % 2 or o[SEQUENCE] != self._command[SEQUENCE] or o[CHECK] != _check(o, wanted):
            return None
        return Command(bool(o[PLAYING]), float(wanted[0]), int(o[SERIAL]), wanted[1:])

    # ---- status

    @contextmanager
    def writing(self) -> Iterator[tuple[NDArray[np.int64], Array]]:
        """Write the status; by the child only."""
        self._counts[SEQUENCE] += 1
        try:
            yield self._counts, self._reals
        finally:
            self._counts[SEQUENCE] += 1

    def write_frame(self, number: int, t: float, axes: Array, values: Array) -> None:
        """Write a frame, which nobody reads before the status has its number."""
        row = self.rows[number % len(self.rows)]
        row[NUMBER], row[TIME] = number, t
        row[HEAD : HEAD + self.axes] = axes
        row[HEAD + self.axes :] = values

    def set_state(self, state: str, text: str) -> None:
        """A change of state, and a text that goes with it."""
        data = text.encode("utf-8")[:TEXT]
        with self.writing() as (counts, _):
            self._text[: len(data)] = np.frombuffer(data, np.uint8)
            counts[LENGTH], counts[STATE] = len(data), STATES.index(state)

    def heartbeat(self) -> None:
        """A sign of life; one number, so it needs no sequence."""
        self._counts[HEARTBEAT] += 1

    def status(self) -> MachineStatus:
        """The status; if the writer died while writing, what there is of it."""
        for _ in range(TRIES):
            n, reals = self._counts.copy(), self._reals.copy()
            latencies, text = self.latencies.copy(), self._text[: n[LENGTH]].tobytes()
            if n[SEQUENCE] % 2 == 0 and n[SEQUENCE] == self._counts[SEQUENCE]:
                break
        last, heartbeat, frames, missed = (int(n[i]) for i in (LAST, HEARTBEAT, FRAMES, MISSED))
        load, worst, slipped = (float(r) for r in reals[:3])
        words = text.decode("utf-8", "replace")
        return MachineStatus(
            STATES[n[STATE]], last, heartbeat, frames, missed, load, worst, slipped, words, latencies
        )


def _check(command: NDArray[np.int64], wanted: Array) -> int:
    """A checksum of a command."""
    return zlib.crc32(wanted.tobytes(), zlib.crc32(command[PLAYING : SERIAL + 1].tobytes()))
