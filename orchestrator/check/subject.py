"""The FMU that is checked: unpacks and parses a file that may not be a valid FMU.

The file must exist. Faults of the archive and of the XML become findings and never stop the check.
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
MAX_BYTES = 2 << 30  # unpacked; FMUs with half a million variables and five binaries are much smaller
MAX_MEMBERS = 50_000
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # compression that FMI permits
SYMBOLIC_LINK = 0o120000
MEMBER_ERRORS = (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, NotImplementedError, EOFError)


def unpack(path: Path, folder: Path) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Unpack members with safe names into `folder`; returns the names of all members, and findings."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            faults = [*_faults(members), *_extract(archive, folder)]
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as problem:
        text = f"{path.name}: expected a zip archive, got {_content(path)}: {problem}"
        return (), (Finding("archive.zip", "error", text),)
    return tuple(m.orig_filename for m in members), tuple(faults)


def _content(path: Path) -> str:
    """Guess from the first bytes of a file what it contains."""
    with path.open("rb") as file:
        head = file.read(64)
    if not head:
        return "an empty file"
    if head.startswith(b"version https://git-lfs"):
        return "a Git LFS pointer (fetch the file itself)"
    formats = {b"PK": "a damaged archive", b"<": "XML", b"7z": "a 7z archive", b"\x1f\x8b": "a gzip file"}
    return next((name for start, name in formats.items() if head.startswith(start)), "an unknown format")


def _error(rule: str, text: str) -> Finding:
    return Finding(rule, "error", text)


def _faults(members: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """Findings about the members listed in the central directory of the archive."""
    for member in members:
        name = member.orig_filename
        if reason := why_unsafe(name):
            yield _error("archive.name", f"member {name!r} {reason}")
        if member.external_attr >> 16 & 0o170000 == SYMBOLIC_LINK:
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
    yield from _duplicates(members)


def _duplicates(members: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """Members that overwrite each other, at least on some systems."""
    names: dict[str, str] = {}
    for name in (m.filename for m in members):
        other = names.setdefault(name.casefold(), name)
        if other is name:
            continue
        fault = "exists twice" if other == name else f"differs from {other!r} only by case"
        yield _error("archive.twice", f"member {name!r} {fault}")


def why_unsafe(name: str) -> str:
    """Why a member must not be unpacked under its name; empty if it may."""
    if "\\" in name:
        return "has a backslash, expected forward slashes"
    if name.startswith("/") or name[1:2] == ":":
        return "has an absolute path, expected a relative one"
    if ".." in PurePosixPath(name).parts:
        return "has '..' in its path, expected none"
    return "has a control character, expected none" if any(ord(c) < 32 for c in name) else ""


def _extract(archive: zipfile.ZipFile, folder: Path) -> Iterator[Finding]:
    """Unpack members with safe names, until their size or number is too large; yields findings."""
    total = 0
    for count, member in enumerate(archive.infolist()):
        total += member.file_size
        if total > MAX_BYTES or count >= MAX_MEMBERS:
            text = f"more than {MAX_BYTES >> 20} MiB or {MAX_MEMBERS} members; the others are not checked"
            yield _error("archive.size", text)
            return
        if why_unsafe(member.orig_filename) or member.is_dir():
            continue
        try:
            target = folder / member.filename
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(member) as source, target.open("wb") as file:
                shutil.copyfileobj(source, file)
        except MEMBER_ERRORS as problem:
            yield _error("archive.zip", f"member {member.filename!r} cannot be unpacked: {problem}")


Element = Any  # lxml ships no types


@dataclass(frozen=True)
class Subject:
    """One FMU.

    path          the file
    folder        temporary folder with the unpacked members, except those with unsafe names
    version       fmiVersion as written, such as "2.0"; "" if unknown
    root          root element of modelDescription.xml, with line numbers; None if the file is missing, is
                  not XML or has a document type
    names         names of all members of the archive, as written
    faults        findings from unpacking and parsing, with the ids of their rules
    """

    path: Path
    folder: Path
    version: str = ""
    root: Element | None = None
    names: tuple[str, ...] = ()
    faults: tuple[Finding, ...] = field(default=())

    @property
    def major(self) -> int:
        """2 or 3; 0 if unknown or not supported."""
        head = self.version.partition(".")[0]
        return int(head) if head in ("2", "3") else 0

    @cached_property
    def files(self) -> frozenset[str]:
        """The unpacked files, with forward slashes."""
        paths = (p for p in self.folder.rglob("*") if p.is_file())
        return frozenset(p.relative_to(self.folder).as_posix() for p in paths)

    @cached_property
    def model(self) -> ModelDescription:
        """The content of modelDescription.xml, which may be invalid."""
        from orchestrator.fmi.read_description import read_description

        return read_description(self.root, self.major)

    @cached_property
    def binaries(self) -> tuple[Binary, ...]:
        """The shared libraries of all platforms, one for each architecture of a universal library."""
        from orchestrator.check.binary import read_all

        return read_all(self.folder, sorted(self.files))


@contextmanager
def open_subject(path: Path) -> Iterator[Subject]:
    """Unpack an FMU into a temporary folder and parse it; faults become findings of the subject."""
    with tempfile.TemporaryDirectory(prefix="harvester-check-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        yield parse_unpacked(path, folder, *unpack(path, folder))


def parse_unpacked(
    path: Path, folder: Path, names: tuple[str, ...] = (), faults: tuple[Finding, ...] = ()
) -> Subject:
    """Parse an FMU that is already unpacked in `folder`; `names` and `faults` are those of the archive."""
    root, fault = read_xml(folder, DESCRIPTION) if (folder / DESCRIPTION).is_file() else (None, "")
    xml_faults = (Finding("xml.syntax", "error", fault),) if fault else ()
    version = "" if root is None else root.get("fmiVersion", "")
    return Subject(path, folder, version, root, names, (*faults, *xml_faults))


def read_xml(folder: Path, file: str) -> tuple[Element | None, str]:
    """The root of an XML file, or None and the fault. Entities are not expanded, and nothing is fetched."""
    from lxml import etree

    try:
        tree = etree.parse(str(folder / file), etree.XMLParser(resolve_entities=False, no_network=True))
    except (etree.XMLSyntaxError, OSError) as problem:
        return None, f"{file}: cannot be read as XML: {problem}"
    if tree.docinfo.doctype:
        return None, f"{file}: expected no document type, got {tree.docinfo.doctype[:60]!r}"
    return tree.getroot(), ""
