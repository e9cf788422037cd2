"""The zip archive and what is in it apart from the model: icon, documentation, licence, texts, sources."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import PurePosixPath

from orchestrator.base.xml import child, children, local_name
from orchestrator.check.finding import Finding, RuleTable, error, note, some, warning
from orchestrator.check.rules.identity import violations
from orchestrator.check.rules.libraries import TUPLE
from orchestrator.check.subject import DESCRIPTION, Subject, read_xml, unsafe

ARCHIVE = RuleTable()
FOLDERS = ("documentation", "sources", "binaries", "resources", "extra", "terminalsAndIcons")
LONGEST = 150  # Windows takes 260 characters, of which a temporary folder and the FMU's name need some


def _opening(rule: str, subject: Subject) -> Iterator[Finding]:
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
    ARCHIVE.rule(_id, _text, *_threads)(partial(_opening, _id))


@ARCHIVE.rule("archive.suffix", "The file name ends in .fmu")
def suffix(subject: Subject) -> Iterator[Finding]:
    if subject.path.suffix.lower() != ".fmu":
        yield warning(f"{subject.path.name}: expected a name that ends in .fmu")


@ARCHIVE.rule(
    "archive.description", "modelDescription.xml lies at the top of the archive", "FMIKit#312 FMIKit#261"
)
def description(subject: Subject) -> Iterator[Finding]:
    if DESCRIPTION in subject.names or any(f.rule == "archive.zip" for f in subject.faults):
        return
    if "SystemStructure.ssd" in subject.names:
        text = "is a system (SSP), expected an FMU; check the .fmu files in its folder resources one by one"
        yield error(f"{text}, run the system with harvester run")
        return
    names = {n: PurePosixPath(n.replace("\\", "/")).name for n in subject.names}
    near = [n for n, name in names.items() if name.lower() == DESCRIPTION.lower()]
    found = f"found {near[0]}" if near else f"the archive holds {', '.join(subject.names[:5]) or 'nothing'}"
    yield error(f"{DESCRIPTION} is missing at the top of the archive; {found}")


@ARCHIVE.rule(
    "archive.path",
    "Paths in the archive have ASCII letters, no spaces, and fit into Windows",
    "FMPy#230 fmi-standard#289",
)
def paths(subject: Subject) -> Iterator[Finding]:
    unusual = [n for n in subject.names if " " in n or not n.isascii()]
    if unusual:
        yield warning(
            f"{some(unusual, 3)}: spaces or non-ASCII letters; tools build paths and URIs from them"
        )
    long = [n for n in subject.names if len(n) > LONGEST]
    if long:
        yield warning(
            f"member {long[0]!r} has {len(long[0])} characters, expected at most {LONGEST} for Windows"
        )


@ARCHIVE.rule("archive.stray", "The archive holds only what the standard names")
def stray(subject: Subject) -> Iterator[Finding]:
    top = {n.split("/")[0] for n in subject.names if not unsafe(n)}
    strange = sorted(top - {DESCRIPTION, "model.png", *FOLDERS})
    if subject.major and strange:
        yield note(
            f"{', '.join(strange[:5])}: not a file or folder of an FMU; data for others belong into extra/"
        )


@ARCHIVE.rule("archive.extra", "Folders below extra/ have reverse domain names")
def extra(subject: Subject) -> Iterator[Finding]:
    names = {n.split("/")[1] for n in subject.names if n.startswith("extra/") and n.count("/") > 1}
    for name in sorted(n for n in names if "." not in n):
        yield note(f"extra/{name}: expected a reverse domain name such as extra/com.example")


CONTENTS = RuleTable()
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
    *(".xml", ".html", ".htm", ".txt", ".md", ".json", ".toml"),
    *(".csv", ".ssv", ".c", ".h", ".py", ".svg"),
)


@CONTENTS.rule("contents.icon", "There is an icon", "OpenModelica#13162")
def icon(subject: Subject) -> Iterator[Finding]:
    expected = ICONS.get(subject.major, ())
    if expected and not subject.files.intersection(expected):
        yield note(f"{expected[0]} is missing; tools show an empty block")


@CONTENTS.rule("contents.documentation", "There is documentation")
def documentation(subject: Subject) -> Iterator[Finding]:
    if subject.major and "documentation/index.html" not in subject.files:
        yield note("documentation/index.html is missing; users cannot look up what the FMU models")


@CONTENTS.rule("contents.licence", "The licence is stated")
def licence(subject: Subject) -> Iterator[Finding]:
    if not subject.major or subject.root is None:
        return
    there = [f for f in subject.files if f.startswith("documentation/licenses/")]
    if not there and not subject.root.get("license"):
        yield note("no licence, neither as attribute license nor in documentation/licenses")
    elif there and not any(
        re.fullmatch(r"documentation/licenses/license\.(txt|html|spdx)", f) for f in there
    ):
        yield note(f"{sorted(there)[0]}: expected an entry point license.txt or license.html next to it")


@CONTENTS.rule("contents.texts", "The FMU tells what it is, who made it and with what")
def texts(subject: Subject) -> Iterator[Finding]:
    if not subject.major or subject.root is None:
        return
    lacking = [n for n in TEXTS if not (subject.root.get(n) or "").strip()]
    if lacking:
        yield note(f"{DESCRIPTION} line {subject.root.sourceline}: no {', '.join(lacking)}")


@CONTENTS.rule(
    "contents.categories", "There are log categories, each once; in FMI 2 with the standard's names"
)
def categories(subject: Subject) -> Iterator[Finding]:
    found = subject.model.categories
    if subject.major and not found:
        yield note(f"{DESCRIPTION}: no log categories; messages of the FMU cannot be chosen")
    for name, count in Counter(found).items():
        if count > 1:
            yield warning(f"{DESCRIPTION}: log category {name} is there {count} times")
    if subject.major == 2 and found and not set(CATEGORIES.split()).intersection(found):
        yield note(
            f"{DESCRIPTION}: no log category of the standard, such as logStatusError; found {found[0]}"
        )


@CONTENTS.rule("contents.annotations", "No data are meant for one tool only")
def vendors(subject: Subject) -> Iterator[Finding]:
    path = ("VendorAnnotations", "Tool") if subject.major == 2 else ("Annotations", "Annotation")
    for element in children(subject.root, *path):
        who = element.get("name") or element.get("type") or local_name(element)
        yield note(
            f"{DESCRIPTION} line {element.sourceline}: annotations for {who}; other tools pass them over"
        )


@CONTENTS.rule("contents.paths", "Files hold no paths of the machine that made them")
def private_paths(subject: Subject) -> Iterator[Finding]:
    for file in sorted(f for f in subject.files if f.endswith(TEXT_FILES)):
        data = (subject.folder / file).read_bytes()
        found = MACHINE.search(data)
        if found:
            line = data.count(b"\n", 0, found.start()) + 1
            yield warning(
                f"{file} line {line}: {found.group()[:80].decode('utf-8', 'replace')} is a path of the"
                " machine that made the FMU"
            )


@CONTENTS.rule("contents.machine", "Libraries hold no paths of the machine that built them")
def machine(subject: Subject) -> Iterator[Finding]:
    for file in sorted({b.file for b in subject.binaries}):
        found = MACHINE.search((subject.folder / file).read_bytes())
        if found:
            yield note(f"{file}: holds the path {found.group()[:80].decode('utf-8', 'replace')}")


@CONTENTS.rule("contents.size", "The FMU is no larger than it needs to be")
def size(subject: Subject) -> Iterator[Finding]:
    bytes_ = subject.path.stat().st_size
    if bytes_ > LARGEST:
        yield note(f"{bytes_ / 1e6:.0f} MB; tools unpack it for each instance or each model")


SOURCES = RuleTable()
BUILD = "sources/buildDescription.xml"
CODE = (".c", ".cc", ".cpp", ".cxx")
HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
HEADERS_3 = ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h")


def _code(subject: Subject) -> list[str]:
    return sorted(f for f in subject.files if f.startswith("sources/") and f.endswith(CODE))


@SOURCES.rule("source.listed", "Sources that are listed are there")
def listed(subject: Subject) -> Iterator[Finding]:
    for kind in subject.model.interfaces:
        for file in children(subject.root, kind, "SourceFiles", "File"):
            name = file.get("name", "")
            if f"sources/{name}" not in subject.files:
                yield error(f"{DESCRIPTION} line {file.sourceline}: sources/{name} is listed, but missing")
    if BUILD not in subject.files:
        return
    root, _ = read_xml(subject.folder, BUILD)
    for file in children(root, "BuildConfiguration", "SourceFileSet", "SourceFile"):
        name = file.get("name", "")
        if f"sources/{name}" not in subject.files:
            yield error(f"{BUILD} line {file.sourceline}: sources/{name} is listed, but missing")


@SOURCES.rule("source.build", "Sources come with the list of files to compile")
def build(subject: Subject) -> Iterator[Finding]:
    code = _code(subject)
    if not code or not subject.model.interfaces:
        return
    lists = [k for k in subject.model.interfaces if child(subject.root, k, "SourceFiles", "File") is not None]
    if subject.major == 3 and BUILD not in subject.files:
        yield error(f"{BUILD} is missing next to {some(code, 2)}; FMI 3 tools cannot compile them")
    elif subject.major == 2 and BUILD not in subject.files and not lists:
        yield warning(f"{DESCRIPTION}: no SourceFiles for {some(code, 2)}")
    elif subject.major == 2 and lists and len(lists) < len(subject.model.interfaces):
        yield warning(f"{DESCRIPTION}: SourceFiles for one kind only, expected for all")


@SOURCES.rule("source.description", "buildDescription.xml keeps its schema and fits modelDescription.xml")
def build_description(subject: Subject) -> Iterator[Finding]:
    if BUILD not in subject.files:
        return
    root, wrong = read_xml(subject.folder, BUILD)
    if root is None:
        yield error(wrong)
        return
    for line, message in violations(root, "fmi3/fmi3BuildDescription.xsd"):
        yield error(f"{BUILD} line {line}: {message}")
    if subject.major == 3 and root.get("fmiVersion") != subject.version:
        yield error(
            f"{BUILD}: fmiVersion is {root.get('fmiVersion')}, expected {subject.version} as in {DESCRIPTION}"
        )
    configurations = list(children(root, "BuildConfiguration"))
    for c in configurations:
        name, platform = c.get("modelIdentifier"), c.get("platform")
        if name not in subject.model.identifiers:
            known = ", ".join(subject.model.identifiers) or "none"
            yield error(f"{BUILD} line {c.sourceline}: modelIdentifier {name!r}, expected {known}")
        if platform and not TUPLE.fullmatch(platform):
            yield note(f"{BUILD} line {c.sourceline}: {platform} is no platform of the standard")
    bare = Counter(c.get("modelIdentifier") for c in configurations if not c.get("platform"))
    if any(n > 1 for n in bare.values()):
        yield error(f"{BUILD}: more than one BuildConfiguration without platform, expected one")


@SOURCES.rule("source.name", "A single source file is named after the model (FMI 3)")
def single(subject: Subject) -> Iterator[Finding]:
    root, _ = read_xml(subject.folder, BUILD) if BUILD in subject.files and subject.major == 3 else (None, "")
    names = {f.get("name") for f in children(root, "BuildConfiguration", "SourceFileSet", "SourceFile")}
    for name in names & {"all.c", "model.c", "main.c", "fmu.c"} if len(names) == 1 else ():
        expected = subject.model.identifiers[0] if subject.model.identifiers else "model"
        yield note(
            f"sources/{name}: expected a name such as {expected}.c; objects of several FMUs get mixed up"
        )


@SOURCES.rule("source.headers", "Sources bring no headers of FMI; the importer has them")
def headers(subject: Subject) -> Iterator[Finding]:
    found = sorted(
        f for f in subject.files if f.startswith("sources/") and f.endswith((*HEADERS, *HEADERS_3))
    )
    if found:
        yield note(f"{some(found)}: headers of FMI, which the importing tool brings itself")
