"""Compiles C files to a shared library with `zig cc` (package `ziglang`) and keeps it in the user's cache.

The wheel of harvester-cosim contains the libraries that its commands need (`tools/release.py`), for all
platforms. A library is taken from there if its sources and arguments are the same, so those commands need no
compiler.

The key of a library in the cache is a hash of its sources, its arguments and the version of the compiler.
The compiler's own cache identifies a source file by its path, which is of no use for temporary folders.

A library is executed, so it is taken only from a folder and a file that nobody but the user can change.
The folder also has the hashes of all FMUs that this installation has generated, see `is_generated`.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import platform
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from orchestrator.base.errors import Problem
from orchestrator.base.extras import install
from orchestrator.base.files import write_whole

SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
OTHERS = stat.S_IWGRP | stat.S_IWOTH  # permission to write for others than the owner
GENERATED = "generated"  # end of the name of an empty file in the cache, see `is_generated`
COMPILED = Path(__file__).parents[1] / "compiled"  # libraries in the wheel; a checkout has none


@dataclass(frozen=True)
class Platform:
    """Processor and operating system.

    name      platform tuple of FMI 3.0
    folders   folders of FMI 2.0; the platform tuple if FMI 2.0 defines none (FMI 2.0.5, section 2.3)
    target    target of the compiler, with the oldest supported C library
    suffix    suffix of shared libraries
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
    # the standard defines aarch64-darwin, but tools look in darwin64 for any processor
    Platform("aarch64-darwin", ("darwin64", "aarch64-darwin"), "aarch64-macos.11.0", ".dylib"),
)
PLATFORMS: Mapping[str, Platform] = {p.name: p for p in _ALL}
_SYSTEMS = {"Linux": "linux", "Windows": "windows", "Darwin": "darwin"}
_PROCESSORS = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


def host() -> str:
    """Name of the platform that this program runs on."""
    system, processor = platform.system(), platform.machine()
    name = f"{_PROCESSORS.get(processor.lower())}-{_SYSTEMS.get(system)}"
    if name not in PLATFORMS:
        raise Problem(f"{system} on {processor} is not supported, expected one of {', '.join(PLATFORMS)}")
    return name


def linker_arguments(library: str, target: Platform, libraries: Sequence[str] = ()) -> tuple[str, ...]:
    """Arguments for the linker of a platform; `libraries` are of the system, except on Windows and macOS."""
    if target.suffix == ".dylib":
        return ("-install_name", f"@rpath/{library}")  # else the path in the build folder is stored
    return tuple(libraries) if target.suffix == ".so" else ()


