"""The binary of an FMU for this machine: where it lies, loading it, calling it, and what it logs."""

from __future__ import annotations

import ctypes
import os
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.check.child.description import Declared
from orchestrator.worker.beacon import Beacon

STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
WARNING, DISCARD, FATAL = 1, 2, 4
SUFFIX = {"Linux": ".so", "Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")
Logger2 = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p
)
Logger3 = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)


class Refused(Exception):
    """A call that ended with a status worse than a warning."""

    def __init__(self, call: str, status: int, said: str = "", time: float = float("nan")) -> None:
        self.call, self.status, self.said, self.time = call, status, said, time
        label = STATUS[status] if 0 <= status < len(STATUS) else str(status)
        when = f" at t = {time:.9g} s" if time == time else ""
        super().__init__(f"{call} returned {label}{when}" + (f': "{said}"' if said else ""))


class Crashed(Exception):
    """A crash that this platform turns into an exception (Windows)."""


class Missing(Exception):
    """A function that the binary does not have."""


def folders(major: int) -> list[str]:
    """Names of the folders for this machine, the most fitting first."""
    system, machine = platform.system(), platform.machine().lower()
    processor = "aarch64" if machine in ("arm64", "aarch64") else "x86_64"
    if major == 3:
        return [f"{processor}-{system.lower()}"]
    plain = {"Linux": "linux64", "Windows": "win64", "Darwin": "darwin64"}.get(system, system.lower())
    pair = f"{processor}-{system.lower()}"
    if processor == "aarch64":  # FMI 2 names do not tell the processor; those of macOS may be for both
        return [pair, plain] if system == "Darwin" else [pair]
    return [plain, pair]


def find(folder: Path, declared: Declared, side: str) -> Path | None:
    """The binary for this machine, or None."""
    identifier = declared.sides[side].get("modelIdentifier", "")
    places = (folder / "binaries" / name / f"{identifier}{SUFFIX}" for name in folders(declared.major))
    return next((p for p in places if p.is_file()), None)


@dataclass
class Log:
    """What the FMU said: status, category, text."""

    messages: list[tuple[int, str | None, str]] = field(default_factory=list)

    def add(self, status: int, category: bytes | None, text: bytes | None) -> None:
        """Keep a message, up to a number that a person would read."""
        if len(self.messages) < 10_000:
            kind = None if category is None else category.decode(errors="replace")
            self.messages.append((status, kind, (text or b"").decode(errors="replace")))

    def last(self) -> str:
        """The last complaint, in one line."""
        said = [text for status, _, text in self.messages[-20:] if status > 0]
        return " ".join(said[-1].split())[:200] if said else ""


class Binary:
    """The loaded library; every call is announced to the beacon first."""

    def __init__(self, path: Path, declared: Declared, beacon: Beacon) -> None:
        self.declared, self.beacon, self.prefix = declared, beacon, f"fmi{declared.major}"
        self.log = Log()
        beacon.call(f"loading {path.name}")
        with _inside(path.parent):  # some libraries look for their neighbours in the working directory
            self._library = ctypes.CDLL(str(path))
        self.handle = self._library._handle
        self._functions: dict[str, Any] = {}
        self.logger: Any = (Logger2 if declared.major == 2 else Logger3)(self._receive)

    def _receive(self, _: Any, *said: Any) -> None:
        status, category, text = said[-3:]
        self.log.add(status, category, text)

    def function(self, name: str, result: Any = ctypes.c_int) -> Any:
        """A function by its name without the prefix."""
        if name not in self._functions:
            try:
                found = self._library[self.prefix + name]
            except AttributeError:
                raise Missing(f"{self.prefix}{name} is missing in the binary") from None
            found.restype = result
            self._functions[name] = found
        return self._functions[name]

    def has(self, name: str) -> bool:
        """Does the binary export this function?"""
        return hasattr(self._library, self.prefix + name)

    def raw(self, name: str, *arguments: Any, result: Any = ctypes.c_int) -> Any:
        """Call and return what the function returns."""
        self.beacon.call(self.prefix + name)
        try:
            return self.function(name, result)(*arguments)
        except OSError as error:
            raise Crashed(f"{error} in {self.prefix}{name}") from None

    def call(self, name: str, *arguments: Any) -> None:
        """Call and raise Refused on anything worse than a warning."""
        status = self.raw(name, *arguments)
        if status > WARNING or status < 0:
            raise Refused(self.prefix + name, status, self.log.last(), self.beacon.time)

    def unload(self) -> None:
        """Take the library out of the process."""
        self.beacon.call("unloading the binary")
        close: Callable[[Any], Any]
        if sys.platform == "win32":
            close = ctypes.windll.kernel32.FreeLibrary
            close(ctypes.c_void_p(self.handle))
        else:
            ctypes.CDLL(None).dlclose(ctypes.c_void_p(self.handle))


@contextmanager
def _inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
