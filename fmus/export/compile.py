"""Compiles the shared libraries of an FMU: platforms, their folders in the FMU, compiler options."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import fmpy

from orchestrator.base import compiler
from orchestrator.base.compiler import PLATFORMS, CompilerError, Platform, host, linker_arguments
from orchestrator.base.errors import Problem

__all__ = ["FLAGS", "HEADERS", "PLATFORMS", "Platform", "binaries", "host", "select", "shared_library"]


def select(names: Sequence[str]) -> tuple[str, ...]:
    """Names of platforms from options of a user: host, all, or names."""
    chosen: list[str] = []
    for name in names:
        if name not in ("host", "all", *PLATFORMS):
            raise Problem(f"platform {name!r} is unknown, expected host, all or {', '.join(PLATFORMS)}")
        chosen += PLATFORMS if name == "all" else [host() if name == "host" else name]
    return tuple(name for name in PLATFORMS if name in chosen)


def binaries(model: str, fmi: int, libraries: Mapping[str, bytes]) -> dict[str, bytes]:
    """Files of the FMU, path -> content, from shared libraries by platform."""
    slices: dict[str, list[bytes]] = {}
    for name, library in libraries.items():
        for folder in PLATFORMS[name].folders if fmi == 2 else (name,):
            slices.setdefault(f"binaries/{folder}/{model}{PLATFORMS[name].suffix}", []).append(library)
    return {path: libs[0] if len(libs) == 1 else universal(libs) for path, libs in slices.items()}


def universal(slices: Sequence[bytes]) -> bytes:
    """A macOS library for several processors: a big-endian table, then the libraries, aligned to pages."""
    page = 14  # log2 of the page size of arm64
    table = struct.pack(">II", 0xCAFEBABE, len(slices))
    body, start = b"", 1 << page
    for library in slices:
        processor = struct.unpack_from("<II", library, 4)  # type and subtype
        offset = start + len(body)
        table += struct.pack(">IIIII", *processor, offset, len(library), page)
        body += library + b"\0" * (-len(library) % (1 << page))
    return table.ljust(start, b"\0") + body


FLAGS = (
    *("-std=c99", "-O3", "-g0", "-s", "-fPIC", "-shared", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"),
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
)
HEADERS = Path(fmpy.__file__).parent / "c-code"  # fmi2*.h and fmi3*.h, which FMUs must not contain


def shared_library(
    model: str,
    code: Mapping[str, bytes],
    compiled: Sequence[str],
    platform: str,
    libraries: Sequence[str] = ("-lm",),
) -> bytes:
    """The shared library of a model.

    code        the files under sources/ by name
    compiled    names of the files to compile
    platform    a name of `PLATFORMS`
    libraries   linker options for system libraries, except on Windows and macOS
    """
    try:
        made = compiler.shared_library(*recipe(model, code, compiled, platform, libraries))
    except CompilerError as error:
        raise Problem(f"{model}, {platform}: {error}") from None
    return made.read_bytes()


def recipe(
    model: str,
    code: Mapping[str, bytes],
    compiled: Sequence[str],
    platform: str,
    libraries: Sequence[str] = ("-lm",),
) -> tuple[str, Mapping[str, bytes], list[str], list[bytes]]:
    """How the library of a model is made: arguments of `compiler.shared_library`."""
    target = PLATFORMS[platform]
    library = f"{model}{target.suffix}"
    arguments = ["-target", target.target, *FLAGS, "-isystem", str(HEADERS), *compiled]
    arguments += linker_arguments(library, target, libraries)
    return library, code, arguments, [path.read_bytes() for path in sorted(HEADERS.glob("*.h"))]
