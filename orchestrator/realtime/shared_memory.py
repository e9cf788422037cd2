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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.data.table import Array
from orchestrator.realtime.deadlines import BINS
from orchestrator.realtime.setup import State


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


STATES = tuple(State)  # in the memory by their numbers
TEXT = 1 << 20  # bytes of the details
TRIES = 1000  # readings while the writer writes, which takes microseconds


class Command(NamedTuple):
    """A command to the machine. serial: counts the commands with new values of the axes."""

    playing: bool
    speed: float
    serial: int
    values: Array


class MachineStatus(NamedTuple):
    """Status of the process. last: number of the latest frame; heartbeat: counts its loops."""

    state: State
    text: str
    last: int
    heartbeat: int
    frames: int
    missed: int
    load: float
    worst: float
    slipped: float
    latencies: NDArray[np.int64]


def layout(axes: int, signals: int, rows: int) -> np.dtype[Any]:
    """Type of the memory: command, status and its details, frames. Frame n is in row n modulo rows."""
    command = [("playing", "i8"), ("speed", "f8"), ("serial", "i8"), ("values", "f8", (axes,))]
    counts = [(name, "i8") for name in ("state", "last", "heartbeat", "frames", "missed")]
    reals = [(name, "f8") for name in ("load", "worst", "slipped")]
    status = [*counts, *reals, ("latencies", "i8", (BINS,))]
    frame = [("number", "i8"), ("time", "f8"), ("axes", "f8", (axes,)), ("values", "f8", (signals,))]
    parts: list[Any] = [
        ("command", [("sequence", "i8"), ("check", "i8"), ("content", command)]),
        ("status", [("sequence", "i8"), ("length", "i8"), ("content", status)]),
        ("text", "u1", (TEXT,)),
        ("frames", frame, (rows,)),
    ]
    return np.dtype(parts)


class SharedState:
    """Typed views of a block of shared memory.

    frames   the latest frames, shape (rows,): number, time, axes, values
    """

    def __init__(self, memory: mmap_of_mmap, axes: int, signals: int, rows: int) -> None:
        whole = np.frombuffer(memory, layout(axes, signals, rows), 1).reshape(())
        parts = (whole[name] for name in ("command", "status", "text", "frames"))
        self._command, self._status, self._text, self.frames = parts

    # ---- command

    def write_command(self, command: Command) -> None:
        """Write a command. Only the parent does so."""
        shared = self._command
        shared["sequence"] += 1
        shared["content"] = tuple(command)
        shared["check"] = _check(shared)
        shared["sequence"] += 1

    def read_command(self) -> Command | None:
        """The command; None while it is being written."""
        read = self._command.copy()
        sequence = read["sequence"]
        if sequence % 2 or sequence != self._command["sequence"] or read["check"] != _check(read):
            return None
        playing, *others = read["content"].item()
        return Command(bool(playing), *others)

    # ---- status

    @contextmanager
    def writing(self) -> Iterator[NDArray[Any]]:
        """Context for writing the status, whose fields it gives. Only the child does so."""
        self._status["sequence"] += 1
        try:
            yield self._status["content"]
        finally:
            self._status["sequence"] += 1

    def write_frame(self, number: int, t: float, axes: Array, values: Array) -> None:
        """Write a frame. Readers ignore it until the status has its number."""
        self.frames[number % len(self.frames)] = (number, t, axes, values)

    def set_state(self, state: State, text: str) -> None:
        """Publish a state, with its details as text."""
        data = text.encode("utf-8")[:TEXT]
        with self.writing() as status:
            self._text[: len(data)] = np.frombuffer(data, np.uint8)
            self._status["length"], status["state"] = len(data), STATES.index(state)

    def heartbeat(self) -> None:
        """Count the heartbeat: a single number, which needs no sequence number."""
        self._status["content"]["heartbeat"] += 1

    def status(self) -> MachineStatus:
        """Read the status. If the writer died while writing, the status may be inconsistent."""
        for _ in range(TRIES):
            read = self._status.copy()
            text = self._text[: max(int(read["length"]), 0)].tobytes()
            if read["sequence"] % 2 == 0 and read["sequence"] == self._status["sequence"]:
                break
        number, *others = read["content"].item()
        state = STATES[number] if 0 <= number < len(STATES) else State.FAILED  # an FMU may write anywhere
        return MachineStatus(state, text.decode("utf-8", "replace"), *others)


def _check(command: NDArray[Any]) -> int:
    """Checksum of a command."""
    return zlib.crc32(command["content"].tobytes())
