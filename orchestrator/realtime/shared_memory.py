"""Shared memory of a machine's process and its parent: command, status, and frames.

The memory disappears with the last process that uses it. On POSIX it is a deleted file (on Linux a memory
file), which the child inherits as an open descriptor. On Windows it is a named mapping.

Each part has one writer and a sequence number (a seqlock). The writer makes the number odd, writes, and makes
it even. A reader that finds an odd or a changed number reads again. No process waits for another, and a
process that dies leaves no lock. The command also has a checksum, because half a command must not move a
machine.
"""

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

from orchestrator.data.table import Array
from orchestrator.realtime.deadlines import BINS


class Memory:
    """A block of shared memory, initially zero.

    address       argument of `attach` in the other process
    descriptors   file descriptors that the other process must inherit
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
        """Close the descriptors, after the other process has inherited them."""
        for descriptor in self.descriptors:
            os.close(descriptor)
        self.descriptors = ()


def attach(address: str) -> mmap.mmap:
    """Map the memory that another process has created."""
    name, _, size = address.partition(":")
    if sys.platform == "win32":
        return mmap.mmap(-1, int(size), tagname=name)
    descriptor = int(name)
    try:
        return mmap.mmap(descriptor, int(size))
    finally:
        os.close(descriptor)


def _nameless() -> int:
    """Open a file without a name."""
    if sys.platform == "linux":
        return os.memfd_create("harvester")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


STATES = ("starting", "running", "paused", "ended", "failed")
TEXT = 1 << 20  # bytes of the details
TRIES = 1000  # readings while the writer writes, which takes microseconds
SEQUENCE, CHECK, PLAYING, SERIAL = range(4)  # integers of the command; speed and values follow as reals
STATE, LAST, HEARTBEAT, FRAMES, MISSED, LENGTH = range(1, 7)  # integers of the status, after the sequence
LOAD, WORST, SLIPPED = range(3)  # reals of the status
NUMBER, TIME, HEAD = range(3)  # columns of a frame; axes and signals follow


class Command(NamedTuple):
    """A command to the machine. serial: counts the commands with new values of the axes."""

    playing: bool
    speed: float
    serial: int
    values: Array


class MachineStatus(NamedTuple):
    """Status of the process. last: number of the latest frame; heartbeat: counts its loops."""

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
    """Size of a `SharedState` in bytes."""
    return 8 * (8 + 1 + axes + 16 + 8 + BINS + TEXT // 8 + rows * (HEAD + axes + signals))


class SharedState:
    """Typed views of a block of shared memory.

    rows    latest frames, shape (rows, 2 + axes + signals): frame n is in row n modulo rows
    """

    def __init__(self, memory: mmap_of_mmap, axes: int, signals: int, rows: int) -> None:
        self.axes, self._memory, self._position = axes, memory, 0
        self._command, self._command_reals = self._integers(8), self._floats(1 + axes)
        self._counts, self._reals, self.latencies = self._integers(16), self._floats(8), self._integers(BINS)
        self._text = self._integers(TEXT // 8).view(np.uint8)
        self.rows = self._floats(rows * (HEAD + axes + signals)).reshape(rows, -1)

    def _integers(self, count: int) -> NDArray[np.int64]:
        """View of the next integers of the memory."""
        self._position += 8 * count
        return np.frombuffer(self._memory, np.int64, count, self._position - 8 * count)

    def _floats(self, count: int) -> Array:
        return self._integers(count).view(np.float64)

    # ---- command

    def write_command(self, command: Command) -> None:
        """Write a command. Only the parent does so."""
        integers = self._command
        integers[SEQUENCE] += 1
        integers[PLAYING], integers[SERIAL] = command.playing, command.serial
        self._command_reals[0], self._command_reals[1:] = command.speed, command.values
        integers[CHECK] = _check(integers, self._command_reals)
        integers[SEQUENCE] += 1

    def read_command(self) -> Command | None:
        """The command; None while it is being written."""
        integers, reals = self._command.copy(), self._command_reals.copy()
        sequence = integers[SEQUENCE]
        if sequence % 2 or sequence != self._command[SEQUENCE] or integers[CHECK] != _check(integers, reals):
            return None
        return Command(bool(integers[PLAYING]), float(reals[0]), int(integers[SERIAL]), reals[1:])

    # ---- status

    @contextmanager
    def writing(self) -> Iterator[tuple[NDArray[np.int64], Array]]:
        """Context for writing the status. Only the child does so."""
        self._counts[SEQUENCE] += 1
        try:
            yield self._counts, self._reals
        finally:
            self._counts[SEQUENCE] += 1

    def write_frame(self, number: int, t: float, axes: Array, values: Array) -> None:
        """Write a frame. Readers ignore it until the status has its number."""
        row = self.rows[number % len(self.rows)]
        row[NUMBER], row[TIME] = number, t
        row[HEAD : HEAD + self.axes] = axes
        row[HEAD + self.axes :] = values

    def set_state(self, state: str, text: str) -> None:
        """Publish a state, with its details as text."""
        data = text.encode("utf-8")[:TEXT]
        with self.writing() as (counts, _):
            self._text[: len(data)] = np.frombuffer(data, np.uint8)
            counts[LENGTH], counts[STATE] = len(data), STATES.index(state)

    def heartbeat(self) -> None:
        """Count the heartbeat: a single number, which needs no sequence number."""
        self._counts[HEARTBEAT] += 1

    def status(self) -> MachineStatus:
        """Read the status. If the writer died while writing, the status may be inconsistent."""
        for _ in range(TRIES):
            n, reals = self._counts.copy(), self._reals.copy()
            latencies, text = self.latencies.copy(), self._text[: max(n[LENGTH], 0)].tobytes()
            if n[SEQUENCE] % 2 == 0 and n[SEQUENCE] == self._counts[SEQUENCE]:
                break
        last, heartbeat, frames, missed = (int(n[i]) for i in (LAST, HEARTBEAT, FRAMES, MISSED))
        load, worst, slipped = (float(r) for r in reals[:3])
        details = text.decode("utf-8", "replace")
        state = STATES[n[STATE]] if 0 <= n[STATE] < len(STATES) else "failed"  # an FMU may write anywhere
        return MachineStatus(state, last, heartbeat, frames, missed, load, worst, slipped, details, latencies)


def _check(integers: NDArray[np.int64], reals: Array) -> int:
    """Checksum of a command."""
    return zlib.crc32(reals.tobytes(), zlib.crc32(integers[PLAYING : SERIAL + 1].tobytes()))
