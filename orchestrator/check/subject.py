"""The FMU under check: an archive that may be anything, unpacked and opened as far as that goes.

Nothing in it can stop the check; what is wrong with the archive becomes findings.
"""

from __future__ import annotations

import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from orchestrator.check.finding import Finding

if TYPE_CHECKING:
    from orchestrator.check.binary import Binary
    from orchestrator.fmi.raw_description import ModelDescription

DESCRIPTION = "modelDescription.xml"
MOST_BYTES = 2 << 30  # a description of half a million variables and five binaries stay far below
MOST_MEMBERS = 50_000
METHODS = {zipfile.ZIP_STORED: "store", zipfile.ZIP_DEFLATED: "deflate"}
LINK = 0o120000
BAD = (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, NotImplementedError, EOFError)  # of a member


def unpack(path: Path, folder: Path) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Names of all members, and what is wrong; members that are safe to write are in `folder` afterwards."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            faults = [*_faults(members), *_written(archive, folder)]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as problem:
        text = f"{path.name}: expected a zip archive, got {_kind(path)}: {problem}"
        return (), (Finding("archive.zip", "error", text),)
    return tuple(m.orig_filename for m in members), tuple(faults)


def _kind(path: Path) -> str:
    """What the file seems to be."""
    with path.open("rb") as file:
        head = file.read(64)
    if not head:
        return "an empty file"
    if head.startswith(b"version https://git-lfs"):
        return "a Git LFS pointer, fetch the file itself"
    known = {b"PK": "a damaged archive", b"<": "XML", b"7z": "a 7z archive", b"\x1f\x8b": "a gzip file"}
    return next((what for start, what in known.items() if head.startswith(start)), "something else")


def _error(rule: str, text: str) -> Finding:
    return Finding(rule, "error", text)


def _faults(members: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """What the directory of the archive shows."""
    for member in members:
        name = member.orig_filename
        why = unsafe(name)
        if why:
            yield _error(
                "archive.name", f"member {name!r} {why}; expected a relative path with forward slashes"
            )
        if member.external_attr >> 16 & 0o170000 == LINK:
            yield _error("archive.link", f"member {name!r} is a symbolic link, expected a file")
        if member.compress_type not in METHODS:
            method = zipfile.compressor_names.get(member.compress_type, str(member.compress_type))  # type: ignore[attr-defined]
            yield _error(
                "archive.method", f"member {name!r} is compressed with {method}, expected deflate or store"
            )
        elif member.compress_type == zipfile.ZIP_STORED and member.flag_bits & 8 and member.file_size:
            yield _error("archive.method", f"member {name!r} is stored with a data descriptor, expected none")
        if member.flag_bits & 1:
            yield _error("archive.method", f"member {name!r} is encrypted, expected no encryption")
    yield from _same(members)


def _same(members: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """Members that overwrite each other, on some machines at least."""
    seen: dict[str, str] = {}
    for name in (m.filename for m in members):
        other = seen.setdefault(name.casefold(), name)
        if other is name:
            continue
        what = "is there twice" if other == name else f"differs from {other!r} only by case"
        yield _error("archive.twice", f"member {name!r} {what}")


def unsafe(name: str) -> str:
    """Why a member must not be written under its name; empty when it may be."""
    if "\\" in name:
        return "has a backslash"
    if name.startswith("/") or name[1:2] == ":":
        return "has an absolute path"
    if ".." in PurePosixPath(name).parts:
        return "leads out of the archive"
    return "has a control character" if any(ord(c) < 32 for c in name) else ""


def _written(archive: zipfile.ZipFile, folder: Path) -> Iterator[Finding]:
    """Write all members that may be written."""
    total = 0
    for count, member in enumerate(archive.infolist()):
        total += member.file_size
        if total > MOST_BYTES or count >= MOST_MEMBERS:
            text = f"more than {MOST_BYTES >> 20} MB or {MOST_MEMBERS} members; the rest is not checked"
            yield _error("archive.size", text)
            return
        if unsafe(member.orig_filename) or member.is_dir():
            continue
        try:
            target = folder / member.filename
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(member) as source, target.open("wb") as file:
                shutil.copyfileobj(source, file)
        except BAD as problem:
            yield _error("archive.zip", f"member {member.filename!r} cannot be unpacked: {problem}")


Element = Any  # lxml ships no types


@dataclass(frozen=True)
class Subject:
    """One FMU.

    path          the file
    folder        its content, unpacked for the time of the check; members with unsafe names are left out
    version       fmiVersion as written, such as "2.0"; "" when unknown
    root          root element of modelDescription.xml, with line numbers; None when it is not XML
    names         names of all members of the archive, as written
    faults        what went wrong while opening, with the ids of the rules that tell it
    """

    path: Path
    folder: Path
    version: str = ""
    root: Element | None = None
    names: tuple[str, ...] = ()
    faults: tuple[Finding, ...] = field(default=())

    @property
    def major(self) -> int:
        """2 or 3; 0 when unknown or not supported."""
        head = self.version.partition(".")[0]
        return int(head) if head in ("2", "3") else 0

    @cached_property
    def files(self) -> frozenset[str]:
        """The unpacked files, with forward slashes."""
        there = (p for p in self.folder.rglob("*") if p.is_file())
        return frozenset(p.relative_to(self.folder).as_posix() for p in there)

    @cached_property
    def model(self) -> ModelDescription:
        """What modelDescription.xml says, read without judging it."""
        from orchestrator.fmi.read_description import read_description

        return read_description(self.root, self.major)

    @cached_property
    def binaries(self) -> tuple[Binary, ...]:
        """The shared libraries of all platforms; of a universal one, each architecture."""
        from orchestrator.check.binary import read_all

        return read_all(self.folder, sorted(self.files))


@contextmanager
def opened(path: Path) -> Iterator[Subject]:
    """Open an FMU for the time of a check; whatever is wrong with it becomes a fault of the subject."""
    with tempfile.TemporaryDirectory(prefix="harvester-check-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        yield unpacked(path, folder, *unpack(path, folder))


def unpacked(
    path: Path, folder: Path, names: tuple[str, ...] = (), faults: tuple[Finding, ...] = ()
) -> Subject:
    """The subject in a folder; `names` and `faults` of the archive."""
    root, wrong = read_xml(folder, DESCRIPTION) if (folder / DESCRIPTION).is_file() else (None, "")
    more = (Finding("xml.syntax", "error", wrong),) if wrong else ()
    version = "" if root is None else root.get("fmiVersion", "")
    return Subject(path, folder, version, root, names, (*faults, *more))


def read_xml(folder: Path, file: str) -> tuple[Element | None, str]:
    """The root of an XML file and what is wrong with it. Entities are not expanded and nothing is fetched."""
    from lxml import etree

    try:
        tree = etree.parse(str(folder / file), etree.XMLParser(resolve_entities=False, no_network=True))
    except (etree.XMLSyntaxError, OSError) as problem:
        return None, f"{file}: is not XML: {problem}"
    if tree.docinfo.doctype:
        return None, f"{file}: has a document type {tree.docinfo.doctype[:60]!r}, expected none"
    return tree.getroot(), ""
