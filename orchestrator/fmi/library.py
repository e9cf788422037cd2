"""The shared library of an FMU: finding it, loading it.

Functions are looked up when they are used, so an FMU that lacks an optional one still runs.

The functions that an FMU calls back: its messages go to the log of the instance that sent them.

The messages an FMU logs during a run, and the status of its calls.
"""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import calloc, free, freeLibrary, platform, platform_tuple, sharedLibraryExtension
from fmpy.fmi1 import printLogMessage
from fmpy.fmi2 import (
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import fmi3LogMessageCallback
from numpy.typing import NDArray

from orchestrator.base.errors import Problem
from orchestrator.data.trace import Trace


def folders(fmi: int) -> list[str]:
    """Where in binaries/ the library may lie, the most fitting first.

    FMI 3.0 has tuples such as x86_64-linux. FMI 2.0 has linux64 and the like, which do not tell the
    processor, so on ARM the tuple comes first.
    """
    if fmi == 3:
        return [platform_tuple]
    arm = platform_tuple.startswith("aarch64")
    return [platform_tuple, platform] if arm else [platform, platform_tuple]


class Library:
    """The loaded functions of one FMU binary."""

    def __init__(self, folder: Path, identifier: str, label: str, fmi: int = 2) -> None:
        name = identifier + sharedLibraryExtension
        paths = [folder / "binaries" / place / name for place in folders(fmi)]
        path = next((p for p in paths if p.is_file()), None)
        if path is None:
            raise Problem(f"{label}: no binary for this platform: {_found(folder, paths[0])}")
        before = Path.cwd()
        os.chdir(path.parent)  # some libraries look for their neighbours in the working directory
        try:
            self._dll = ctypes.CDLL(str(path))
        except OSError as error:
            raise Problem(f"{label}: {path.name} cannot be loaded: {error}") from error
        finally:
            os.chdir(before)
        self._label = label

    def function(self, name: str, result: Any = ctypes.c_int) -> Callable[..., Any]:
        """A function of the library by name; missing ones are reported by name."""
        try:
            function = self._dll[name]
        except AttributeError:
            raise Problem(f"{self._label}: its binary lacks the function {name}") from None
        function.restype = result
        return function

    def address(self, name: str) -> int:
        """Where a function is in memory."""
        return ctypes.cast(self.function(name), ctypes.c_void_p).value or 0  # type: ignore[arg-type]

    def close(self) -> None:
        """Unload the library."""
        freeLibrary(self._dll._handle)


def _found(folder: Path, expected: Path) -> str:
    """What the FMU holds instead of the binary that is looked for."""
    files = (folder / "binaries").rglob("*")
    there = ", ".join(sorted(p.relative_to(folder).as_posix() for p in files if p.is_file()))
    return f"expected {expected.relative_to(folder).as_posix()}, got {there or 'no binaries at all'}"


_logs: dict[int, Log] = {}  # environment -> log
_names: dict[int, Mapping[int, str]] = {}  # environment -> value reference -> name


def _receive(environment: int | None, name: bytes, status: int, category: bytes, text: bytes) -> None:
    """The one logger of all FMI 2.0 FMUs; messages of unknown instances go where FMPy prints its own."""
    log = _logs.get(environment or 0)
    if log is None:
        instance = (name or b"").decode(errors="replace")
        log = next((x for x in reversed(_logs.values()) if x.component == instance), None)
    if log is not None:
        log.add(status, (text or category or b"").decode(errors="replace"))
    elif 0 <= status < len(STATUS):
        printLogMessage(None, name, status, category, text)


def _receive3(environment: int | None, status: int, category: bytes, text: bytes) -> None:
    """The one logger of all FMI 3.0 FMUs."""
    log = _logs.get(environment or 0)
    if log is not None:
        message = (text or category or b"").decode(errors="replace")
        log.add(status, named(message, _names.get(environment or 0, {})))


def named(text: str, names: Mapping[int, str]) -> str:
    """A message of FMI 3.0 with names in place of value references: #12# is the variable 12, ## is #."""

    def name(found: re.Match[str]) -> str:
        number = found.group(1)
        return names.get(int(number), found.group()) if number else "#"

    return re.sub(r"#(\d*)#", name, text)


_logger, logger3 = fmi2CallbackLoggerTYPE(_receive), fmi3LogMessageCallback(_receive3)


class Environment:
    """Says which log an instance writes to; `key` is the pointer that its callbacks get."""

    def __init__(self, log: Log, names: Mapping[int, str] | None = None) -> None:
        self.key = max(_logs, default=0) + 1
        _logs[self.key], _names[self.key] = log, names or {}

    def release(self) -> None:
        """Stop listening."""
        _logs.pop(self.key, None)
        _names.pop(self.key, None)


def callbacks2(environment: Environment) -> fmi2CallbackFunctions:
    """The callbacks of one FMI 2.0 instance; memory functions go straight to the C library."""
    struct = fmi2CallbackFunctions()
    struct.logger = _logger
    struct.allocateMemory = ctypes.cast(calloc, fmi2CallbackAllocateMemoryTYPE)
    struct.freeMemory = ctypes.cast(free, fmi2CallbackFreeMemoryTYPE)
    struct.componentEnvironment = environment.key
    try:  # FMPy's helper fills in the printf arguments, where it has one for this platform
        from fmpy.logging import addLoggerProxy
    except (ImportError, OSError):
        return struct
    addLoggerProxy(ctypes.byref(struct))
    return struct


STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
WARNING, DISCARD, ERROR, FATAL = 1, 2, 3, 4
KEPT = 1000  # messages kept per component; the rest is only counted
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_NAME = re.compile(r"([\w.\[\]]+) = ")  # a message that begins with a variable and its value
_TIME = re.compile(rf"\bt = {_NUMBER.pattern}")


@dataclass(frozen=True)
class Message:
    """One log message of an FMU; time [s] is the last communication point, step the beginning of the step."""

    time: float
    component: str
    status: str
    text: str
    step: float = field(default=np.nan, compare=False)

    def __str__(self) -> str:
        when = "" if _TIME.search(self.text) else f" at t = {self.time:.6g} s"  # an FMU may tell a better one
        return f"{self.component}{when}: {self.text}"


@dataclass
class Log:
    """The messages of one component, in order.

    clock   shape (2,) [s]: the last communication point, and where the last step began
    """

    component: str
    messages: list[Message] = field(default_factory=list)
    dropped: int = 0
    clock: NDArray[np.float64] = field(default_factory=lambda: np.full(2, np.nan))

    @property
    def time(self) -> float:
        """The last communication point [s]."""
        return float(self.clock[0])

    @time.setter
    def time(self, t: float) -> None:
        self.clock[0] = t

    def begin_step(self, t: float) -> None:
        """A step begins at t [s]."""
        self.clock[:] = t

    def add(self, status: int, text: str) -> None:
        """Keep a message, up to KEPT of them."""
        if len(self.messages) >= KEPT:
            self.dropped += 1
            return
        text = re.sub(r"^\s*fmi[23]\w+: ", "", text)  # the function that was called is of no use to a reader
        label = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        self.messages.append(Message(self.time, self.component, label, " ".join(text.split()), self.clock[1]))

    def withdraw(self) -> None:
        """Forget the messages of steps from the last communication point on, which are to be repeated."""
        self.messages = [m for m in self.messages if not m.step >= self.time]

    def last(self, count: int = 3) -> str:
        """The last messages of the latest step, or its errors, as one line to end an error with."""
        recent = self.messages[-count:]
        recent = [m for m in recent if m.time == self.time] or recent
        recent = [m for m in recent if m.status not in ("ok", "warning")] or recent
        texts = list(dict.fromkeys(m.text for m in recent))
        return "".join(f"; it says: {text}" for text in texts)

    def warnings(self, trace: Trace | None = None) -> list[str]:
        """One line per message that is not mere information; those that differ in numbers only are merged.

        trace   the record: a message tells a value when it was noticed, the record may have larger ones
        """
        alike: dict[str, list[Message]] = {}
        for m in self.messages:
            if m.status != "ok":
                alike.setdefault(_NUMBER.sub("#", m.text), []).append(m)
        lines = [_merged(group, trace) for group in alike.values()]
        return [*lines, f"{self.component}: {self.dropped} more messages"] if self.dropped else lines


def _merged(alike: list[Message], trace: Trace | None) -> str:
    """Messages that differ in numbers only, as the first of them."""
    first, largest = alike[0], _largest(alike[0], trace)
    if len(alike) == 1:
        return f"{first}{f' ({largest})' if largest else ''}"
    varying = len({_TIME.sub("", m.text) for m in alike}) > 1
    at = f"t = {first.time:.6g} s"
    count = f"the first of {len(alike)}, at {at}" if varying else f"{len(alike)} times, first at {at}"
    return f"{first.component}: {first.text} ({'; '.join(filter(None, (count, largest)))})"


def _largest(message: Message, trace: Trace | None) -> str:
    """The largest magnitude in the record of the variable that a message is about."""
    match = _NAME.match(message.text)
    name = f"{message.component}.{match[1]}" if match else ""
    if trace is None or name not in trace.signals or not len(trace.time):
        return ""
    row = int(np.argmax(np.abs(trace[name])))
    value = f"{trace[name][row]:.6g} {trace.units.get(name, '')}".rstrip()
    return f"largest recorded: {value} at t = {trace.time[row]:.6g} s"
