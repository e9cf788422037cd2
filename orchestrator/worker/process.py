"""Parent's side of a worker process: start, messages, limits of time and memory, cause of its end, clean-up.

`Worker.messages` enforces the limits (`WorkerLimits`). The caller sets their values: for `harvester check`
these are `ProbeLimits` in orchestrator/check/probe_process.py and the option --timeout in
orchestrator/cli/check.py.
"""

import io
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
from queue import Empty, Queue
from typing import Any

from orchestrator.worker.activity import Activity, ActivityRecord
from orchestrator.worker.call_slots import calls_in_progress

ALIVE_INTERVAL = 0.5  # [s], longest time between two checks whether the process is alive
POLL_INTERVAL = 0.01  # [s] between two checks of the limits
PIPE_SIZE = 1 << 20  # bytes; an unprivileged user may have that
MAX_QUOTED = 200  # characters of the last line of stderr
MAX_STDERR = 1 << 20  # bytes; of a longer stderr file the beginning is kept
MAX_MESSAGES = 16  # waiting to be read; then the process waits, so that memory stays bounded
SIGNAL_NAMES = {
    "SIGSEGV": "segmentation fault",
    "SIGBUS": "bus error",
    "SIGABRT": "abort",
    "SIGFPE": "arithmetic exception",
    "SIGILL": "illegal instruction",
    "SIGKILL": "killed by the system (out of memory?)",
}
# Ctrl-C in the terminal interrupts only this process, which then ends the worker. Linux also schedules
# sessions fairly, so that a browser with many threads takes less time from a real-time machine.
SESSION_OPTIONS: dict[str, Any] = {"start_new_session": True}
if sys.platform == "win32":
    SESSION_OPTIONS = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
_END_OF_MESSAGES = object()


@dataclass(frozen=True)
class WorkerLimits:
    """Limits of a worker process, set by the caller and enforced by `Worker.messages`; default: none.

    call_time    longest call into an FMU [s], by the activity file; a longer call is reported as a hang
    total_time   longest time until the process ends [s]
    memory       largest resident memory [bytes], on systems that report it
    """

    call_time: float = math.inf
    total_time: float = math.inf
    memory: float = math.inf


class LimitExceeded(Exception):
    """A process exceeded its limits; `timed_out`: its total time has passed, so it may only be slow."""

    def __init__(self, message: str, timed_out: bool = False) -> None:
        self.timed_out = timed_out
        super().__init__(message)


