"""Compiles C files to a shared library with `zig cc` (package `ziglang`) and keeps it in the user's cache.

The key of a library in the cache is a hash of its sources, its arguments and the version of the compiler.
The compiler's own cache identifies a source file by its path, which is of no use for temporary folders.

A library is executed, so it is taken only from a folder and a file that nobody but the user can change.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from orchestrator.base.errors import Problem

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
OTHERS = stat.S_IWGRP | stat.S_IWOTH  # permission to write for others than the owner


class CompilerError(Problem):
    """The compiler is missing or reports an error; `output` is the whole text that it wrote to stderr."""

    output = ""


def shared_library(
    name: str, code: Mapping[str, bytes], arguments: Sequence[str], dependencies: Iterable[bytes] = ()
) -> Path:
    """Path of the library `name` made by `zig cc ARGUMENTS` from C files; compiled unless in the cache.

    code           file name -> content; all files are in the working directory of the compiler
    dependencies   contents that the library depends on besides `code`, such as headers in other folders

    Each compilation has a new temporary folder, so that no build path can get into the library.
    """
    digest = hashlib.sha256()
    sources = (part for file in sorted(code) for part in (file.encode(), code[file]))
    for part in (_compiler_version().encode(), *(a.encode() for a in arguments), *sources, *dependencies):
        digest.update(len(part).to_bytes(8, "big") + part)
    file = f"{digest.hexdigest()[:32]}-{name}"
    with suppress(OSError):  # the cache is not writable
        if folder := _private_folder():
            return _compile(folder / file, name, code, arguments)
    own = _process_folder()
    zig = {**os.environ, "ZIG_GLOBAL_CACHE_DIR": str(own / "zig")}  # of the compiler, next to ours
    return _compile(own / file, name, code, arguments, zig)


def kept(name: str, make: Callable[[], bytes], dependencies: Iterable[bytes]) -> bytes:
    """The bytes that `make` returns, from the cache if they were made before from equal `dependencies`.

    name   end of the name of the file in the cache
    """
    digest = hashlib.sha256()
    for part in dependencies:
        digest.update(len(part).to_bytes(8, "big") + part)
    with suppress(OSError):  # the cache is not writable
        if folder := _private_folder():
            file = folder / f"{digest.hexdigest()[:32]}-{name}"
            if _is_private(file):
                return file.read_bytes()
            content = make()
            with tempfile.TemporaryDirectory(dir=folder) as temporary:
                (Path(temporary) / name).write_bytes(content)
                (Path(temporary) / name).chmod(0o600)
                (Path(temporary) / name).replace(file)
            return content
    return make()


def _private_folder() -> Path | None:
    """The cache, which is made if needed; None if another user can change it."""
    folder = cache_folder().resolve()  # what is checked is what is used, also behind a symbolic link
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not _owned(folder):
        _warn_of_shared(folder)
        return None
    if folder.stat().st_mode & OTHERS:
        folder.chmod(0o700)
    return folder


def cache_folder() -> Path:
    """The user's folder for files that can be computed again."""
    folder = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return Path(folder or Path.home() / ".cache") / "harvester-cosim"


def _owned(path: Path) -> bool:
    """True if the user owns a file or folder itself, not only the target of a symbolic link.

    The cache of Windows is in the profile of the user, which other users cannot change.
    """
    return sys.platform == "win32" or path.lstat().st_uid == os.geteuid()


def _is_private(file: Path) -> bool:
    """True if the user owns a regular file and nobody else can write to it; the superuser always can."""
    if sys.platform == "win32":
        return file.is_file()
    if not os.path.lexists(file):
        return False
    mode = file.lstat().st_mode
    return _owned(file) and stat.S_ISREG(mode) and not mode & OTHERS


@cache
def _warn_of_shared(folder: Path) -> None:
    """Say once in a process that the cache is not used."""
    reason = "expected a folder of your own, got one of another user"
    logging.getLogger(__name__).warning("%s: %s: compiled code is not kept there", folder, reason)


def _compiler_version() -> str:
    try:
        return version("ziglang")
    except PackageNotFoundError:
        raise CompilerError("no C compiler: the package ziglang is not installed") from None


def _compile(
    library: Path,
    name: str,
    code: Mapping[str, bytes],
    arguments: Sequence[str],
    environment: Mapping[str, str] | None = None,
) -> Path:
    if _is_private(library):
        return library
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        for file, data in code.items():
            (Path(folder) / file).write_bytes(data)
        command = [sys.executable, "-m", "ziglang", "cc", *arguments, "-o", name]
        run = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False, env=environment
        )
        if run.returncode:
            raise _compiler_error(run)
        made = Path(folder) / name
        made.chmod(0o700)
        try:
            made.replace(library)
        except OSError:  # on Windows, if another process compiled it meanwhile and has loaded it
            if not _is_private(library):
                raise
    return library


def _compiler_error(run: subprocess.CompletedProcess[str]) -> CompilerError:
    lines = run.stderr.strip().splitlines() or ["no reason given"]
    reason = next((line for line in lines if "error: " in line), lines[-1])
    error = CompilerError(f"the C compiler failed with exit status {run.returncode}: {reason}")
    error.output = run.stderr
    return error


@cache
def _process_folder() -> Path:
    """A temporary folder that is removed when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="harvester-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
