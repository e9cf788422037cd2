"""The FMU that is checked: unpacks and parses a file that may not be a valid FMU.

The file must exist. Faults of the archive and of the XML become findings and never stop the check.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from orchestrator.base import files
from orchestrator.base.errors import Problem
from orchestrator.base.xml import MAX_BYTES, Element, excess, too_large
from orchestrator.check.binary import Binary, read_all
from orchestrator.check.finding import Finding
from orchestrator.fmi.description import ModelDescription, read_description

DESCRIPTION = "modelDescription.xml"
SYMBOLIC_LINK = 0o120000


def unpack(path: Path, folder: Path) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Unpack members with safe names into `folder`; returns the names of all members, and findings."""
    try:
        with files.Location(path).opened() as file, files.open_archive(file) as archive:
            members = archive.infolist()
            refused = {
                "archive.size": files.size_fault(members, path.stat().st_size),
                "archive.zip": files.overlap(members),
            }
            told = [
                (rule, f"{fault}; its members are not checked") for rule, fault in refused.items() if fault
            ]
            faults = [Finding(rule, "error", text) for rule, text in told]
            faults = faults or [*_faults(members), *_extract(archive, folder)]
    except files.ZIP_ERRORS as problem:
        text = f"{path.name}: expected a zip archive, got {_content(path)}: {problem}"
        return (), (Finding("archive.zip", "error", text),)
    return tuple(m.orig_filename for m in members), tuple(faults)


def _content(path: Path) -> str:
    """Guess from the first bytes of a file what it contains."""
    with files.Location(path).opened() as file:
        head = file.read(64)
    if not head:
        return "an empty file"
    if head.startswith(b"version https://git-lfs"):
        return "a Git LFS pointer (fetch the file itself)"
    formats = {b"PK": "a damaged archive", b"<": "XML", b"7z": "a 7z archive", b"\x1f\x8b": "a gzip file"}
    return next((name for start, name in formats.items() if head.startswith(start)), "an unknown format")


def _faults(members: list[zipfile.ZipInfo]) -> Iterator[Finding]:
    """Findings about the members listed in the central directory of the archive."""
    names: dict[str, str] = {}
    for member in members:
        name = f"member {member.orig_filename!r}"
        if fault := files.name_fault(member):
            yield Finding("archive.name", "error", f"{name} {fault}")
        elif "\\" in member.orig_filename:
            yield Finding("archive.name", "error", f"{name} has a backslash, expected forward slashes")
        if member.external_attr >> 16 & 0o170000 == SYMBOLIC_LINK:
            yield Finding("archive.link", "error", f"{name} is a symbolic link, expected a file")
        if fault := files.why_unreadable(member):
            yield Finding("archive.method", "error", f"{name} {fault}")
        elif member.compress_type == zipfile.ZIP_STORED and member.flag_bits & 8 and member.file_size:
            text = f"{name} is stored with a data descriptor, expected none"
            yield Finding("archive.method", "warning", text)
        # members that overwrite each other, at least on some systems
        other = names.setdefault(member.filename.casefold(), member.filename)
        if other is not member.filename:
            fault = "exists twice" if other == member.filename else f"differs from {other!r} only by case"
            yield Finding("archive.twice", "warning", f"member {member.filename!r} {fault}")


def _extract(archive: zipfile.ZipFile, folder: Path) -> Iterator[Finding]:
    """Unpack the members that can be unpacked; yields findings on the others."""
    for member in archive.infolist():
        if files.name_fault(member) or files.why_unreadable(member) or member.is_dir():
            continue
        try:
            files.extract_member(archive, member, folder)
        except files.ZIP_ERRORS as problem:
            if isinstance(problem, OSError) and problem.errno in files.FULL:
                raise Problem(
                    f"{archive.filename}: cannot be unpacked into {folder}: {problem.strerror}"
                ) from None
            text = f"member {member.filename!r} cannot be unpacked: {problem}"
            yield Finding("archive.zip", "error", text)


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
    root: Element = None
    names: tuple[str, ...] = ()
    faults: tuple[Finding, ...] = ()

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
        return read_description(self.root, self.major)

    @cached_property
    def binaries(self) -> tuple[Binary, ...]:
        """The shared libraries of all platforms, one for each architecture of a universal library."""
        return read_all(self.folder, sorted(self.files))


@contextmanager
def open_subject(path: Path) -> Iterator[Subject]:
    """Unpack an FMU into a temporary folder and parse it; faults become findings of the subject."""
    with files.temporary_folder("harvester-check-", str(path)) as folder:
        yield parse_unpacked(path, folder, *unpack(path, folder))


def parse_unpacked(
    path: Path, folder: Path, names: tuple[str, ...] = (), faults: tuple[Finding, ...] = ()
) -> Subject:
    """Parse an FMU that is already unpacked in `folder`; `names` and `faults` are those of the archive."""
    root, fault = read_xml(folder, DESCRIPTION)
    xml_faults = (Finding("xml.syntax", "error", fault),) if fault else ()
    version = "" if root is None else root.get("fmiVersion", "")
    return Subject(path, folder, version, root, names, (*faults, *xml_faults))


def read_xml(folder: Path, file: str) -> tuple[Element | None, str]:
    """The root of an XML file, or None and the fault, which is empty if there is no such file.

    Entities are not expanded, and nothing is fetched.
    """
    from lxml import etree

    if not (path := folder / file).is_file():
        return None, ""
    try:
        text = files.Location(path).read(MAX_BYTES)
    except Problem as problem:
        return None, str(problem).replace(str(path), file, 1)
    if fault := too_large(text):
        return None, f"{file}: {fault}"
    try:
        root = etree.fromstring(text, etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as problem:
        return None, f"{file}: cannot be read as XML: {problem}"
    if doctype := root.getroottree().docinfo.doctype:
        return None, f"{file}: expected no document type, got {doctype[:60]!r}"
    if fault := excess(root):
        return None, f"{file}: {fault}"
    return root, ""
