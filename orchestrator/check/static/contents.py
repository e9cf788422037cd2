"""What a tool shows its user: icon, documentation, licence, texts; and what should not be in the files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator

from orchestrator.check.finding import Finding, note, warning
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject
from orchestrator.check.unpack import DESCRIPTION
from orchestrator.files.xml import children, local

RULES = Table()
ICONS = {2: ("model.png", "terminalsAndIcons/icon.png"), 3: ("terminalsAndIcons/icon.png",)}
CATEGORIES = """logEvents logSingularLinearSystems logNonlinearSystems logDynamicStateSelection
    logStatusWarning logStatusDiscard logStatusError logStatusFatal logStatusPending logAll"""
TEXTS = ("description", "author", "version", "generationTool")
MACHINE = re.compile(
    rb"(?<![\w.:/])(?:/(?:home|Users|root|tmp|var/folders|builds|opt/[\w.-]+)/[\w.-]+[\w./-]*"
    rb"|(?:file:///)?[A-Za-z]:[\\/](?:Users|Program Files|Temp|work|build|dev|projects?)[\\/][\w. \\/-]*)"
)
LARGEST = 50e6
TEXT_FILES = (
    ".xml",
    ".html",
    ".htm",
    ".txt",
    ".md",
    ".json",
    ".toml",
    ".csv",
    ".ssv",
    ".c",
    ".h",
    ".py",
    ".svg",
)


@RULES.rule("contents.icon", "There is an icon", "OpenModelica#13162")
def icon(subject: Subject) -> Iterator[Finding]:
    expected = ICONS.get(subject.major, ())
    if expected and not subject.files.intersection(expected):
        yield note(f"{expected[0]} is missing; tools show an empty block")


@RULES.rule("contents.documentation", "There is documentation")
def documentation(subject: Subject) -> Iterator[Finding]:
    if subject.major and "documentation/index.html" not in subject.files:
        yield note("documentation/index.html is missing; users cannot look up what the FMU models")


@RULES.rule("contents.licence", "The licence is told")
def licence(subject: Subject) -> Iterator[Finding]:
    if not subject.major or subject.root is None:
        return
    there = [f for f in subject.files if f.startswith("documentation/licenses/")]
    if not there and not subject.root.get("license"):
        yield note("no licence, neither as attribute license nor in documentation/licenses")
    elif there and not any(
        re.fullmatch(r"documentation/licenses/license\.(txt|html|spdx)", f) for f in there
    ):
        yield note(f"{sorted(there)[0]}: expected an entry point license.txt or license.html beside it")


@RULES.rule("contents.texts", "The FMU tells what it is, who made it and with what")
def texts(subject: Subject) -> Iterator[Finding]:
    if not subject.major or subject.root is None:
        return
    lacking = [n for n in TEXTS if not (subject.root.get(n) or "").strip()]
    if lacking:
        yield note(f"{DESCRIPTION} line {subject.root.sourceline}: no {', '.join(lacking)}")


@RULES.rule("contents.categories", "There are log categories, each once; in FMI 2 with the standard's names")
def categories(subject: Subject) -> Iterator[Finding]:
    found = [c.get("name", "") for c in children(subject.root, "LogCategories", "Category")]
    if subject.major and not found:
        yield note(f"{DESCRIPTION}: no log categories; messages of the FMU cannot be chosen")
    for name, count in Counter(found).items():
        if count > 1:
            yield warning(f"{DESCRIPTION}: log category {name} is there {count} times")
    if subject.major == 2 and found and not set(CATEGORIES.split()).intersection(found):
        yield note(
            f"{DESCRIPTION}: no log category of the standard, such as logStatusError; found {found[0]}"
        )


@RULES.rule("contents.annotations", "No data are meant for one tool only")
def vendors(subject: Subject) -> Iterator[Finding]:
    path = ("VendorAnnotations", "Tool") if subject.major == 2 else ("Annotations", "Annotation")
    for element in children(subject.root, *path):
        who = element.get("name") or element.get("type") or local(element)
        yield note(
            f"{DESCRIPTION} line {element.sourceline}: annotations for {who}; other tools pass them over"
        )


@RULES.rule("contents.paths", "Files hold no paths of the machine that made them")
def paths(subject: Subject) -> Iterator[Finding]:
    for file in sorted(f for f in subject.files if f.endswith(TEXT_FILES)):
        data = (subject.folder / file).read_bytes()
        found = MACHINE.search(data)
        if found:
            line = data.count(b"\n", 0, found.start()) + 1
            yield warning(
                f"{file} line {line}: {found.group()[:80].decode('utf-8', 'replace')} is a path of the"
                " machine that made the FMU"
            )


@RULES.rule("contents.machine", "Libraries hold no paths of the machine that built them")
def machine(subject: Subject) -> Iterator[Finding]:
    for file in sorted({b.file for b in subject.binaries}):
        found = MACHINE.search((subject.folder / file).read_bytes())
        if found:
            yield note(f"{file}: holds the path {found.group()[:80].decode('utf-8', 'replace')}")


@RULES.rule("contents.size", "The FMU is no larger than it needs to be")
def size(subject: Subject) -> Iterator[Finding]:
    bytes_ = subject.path.stat().st_size
    if bytes_ > LARGEST:
        yield note(f"{bytes_ / 1e6:.0f} MB; tools unpack it for each instance or each model")
