"""Parent's side of a worker process: start, messages, limits of time and memory, cause of its end, clean-up.

`Pool` keeps idle processes of one kind for the next task.

`Worker.messages` enforces the limits (`WorkerLimits`). The caller sets their values: for `harvester check`
these are `ProbeLimits` in orchestrator/check/probe_process.py and the option --timeout in
orchestrator/cli/check.py.
"""

import _thread
import io
import math
import os
import pickle
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from queue import Empty, Queue, SimpleQueue
from typing import Any

from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.base.processes import remove_folder, resident_memory
from orchestrator.worker.calls import ACTIVITY_SIZE, CALLS_SIZE, OUTSIDE, Activity, activity_in, calls_in
from orchestrator.worker.wire import DISCONNECTED, Garbled, read_message

ALIVE_INTERVAL = 0.5  # [s], longest time between two checks whether the process is alive
CLOSE_TIME = 0.5  # [s] from the end of its messages to its end, else it has lost its connection
END_TIME = 10.0  # [s] that the system has to end a process that was killed
POLL_INTERVAL = 0.01  # [s] between two checks of the limits
PIPE_SIZE = 1 << 20  # bytes; an unprivileged user may have that
MAX_QUOTED = 200  # characters of the last line of stderr
MAX_STDERR = 1 << 20  # bytes; of a longer stderr file the beginning is kept
MAX_MESSAGES = 8  # waiting to be read; then the process waits, so that memory stays bounded
SIGNAL_NAMES = {
    "SIGSEGV": "segmentation fault",
    "SIGBUS": "bus error",
    "SIGABRT": "abort",
    "SIGFPE": "arithmetic exception",
    "SIGILL": "illegal instruction",
    "SIGKILL": "killed by the system (out of memory?)",
    "SIGALRM": "SIGALRM (a timer that an FMU has set)",
}
# Ctrl-C in the terminal interrupts only this process, which then ends the worker. Linux also schedules
# sessions fairly, so that a browser with many threads takes less time from a real-time machine.
SESSION_OPTIONS: dict[str, Any] = {"start_new_session": True}
if sys.platform == "win32":
    SESSION_OPTIONS = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
