"""The FMU under check, opened as far as it can be opened; nothing in it can stop the check."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orchestrator.check.finding import Finding

Element = Any  # lxml ships no types


@dataclass(frozen=True)
class Subject:
    """One FMU.

    path          the file
    folder        its content, unpacked for the time of the check; members with unsafe names are left out
    version       fmiVersion as written, such as "2.0"; "" when unknown
    root          root element of modelDescription.xml, with line numbers; None when it is not XML
    description   FMPy's ModelDescription; None when FMPy cannot read it
    names         names of all members of the archive, as written
    faults        what went wrong while opening
    """

    path: Path
    folder: Path
    version: str = ""
    root: Element | None = None
    description: Any | None = None
    names: tuple[str, ...] = ()
    faults: tuple[Finding, ...] = field(default=())

    @property
    def major(self) -> int:
        """2 or 3; 0 when unknown or not supported."""
        head = self.version.partition(".")[0]
        return int(head) if head in ("2", "3") else 0
