"""Shared library of an FMU: search for the platform, loading, and the callback functions of FMI.

Functions are looked up at their first use, so that an FMU without an optional function can still run. One
logger function per FMI version receives the messages of all FMUs and passes them to the log of the instance.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from threading import Lock
from typing import Any

from orchestrator.base.errors import Problem, one_line
from orchestrator.base.files import is_file_name
from orchestrator.fmi.messages import Log, status_label
from orchestrator.worker.calls import LOADING, UNLOADING, in_progress

SYSTEM = {"win32": "windows", "darwin": "darwin"}.get(sys.platform, "linux")
ELF_MACHINES = {3: "x86", 40: "arm", 62: "x86_64", 183: "aarch64"}
MACHINE = os.uname().machine if hasattr(os, "uname") else os.environ.get("PROCESSOR_ARCHITECTURE", "")
ARM = MACHINE.lower() in ("arm64", "aarch64")
BITS = 64 if sys.maxsize > 2**32 else 32
SUFFIX = {"windows": ".dll", "darwin": ".dylib"}.get(SYSTEM, ".so")
PLATFORM_TUPLE = (
    f"{'aarch64' if ARM else 'x86_64' if BITS == 64 else 'x86'}-{SYSTEM}"  # FMI 3.0: x86_64-linux
)
FMI2_PLATFORM = f"{SYSTEM.removesuffix('dows')}{BITS}"  # FMI 2.0: linux64, win64, darwin64


class MissingFunction(Problem):
    """The binary of an FMU does not export a function."""


def platform_folders(fmi: int) -> list[str]:
    """Folders in binaries/ that can contain the library for this machine, in the order of the search.

    Names of FMI 2.0, such as linux64, do not contain the processor. On ARM the tuple of FMI 3.0 is first.
    """
    if fmi == 3:
        return [PLATFORM_TUPLE]
    names = [FMI2_PLATFORM, PLATFORM_TUPLE]
    return names[::-1] if PLATFORM_TUPLE.startswith("aarch64") else names


def find_library(folder: Path, identifier: str, fmi: int) -> Path | None:
    """Path of the library for this machine in an unpacked FMU, or None."""
    if not is_file_name(identifier):  # a path could lead out of the FMU
        return None
    paths = (folder / "binaries" / name / f"{identifier}{SUFFIX}" for name in platform_folders(fmi))
    return next((p for p in paths if os.path.isfile(p)), None)  # False for a name that is too long


def load_library(folder: Path, identifier: str, fmi: int, name: str) -> Library:
    """Load the library of an unpacked FMU, or raise a Problem that begins with `name`."""
    path = find_library(folder, identifier, fmi)
    if path is None:
        expected = f"binaries/{platform_folders(fmi)[0]}/{identifier}{SUFFIX}"
        files = (folder / "binaries").rglob("*")
        names = ", ".join(sorted(p.relative_to(folder).as_posix() for p in files if p.is_file()))
        got = names or "no binaries at all"
        raise Problem(f"{name}: no binary for this platform: expected {expected}, got {got}")
    try:
        return Library(path, fmi, name)
    except OSError as error:
        got = _machine(path)
        other = f"expected code for {MACHINE}, got {got}" if got and got != MACHINE else error
        raise Problem(f"{name}: {path.name} cannot be loaded: {other}") from error


def _machine(path: Path) -> str:
    """The processor of an ELF library, as in the platform tuples of FMI 3.0; empty if unknown."""
    with path.open("rb") as file:
        head = file.read(20)
    return ELF_MACHINES.get(int.from_bytes(head[18:20], "little"), "") if head[:4] == b"\x7fELF" else ""


_one_at_a_time = Lock()  # because the working directory is that of all threads


class Library:
    """A loaded FMU binary and its functions. The constructor raises OSError if loading fails.

    prefix   prefix of the functions: fmi2 or fmi3
    """

    def __init__(self, path: Path, fmi: int, name: str = "") -> None:
        self.fmi, self.prefix, self._name = fmi, f"fmi{fmi}", name
        self._functions: dict[str, Any] = {}
        self._threads = thread_count()
        with _one_at_a_time:
            before = os.getcwd()
            os.chdir(path.parent)  # some libraries search for other libraries in the working directory
            try:
                with in_progress(name, fmi, LOADING):
                    self._library = ctypes.CDLL(str(path))
            finally:
                os.chdir(before)

    def function(self, name: str, result: Any = ctypes.c_int) -> Callable[..., Any]:
        """A function of the library, by its name without prefix."""
        if name not in self._functions:
            try:
                self._functions[name] = self._library[self.prefix + name]
            except AttributeError:
                message = f"its binary lacks the function {self.prefix}{name}"
                raise MissingFunction(f"{self._name}: {message}" if self._name else message) from None
            self._functions[name].restype = result
        function: Callable[..., Any] = self._functions[name]
        return function

    def has(self, name: str) -> bool:
        """True if the library exports a function."""
        return hasattr(self._library, self.prefix + name)

    def address(self, name: str) -> int:
        """Address of a function, for calls from C."""
        return ctypes.cast(self.function(name), ctypes.c_void_p).value or 0  # type: ignore[arg-type]

    def close(self) -> None:
        """Unload the library, unless threads that were started meanwhile may still be in its code."""
        if thread_count() > self._threads:
            return
        handle = ctypes.c_void_p(self._library._handle)
        with in_progress(self._name, self.fmi, UNLOADING):
            if sys.platform == "win32":
                ctypes.windll.kernel32.FreeLibrary(handle)
            else:
                _c_library().dlclose(handle)


@cache
def _c_library() -> ctypes.CDLL:
    return ctypes.CDLL("msvcrt" if SYSTEM == "windows" else None)


def thread_count() -> int:
    """Number of threads of this process; 0 if the system does not tell."""
    try:
        return len(os.listdir("/proc/self/task"))
    except OSError:
        return 0


# ---- callback functions

_logs: dict[int, Log] = {}  # environment -> log


def register_log(log: Log) -> int:
    """Register a log; returns the environment, which an instance passes with each message."""
    key = max(_logs, default=0) + 1
    _logs[key] = log
    return key


def unregister_log(environment: int) -> None:
    """Remove the log of an environment."""
    _logs.pop(environment, None)


def _text(raw: bytes | None) -> str:
    return (raw or b"").decode(errors="replace")


def _receive2(
    environment: int | None, name: bytes | None, status: int, category: bytes | None, text: bytes | None
) -> None:
    if environment not in _logs:  # some FMUs do not pass their environment
        environment = next((n for n in reversed(_logs) if _logs[n].component == _text(name)), None)
    if environment is not None:
        _receive3(environment, status, category, text)
    elif "fmpy.fmi1" in sys.modules and 0 <= status <= 5:  # an FMU of FMPy, which uses the same proxy
        sys.modules["fmpy.fmi1"].printLogMessage(None, name, status, category, text or b"")
    else:
        import logging  # on first use, because the import takes as long as all others

        line = one_line(f"{_text(name)}: {status_label(status)}: {_text(text)}")
        logging.getLogger(__name__).warning("%s", line)


def _receive3(environment: int | None, status: int, category: bytes | None, text: bytes | None) -> None:
    log = _logs.get(environment or 0)
    if log is not None:
        log.add(status, _text(text or category), None if category is None else _text(category))


_P, _S = ctypes.c_void_p, ctypes.c_char_p
_logger2 = ctypes.CFUNCTYPE(None, _P, _S, ctypes.c_int, _S, _S)(_receive2)
logger3 = ctypes.CFUNCTYPE(None, _P, ctypes.c_int, _S, _S)(_receive3)


class Callbacks2(ctypes.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = [(n, _P) for n in ("logger", "allocate", "free", "finished", "environment")]


def callbacks2(environment: int) -> Callbacks2:
    """The callbacks of an FMI 2.0 instance; the memory functions are those of the C library."""
    callbacks = Callbacks2(ctypes.cast(_logger2, _P), *_memory(), None, environment)
    proxy = _proxy()
    if proxy:
        proxy(ctypes.byref(callbacks))
    return callbacks


@cache
def _memory() -> tuple[ctypes.c_void_p, ctypes.c_void_p]:
    """Addresses of calloc and free of the C library."""
    library = _c_library()
    return ctypes.cast(library.calloc, _P), ctypes.cast(library.free, _P)


@cache
def _proxy() -> Any:
    """FMPy's function that formats messages with printf arguments; None if not available."""
    spec = find_spec("fmpy")  # without importing the package
    if spec is None or spec.origin is None:
        return None
    path = Path(spec.origin).parent / "logging" / FMI2_PLATFORM / f"logging{SUFFIX}"
    try:
        return ctypes.CDLL(str(path)).addLoggerProxy
    except (OSError, AttributeError):
        return None
