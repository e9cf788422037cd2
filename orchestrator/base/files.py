"""Files on disk and inside zip archives, such as an FMU inside an SSP: read, list, extract, write."""

from __future__ import annotations

import atexit
import csv
import errno
import hashlib
import os
import re
import shutil
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property, lru_cache, partial
from io import BytesIO, StringIO
from itertools import pairwise
from pathlib import Path, PurePosixPath
from threading import Lock, get_native_id
from typing import IO, TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from orchestrator.base import SHIPPED
from orchestrator.base.errors import Problem
from orchestrator.base.interrupts import DeferredInterrupts
from orchestrator.base.processes import remove_folder

if sys.platform == "linux":
    from _ctypes import dlclose, dlopen  # ctypes.CDLL never closes
if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# sub-folders of what `harvester build` makes: all files for FMI 3.0, and in each folder the variants of parts
FMI3, VARIANTS = "fmi3", "variants"

# ---- limits of archives, and faults of their members -------------------------------------------------------

# The largest FMUs in use have some 100 MB. Those with Python or Java inside have 1 GB and 20 000 files.
MAX_UNPACKED = 2 << 30  # bytes of all members of one archive
MAX_MEMBERS = 50_000
MAX_DIRECTORY = 10 << 20  # bytes of the list of members, 200 for each; `zipfile` reads this in 2 s
# Packed descriptions of 200 000 variables have a tenth of their size, constant bytes have a thousandth.
MAX_RATIO = 200
ANY_RATIO = 500 << 20  # bytes up to which the ratio does not matter, such as sparse tables of 150 MB
MAX_NESTING = 8  # archives inside archives; the FMU in an SSP in an SSP has 2
MAX_PATH = 1000  # characters of the name of a member; a whole path has at most 4096 on Linux, 260 on Windows
MAX_TEXT = 64 << 20  # bytes of a text that this project has written, or of a script
MAX_BUFFER = 64 << 20  # bytes of an inner archive in memory; a larger one is in a temporary file
CHUNK = 1 << 20  # bytes that are unpacked at once
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # compression that FMI and SSP permit
LOCAL_HEADER = 30  # bytes before each member, at least

# what `zipfile` raises for damaged archives; RuntimeError includes unsupported features and encryption,
# ValueError includes names that are not UTF-8, and OverflowError is for offsets above 2^63
ZIP_ERRORS = (
    *(zipfile.BadZipFile, zlib.error, OSError, EOFError),
    *(RuntimeError, ValueError, OverflowError),
)
PARTIAL = ".partial"  # end of the name of a file that is being written, see `put`
FULL = (errno.ENOSPC, errno.EDQUOT)


def has_control(text: str) -> bool:
    """True if a text has control characters of ASCII; other characters may be part of a name."""
    return any(ord(c) < 32 or ord(c) == 127 for c in text)


def why_unsafe(name: str) -> str:
    """Why a member must not be unpacked under a name; empty if it may."""
    if not name:
        return "is empty"
    if "\\" in name:
        return "has a backslash, expected forward slashes"
    if name.startswith("/") or ":" in name:
        return "has an absolute path or a drive, expected a relative path"
    if ".." in PurePosixPath(name).parts:
        return "has '..' in its path, expected none"
    if len(name) > MAX_PATH:
        return f"has {len(name)} characters, expected at most {MAX_PATH}"
    return "has a control character, expected none" if has_control(name) else ""


def is_file_name(name: str) -> bool:
    """True for the name of a file without a path."""
    return name not in (".", "..") and "/" not in name and not why_unsafe(name)


def forward(name: str) -> str:
    """The name of a member with forward slashes; old packers on Windows write backslashes."""
    return name.replace("\\", "/")


def name_fault(member: zipfile.ZipInfo) -> str:
    """Why a member must not be unpacked under its names; empty if it may.

    Newer versions of Python take `filename` from an extra field (Info-ZIP 0x7075), which spells names that
    are not ASCII.
    """
    written, name = forward(member.orig_filename), member.filename
    if fault := why_unsafe(written) or why_unsafe(name):
        return fault
    if written != name and written.isascii():
        return f"has the name {name!r} in an extra field, expected one name"
    return ""


