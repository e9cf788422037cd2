"""Compile C to a shared library with the compiler of the package `ziglang`, and keep it in the user's cache.

The compiler has a cache of its own, but that knows a file by its place on the disk, not by what is in it.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from orchestrator.base.errors import Problem

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


class CompilerError(Problem):
    """The compiler is missing or refuses; `output` is all that it wrote."""

    output = ""


def shared_library(
    name: str, code: Mapping[str, bytes], arguments: Sequence[str], more: Iterable[bytes] = ()
) -> Path:
    """The library `name` of C files, as `zig cc ARGUMENTS` makes it in a folder that holds them; kept.

    more   what it follows from besides files, arguments and compiler, such as headers elsewhere

    The folder is another one each time, so that the library cannot know where it was built.
    """
    digest = hashlib.sha256()
    for part in (_compiler().encode(), *(a.encode() for a in arguments), *_parts(code), *more):
        digest.update(len(part).to_bytes(8, "big") + part)
    file = f"{digest.hexdigest()[:32]}-{name}"
    try:
        return _compile(cache_folder() / file, name, code, arguments)
    except OSError:  # a cache that cannot be written to keeps nothing
        return _compile(_process_folder() / file, name, code, arguments)


def cache_folder() -> Path:
    """The user's folder for what can be made again."""
    named = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return Path(named or Path.home() / ".cache") / "harvester-cosim"


def _parts(code: Mapping[str, bytes]) -> Iterable[bytes]:
    for name in sorted(code):
        yield from (name.encode(), code[name])


def _compiler() -> str:
    try:
        return version("ziglang")
    except PackageNotFoundError:
        raise CompilerError("no C compiler: the package ziglang is not installed") from None


def _compile(kept: Path, name: str, code: Mapping[str, bytes], arguments: Sequence[str]) -> Path:
    if kept.is_file():
        return kept
    kept.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
        for file, data in code.items():
            (Path(folder) / file).write_bytes(data)
        command = [sys.executable, "-m", "ziglang", "cc", *arguments, "-o", name]
        run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if run.returncode:
            raise _compiler_error(run)
        with suppress(OSError):  # somebody else was faster, and uses it already
            (Path(folder) / name).replace(kept)
    return kept


def _compiler_error(run: subprocess.CompletedProcess[str]) -> CompilerError:
    lines = run.stderr.strip().splitlines() or ["no reason given"]
    reason = next((line for line in lines if "error: " in line), lines[-1])
    error = CompilerError(f"the C compiler failed with exit status {run.returncode}: {reason}")
    error.output = run.stderr
    return error


@cache
def _process_folder() -> Path:
    """A folder for this process alone."""
    folder = Path(tempfile.mkdtemp(prefix="harvester-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
