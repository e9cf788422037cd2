"""The parent's side of a worker process: start, messages, limits, how it ended, removal of its files."""

from __future__ import annotations

import math
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from orchestrator.worker.activity import Activity, ActivityRecord

ALIVE_INTERVAL = 0.5  # [s] at most between two looks at whether the process lives
POLL_INTERVAL = 0.01  # [s] between two looks at what it takes
MAX_QUOTED = 200  # characters of what a process wrote before it died
MAX_STDERR = 1 << 20  # bytes that a process may write to stderr before they are thrown away
SIGNAL_NAMES = {
    "SIGSEGV": "segmentation fault",
    "SIGBUS": "bus error",
    "SIGABRT": "abort",
    "SIGFPE": "arithmetic exception",
    "SIGILL": "illegal instruction",
    "SIGKILL": "killed by the system (out of memory?)",
}
# Ctrl-C in the terminal is for this process, which ends the other. With a session of its own Linux also parts
# processors between the two first, so a browser with many threads takes less from a machine in real time.
SESSION_OPTIONS: dict[str, Any] = {"start_new_session": True}
if sys.platform == "win32":
    SESSION_OPTIONS = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
_END_OF_MESSAGES = object()


@dataclass(frozen=True)
class WorkerLimits:
    """What a worker process may take.

    call     longest single call into an FMU [s], as the beacon shows it; a longer one is a hang
    total    longest time for all of its work [s]
    memory   [bytes], where the system tells
    """

    call_time: float = math.inf
    total_time: float = math.inf
    memory: float = math.inf


class LimitExceeded(Exception):
    """A process took more than its limits allow; `late`: its time was over, it may only be slow."""

    def __init__(self, text: str, late: bool = False) -> None:
        self.timed_out = late
        super().__init__(text)