def why_unreadable(member: zipfile.ZipInfo) -> str:
    """Why a member cannot be read; empty if it can."""
    if member.flag_bits & 1:
        return "is encrypted, expected no encryption"
    if member.compress_type in METHODS:
        return ""
    method = zipfile.compressor_names.get(member.compress_type, str(member.compress_type))  # type: ignore[attr-defined]
    return f"is compressed with {method}, expected deflate or store; unpack the archive and pack it again"


def size_fault(members: Sequence[zipfile.ZipInfo], packed: int) -> str:
    """Why an archive of `packed` bytes is too large to be unpacked; empty if it is not."""
    unpacked = sum(m.file_size for m in members)
    if len(members) > MAX_MEMBERS:
        return f"expected at most {MAX_MEMBERS} members, got {len(members)}"
    if unpacked > MAX_UNPACKED:
        return f"expected at most {MAX_UNPACKED / 1e6:.0f} MB unpacked, got {unpacked / 1e6:.0f} MB"
    if unpacked > max(ANY_RATIO, MAX_RATIO * packed):
        ratio = f"expected at most {MAX_RATIO} times its size unpacked"
        return f"{ratio}, got {unpacked / 1e6:.0f} MB in {packed / 1e6:.3g} MB"
    return ""


def overlap(members: Sequence[zipfile.ZipInfo]) -> str:
    """Two members that share bytes of the archive, as those of a bomb do; empty if there are none."""
    for one, other in pairwise(sorted(members, key=lambda m: m.header_offset)):
        if one.header_offset + LOCAL_HEADER + one.compress_size > other.header_offset:
            return f"expected separate members, but {one.filename!r} and {other.filename!r} overlap"
    return ""


def open_archive(file: IO[bytes]) -> zipfile.ZipFile:
    """An archive whose members have names with forward slashes; raises one of `ZIP_ERRORS`."""
    record = zipfile._EndRecData(file)  # type: ignore[attr-defined]  # as ZipFile does
    if record and (size := record[zipfile._ECD_SIZE]) > MAX_DIRECTORY:  # type: ignore[attr-defined]
        limit = f"a list of members of at most {MAX_DIRECTORY / 1e6:.0f} MB"
        raise zipfile.BadZipFile(f"expected {limit}, got {size / 1e6:.0f} MB")
    archive = zipfile.ZipFile(file)
    for member in archive.infolist():
        member.filename = forward(member.filename)
        archive.NameToInfo[member.filename] = member
    return archive


def extract_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, folder: Path) -> None:
    """Unpack a member; raises one of `ZIP_ERRORS`, also for unsafe names. A symbolic link becomes a file."""
    if fault := name_fault(member) or why_unreadable(member):
        raise zipfile.BadZipFile(f"member {member.orig_filename!r} {fault}")
    target = folder / member.filename
    if member.is_dir():
        target.mkdir(parents=True, exist_ok=True)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(member) as source, target.open("wb") as file:
        shutil.copyfileobj(source, file, CHUNK)


@contextmanager
def temporary_folder(prefix: str, archive: str) -> Iterator[Path]:
    """A temporary folder to unpack an archive into, removed at the end."""
    folder = None
    try:
        with DeferredInterrupts():
            folder = Path(tempfile.mkdtemp(prefix=prefix))
        yield folder
    except OSError as error:
        if folder:
            raise
        raise Problem(f"{archive}: no temporary folder to unpack it: {_reason(error)}") from None
    finally:
        if folder:
            with DeferredInterrupts():
                remove_folder(folder)


# ---- archives that are used more than once -----------------------------------------------------------------


_kept: ContextVar[Callable[[Location], zipfile.ZipFile] | None] = ContextVar("_kept", default=None)


@contextmanager
def archive_kept_open() -> Iterator[None]:
    """Context in which the archive on disk that was read last stays open: its members are listed once."""
    with ExitStack() as last:

        @lru_cache(maxsize=1)
        def archive_at(location: Location) -> zipfile.ZipFile:
            archive_at.cache_clear()
            last.close()
            return last.enter_context(location.opened_zip())

        token = _kept.set(archive_at)
        try:
            yield
        finally:
            _kept.reset(token)