C_FLAGS = (  # of our own C libraries
    *("-std=gnu11", "-O2", "-g0", "-s", "-fPIC", "-shared", "-pthread", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror"),
    "-ffp-contract=off",  # bit-identical results on each processor
    "-mcpu=baseline",  # the cache may be shared by machines with different instruction sets
)


def recipe(name: str, folder: Path, system: str) -> tuple[str, dict[str, bytes], list[str]]:
    """The library of the C files in a folder for one of `PLATFORMS`, as arguments of `shared_library`."""
    target = PLATFORMS[system]
    library = f"{name}{target.suffix}"
    code = {path.name: path.read_bytes() for path in folder.glob("*.[ch]")}
    sources = sorted(file for file in code if file.endswith(".c"))
    return library, code, ["-target", target.target, *C_FLAGS, *sources, *linker_arguments(library, target)]


class CompilerError(Problem):
    """The compiler is missing or reports an error; `output` is the whole text that it wrote to stderr."""

    output = ""


def shared_library(
    name: str,
    code: Mapping[str, bytes],
    arguments: Sequence[str],
    dependencies: Iterable[bytes] = (),
    *,
    begin: Callable[[], object] | None = None,
) -> Path:
    """Path of the library `name` made by `zig cc ARGUMENTS` from C files.

    It is compiled unless it is in the wheel or in the cache.

    code           file name -> content; all files are in the working directory of the compiler
    dependencies   contents that the library depends on besides `code`, such as headers in other folders
    begin          is called before a compilation

    Each compilation has a new temporary folder, so that no build path can get into the library.
    """
    dependencies = list(dependencies)
    shipped = shipped_file(name, code, arguments, dependencies)
    if shipped.is_file():
        return shipped
    file = _file_name(name, _compiler_version(), code, arguments, dependencies)
    try:
        folder = private_cache()
        if folder is not None:
            return _compile(folder / file, name, code, arguments, begin)
    except OSError:  # the cache is not writable
        pass
    own = process_folder()
    zig = {"ZIG_GLOBAL_CACHE_DIR": str(own / "zig"), **os.environ}  # of the compiler, next to ours
    return _compile(own / file, name, code, arguments, begin, zig)


def kept(name: str, make: Callable[[], bytes], dependencies: Iterable[bytes]) -> bytes:
    """The bytes that `make` returns, from the cache if they were made before from equal `dependencies`.

    name   end of the name of the file in the cache
    """
    with suppress(OSError):  # the cache is not writable
        if folder := private_cache():
            file = folder / _file_name(name, "", {}, (), dependencies)
            return _made_once(file, lambda made: made.write_bytes(make())).read_bytes()
    return make()


def note_generated(files: Mapping[str, bytes]) -> None:
    """Remember that this installation has generated an FMU, path -> content."""
    kept(GENERATED, bytes, _code_of(files))


def is_generated(files: Mapping[str, bytes]) -> bool:
    """Has this installation generated an FMU with these C sources and this description, path -> content?"""
    with suppress(OSError):
        if folder := private_cache():
            return _is_whole(folder / _file_name(GENERATED, "", {}, (), _code_of(files)))
    return False


def _code_of(files: Mapping[str, bytes]) -> list[bytes]:
    """The C sources of an FMU, and the description by whose value references they are called."""
    names = sorted(n for n in files if n.startswith("sources/") or n == "modelDescription.xml")
    return [part for name in names for part in (name.encode(), files[name])]


def shipped_file(
    name: str, code: Mapping[str, bytes], arguments: Sequence[str], dependencies: Iterable[bytes] = ()
) -> Path:
    """Where the wheel contains a library, if it does; any version of the compiler may have made it.

    Absolute paths among the arguments differ between computers; what they lead to is in `dependencies`.
    """
    arguments = [argument for argument in arguments if not os.path.isabs(argument)]
    return COMPILED / _file_name(name, "", code, arguments, dependencies)


def _file_name(
    name: str,
    compiler: str,
    code: Mapping[str, bytes],
    arguments: Sequence[str],
    dependencies: Iterable[bytes],
) -> str:
    """A hash of what a library is made from and by, and its name."""
    digest = hashlib.sha256()
    sources = (part for file in sorted(code) for part in (file.encode(), code[file]))
    for part in (compiler.encode(), *(a.encode() for a in arguments), *sources, *dependencies):
        digest.update(len(part).to_bytes(8, "big") + part)
    return f"{digest.hexdigest()[:32]}-{name}"


def private_cache() -> Path | None:
    """The user's cache, which nobody else can change then; None, and a warning, if it is another user's."""
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


def _is_whole(file: Path) -> bool:
    """True if a file of the cache is private and as it was made: the computer may have stopped meanwhile."""
    expected = _sum_file(file)
    return _is_private(file) and expected.is_file() and expected.read_bytes() == _sum(file.read_bytes())


def _sum_file(file: Path) -> Path:
    return file.with_name(f"{file.name}.sha256")


def _sum(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


@cache
def _warn_of_shared(folder: Path) -> None:
    """Say once in a process that the cache is not used."""
    reason = "expected a folder of your own, got one of another user"
    logging.getLogger(__name__).warning("%s: %s: compiled code is not kept there", folder, reason)


def _compiler_version() -> str:
    try:
        return version("ziglang")
    except PackageNotFoundError:
        reason = "the package ziglang is not installed"
        raise CompilerError(f"no C compiler: {reason}; install with: {install('build')}") from None


def _compile(
    library: Path,
    name: str,
    code: Mapping[str, bytes],
    arguments: Sequence[str],
    begin: Callable[[], object] | None,
    environment: Mapping[str, str] | None = None,
) -> Path:
    def make(made: Path) -> None:
        folder = made.parent
        for file, data in code.items():
            (folder / file).write_bytes(data)
        if begin:
            begin()
        command = [sys.executable, "-m", "ziglang", "cc", *arguments, "-o", name]
        run = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False, env=environment
        )
        if run.returncode:
            raise _compiler_error(run)

    return _made_once(library, make, name)


def _made_once(file: Path, make: Callable[[Path], object], name: str = "made") -> Path:
    """A file of the cache, which `make` writes under a name in a temporary folder unless it is there."""
    if _is_whole(file):
        return file
    with _alone(file), tempfile.TemporaryDirectory(dir=file.parent) as folder:
        if _is_whole(file):  # made meanwhile
            return file
        made = Path(folder) / name
        make(made)
        made.chmod(0o700)
        write_whole(_sum_file(file), _sum(made.read_bytes()))
        try:
            made.replace(file)
        except OSError:  # on Windows, if another process made it meanwhile and has loaded it
            if not _is_whole(file):
                raise
    return file


@contextmanager
def _alone(library: Path) -> Iterator[None]:
    """No other thread or process is in such a block for this library; a few libraries share a lock file."""
    with (library.parent / f"{library.name[:2]}.lock").open("ab") as file:
        if sys.platform == "win32":
            import msvcrt

            with suppress(OSError):  # after ten seconds it is compiled twice, which does no harm
                msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)  # until the file is closed
        yield


def _compiler_error(run: subprocess.CompletedProcess[str]) -> CompilerError:
    lines = run.stderr.strip().splitlines() or ["no reason given"]
    reason = next((line for line in lines if "error: " in line), lines[-1])
    error = CompilerError(f"the C compiler failed with exit status {run.returncode}: {reason}")
    error.output = run.stderr
    return error


@cache
def process_folder() -> Path:
    """A temporary folder that is removed when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="harvester-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
