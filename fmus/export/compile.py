"""The machines that an FMU can hold a shared library for, and where in the FMU each one goes.

Keeps what the compiler made, so that a second build of the same code takes seconds.

The compiler has a cache of its own, but it knows a file by its place on the disk, not by what is in it.

From the C of an FMU to a shared library for a platform, with the compiler of the package `ziglang`.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import fmpy

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


@cache
def store() -> Path:
    """The folder of what is kept: in the cache of the compiler, so that who empties that empties this."""
    command = [sys.executable, "-m", "ziglang", "env"]
    told = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    found = re.search(r'global_cache_dir"?\s*[:=]\s*"([^"]+)"', told)  # JSON of old versions, ZON of new ones
    root = Path(found[1].replace("\\\\", "\\")) if found else Path.home() / ".cache"
    return root / "harvester-cosim"


def kept(ingredients: Iterable[bytes], make: Callable[[], bytes]) -> bytes:
    """What `make` makes of the ingredients, from the store if it is there."""
    digest = hashlib.sha256()
    for part in ingredients:
        digest.update(len(part).to_bytes(8, "big") + part)
    path = store() / digest.hexdigest()
    if path.is_file():
        return path.read_bytes()
    data = make()
    _keep(path, data)
    return data


def _keep(path: Path, data: bytes) -> None:
    """Write the whole file or none; a store that cannot be written to keeps nothing."""
    part = path.with_name(f"{path.name}.{os.getpid()}")
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_bytes(data)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


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
    platform    a name of `platforms.PLATFORMS`
    libraries   of the system that it needs on Linux
    """
    target = PLATFORMS[platform]
    library = f"{model}{target.suffix}"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target.target, *FLAGS]
    command += ["-isystem", str(HEADERS), *compiled, "-o", library]
    command += _link(library, target.suffix, libraries)
    return kept(
        _ingredients(command, code), lambda: _compiled(f"{model}, {platform}", command, code, library)
    )


def _compiled(label: str, command: Sequence[str], code: Mapping[str, bytes], library: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        for name, data in code.items():
            (Path(folder) / name).write_bytes(data)
        # relative names in the folder: the library does not know where it was built
        run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if run.returncode:
            raise Problem(f"{label}: the C compiler failed with exit status {run.returncode}\n{run.stderr}")
        return (Path(folder) / library).read_bytes()


def _ingredients(command: Sequence[str], code: Mapping[str, bytes]) -> Iterator[bytes]:
    """All that a library follows from."""
    yield version("ziglang").encode()
    yield from (word.encode() for word in command)
    for name in sorted(code):
        yield from (name.encode(), code[name])
    yield from (path.read_bytes() for path in sorted(HEADERS.glob("*.h")))


def _link(library: str, suffix: str, libraries: Sequence[str]) -> list[str]:
    """What the linker needs to know on each system."""
    if suffix == ".dylib":
        return ["-install_name", f"@rpath/{library}"]  # else its path in the folder of the build
    return [] if suffix == ".dll" else [*libraries]