@dataclass
class SharedFolder:
    """A temporary folder with an unpacked archive: what removes it, its files, the number of its users."""

    folder: Path
    removal: ExitStack
    files: frozenset[tuple[str, int, int]]
    users: int = 0

    @cached_property
    def size(self) -> int:
        """Bytes of all files together."""
        return sum(size for _, size, _ in self.files)

    @property
    def unchanged(self) -> bool:
        """Has nothing in the folder changed since the archive was unpacked?"""
        try:
            return self.files == files_in(self.folder)
        except OSError:  # another program cleans the folder
            return False


def files_in(folder: Path) -> frozenset[tuple[str, int, int]]:
    """Path, size [bytes] and time of the last change [ns] of all that a folder contains."""
    found, waiting = set[tuple[str, int, int]](), [str(folder)]
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                about = entry.stat(follow_symlinks=False)
                found.add((entry.path, about.st_size, about.st_mtime_ns))
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
    return frozenset(found)


# process (a fork has its own folders), SHA-256 and what stays packed -> folder, those used last at the end
_unpacked: dict[tuple[int, str, tuple[str, ...]], SharedFolder] = {}
_checksums: dict[tuple[object, ...], str] = {}  # stamp of a file -> its SHA-256
MOST_KEPT = 64e6  # bytes of all folders without users
_PROCESS = os.getpid()  # forks end without removing what they keep
_unpacking = Lock()

