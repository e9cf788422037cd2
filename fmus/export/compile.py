"""Shared libraries of an FMU: the platforms, the place of each in the FMU, and the compiler's options."""

from __future__ import annotations

import platform
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import fmpy

from orchestrator.base import compiler
from orchestrator.base.compiler import CompilerError
from orchestrator.base.errors import Problem


@dataclass(frozen=True)
class Platform:
    """One kind of machine.

    name      FMI 3.0's platform tuple
    folders   FMI 2.0's folders, with the tuple where 2.0 has no name of its own (FMI 2.0.5, section 2.3)
    target    the compiler's name, with the oldest system library that will do
    suffix    of a shared library
    """

    name: str
    folders: tuple[str, ...]
    target: str
    suffix: str


_ALL = (
    Platform("x86_64-linux", ("linux64",), "x86_64-linux-gnu.2.17", ".so"),
    Platform("aarch64-linux", ("aarch64-linux",), "aarch64-linux-gnu.2.17", ".so"),
    Platform("x86_64-windows", ("win64",), "x86_64-windows-gnu", ".dll"),
    Platform("x86_64-darwin", ("darwin64",), "x86_64-macos.11.0", ".dylib"),
    # tools look for a Mac's library in darwin64, whatever its processor; the standard says aarch64-darwin
    Platform("aarch64-darwin", ("darwin64", "aarch64-darwin"), "aarch64-macos.11.0", ".dylib"),
)
PLATFORMS: Mapping[str, Platform] = {p.name: p for p in _ALL}
_SYSTEMS = {"Linux": "linux", "Windows": "windows", "Darwin": "darwin"}
_PROCESSORS = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


def host() -> str:
    """Name of the platform this runs on."""
    system, processor = platform.system(), platform.machine()
    name = f"{_PROCESSORS.get(processor.lower())}-{_SYSTEMS.get(system)}"
    if name not in PLATFORMS:
        raise Problem(f"no platform for {system} {processor}, expected one of {', '.join(PLATFORMS)}")
    return name


def select(names: Sequence[str]) -> tuple[str, ...]:
    """Names of platforms from words of a user: host, all, or names."""
    chosen: list[str] = []
    for name in names:
        if name not in ("host", "all", *PLATFORMS):
            raise Problem(f"platform {name!r} is unknown, expected host, all or {', '.join(PLATFORMS)}")
        chosen += PLATFORMS if name == "all" else [host() if name == "host" else name]
    return tuple(name for name in PLATFORMS if name in chosen)


def binaries(model: str, fmi: int, libraries: Mapping[str, bytes]) -> dict[str, bytes]:
    """Shared libraries by platform -> files of the FMU by path."""
    slices: dict[str, list[bytes]] = {}
    for name, library in libraries.items():
        for folder in PLATFORMS[name].folders if fmi == 2 else (name,):
            slices.setdefault(f"binaries/{folder}/{model}{PLATFORMS[name].suffix}", []).append(library)
    return {path: parts[0] if len(parts) == 1 else universal(parts) for path, parts in slices.items()}


def universal(slices: Sequence[bytes]) -> bytes:
    """A macOS library for several processors: a big-endian table, then one library each, on pages."""
    page = 14  # 16 KiB, of arm64
    table = struct.pack(">II", 0xCAFEBABE, len(slices))
    body, start = b"", 1 << page
    for part in slices:
        processor = struct.unpack_from("<II", part, 4)  # type and subtype, from the library's own header
        offset = start + len(body)
        table += struct.pack(">IIIII", *processor, offset, len(part), page)
        body += part + b"\0" * (-len(part) % (1 << page))
    return table.ljust(start, b"\0") + body


FLAGS = (
    *("-std=c99", "-O3", "-g0", "-s", "-fPIC", "-shared", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"),
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
)
HEADERS = Path(fmpy.__file__).parent / "c-code"  # fmi2*.h, fmi3*.h: the standard keeps them out of FMUs


def shared_library(
    model: str,
    code: Mapping[str, bytes],
    compiled: Sequence[str],
    platform: str,
    libraries: Sequence[str] = ("-lm",),
) -> bytes:
    """The library of a model.

    code        the files under sources/ by name
    compiled    those that the FMU tells an importer to compile
    platform    a name of `PLATFORMS`
    libraries   of the system that it needs on Linux
    """
    target = PLATFORMS[platform]
    library = f"{model}{target.suffix}"
    arguments = ["-target", target.target, *FLAGS, "-isystem", str(HEADERS), *compiled]
    arguments += _link(library, target.suffix, libraries)
    headers = (path.read_bytes() for path in sorted(HEADERS.glob("*.h")))
    try:
        return compiler.shared_library(library, code, arguments, headers).read_bytes()
    except CompilerError as error:
        raise Problem(f"{model}, {platform}: {error}") from None


def _link(library: str, suffix: str, libraries: Sequence[str]) -> list[str]:
    """What the linker needs to know on each system."""
    if suffix == ".dylib":
        return ["-install_name", f"@rpath/{library}"]  # else its path in the folder of the build
    return [] if suffix == ".dll" else [*libraries]