CLOSED = "the process lost its connection (an FMU replaced the process or closed its files)"
GARBLED = "the process sent bytes that are no message (an FMU wrote to its connection)"


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
    contents      returns the type of the content of each message that may arrive, by its name; called
                  at the first message, when the types have been imported
    name          prefix of its temporary folder, which is removed at the end
    grace         time for an orderly end before the process is killed [s]
    environment   environment variables that differ from those of this process
    descriptors   file descriptors that the process inherits (POSIX)
    in_folder     use the temporary folder as working directory, for files that an FMU writes

    reusable      false when an FMU has left something behind in the process
    fmus          names of those in it, for messages that cannot tell which of them it was
    """

    reusable, fmus = True, ""

    def __init__(
        self,
        target: str,
        contents: Callable[[], Mapping[str, Any]],
        name: str = "worker",
        grace: float = 0.0,
        environment: Mapping[str, str] | None = None,
        descriptors: Sequence[int] = (),
        in_folder: bool = False,
    ) -> None:
        with DeferredInterrupts():  # until the finalizer is there, which removes the folder
            self.folder = Path(tempfile.mkdtemp(prefix=f"{name}-"))
            self._child = _start(target, self.folder, environment or {}, descriptors, in_folder)
            self.working = self._child.pid  # the process that works: this one, or a fork of it
            _enlarge(self._child.stdout)
            self._messages: Queue[Any] = Queue(MAX_MESSAGES)
            self._closed_at, self._stopped = math.inf, ""  # end of the messages; why `get` has killed it
            to_send: SimpleQueue[bytes | None] = SimpleQueue()
            self._to_send = to_send
            arguments = self._child.stdout, self._messages, contents
            reader = threading.Thread(target=_read, args=arguments, daemon=True)
            writer = threading.Thread(target=_write, args=(self._child.stdin, to_send), daemon=True)
            reader.start()
            writer.start()
            self._last: list[str] = []  # `where` at the end, stored by the finalizer
            end = os.getpid(), self._child, reader, self._messages, to_send, self.folder, grace, self._last
            self._ends = weakref.finalize(self, _abandon, *end)

    def close(self) -> None:
        """End the process and remove its files."""
        with DeferredInterrupts():
            if of := self._ends.detach():
                _end(*of[2])

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
        """The last activity, else the FMI calls in progress, else the FMUs; also after `close`."""
        where = self._last[0] if self._last else _where(self.folder)
        return f"{where}: {self.fmus}" if where == OUTSIDE and self.fmus else where

    @property
    def activity(self) -> Activity:
        """The last activity that the process has stored."""
        return activity_in(read_file(self.folder / "activity", ACTIVITY_SIZE))

    @property
    def memory(self) -> float:
        """Resident memory of the process that works [bytes]; 0 on systems that do not report it."""
        return resident_memory(self.working)

    @property
    def printed(self) -> list[str]:
        """The lines on stdout and stderr; only the latest ones if there are many."""
        text = read_file(self.folder / "errors", MAX_STDERR).decode(errors="replace")
        return [line.strip()[:MAX_QUOTED] for line in text.splitlines() if line.strip()]

    def forget_printed(self, kept: int = 0) -> None:
        """Cut the file of stdout and stderr, except for the first bytes."""
        with suppress(OSError):  # Windows locks files in use
            os.truncate(self.folder / "errors", kept)

    def cut_printed(self) -> None:
        """Keep only the beginning of what was printed if that is too much."""
        with suppress(OSError):
            if (self.folder / "errors").stat().st_size > MAX_STDERR:
                self.forget_printed(MAX_STDERR // 256)

    @property
    def last_stderr_line(self) -> str:
        """The last line on stdout and stderr."""
        return (self.printed or [""])[-1]

    @property
    def report(self) -> str:
        """Cause of the end, last activity and last line of stderr, for a message."""
        last = self.last_stderr_line[:120]
        return f"{self.cause} {self.where}" + (f' ("{last}")' if last else "")

    @property
    def cause(self) -> str:
        """`ending` as the subject of a message."""
        return self.ending.replace("exit status", "the process ended with exit status")

    @property
    def ending(self) -> str:
        """Cause of the end, such as "segmentation fault" or "exit status 1"; empty while the process runs."""
        code = self._child.poll()
        if self._stopped or code == DISCONNECTED:
            return self._stopped or CLOSED
        if code is None:
            return ""
        if code >= 0:
            return f"exit status {code}"
        name = {int(s): s.name for s in signal.Signals}.get(-code, f"signal {-code}")
        return SIGNAL_NAMES.get(name, name)

    def put(self, message: Any) -> None:
        """Send an object that can be pickled, or is pickled (bytes); ignored if the process has ended.

        Returns at once, also if the process does not read.
        """
        data = message if isinstance(message, bytes) else pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        self._to_send.put(data)

    def get(self, timeout: float | None = None) -> tuple[str, Any]:
        """The next message: its name and content.

        Raises TimeoutError after `timeout` [s] without a message, EOFError after the last message of a
        process that has ended. A process that can send no more messages is ended first.
        """
        until = math.inf if timeout is None else time.monotonic() + timeout
        while True:
            dead, now = not self.alive, time.monotonic()
            if self._closed_at < math.inf and (dead or self._stopped):
                raise EOFError(self.ending)
            if now - self._closed_at > CLOSE_TIME:
                self.stop(CLOSED)
                continue
            # the messages of a dead process arrive soon, unless a child of it keeps the pipe open
            most = ALIVE_INTERVAL if self._closed_at == math.inf else POLL_INTERVAL
            wait = ALIVE_INTERVAL if dead else max(0.0, min(most, until - now))
            with suppress(Empty):
                message = self._messages.get(timeout=wait)
                if isinstance(message, tuple):
                    return message
                self._closed_at, dead = time.monotonic(), False
                if message:
                    self.stop(message)
            if dead:
                raise EOFError(self.ending)
            if time.monotonic() >= until:
                raise TimeoutError

    def stop(self, reason: str) -> None:
        """End the process because of something that it did; `ending` is the reason then."""
        if self.alive:
            self._stopped, last = reason, _where(self.folder)
            self.kill()
            self._last[:] = [last]
            with suppress(subprocess.TimeoutExpired):
                self._child.wait(END_TIME)

    def messages(
        self, limits: WorkerLimits, stop: threading.Event | None = None, began: float | None = None
    ) -> Iterator[tuple[str, Any]]:
        """All messages until the process ends; raises LimitExceeded if a limit is exceeded or `stop` set."""
        last_call = time.monotonic()
        began = last_call if began is None else began
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
                self.check_limits(limits, began)
            except LimitExceeded as limit:
                raise LimitExceeded(f"{limit}, stopped {self.where}", limit.timed_out) from None
            if stop is not None and stop.is_set():
                raise LimitExceeded("interrupted", timed_out=True)

    def check_limits(self, limits: WorkerLimits, began: float) -> None:
        """Raise LimitExceeded at the limit of memory or of total time; cut a stderr file that is too large.

        began   beginning of the work, by `time.monotonic` [s]
        """
        self.cut_printed()
        if self.memory > limits.memory:
            raise LimitExceeded(f"uses more than {limits.memory / 1e9:.3g} GB of memory")
        if time.monotonic() - began > limits.total_time:
            raise LimitExceeded(f"not done within {limits.total_time:g} s", timed_out=True)

    def kill(self) -> None:
        """End the process and its children at once; messages that it has sent can still be read."""
        _kill(self._child, self.folder)


def read_file(path: Path, most: int) -> bytes:
    """The first bytes of a file that another process writes; none if it is not a usual file.

    It is not mapped into memory: reading beyond the end of a file that was cut ends a process.
    """
    flags = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_BINARY", "O_NONBLOCK", "O_NOFOLLOW"))
    try:
        with open(os.open(path, flags), "rb") as file:
            usual = stat.S_ISREG(os.fstat(file.fileno()).st_mode)
            return file.read(most) if usual else b""
    except OSError:
        return b""


def _start(
    target: str, folder: Path, environment: Mapping[str, str], descriptors: Sequence[int], in_folder: bool
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
            cwd=folder if in_folder else None,
            pass_fds=descriptors,
            **SESSION_OPTIONS,
        )


def _enlarge(pipe: Any) -> None:
    """Let a message of a run fit into a pipe, which else takes 64 kB and then makes the process wait."""
    if sys.platform == "linux":
        import fcntl

        with suppress(OSError):  # the user has too many large pipes
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_SIZE)


def _read(source: Any, messages: Queue[Any], contents: Callable[[], Mapping[str, Any]]) -> None:
    """Queue all complete messages until the process ends, then why there are no more; empty for its end."""
    buffered = io.BufferedReader(io.FileIO(source.fileno(), closefd=False))
    end = ""
    try:
        for number in count():
            messages.put(read_message(buffered, number, contents))
    except (EOFError, OSError, ValueError):
        pass
    except (Garbled, MemoryError):
        end = GARBLED
    messages.put(end)


def _write(target: Any, messages: SimpleQueue[bytes | None]) -> None:
    """Send messages until None, or until the process ends; then its pipe is closed."""
    with suppress(OSError, ValueError):  # the next `get` reports the end of the process
        while (message := messages.get()) is not None:
            rest = memoryview(message)
            while rest:
                rest = rest[target.write(rest) or 0 :]
    with suppress(OSError):
        target.close()


def _where(folder: Path) -> str:
    """The last activity that a process has stored, else the FMI calls in progress."""
    last = activity_in(read_file(folder / "activity", ACTIVITY_SIZE))
    return str(last) if last.count else calls_in(read_file(folder / "calls", CALLS_SIZE))


def _kill(child: subprocess.Popen[bytes], folder: Path) -> None:
    """Kill a process and those that it has started, on Linux also those in sessions of their own."""
    started = [*_started_in(folder), *_descendants(child.pid)]
    if sys.platform == "win32":
        subprocess.run(["taskkill", "/T", "/F", "/PID", str(child.pid)], capture_output=True, check=False)
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)
    if child.poll() is None:
        child.kill()
    for pid in {*started, *_started_in(folder)}:
        with suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)


def _started_in(folder: Path) -> Iterator[int]:
    """Processes that have inherited the environment variable TMPDIR of a worker, or its outputs (Linux)."""
    mark, printed = b"TMPDIR=" + os.fsencode(folder) + b"\0", str(folder / "errors")
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended, or belongs to another user
            outputs = (process / "fd" / number for number in "12")
            if mark in (process / "environ").read_bytes() or printed in map(os.readlink, outputs):
                yield int(process.name)


def _descendants(pid: int) -> Iterator[int]:
    """The processes below a process that runs (Linux): a worker adopts those whose parents have ended."""
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in (task / "children").read_text("ascii").split():
                yield int(child)
                yield from _descendants(int(child))


def _abandon(*of: Any) -> None:
    """End a process that nobody refers to: an interrupt, which would be lost here, is raised soon after."""
    try:
        with DeferredInterrupts(second_at_once=False):
            _end(*of)
    except KeyboardInterrupt:
        if threading.main_thread().is_alive():  # else Python exits
            threading.Timer(POLL_INTERVAL, _interrupt_main_thread).start()


def _interrupt_main_thread() -> None:
    """As Ctrl-C does: also a call that waits ends, except on Windows."""
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def _end(
    owner: int,
    child: subprocess.Popen[bytes],
    reader: threading.Thread,
    messages: Queue[Any],
    to_send: SimpleQueue[bytes | None],
    folder: Path,
    grace: float,
    last: list[str],
) -> None:
    """Close the pipe, wait, kill the process and its children, and remove the files."""
    if os.getpid() != owner:  # this process was forked from the parent, which still uses the worker
        return
    to_send.put(None)
    with suppress(subprocess.TimeoutExpired):
        child.wait(grace)
    _kill(child, folder)
    with suppress(subprocess.TimeoutExpired):
        child.wait(END_TIME)
    until = time.monotonic() + 1.0
    while reader.is_alive() and time.monotonic() < until:
        with suppress(Empty):  # the reader may wait for a place in the queue
            messages.get(timeout=0.01)
        reader.join(0.01)
    with suppress(OSError):
        if child.stdout is not None and not reader.is_alive():  # closing it would wait for the reader
            child.stdout.close()
    last.append(_where(folder))
    remove_folder(folder)


# ---- many of one kind

_of_parent: list[Any] = []  # idle ones, in a forked process; never closed there


class Pool:
    """Worker processes that start when they are needed, for tasks in any number of threads.

    start   starts one
    kept    number of idle ones that wait for the next task, at most
    """

    def __init__(self, start: Callable[[], Worker], kept: float = math.inf) -> None:
        self.start, self._kept = start, kept
        # with the environment variables and the parent at its start
        self._idle: list[tuple[Worker, tuple[int, dict[str, str]]]] = []

    def warm(self, count: int = 1) -> None:
        """Start processes for the next tasks, until so many are idle."""
        while len(self._idle) < count:
            self._idle.append((self.start(), _circumstances()))

    @contextmanager
    def worker(self) -> Iterator[Worker]:
        """An idle process, else a new one; kept for the next task if it is reusable and this one succeeds."""
        worker, circumstances = self._take()
        try:
            worker.forget_printed()
            yield worker
        except BaseException:
            worker.close()
            raise
        if worker.alive and worker.reusable and len(self._idle) < self._kept:
            self._idle.append((worker, circumstances))
        else:
            worker.close()

    def _take(self) -> tuple[Worker, tuple[int, dict[str, str]]]:
        now = _circumstances()
        while True:
            try:
                worker, before = self._idle.pop()
            except IndexError:
                return self.start(), now
            if before[0] != now[0]:
                _of_parent.append(worker)
            elif before == now and worker.alive:
                return worker, now
            else:
                worker.close()

    def close(self) -> None:
        """End the idle processes."""
        with DeferredInterrupts():
            while self._idle:
                self._idle.pop()[0].close()


def _circumstances() -> tuple[int, dict[str, str]]:
    """What a process inherits: an FMU may read environment variables."""
    return os.getpid(), dict(os.environ)