# ---- locations ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Location:
    """A file on disk, or a member of a (nested) archive.

    path      the file on disk
    members   member names, that of the outermost archive first; empty for the file on disk itself
    """

    path: Path
    members: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "/".join([str(self.path), *self.members])

    def read(self, limit: int = MAX_UNPACKED) -> bytes:
        """The bytes of the file, at most `limit`."""
        with self.opened(limit) as file:
            self._check_size(file.seek(0, os.SEEK_END), limit)
            file.seek(0)
            return file.read()

    def text(self) -> str:
        """The text of the file, UTF-8 of at most `MAX_TEXT` bytes."""
        try:
            return self.read(MAX_TEXT).decode()
        except UnicodeDecodeError as error:
            byte = error.object[error.start]
            raise Problem(f"{self}: expected text in UTF-8, got the byte 0x{byte:02x}") from None

    def _check_size(self, size: int, limit: int) -> None:
        if size > limit:
            raise Problem(f"{self}: expected at most {limit / 1e6:.0f} MB, got {size / 1e6:.0f} MB")

    @contextmanager
    def opened(self, limit: int = MAX_UNPACKED) -> Iterator[IO[bytes]]:
        """The file, opened for reading; a member, of at most `limit` bytes, is unpacked before."""
        if not self.members:
            with self._open_path() as file:
                yield file
            return
        with tempfile.SpooledTemporaryFile(MAX_BUFFER) as file:
            with self.parent.zip() as archive:
                self._unpack(archive, file, limit)
            file.seek(0)
            yield file

    def _open_path(self) -> IO[bytes]:
        if not os.path.isfile(self.path):  # not a device or a pipe, which may have no end
            if not os.path.exists(self.path):
                raise Problem(f"{self.path}: no such file")
            if os.path.isdir(self.path):
                raise Problem(f"{self.path}: expected a file, got a folder")
            raise Problem(f"{self.path}: expected a file, got a device or a pipe")
        try:
            return self.path.open("rb")
        except OSError as error:
            raise Problem(f"{self.path}: cannot be read: {error.strerror}") from None

    def _unpack(self, archive: zipfile.ZipFile, file: IO[bytes], limit: int) -> None:
        """Unpack this member of its archive into a file."""
        try:
            member = archive.getinfo(self.members[-1])
        except KeyError:
            names = ", ".join(n for n in sorted(archive.namelist()) if not n.endswith("/"))
            raise Problem(
                f"{self.parent}: {self.members[-1]} is missing; the archive contains {names}"
            ) from None
        if fault := why_unreadable(member):
            raise Problem(f"{self}: the member {fault}")
        self._check_size(member.file_size, limit)
        try:
            with archive.open(member) as source:
                shutil.copyfileobj(source, file, CHUNK)
            file.flush()  # here, so that a full disk is an error of this member
        except ZIP_ERRORS as error:
            raise Problem(f"{self}: cannot be unpacked: {_reason(error)}") from None

    @property
    def parent(self) -> Location:
        """The archive that contains this member."""
        return Location(self.path, self.members[:-1])

    @contextmanager
    def zip(self) -> Iterator[zipfile.ZipFile]:
        """Open this file as an archive; refuse one that is damaged or unpacks to too much."""
        if len(self.members) > MAX_NESTING:
            raise Problem(f"{self}: expected at most {MAX_NESTING} archives inside each other")
        if (archive_at := _kept.get()) and not self.members:
            yield archive_at(self)
            return
        with self.opened_zip() as archive:
            yield archive

    @contextmanager
    def opened_zip(self) -> Iterator[zipfile.ZipFile]:
        """As `zip`, also in the context of `archive_kept_open` opened anew."""
        with self.opened() as file, self._as_zip(file) as archive:
            if self.members:  # an FMU, whose checksum a run needs
                self._kept(partial(_sha256, file))
            yield archive

    def _as_zip(self, file: IO[bytes]) -> zipfile.ZipFile:
        """This file, which is open, as an archive."""
        try:
            archive = open_archive(file)
        except ZIP_ERRORS as error:
            known = isinstance(error, zipfile.BadZipFile) and "not a zip" in str(error)
            got = "something else" if known else f"one that cannot be read: {_reason(error)}"
            raise Problem(f"{self}: expected a zip archive, got {got}") from None
        members = archive.infolist()
        if fault := size_fault(members, file.seek(0, os.SEEK_END)) or overlap(members):
            raise Problem(f"{self}: {fault}")
        return archive

    def member(self, name: str) -> Location:
        """The file `name` of this archive or folder."""
        if reason := why_unsafe(name):
            raise Problem(f"{self}: member {name!r} {reason}")
        return Location(self.path / name) if self.is_folder else Location(self.path, (*self.members, name))

    @property
    def is_folder(self) -> bool:
        """True if this is a folder, such as an unpacked archive."""
        return not self.members and os.path.isdir(self.path)

    @property
    def exists(self) -> bool:
        """True if the file is there."""
        if not self.members:
            return os.path.isfile(self.path)
        return self.members[-1] in self.parent.names()

    def names(self) -> list[str]:
        """Names of the files of this archive or folder, with forward slashes."""
        if self.is_folder:
            return [p.relative_to(self.path).as_posix() for p in sorted(self.path.rglob("*")) if p.is_file()]
        with self.zip() as archive:
            return [n for n in archive.namelist() if not n.endswith("/")]

    def resolve(self, uri: str) -> Location:
        """The file that a URI in this file refers to: a relative path or a file: URI.

        A file in an archive can refer only to files of the same archive. A file on disk may refer to any file
        on disk, such as ../fmus/swing.fmu, because its author could as well be on this machine.
        """
        context = f"{self}: source {uri!r}: expected"
        try:
            parts = urlsplit(uri)
        except ValueError as error:
            raise Problem(f"{context} a URI, got {error}") from None
        path = unquote(parts.path)
        if parts.query or parts.fragment:
            raise Problem(f"{context} a file without query or fragment")
        if has_control(path):
            raise Problem(f"{context} a path without control characters")
        if parts.netloc not in ("", "localhost") or (len(parts.scheme) > 1 and parts.scheme != "file"):
            raise Problem(f"{context} a relative path or a file: URI")
        if not self.members:
            return Location(Path(path) if parts.scheme == "file" else self.path.parent / path)
        name = _normalised(PurePosixPath(self.members[-1]).parent / path)
        if parts.scheme or why_unsafe(name):
            raise Problem(f"{context} a path inside of the archive; unpack the SSP to use other files")
        return Location(self.path, (*self.members[:-1], name))

    def extract(self, folder: Path, without: tuple[str, ...] = ()) -> None:
        """Unpack this archive or copy this folder; refuse members with a path outside of the archive.

        without   prefixes of member names, such as "sources/"; these members stay packed and are not checked.
                  No effect on a folder
        """
        if not self.is_folder:
            with self.zip() as archive:
                self._extract(archive, folder, without)
            return
        try:
            shutil.copytree(self.path, folder)
        except OSError as error:
            raise self._not_unpacked(folder, error) from None

    def _extract(self, archive: zipfile.ZipFile, folder: Path, without: tuple[str, ...]) -> None:
        try:
            for member in archive.infolist():
                if not member.filename.startswith(without):
                    extract_member(archive, member, folder)
        except ZIP_ERRORS as error:
            raise self._not_unpacked(folder, error) from None

    def _not_unpacked(self, folder: Path, error: Exception) -> Problem:
        return Problem(f"{self}: cannot be unpacked into {folder}: {_reason(error)}")

    @contextmanager
    def unpacked(self, without: tuple[str, ...] = ()) -> Iterator[Path]:
        """This folder, or a temporary folder with the unpacked archive.

        Equal archives in use at the same time share a folder, so that the library of an FMU is loaded once.
        On Linux the last folders stay for the next run until this process ends, 64 MB together, unless a run
        has changed them or has left its library loaded.

        without   as in `extract`
        """
        if self.is_folder:
            yield self.path.resolve()
            return
        with _unpacking:
            shared = _kept_folder((os.getpid(), _checksums.get(self._stamp(), ""), without))
            if not shared:
                with self.opened() as file:
                    key = os.getpid(), self._kept(partial(_sha256, file)), without
                    shared = _unpacked[key] = _kept_folder(key) or self._shared(file, without)
            shared.users += 1
        try:
            yield shared.folder
        finally:
            with _unpacking:
                shared.users -= 1
                if not shared.users:
                    _remove_unused(last=shared)

    def _stamp(self) -> tuple[object, ...]:
        """What changes when the file on disk is written again."""
        try:
            about = os.stat(self.path)
        except OSError:
            return ()
        stamp = about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns
        return *stamp, os.path.abspath(self.path), self.members

    def _kept(self, checksum: Callable[[], str]) -> str:
        """The checksum of this file, kept until it is written again."""
        stamp = self._stamp()
        if (known := _checksums.get(stamp)) is None:
            known = checksum()
            _checksums.update({stamp: known} if stamp else {})
        return known

    def _shared(self, file: IO[bytes], without: tuple[str, ...]) -> SharedFolder:
        """A new folder with this archive, which is open."""
        with ExitStack() as stack:
            folder = stack.enter_context(temporary_folder("fmu-", str(self)))
            with self._as_zip(file) as archive:
                self._extract(archive, folder, without)
            if not _unpacked:
                atexit.register(_remove_unused, -1.0)
            return SharedFolder(folder, stack.pop_all(), files_in(folder))

    @property
    def kept_sha256(self) -> str:
        """As `sha256`, kept until the file or the folder is written again."""
        return self._kept(lambda: self.sha256)

    @property
    def sha256(self) -> str:
        """The SHA-256 of the file; of a folder that of the checksums of its files."""
        if not self.is_folder:
            with self.opened() as file:
                return _sha256(file)
        lines = (f"{name} {self.member(name).sha256}\n" for name in self.names())
        return hashlib.sha256("".join(sorted(lines)).encode()).hexdigest()


