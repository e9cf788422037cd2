"""The functions that an FMU calls back: its messages go to the log of the instance that sent them."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Mapping

from fmpy import calloc, free
from fmpy.fmi1 import printLogMessage
from fmpy.fmi2 import (
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import fmi3LogMessageCallback

from orchestrator.slaves.log import STATUS, Log

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
