"""The shared library of an FMU: finding it, loading it.

Functions are looked up when they are used, so an FMU that lacks an optional one still runs.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fmpy import freeLibrary, platform, platform_tuple, sharedLibraryExtension

from orchestrator.errors import Problem


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