def _kept_folder(key: tuple[int, str, tuple[str, ...]]) -> SharedFolder | None:
    """The folder of this archive, now the one used last; one that a run has changed is removed instead."""
    found = _unpacked.pop(key, None)
    if found and not found.users and not found.unchanged:
        found.removal.close()
        return None
    if found:
        _unpacked[key] = found
    return found


def _remove_unused(most: float = MOST_KEPT, last: SharedFolder | None = None) -> None:
    """Remove folders of this process that nobody uses, except the last ones, of `most` bytes together.

    last   the folder whose use has just ended; it goes if its library is still loaded: the next run would get
           it with the values of its variables
    """
    loaded = last if last and _is_loaded(last) else None
    process = os.getpid()
    for key, shared in reversed([*_unpacked.items()]):
        if shared.users or key[0] != process:
            continue
        if shared is loaded or process != _PROCESS or shared.size > most:
            _unpacked.pop(key).removal.close()
        else:
            most -= shared.size


def _is_loaded(shared: SharedFolder) -> bool:
    """Is a library in a folder still in this process? True if the system does not tell."""
    if sys.platform != "linux":
        return True
    for path in (path for path, _, _ in shared.files if path.endswith(".so")):
        with suppress(OSError):  # it is not loaded
            dlclose(dlopen(path, os.RTLD_NOLOAD | os.RTLD_LAZY))
            return True
    return False