class Worker:
    """A worker process, which runs until `close` is called or the object is garbage-collected.

    target        "package.module:function", called with a `main.Channel`
    name          prefix of its temporary folder, which is removed at the end
    grace         time for an orderly end before the process is killed [s]
    environment   environment variables that differ from those of this process
    descriptors   file descriptors that the process inherits (POSIX)
    in_folder     use the temporary folder as working directory, for files that an FMU writes
    """

    def __init__(
        self,
        target: str,
        name: str = "worker",
        grace: float = 0.0,
        environment: Mapping[str, str] | None = None,
        descriptors: Sequence[int] = (),
        in_folder: bool = False,
    ) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix=f"{name}-"))
        self._activity = ActivityRecord(self.folder / "activity")
        options = {"cwd": self.folder} if in_folder else {}
        self._child = _start(target, self.folder, environment or {}, pass_fds=descriptors, **options)
        self.working = self._child.pid  # the process that works: this one, or a fork of it
        _enlarge(self._child.stdout)
        self._messages: Queue[Any] = Queue(MAX_MESSAGES)
        reader = threading.Thread(target=_read, args=(self._child.stdout, self._messages), daemon=True)
        reader.start()
        self._last: list[str] = []  # `where` at the end, stored by the finalizer
        end = os.getpid(), self._child, reader, self._messages, self._activity, self.folder, grace, self._last
        self.close = weakref.finalize(self, _end, *end)

    @property
    def pid(self) -> int:
        """The process id."""
        return self._child.pid

    @property
    def alive(self) -> bool:
        """True while the process runs."""
        return self._child.poll() is None

    @property
    def where(self) -> str:
        """The last activity, else the FMI calls in progress; also after `close`."""
        return self._last[0] if self._last else _where(self.folder, self._activity)

    @property
    def activity(self) -> Activity:
        """The last activity that the process has stored."""
        return self._activity.read()

    @property
    def memory(self) -> float:
        """Resident memory of the process that works [bytes]; 0 on systems that do not report it."""
        try:
            pages = Path(f"/proc/{self.working}/statm").read_text(encoding="ascii").split()[1]
        except (OSError, IndexError):
            return 0.0
        return float(pages) * os.sysconf("SC_PAGE_SIZE")

    @property
    def printed(self) -> list[str]:
        """The lines on stdout and stderr; only the latest ones if there are many."""
        with suppress(OSError):
            text = (self.folder / "errors").read_text(encoding="utf-8", errors="replace")
            return [line.strip()[:MAX_QUOTED] for line in text.splitlines() if line.strip()]
        return []

    def forget_printed(self, kept: int = 0) -> None:
        """Cut the file of stdout and stderr, except for the first bytes."""
        with suppress(OSError):  # Windows locks files in use
            os.truncate(self.folder / "errors", kept)

    @property
    def last_stderr_line(self) -> str:
        """The last line on stdout and stderr."""
        return (self.printed or [""])[-1]

    @property
    def report(self) -> str:
        """Cause of the end, last activity and last line of stderr, for a message."""
        cause = self.ending.replace("exit status", "the process ended with exit status")
        return f"{cause} {self.where}" + (
            f' ("{self.last_stderr_line[:120]}")' if self.last_stderr_line else ""
        )

    @property
    def ending(self) -> str:
        """Cause of the end, such as "segmentation fault" or "exit status 1"; empty while the process runs."""
        code = self._child.poll()
        if code is None:
            return ""
        if code >= 0:
            return f"exit status {code}"
        name = {int(s): s.name for s in signal.Signals}.get(-code, f"signal {-code}")
        return SIGNAL_NAMES.get(name, name)

    def put(self, message: Any) -> None:
        """Send an object that can be pickled, or is pickled (bytes); ignored if the process has ended."""
        data = message if isinstance(message, bytes) else pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        assert self._child.stdin is not None
        with suppress(BrokenPipeError, OSError):  # the next `get` reports the end of the process
            rest = memoryview(data)
            while rest:
                rest = rest[self._child.stdin.write(rest) or 0 :]

    def get(self, timeout: float | None = None) -> Any:
        """The next message.

        Raises TimeoutError after `timeout` [s] without a message, EOFError after the last message of a
        process that has ended.
        """
        until = math.inf if timeout is None else time.monotonic() + timeout
        while True:
            dead = not self.alive  # its messages arrive soon, unless a child of it keeps the pipe open
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
        """All messages until the process ends; raises LimitExceeded if a limit is exceeded or `stop` set."""
        begin = last_call = time.monotonic()
        count = -1
        while True:
            try:
                yield self.get(POLL_INTERVAL)
            except TimeoutError:
                pass
            except EOFError:
                return
            activity, now = self.activity, time.monotonic()
            if activity.count != count:
                count, last_call = activity.count, now
            if count and now - last_call > limits.call_time:  # count is 0 while Python starts
                raise LimitExceeded(f"hang: no return within {limits.call_time:g} s {activity}")
            try:
                self.check_limits(limits, begin)
            except LimitExceeded as limit:
                raise LimitExceeded(f"{limit}, stopped {self.where}", limit.timed_out) from None
            if stop is not None and stop.is_set():
                raise LimitExceeded("interrupted", timed_out=True)

    def check_limits(self, limits: WorkerLimits, began: float) -> None:
        """Raise LimitExceeded at the limit of memory or of total time; cut a stderr file that is too large.

        began   beginning of the work, by `time.monotonic` [s]
        """
        with suppress(OSError):
            if (self.folder / "errors").stat().st_size > MAX_STDERR:
                self.forget_printed(MAX_STDERR // 256)
        if self.memory > limits.memory:
            raise LimitExceeded(f"uses more than {limits.memory / 1e9:.3g} GB of memory")
        if time.monotonic() - began > limits.total_time:
            raise LimitExceeded(f"not done within {limits.total_time:g} s", timed_out=True)

    def kill(self) -> None:
        """End the process and its children at once; messages that it has sent can still be read."""
        _kill(self._child, self.folder)


def _start(
    target: str, folder: Path, environment: Mapping[str, str], **options: Any
) -> subprocess.Popen[bytes]:
    """Start a new Python process, without a fork of this one."""
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))  # removed with what FMUs leave there
    roots = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
    variables = {**os.environ, **temporary, "PYTHONPATH": os.pathsep.join(roots), **environment}
    with (folder / "errors").open("ab") as errors:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "orchestrator.worker.main", target, str(folder)],
            bufsize=0,  # a process that is forked from this one must not wait for the lock of a buffer
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=variables,
            **SESSION_OPTIONS,
            **options,
        )


