"""The FMU under check, opened as far as it can be opened; nothing in it can stop the check."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.check.finding import Finding
from orchestrator.check.unpack import DESCRIPTION, unpack

if TYPE_CHECKING:
    from orchestrator.check.binary import Binary
    from orchestrator.check.model import Model

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
    def model(self) -> Model:
        """What modelDescription.xml says, read without judging it."""
        from orchestrator.check.model import read

        return read(self.root, self.major)

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
        names, faults = unpack(path, folder)
        root, wrong = read_xml(folder, DESCRIPTION) if (folder / DESCRIPTION).is_file() else (None, "")
        more = (Finding("xml.syntax", "error", wrong),) if wrong else ()
        version = "" if root is None else root.get("fmiVersion", "")
        yield Subject(path, folder, version, root, names, (*faults, *more))


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
