"""The shared library of an FMI 2.0 FMU: finding it, loading it, and the messages it logs.

Functions are looked up when they are used, so an FMU that lacks an optional one still runs.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fmpy import calloc, free, freeLibrary, platform, sharedLibraryExtension
from fmpy.fmi1 import printLogMessage
from fmpy.fmi2 import (
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)

from orchestrator.errors import Problem
from orchestrator.log import STATUS, Log

_logs: dict[int, Log] = {}  # componentEnvironment -> log


def _receive(environment: int | None, name: bytes, status: int, category: bytes, text: bytes) -> None:
    """The one logger of all FMUs; messages of unknown instances go where FMPy prints its own."""
    log = _logs.get(environment or 0)
    if log is None:
        instance = (name or b"").decode(errors="replace")
        log = next((x for x in reversed(_logs.values()) if x.component == instance), None)
    if log is not None:
        log.add(status, (text or category or b"").decode(errors="replace"))
    elif 0 <= status < len(STATUS):
        printLogMessage(None, name, status, category, text)


_logger = fmi2CallbackLoggerTYPE(_receive)


class Callbacks:
    """The callback functions handed to one instance; memory functions go straight to the C library."""

    def __init__(self, log: Log) -> None:
        self._key = max(_logs, default=0) + 1
        _logs[self._key] = log
        self.struct = fmi2CallbackFunctions()
        self.struct.logger = _logger
        self.struct.allocateMemory = ctypes.cast(calloc, fmi2CallbackAllocateMemoryTYPE)
        self.struct.freeMemory = ctypes.cast(free, fmi2CallbackFreeMemoryTYPE)
        self.struct.componentEnvironment = self._key
        self._format()

    def _format(self) -> None:
        """Let FMPy's helper fill in the printf arguments, where it has one for this platform."""
        try:
            from fmpy.logging import addLoggerProxy
        except (ImportError, OSError):
            return
        addLoggerProxy(ctypes.byref(self.struct))

    def release(self) -> None:
        """Stop listening."""
        _logs.pop(self._key, None)


class Library:
    """The loaded functions of one FMU binary."""

    def __init__(self, folder: Path, identifier: str, label: str) -> None:
        path = folder / "binaries" / platform / (identifier + sharedLibraryExtension)
        if not path.is_file():
            raise Problem(f"{label}: no binary for this platform: {_found(folder, path)}")
        before = Path.cwd()
        os.chdir(path.parent)  # some libraries look for their neighbours in the working directory
        try:
            self._dll = ctypes.CDLL(str(path))
        except OSError as error:
            raise Problem(f"{label}: {path.name} cannot be loaded: {error}") from error
        finally:
            os.chdir(before)
        self._label = label

    def function(self, name: str, result: Any = ctypes.c_int, *arguments: Any) -> Callable[..., Any]:
        """A function of the library by name; missing ones are reported by name."""
        try:
            function = self._dll[name]
        except AttributeError:
            raise Problem(f"{self._label}: its binary lacks the function {name}") from None
        function.restype = result
        if arguments:
            function.argtypes = arguments
        return function

    def close(self) -> None:
        """Unload the library."""
        freeLibrary(self._dll._handle)


def _found(folder: Path, path: Path) -> str:
    """What the FMU holds instead of the binary that is looked for."""
    there = sorted(p.relative_to(folder).as_posix() for p in (folder / "binaries").rglob("*") if p.is_file())
    expected = f"expected binaries/{platform}/{path.name}"
    return f"{expected}, got {', '.join(there) if there else 'no binaries at all'}"
