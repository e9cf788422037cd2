"""Sources: what is listed is there, and what is there is listed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from orchestrator.check.finding import Finding, error, note, some, warning
from orchestrator.check.registry import Table
from orchestrator.check.static.description import violations
from orchestrator.check.static.platforms import TUPLE
from orchestrator.check.subject import Subject, read_xml
from orchestrator.check.unpack import DESCRIPTION
from orchestrator.files.xml import child, children

RULES = Table()
BUILD = "sources/buildDescription.xml"
CODE = (".c", ".cc", ".cpp", ".cxx")
HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
HEADERS_3 = ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h")


def _code(subject: Subject) -> list[str]:
    return sorted(f for f in subject.files if f.startswith("sources/") and f.endswith(CODE))


@RULES.rule("source.listed", "Sources that are listed are there")
def listed(subject: Subject) -> Iterator[Finding]:
    for element in subject.model.interfaces.values():
        for file in children(element, "SourceFiles", "File"):
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


@RULES.rule("source.build", "Sources come with the list of files to compile")
def build(subject: Subject) -> Iterator[Finding]:
    code = _code(subject)
    if not code or not subject.model.interfaces:
        return
    lists = [e for e in subject.model.interfaces.values() if child(e, "SourceFiles", "File") is not None]
    if subject.major == 3 and BUILD not in subject.files:
        yield error(f"{BUILD} is missing beside {some(code, 2)}; FMI 3 tools cannot compile them")
    elif subject.major == 2 and BUILD not in subject.files and not lists:
        yield warning(f"{DESCRIPTION}: no SourceFiles for {some(code, 2)}")
    elif subject.major == 2 and lists and len(lists) < len(subject.model.interfaces):
        yield warning(f"{DESCRIPTION}: SourceFiles for one kind only, expected for all")


@RULES.rule("source.description", "buildDescription.xml keeps its schema and fits modelDescription.xml")
def description(subject: Subject) -> Iterator[Finding]:
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


@RULES.rule("source.name", "A single source file is named after the model (FMI 3)")
def single(subject: Subject) -> Iterator[Finding]:
    root, _ = read_xml(subject.folder, BUILD) if BUILD in subject.files and subject.major == 3 else (None, "")
    names = {f.get("name") for f in children(root, "BuildConfiguration", "SourceFileSet", "SourceFile")}
    for name in names & {"all.c", "model.c", "main.c", "fmu.c"} if len(names) == 1 else ():
        expected = subject.model.identifiers[0] if subject.model.identifiers else "model"
        yield note(
            f"sources/{name}: expected a name such as {expected}.c; objects of several FMUs get mixed up"
        )


@RULES.rule("source.headers", "Sources bring no headers of FMI; the importer has them")
def headers(subject: Subject) -> Iterator[Finding]:
    found = sorted(
        f for f in subject.files if f.startswith("sources/") and f.endswith((*HEADERS, *HEADERS_3))
    )
    if found:
        yield note(f"{some(found)}: headers of FMI, which the importing tool brings itself")
