"""Child's side of a worker process: `python -m orchestrator.worker.main MODULE:FUNCTION FOLDER`.

Messages of the parent are pickled and arrive on standard input. Answers are frames of data, see `wire`, and
go to standard output. What an FMU prints goes to the file of stderr. Temporary files are made in the folder
of the process.
"""

import ctypes
import locale
import mmap
import os
import pickle
import signal
import struct
import sys
import threading
import time
import traceback
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any

from orchestrator.base.processes import remove_folder
from orchestrator.worker.calls import share_activity, share_calls
from orchestrator.worker.wire import DISCONNECTED, packed

NUMBER = struct.Struct("<I")  # of the next frame; in memory that a fork for a task shares
PATIENCE = 2.0  # [s] for the parent to end this process
SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of Linux
_END_OF_INPUT = object()


class Channel:
    """Connection of a function in a worker process to its parent.

    folder     for temporary files; removed by the parent, or by this process if the parent has ended
    grace      time for an orderly end after the parent has closed its end [s]
    ended      set when the parent has closed its end
    activity   shared memory for the last FMI call
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.grace, self.ended, self._parent = folder, 0.0, threading.Event(), os.getppid()
        self._maps: list[mmap.mmap] = []
        self.activity = share_activity(folder / "activity", self.keep)
        self.keep(share_calls(folder / "calls"))
        self._owner, self._numbers = os.getpid(), self.keep(mmap.mmap(-1, NUMBER.size))
        self._input, self._answers = os.dup(sys.stdin.fileno()), os.dup(sys.stdout.fileno())
        self._writing, self._pipe = threading.Lock(), os.fstat(self._answers).st_ino
        self.descriptors = 0, 1, 2, self._input, self._answers
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what an FMU prints is no answer
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, sys.stdin.fileno())  # what an FMU reads is no message
        os.close(nothing)
        self._messages: SimpleQueue[Any] = SimpleQueue()
        threading.Thread(target=self._read, args=(os.fdopen(self._input, "rb"),), daemon=True).start()

    def get(self) -> Any:
        """The next message; raises EOFError when the parent has closed its end."""
        message = self._messages.get()
        if message is _END_OF_INPUT:
            raise EOFError
        return message

    @property
    def waiting(self) -> bool:
        """Is there a message, or has the parent closed its end?"""
        return not self._messages.empty()

    def put(self, name: str, content: Any = None) -> None:
        """Send a message, without buffering, so that it survives a crash; see `wire.packed`."""
        with self._writing:  # an FMU may log from a thread of its own
            if os.getpid() != self._owner:  # an FMU has forked this process
                os._exit(0)
            (number,) = NUMBER.unpack(self._numbers[:])
            parts = packed(number, name, content)
            self._numbers[:] = NUMBER.pack(number + 1)
            try:
                make_blocking(self._answers)
                if os.fstat(self._answers).st_ino != self._pipe:  # an FMU has put a file in its place
                    self._lost()
                for part in parts:
                    rest = memoryview(part)
                    while rest:
                        rest = rest[os.write(self._answers, rest) :]
            except OSError:
                self._lost()

    def _lost(self) -> None:
        """End this process, which has lost its connection: because of an FMU, or of the end of the parent."""
        for _ in range(20):
            if os.getppid() != self._parent:  # the parent closes its files before it has ended
                self.end()
            time.sleep(0.01)
        os._exit(DISCONNECTED)

    def keep(self, memory: mmap.mmap) -> mmap.mmap:
        """Keep a map of shared memory to this process: one that an FMU forks ends where it would write there.

        Only Linux can do so; elsewhere such a process ends in `put`.
        """
        self._maps.append(memory)
        if hasattr(mmap, "MADV_DONTFORK"):
            memory.madvise(mmap.MADV_DONTFORK)
        return memory

    def fork(self) -> int:
        """Fork this process for a task; the fork is the one that sends."""
        for memory in self._maps:
            memory.madvise(mmap.MADV_DOFORK)
        pid = os.fork()
        for memory in () if pid else self._maps:
            memory.madvise(mmap.MADV_DONTFORK)
        self._owner = os.getpid()
        return pid

    def end(self, status: int = 0) -> None:
        """Remove the folder, and end this process; if the parent has ended, also those that FMUs started."""
        remove_folder(self.folder)
        if hasattr(os, "killpg") and os.getppid() != self._parent and os.getpgrp() == os.getpid():
            os.killpg(os.getpgrp(), signal.SIGKILL)
        os._exit(status)

    def _read(self, source: IO[bytes]) -> None:
        """Queue messages until the input ends; then end the process, even during a call of an FMU."""
        try:
            while True:
                make_blocking(self._input)
                self._messages.put(pickle.load(source))
        except Exception as error:  # of any kind, for what an FMU has written to the pipe
            if not isinstance(error, EOFError) and "truncated" not in str(error):
                os._exit(DISCONNECTED)
            self.ended.set()
            self._messages.put(_END_OF_INPUT)
            end = time.monotonic() + self.grace + PATIENCE
            time.sleep(self.grace)
            while os.getppid() == self._parent and time.monotonic() < end:
                time.sleep(0.05)  # the parent also ends what this process has started
            self.end(DISCONNECTED)


def make_blocking(descriptor: int) -> None:
    """Undo what an FMU may have done to a pipe."""
    if hasattr(os, "set_blocking"):  # not in older versions of Python on Windows
        os.set_blocking(descriptor, True)


def left_behind(channel: Channel, threads: bool = True) -> tuple[Any, ...]:
    """What FMUs may change in this process and leave to the next run, as far as the system tells.

    threads: their number counts. In many runs of the same FMUs it does not: many libraries keep threads for
    the next one.
    """
    names = (*(("Threads",) if threads else ()), "SigBlk", "SigIgn", "SigCgt")
    found: list[Any] = [locale.setlocale(locale.LC_NUMERIC)]
    process = Path("/proc/self")
    with suppress(OSError):  # Linux
        lines = (process / "status").read_text("utf-8", "replace").splitlines()
        found += [line for line in lines if line.startswith(names)]
        found += [file.read_text("ascii") for file in process.glob("task/*/children")]
        found += [os.readlink(process / "fd" / str(descriptor)) for descriptor in channel.descriptors]
        found.append((process / "timers").read_text("ascii"))
    if sys.platform != "win32":
        import resource

        found += [resource.getrlimit(getattr(resource, name)) for name in dir(resource) if "RLIMIT_" in name]
        found += [signal.getitimer(getattr(signal, name)) for name in dir(signal) if "ITIMER_" in name]
    return (*found,)


def main(target: str, folder: Path) -> None:
    """Run the function, then end the process without the exit handlers of FMUs."""
    channel = Channel(folder)
    if sys.platform == "linux":  # the parent finds also a process whose parent has ended
        ctypes.CDLL(None).prctl(SUBREAPER, 1)
    module, _, name = target.partition(":")
    try:
        getattr(import_module(module), name)(channel)
    except EOFError:
        channel.ended.wait(1.0)
        if not channel.grace:  # the parent finds what FMUs have started as long as this process lives
            time.sleep(PATIENCE)
            channel.end(DISCONNECTED)
    except BaseException:  # the parent reports the last line of the traceback
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    if channel.ended.is_set():  # the parent may have ended
        channel.end()
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
