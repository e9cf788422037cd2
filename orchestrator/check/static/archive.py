"""The zip archive: what the standards allow in it, and what was found while unpacking."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import PurePosixPath

from orchestrator.check.finding import Finding, error, note, some, warning
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject
from orchestrator.check.unpack import DESCRIPTION, unsafe

RULES = Table()
FOLDERS = ("documentation", "sources", "binaries", "resources", "extra", "terminalsAndIcons")
LONGEST = 150  # Windows takes 260 characters, of which a temporary folder and the FMU's name need some


def _told(rule: str, subject: Subject) -> Iterator[Finding]:
    """What opening the FMU found."""
    return (f for f in subject.faults if f.rule == rule)


for _id, _text, _threads in (
    ("archive.zip", "The file is a zip archive, and all its members can be unpacked", ()),
    ("archive.name", "Members have relative names with forward slashes and stay inside the archive", ()),
    ("archive.link", "No member is a symbolic link", ()),
    ("archive.method", "Members are deflated or stored, not encrypted", ()),
    ("archive.twice", "No two members have the same name, also where case does not count", ()),
    ("archive.size", "The archive can be unpacked in reasonable space", ()),
):
    RULES.rule(_id, _text, *_threads)(partial(_told, _id))


@RULES.rule("archive.suffix", "The file name ends in .fmu")
def suffix(subject: Subject) -> Iterator[Finding]:
    if subject.path.suffix.lower() != ".fmu":
        yield warning(f"{subject.path.name}: expected a name that ends in .fmu")


@RULES.rule(
    "archive.description", "modelDescription.xml lies at the top of the archive", "FMIKit#312 FMIKit#261"
)
def description(subject: Subject) -> Iterator[Finding]:
    if DESCRIPTION in subject.names or any(f.rule == "archive.zip" for f in subject.faults):
        return
    if "SystemStructure.ssd" in subject.names:
        yield error(
            "is a system (SSP), expected an FMU; check the .fmu files in its folder resources one by one,"
            " run the system with harvester run"
        )
        return
    near = [
        n for n in subject.names if PurePosixPath(n.replace("\\", "/")).name.lower() == DESCRIPTION.lower()
    ]
    found = f"found {near[0]}" if near else f"the archive holds {', '.join(subject.names[:5]) or 'nothing'}"
    yield error(f"{DESCRIPTION} is missing at the top of the archive; {found}")


@RULES.rule(
    "archive.path",
    "Paths in the archive have ASCII letters, no spaces, and fit into Windows",
    "FMPy#230 fmi-standard#289",
)
def paths(subject: Subject) -> Iterator[Finding]:
    odd = [n for n in subject.names if " " in n or not n.isascii()]
    if odd:
        yield warning(f"{some(odd, 3)}: spaces or non-ASCII letters; tools build paths and URIs from them")
    long = [n for n in subject.names if len(n) > LONGEST]
    if long:
        yield warning(
            f"member {long[0]!r} has {len(long[0])} characters, expected at most {LONGEST} for Windows"
        )


@RULES.rule("archive.stray", "The archive holds only what the standard names")
def stray(subject: Subject) -> Iterator[Finding]:
    top = {n.split("/")[0] for n in subject.names if not unsafe(n)}
    strange = sorted(top - {DESCRIPTION, "model.png", *FOLDERS})
    if subject.major and strange:
        yield note(
            f"{', '.join(strange[:5])}: not a file or folder of an FMU; data for others belong into extra/"
        )


@RULES.rule("archive.extra", "Folders below extra/ have reverse domain names")
def extra(subject: Subject) -> Iterator[Finding]:
    names = {n.split("/")[1] for n in subject.names if n.startswith("extra/") and n.count("/") > 1}
    for name in sorted(n for n in names if "." not in n):
        yield note(f"extra/{name}: expected a reverse domain name such as extra/com.example")