class Worker:
    """One process, from its start until `close` is called or nobody knows it any more.

    target        "package.module:function"; it is called with a `main.Channel`
    name          of the folder for its temporary files, which is removed at the end
    patience      [s] for an orderly end, then it is killed
    environment   variables that differ from those of this process
    descriptors   open files that it inherits (POSIX)
    inside        it works in its folder: files that an FMU writes go there
    """

    def __init__(
        self,
        target: str,
        name: str = "worker",
        patience: float = 0.0,
        environment: Mapping[str, str] | None = None,
        descriptors: Sequence[int] = (),
        inside: bool = False,
    ) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix=f"{name}-"))
        self._activity = ActivityRecord(self.folder / "beacon")
        options = {"cwd": self.folder} if inside else {}
        self._child = _start(target, self.folder, environment or {}, pass_fds=descriptors, **options)
        self._messages: SimpleQueue[Any] = SimpleQueue()
        reader = threading.Thread(target=_read, args=(self._child.stdout, self._messages), daemon=True)
        reader.start()
        self.close = weakref.finalize(self, _end, self._child, reader, self._activity, self.folder, patience)

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._child.pid

    @property
    def alive(self) -> bool:
        """Does it still run?"""
        return self._child.poll() is None

    @property
    def activity(self) -> Activity:
        """What it was doing last, if it tells by its beacon."""
        return self._activity.read()

    @property
    def memory(self) -> float:
        """Memory that it takes [bytes]; 0 where the system does not tell."""
        try:
            pages = Path(f"/proc/{self.pid}/statm").read_text(encoding="ascii").split()[1]
        except (OSError, IndexError):
            return 0.0
        return float(pages) * os.sysconf("SC_PAGE_SIZE")

    @property
    def last_stderr_line(self) -> str:
        """The last line that it wrote to stderr."""
        with suppress(OSError):
            text = (self.folder / "errors").read_text(encoding="utf-8", errors="replace")
            return text.strip().rpartition("\n")[2][:MAX_QUOTED]
        return ""

    @property
    def report(self) -> str:
        """How the process ended, what it was doing then, and its last words."""
        how = self.ending.replace("exit status", "the process ended with exit status")
        return f"{how} {self.activity}" + (
            f' ("{self.last_stderr_line[:120]}")' if self.last_stderr_line else ""
        )

    @property
    def ending(self) -> str:
        """How the process ended, such as "segmentation fault" or "exit status 1"; empty while it lives."""
        code = self._child.poll()
        if code is None:
            return ""
        if code >= 0:
            return f"exit status {code}"
        name = {int(s): s.name for s in signal.Signals}.get(-code, f"signal {-code}")
        return SIGNAL_NAMES.get(name, name)

    def put(self, message: Any) -> None:
        """Send something that can be pickled, or is pickled (bytes); nothing where the process is gone."""
        data = message if isinstance(message, bytes) else pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        assert self._child.stdin is not None
        with suppress(BrokenPipeError, OSError):  # what is read next tells of it
            self._child.stdin.write(data)
            self._child.stdin.flush()

    def get(self, timeout: float | None = None) -> Any:
        """The next message.

        Raises TimeoutError when none came in time, EOFError when the process has ended and all were read.
        """
        until = math.inf if timeout is None else time.monotonic() + timeout
        while True:
            dead = not self.alive  # then what it sent is on its way, unless an orphan of it holds the pipe
            try:
                message = self._messages.get(
                    timeout=ALIVE_INTERVAL
                    if dead
                    else max(0.0, min(ALIVE_INTERVAL, until - time.monotonic()))
                )
            except Empty:
                if dead:
                    raise EOFError(self.ending) from None
                if time.monotonic() >= until:
                    raise TimeoutError from None
                continue
            if message is not _END_OF_MESSAGES:
                return message
            self._messages.put(_END_OF_MESSAGES)
            self._child.wait()
            raise EOFError(self.ending)

    def messages(self, limits: WorkerLimits, stop: threading.Event | None = None) -> Iterator[Any]:
        """All messages until the process ends; raises LimitExceeded where it takes too much or is to stop."""
        begin = moved = time.monotonic()
        count = -1
        while True:
            try:
                yield self.get(POLL_INTERVAL)
            except TimeoutError:
                self._quieten()
            except EOFError:
                return
            seen, now = self.activity, time.monotonic()
            if seen.count != count:
                count, moved = seen.count, now
            if count and now - moved > limits.call_time:  # before the first call it is Python that starts
                raise LimitExceeded(f"hang: no return within {limits.call_time:g} s {seen}")
            if self.memory > limits.memory:
                raise LimitExceeded(f"takes more than {limits.memory / 1e9:.3g} GB of memory, stopped {seen}")
            if now - begin > limits.total_time:
                raise LimitExceeded(f"not done within {limits.total_time:g} s, stopped {seen}", late=True)
            if stop is not None and stop.is_set():
                raise LimitExceeded("interrupted", late=True)

    def _quieten(self) -> None:
        """Throw away what it wrote to stderr, if that is a lot."""
        errors = self.folder / "errors"
        with suppress(OSError):  # refused where a file in use is locked
            if errors.stat().st_size > MAX_STDERR:
                os.truncate(errors, 0)


def machine_memory() -> float:
    """Memory of this machine [bytes]; infinite where it is not told."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def _start(
    target: str, folder: Path, environment: Mapping[str, str], **options: Any
) -> subprocess.Popen[bytes]:
    """A Python of its own, which imports nothing of this one."""
    roots = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(roots), **environment}
    with (folder / "errors").open("ab") as errors:
        return subprocess.Popen(
            [sys.executable, "-m", "orchestrator.worker.main", target, str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=variables,
            **SESSION_OPTIONS,
            **options,
        )


def _read(source: Any, messages: SimpleQueue[Any]) -> None:
    """All messages until the process ends; one that is cut off is none."""
    with suppress(EOFError, OSError, ValueError, pickle.UnpicklingError, AttributeError, ImportError):
        while True:
            messages.put(pickle.load(source))
    messages.put(_END_OF_MESSAGES)


def _end(
    child: subprocess.Popen[bytes],
    reader: threading.Thread,
    beacon: ActivityRecord,
    folder: Path,
    patience: float,
) -> None:
    """Close the pipe, wait, kill what is left, also what an FMU has started, and remove the files."""
    with suppress(OSError):
        if child.stdin is not None:
            child.stdin.close()
    with suppress(subprocess.TimeoutExpired):
        child.wait(patience)
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)
    if child.poll() is None:
        child.kill()
    child.wait()
    reader.join(1.0)
    with suppress(OSError):
        if child.stdout is not None:
            child.stdout.close()
    beacon.close()
    shutil.rmtree(folder, ignore_errors=True)
