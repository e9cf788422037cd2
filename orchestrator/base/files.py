"""Files on disk and inside zip archives, such as an FMU inside an SSP: read, list, extract, write."""

from __future__ import annotations

import io
import os
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from orchestrator.base.errors import Problem

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


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

    def read(self) -> bytes:
        """The bytes of the file."""
        if not self.members:
            if not self.path.is_file():
                raise Problem(f"{self.path}: no such file")
            return self.path.read_bytes()
        with self.parent.zip() as archive:
            try:
                return archive.read(self.members[-1])
            except KeyError:
                names = ", ".join(n for n in sorted(archive.namelist()) if not n.endswith("/"))
                raise Problem(
                    f"{self.parent}: {self.members[-1]} is missing; the archive contains {names}"
                ) from None

    @property
    def parent(self) -> Location:
        """The archive that contains this member."""
        return Location(self.path, self.members[:-1])

    def zip(self) -> zipfile.ZipFile:
        """Open this file as an archive."""
        try:
            return zipfile.ZipFile(self.path if not self.members else io.BytesIO(self.read()))
        except FileNotFoundError:
            raise Problem(f"{self.path}: no such file") from None
        except zipfile.BadZipFile:
            raise Problem(f"{self}: expected a zip archive, got something else") from None

    def member(self, name: str) -> Location:
        """The file `name` of this archive or folder."""
        return Location(self.path / name) if self.is_folder else Location(self.path, (*self.members, name))

    @property
    def is_folder(self) -> bool:
        """True if this is a folder, such as an unpacked archive."""
        return not self.members and self.path.is_dir()

    def names(self) -> list[str]:
        """Names of the files of this archive or folder, with forward slashes."""
        if self.is_folder:
            return [p.relative_to(self.path).as_posix() for p in sorted(self.path.rglob("*")) if p.is_file()]
        with self.zip() as archive:
            return [n for n in archive.namelist() if not n.endswith("/")]

    def resolve(self, uri: str) -> Location:
        """The file that a URI in this file refers to: a relative path or a file: URI."""
        try:
            parts = urlsplit(uri)
        except ValueError as error:
            raise Problem(f"{self}: source {uri!r}: expected a URI, got {error}") from None
        if parts.scheme == "file":
            return Location(Path(unquote(parts.path)))
        if len(parts.scheme) > 1:
            raise Problem(f"{self}: source {uri!r}: expected a relative path or a file: URI")
        if not self.members:
            return Location(self.path.parent / unquote(parts.path))
        joined = PurePosixPath(self.members[-1]).parent / unquote(parts.path)
        return Location(self.path, (*self.members[:-1], _normalised(joined)))

    def extract(self, folder: Path) -> None:
        """Unpack this archive or copy this folder; refuse members with a path outside of the archive."""
        if self.is_folder:
            shutil.copytree(self.path, folder)
            return
        with self.zip() as archive:
            for name in archive.namelist():
                if ".." in PurePosixPath(name).parts or name.startswith("/") or ":" in name or "\\" in name:
                    raise Problem(f"{self}: member {name!r} points outside of the archive")
            archive.extractall(folder)


def _normalised(path: PurePosixPath) -> str:
    """The member name of a path, with `.` and `..` resolved."""
    parts: list[str] = []
    for part in path.parts:
        if part == ".." and parts:
            parts.pop()
        elif part != ".":
            parts.append(part)
    return "/".join(parts)


DEFAULT_SYSTEM, BUILD_COMMAND = Path("build/harvester.ssp"), "harvester build"


def require_system(system: Path) -> Path:
    """The path of a system file, which must exist."""
    if not system.exists():
        hint = f"; make it with: {BUILD_COMMAND}" if system == DEFAULT_SYSTEM else ""
        raise Problem(f"{system}: no such file{hint}")
    return system


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
    path.parent.mkdir(parents=True, exist_ok=True)
    body = (",".join(f"{value + 0.0:.{digits}g}" for value in row) for row in rows)
    path.write_text("\n".join([",".join(names), *body, ""]), encoding="utf-8", newline="\n")


def write_zip(path: Path, content: Mapping[str, bytes]) -> None:
    """Write a reproducible zip file: fixed times, sorted members. The file is replaced in one operation."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in sorted(content):
                entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.create_system = 3
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, content[name])
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
