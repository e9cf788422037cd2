"""Files that may lie inside zip archives: an FMU inside an SSP, a parameter file inside the FMU."""

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
    """A file on disk, or a member of a (nested) archive: `inside` lists the member names, outermost first."""

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
                there = ", ".join(n for n in sorted(archive.namelist()) if not n.endswith("/"))
                raise Problem(
                    f"{self.parent}: {self.members[-1]} is missing; the archive holds {there}"
                ) from None

    @property
    def parent(self) -> Location:
        """The archive that holds this member."""
        return Location(self.path, self.members[:-1])

    def zip(self) -> zipfile.ZipFile:
        """This file opened as an archive."""
        try:
            return zipfile.ZipFile(self.path if not self.members else io.BytesIO(self.read()))
        except FileNotFoundError:
            raise Problem(f"{self.path}: no such file") from None
        except zipfile.BadZipFile:
            raise Problem(f"{self}: expected a zip archive, got something else") from None

    def member(self, name: str) -> Location:
        """A file of this archive, or of this folder."""
        return Location(self.path / name) if self.is_folder else Location(self.path, (*self.members, name))

    @property
    def is_folder(self) -> bool:
        """True for an unpacked archive."""
        return not self.members and self.path.is_dir()

    def names(self) -> list[str]:
        """The files of this archive or folder, with forward slashes."""
        if self.is_folder:
            return [p.relative_to(self.path).as_posix() for p in sorted(self.path.rglob("*")) if p.is_file()]
        with self.zip() as archive:
            return [n for n in archive.namelist() if not n.endswith("/")]

    def resolve(self, uri: str) -> Location:
        """The file that a relative (or file:) URI found in this file names."""
        try:
            parts = urlsplit(uri)
        except ValueError as error:
            raise Problem(f"{self}: source {uri!r} is no address: {error}") from None
        if parts.scheme == "file":
            return Location(Path(unquote(parts.path)))
        if len(parts.scheme) > 1:
            raise Problem(f"{self}: source {uri!r} cannot be opened, expected a relative path")
        if not self.members:
            return Location(self.path.parent / unquote(parts.path))
        joined = PurePosixPath(self.members[-1]).parent / unquote(parts.path)
        return Location(self.path, (*self.members[:-1], _normalised(joined)))

    def extract(self, folder: Path) -> None:
        """Unpack this archive, or copy this folder; members that point outside of the archive are refused."""
        if self.is_folder:
            shutil.copytree(self.path, folder)
            return
        with self.zip() as archive:
            for name in archive.namelist():
                if ".." in PurePosixPath(name).parts or name.startswith("/") or ":" in name or "\\" in name:
                    raise Problem(f"{self}: member {name!r} points outside of the archive")
            archive.extractall(folder)


def _normalised(path: PurePosixPath) -> str:
    """A member name without `.` and `..`."""
    kept: list[str] = []
    for part in path.parts:
        if part == ".." and kept:
            kept.pop()
        elif part != ".":
            kept.append(part)
    return "/".join(kept)


DEFAULT_SYSTEM, BUILD_COMMAND = Path("build/harvester.ssp"), "harvester build"


def require_system(system: Path) -> Path:
    """The system, if there is such a file."""
    if not system.exists():
        raise Problem(
            f"{system}: no such file"
            + (f"; make it with: {BUILD_COMMAND}" if system == DEFAULT_SYSTEM else "")
        )
    return system


def make_folder(path: Path) -> None:
    """Make a folder for files to come, before work is spent on them."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Problem(f"{path}: expected a folder, and none can be made: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise Problem(f"{path}: expected a folder to write to, got no permission")


def write_columns(path: Path, names: Sequence[str], rows: NDArray[np.float64], digits: int) -> None:
    """Write rows, shape (n, m), as a CSV file with a header; `digits` significant digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    body = (",".join(f"{value + 0.0:.{digits}g}" for value in row) for row in rows)
    path.write_text("\n".join([",".join(names), *body, ""]), encoding="utf-8", newline="\n")


def write_zip(path: Path, content: Mapping[str, bytes]) -> None:
    """A zip file with fixed times and order; there is the whole file or the one that was there before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in sorted(content):
                entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.create_system = 3
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, content[name])
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