def _enlarge(pipe: Any) -> None:
    """Let a message of a run fit into a pipe, which else takes 64 kB and then makes the process wait."""
    if sys.platform == "linux":
        import fcntl

        with suppress(OSError):  # the user has too many large pipes
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_SIZE)


def _read(source: Any, messages: Queue[Any]) -> None:
    """Queue all complete messages until the process ends."""
    unreadable = pickle.UnpicklingError, AttributeError, ImportError, TypeError
    buffered = io.BufferedReader(io.FileIO(source.fileno(), closefd=False))
    with suppress(EOFError, OSError, ValueError, *unreadable):
        while True:
            messages.put(pickle.load(buffered))
    messages.put(_END_OF_MESSAGES)


def _where(folder: Path, activity: ActivityRecord) -> str:
    """The last activity that a process has stored, else the FMI calls in progress."""
    if (last := activity.read()).count:
        return str(last)
    calls = [f"in {call} of {call.instance}" for call in calls_in_progress(folder / "calls")]
    return "; ".join(calls) or "outside of the FMUs"


def _kill(child: subprocess.Popen[bytes], folder: Path) -> None:
    """Kill a process and those that it has started, on Linux also those in sessions of their own."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)
    if child.poll() is None:
        child.kill()
    for pid in _started_in(folder):
        with suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)


def _started_in(folder: Path) -> Iterator[int]:
    """Processes that have inherited the environment variable TMPDIR of a worker (Linux)."""
    mark = b"TMPDIR=" + os.fsencode(folder) + b"\0"
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended, or belongs to another user
            if mark in (process / "environ").read_bytes():
                yield int(process.name)


def _end(
    owner: int,
    child: subprocess.Popen[bytes],
    reader: threading.Thread,
    messages: Queue[Any],
    activity: ActivityRecord,
    folder: Path,
    grace: float,
    last: list[str],
) -> None:
    """Close the pipe, wait, kill the process and its children, and remove the files."""
    if os.getpid() != owner:  # this process was forked from the parent, which still uses the worker
        return
    with suppress(OSError):
        if child.stdin is not None:
            child.stdin.close()
    with suppress(subprocess.TimeoutExpired):
        child.wait(grace)
    _kill(child, folder)
    child.wait()
    until = time.monotonic() + 1.0
    while reader.is_alive() and time.monotonic() < until:
        with suppress(Empty):  # the reader may wait for a place in the queue
            messages.get(timeout=0.01)
        reader.join(0.01)
    with suppress(OSError):
        if child.stdout is not None and not reader.is_alive():  # closing it would wait for the reader
            child.stdout.close()
    last.append(_where(folder, activity))
    activity.close()
    shutil.rmtree(folder, ignore_errors=True)