def _sha256(file: IO[bytes]) -> str:
    """Of the whole file, which is at its beginning afterwards."""
    file.seek(0)
    found = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]
    file.seek(0)
    return found


def _reason(error: Exception) -> str:
    """The text of an exception, in one line."""
    text = error.strerror if isinstance(error, OSError) else None
    return text or str(error) or type(error).__name__


def _normalised(path: PurePosixPath) -> str:
    """The member name of a path, with `.` and `..` resolved; a leading `..` is kept."""
    parts: list[str] = []
    for part in path.parts:
        if part == ".." and parts and parts[-1] != "..":
            parts.pop()
        elif part != ".":
            parts.append(part)
    return "/".join(parts)


# ---- what a user names -------------------------------------------------------------------------------------

DEFAULT_SYSTEM, BUILD_COMMAND = Path("build/harvester.ssp"), "harvester build"
SYSTEMS, FMUS = (".ssp", ".ssd", ".fmu"), (".fmu",)
ROOT = Path(__file__).parents[2]
# that of the checkout of this code; without one the folder of the user
CHECKOUT = (ROOT if (ROOT / "pyproject.toml").is_file() else Path()) / DEFAULT_SYSTEM.parent
_told = set[str]()


def find(given: str | Path, suffixes: tuple[str, ...], folder: str | Path = "") -> Path:
    """The file that a user names, or else the given path, which does not exist.

    Taken is a path that exists, then a file in the folder build, here or in the checkout, by its name, such
    as `swing`, then one that comes with a package, by its name or by its path in a checkout, such as
    data/scenarios/boom_up.csv.

    folder   that a relative path refers to
    """
    path = Path(folder, given)
    if path.exists() or not str(given):
        return path
    name = re.sub(r"^(\.\./)+", "", Path(given).as_posix())
    names = [name] if name.endswith(suffixes) else [f"{name}{suffix}" for suffix in suffixes]
    folders = DEFAULT_SYSTEM.parent, CHECKOUT
    built = [folder / sub / n for folder in folders for n in names for sub in ("", VARIANTS)]
    if "/" not in name and (file := next((p for p in built if p.is_file()), None)):
        return file
    shipped = _shipped(name, suffixes)
    found = (p for n in names for key, p in shipped.items() if n in (key, PurePosixPath(key).name))
    if file := next(found, None):
        if path.suffix:
            tell_once(f"{path} does not exist; using the one in the package: {file}")
        return file
    return path


SIMILAR = 0.8  # of 1: two words of eight letters that share six


def tell_once(text: str) -> None:
    """Tell what was assumed about a file, once per process, on standard error."""
    if text not in _told:
        _told.add(text)
        if sys.stderr:  # a program without a terminal has none
            sys.stderr.write(f"{text}\n")


def shipped_with(file: Path, name: str) -> Path | None:
    """Another file of the package that a file comes from, such as fmi3/harvester.fmu; else None."""
    if file not in _shipped(file.name, (file.suffix,)).values():
        return None
    others = _shipped(name, (Path(name).suffix,)).items()
    return next((path for key, path in others if key.endswith(f"/{name}")), None)


def _shipped(name: str, suffixes: tuple[str, ...]) -> dict[str, Path]:
    return {key: path for files in SHIPPED for key, path in files(name, suffixes).items()}


