"""From the C of an FMU to a shared library for a platform, with the compiler of the package `ziglang`."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import fmpy

from fmus.contract import ModelError
from fmus.export.keep import kept
from fmus.export.platforms import PLATFORMS

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
            raise ModelError(
                f"{label}: the C compiler failed with exit status {run.returncode}\n{run.stderr}"
            )
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