def require(given: str | Path, suffixes: tuple[str, ...], context: str = "") -> Path:
    """The file that a user names, see `find`; raises Problem with similar names if there is none."""
    path = find(given, suffixes)
    if path.exists():
        return path
    shipped = {Path(key): PurePosixPath(key).stem for key in _shipped(path.name, suffixes)}
    there = {p: str(p) for folder in (DEFAULT_SYSTEM.parent, path.parent) for p in sorted(folder.glob("*"))}
    alike = (path.suffix,) if path.suffix in suffixes else suffixes
    known = {
        file.stem: text
        for file, text in {**shipped, **there}.items()
        if file.suffix in (suffixes if file.stem == path.stem else alike)
    }
    similar = [known[stem] for stem in get_close_matches(path.stem, known, cutoff=SIMILAR)]
    build = f"; build it with: {BUILD_COMMAND}" if path == DEFAULT_SYSTEM else ""
    if str(path) == DEFAULT_SYSTEM.stem:  # a name, not a path
        looked = dict.fromkeys(str(folder.absolute()) for folder in (DEFAULT_SYSTEM.parent, CHECKOUT))
        build = f" in {', '.join(looked)}; build it with: {BUILD_COMMAND}"
    hint = f"; did you mean {', '.join(similar)}?" if similar else ""
    raise Problem(f"{context or path}: no such file{build or hint}")


def require_system(system: str | Path) -> Path:
    """The path of a system file or of its unpacked folder, which must exist."""
    path = require(system, SYSTEMS)
    if path.is_file() and path.suffix.lower() not in SYSTEMS:
        raise Problem(f"{path}: expected a .ssp, .ssd or .fmu file")
    return path


def make_folder(path: Path) -> None:
    """Make a folder for results before the computation starts, and check that it is writable."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Problem(f"{path}: expected a folder, which cannot be made: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise Problem(f"{path}: expected a writable folder, got no permission to write")


def write_columns(path: Path, names: Sequence[str], rows: NDArray[np.float64], digits: int) -> None:
    """Write rows, shape (n, m), as a CSV file with a header; `digits` significant digits."""
    body = (",".join(f"{value + 0.0:.{digits}g}" for value in row) for row in rows)
    write_whole(path, "\n".join([csv_header(names), *body, ""]))


def write_rows(path: Path, rows: Iterable[Iterable[object]]) -> Path:
    """Write rows of any values, the names first, as a CSV file (RFC 4180)."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return write_whole(path, text.getvalue())


def csv_header(names: Iterable[str]) -> str:
    """The row of column names of a CSV file, without the end of the line (RFC 4180).

    A name with white space at an end is quoted, too: readers strip that of other cells.
    """
    return ",".join(
        '"{}"'.format(name.replace('"', '""'))
        if re.search(r'[,"\r\n]', name) or name != name.strip()
        else name
        for name in names
    )


def write_zip(path: Path, content: Mapping[str, bytes]) -> None:
    """Write a reproducible zip file: fixed times, sorted members."""
    write_whole(path, zip_bytes(content))


def write_whole(path: Path, content: bytes | str) -> Path:
    """Write a file as `put` does, a text with the same bytes on every platform."""
    data = content.encode() if isinstance(content, str) else content
    if isinstance(path, Path):
        return put(path, lambda file: file.write_bytes(data))
    with naming(path):  # at a URL, where each file is written whole
        path.write_bytes(data)
    return path


def put(path: Path, write: Callable[[Path], object]) -> Path:
    """Write a file completely or not at all, whenever the process or the computer stops or the disk is full.

    It is written next to `path` and then gets its name. Its folder is made if needed.
    """
    with naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not path.is_file():  # such as /dev/stdout
            write(path)
            return path
        target = path.resolve()  # behind a symbolic link
        temporary = target.with_name(f".{target.name}.{os.getpid()}.{get_native_id()}{PARTIAL}")
        try:
            write(temporary)
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
    return path


@contextmanager
def naming(file: Path, remark: str = "") -> Iterator[None]:
    """Context in which an OSError becomes a Problem that names a file."""
    try:
        yield
    except OSError as error:
        raise Problem(f"{file}: cannot be written: {error.strerror or error}{remark}") from error


def zip_bytes(content: Mapping[str, bytes]) -> bytes:
    """A zip file with fixed times and sorted members: equal contents give equal bytes."""
    made = BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(content):
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content[name])
    return made.getvalue()
