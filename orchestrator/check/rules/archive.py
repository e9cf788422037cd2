"""Rules on the zip archive and its files: names, icon, documentation, licence, local paths, sources."""

import posixpath
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import PurePosixPath

from orchestrator.base.errors import one_line
from orchestrator.base.files import why_unsafe
from orchestrator.base.xml import child, children
from orchestrator.check.finding import Finding, error, join_names, note, warning
from orchestrator.check.rules.identity import violations
from orchestrator.check.rules.libraries import TUPLE
from orchestrator.check.subject import DESCRIPTION, Subject, read_xml

FOLDERS = ("documentation", "sources", "binaries", "resources", "extra", "terminalsAndIcons")
MAX_PATH = 150  # characters; the limit of Windows, 260, includes the temporary folder and the name of the FMU
LONGEST_NAMES = 300  # characters that a finding quotes of names in the archive


def opening(subject: Subject, rule: str) -> Iterator[Finding]:
    """Findings of a rule from opening the FMU."""
    return (f for f in subject.faults if f.rule == rule)


def files_named(subject: Subject, pattern: str, say: str) -> Iterator[str]:
    """Files with names that the FMU should not have."""
    if found := sorted(f for f in subject.files if re.fullmatch(pattern, f)):
        yield f"{join_names(found)}: {say}"


def archive_suffix(subject: Subject) -> Iterator[str]:
    """The file name ends in .fmu."""
    if subject.path.suffix.lower() != ".fmu":
        yield f"{subject.path.name}: expected a file name that ends in .fmu"


def archive_description(subject: Subject) -> Iterator[str]:
    """modelDescription.xml is at the top of the archive."""
    if DESCRIPTION in subject.names or any(f.rule == "archive.zip" for f in subject.faults):
        return
    if "SystemStructure.ssd" in subject.names:
        text = "expected an FMU, got a system (SSP); check the .fmu files in its folder resources one by one"
        yield f"{text}, or run the system with harvester run"
        return
    names = {n: PurePosixPath(n.replace("\\", "/")).name for n in subject.names}
    elsewhere = [n for n, name in names.items() if name.lower() == DESCRIPTION.lower()]
    got = elsewhere[0] if elsewhere else ", ".join(subject.names[:5]) or "an empty archive"
    yield f"expected {DESCRIPTION} at the top of the archive, got {one_line(got, LONGEST_NAMES)}"


def archive_path(subject: Subject) -> Iterator[str]:
    """Paths in the archive are ASCII, have no spaces and are short enough for Windows."""
    if unusual := [n for n in subject.names if " " in n or not n.isascii()]:
        yield f"{join_names(unusual, 3)}: spaces or non-ASCII letters; tools build paths and URIs from them"
    if long := [n for n in subject.names if len(n) > MAX_PATH]:
        yield f"member {long[0]!r} has {len(long[0])} characters, expected at most {MAX_PATH} for Windows"


def archive_stray(subject: Subject) -> Iterator[str]:
    """The archive contains only files and folders of the standard."""
    top = {n.split("/")[0] for n in subject.names if not why_unsafe(n)}
    if unknown := sorted(top - {DESCRIPTION, "model.png", *FOLDERS}):
        yield f"{', '.join(unknown[:5])}: not a file or folder of the standard; other data belong into extra/"


def archive_extra(subject: Subject) -> Iterator[str]:
    """Folders below extra/ have reverse domain names."""
    names = {n.split("/")[1] for n in subject.names if n.startswith("extra/") and n.count("/") > 1}
    for name in sorted(n for n in names if "." not in n):
        yield f"extra/{name}: expected a reverse domain name such as extra/com.example"


ICONS = {2: ("model.png", "terminalsAndIcons/icon.png"), 3: ("terminalsAndIcons/icon.png",)}
CATEGORIES = """logEvents logSingularLinearSystems logNonlinearSystems logDynamicStateSelection
    logStatusWarning logStatusDiscard logStatusError logStatusFatal logStatusPending logAll"""
METADATA = ("description", "author", "version", "generationTool")
LOCAL_PATH = re.compile(
    rb"(?<![\w.:/])(?:/(?:home|Users|root|tmp|var/folders|builds|opt/[\w.-]+)/[\w.-]+[\w./-]*"
    rb"|(?:file:///)?[A-Za-z]:[\\/](?:Users|Program Files|Temp|work|build|dev|projects?)[\\/][\w. \\/-]*)"
)
MAX_SIZE = 50e6  # bytes
TEXT_FILES = (
    *(".xml", ".html", ".htm", ".txt", ".md", ".json", ".toml"),
    *(".csv", ".ssv", ".c", ".h", ".py", ".svg"),
)


MAX_SEARCHED = 50_000_000  # bytes of all files of a rule that are searched for paths, in 1 s


def _searched(subject: Subject, files: Iterable[str]) -> Iterator[tuple[str, bytes]]:
    """Files in order of their names, each with the part of it that is searched."""
    left = MAX_SEARCHED
    for file in sorted(files):
        with (subject.folder / file).open("rb") as opened:
            data = opened.read(left)
        yield file, data
        left -= len(data)
        if not left:
            return


def contents_icon(subject: Subject) -> Iterator[str]:
    """The FMU has an icon."""
    expected = ICONS[subject.major]
    if not subject.files.intersection(expected):
        yield f"{expected[0]} is missing; tools show an empty block"


def contents_documentation(subject: Subject) -> Iterator[str]:
    """The FMU has documentation."""
    if "documentation/index.html" not in subject.files:
        yield "documentation/index.html is missing; users cannot read what the FMU models"


def contents_licence(subject: Subject) -> Iterator[str]:
    """The licence is stated."""
    files = sorted(f for f in subject.files if f.startswith("documentation/licenses/"))
    if not files and not subject.root.get("license"):
        yield "no licence, neither as attribute license nor in documentation/licenses"
    elif files and not any(
        re.fullmatch(r"documentation/licenses/license\.(txt|html|spdx)", f) for f in files
    ):
        yield f"{files[0]}: expected an entry point license.txt or license.html next to it"


def contents_texts(subject: Subject) -> Iterator[str]:
    """The FMU has a description, author, version and generation tool."""
    if missing := [n for n in METADATA if not (subject.root.get(n) or "").strip()]:
        yield f"{DESCRIPTION} line {subject.root.sourceline}: no {', '.join(missing)}"


def contents_categories(subject: Subject) -> Iterator[Finding]:
    """Log categories exist and are unique; in FMI 2 they include names of the standard."""
    names = subject.model.categories
    if not names:
        yield note(f"{DESCRIPTION}: no log categories; users cannot select messages of the FMU")
    for name, count in Counter(names).items():
        if count > 1:
            yield warning(f"{DESCRIPTION}: log category {name} is declared {count} times")
    if subject.major == 2 and names and not set(CATEGORIES.split()).intersection(names):
        text = f"expected log categories of the standard such as logStatusError, got {names[0]}"
        yield note(f"{DESCRIPTION}: {text}")


def contents_paths(subject: Subject) -> Iterator[str]:
    """Files contain no paths of the machine on which the FMU was made."""
    for file, data in _searched(subject, (f for f in subject.files if f.endswith(TEXT_FILES))):
        if match := LOCAL_PATH.search(data):
            line = data.count(b"\n", 0, match.start()) + 1
            path = match.group()[:80].decode("utf-8", "replace")
            yield f"{file} line {line}: {path} is a path of the machine on which the FMU was made"


def contents_machine(subject: Subject) -> Iterator[str]:
    """Libraries contain no paths of the machine on which they were built."""
    for file, data in _searched(subject, {b.file for b in subject.binaries}):
        if match := LOCAL_PATH.search(data):
            yield f"{file}: contains the path {match.group()[:80].decode('utf-8', 'replace')}"


def contents_size(subject: Subject) -> Iterator[str]:
    """The FMU has at most 50 MB."""
    bytes_ = subject.path.stat().st_size
    if bytes_ > MAX_SIZE:
        yield f"{bytes_ / 1e6:.0f} MB; tools unpack it for each instance or each model"


BUILD, SOURCE_FILES = "sources/buildDescription.xml", ("BuildConfiguration", "SourceFileSet", "SourceFile")
CODE = (".c", ".cc", ".cpp", ".cxx")


def _severity(subject: Subject) -> Callable[..., Finding]:
    """A fault of the sources matters less if there are binaries."""
    return warning if subject.binaries else error


def source_listed(subject: Subject) -> Iterator[Finding]:
    """Listed source files exist."""
    lists = [(DESCRIPTION, subject.root, (k, "SourceFiles", "File")) for k in subject.model.interfaces]
    lists.append((BUILD, read_xml(subject.folder, BUILD)[0], SOURCE_FILES))
    for where, root, path in lists:
        files = list(children(root, *path))
        names = dict.fromkeys(posixpath.normpath(f.get("name", "")) for f in files)
        if missing := [n for n in names if f"sources/{n}" not in subject.files]:
            text = f"{len(missing)} of {len(names)} listed files are missing in sources/"
            yield _severity(subject)(f"{where} line {files[0].sourceline}: {text}: {join_names(missing)}")


def source_build(subject: Subject) -> Iterator[Finding]:
    """Sources come with a list of the files to compile."""
    code = sorted(f for f in subject.files if f.startswith("sources/") and f.endswith(CODE))
    if not code or not subject.model.interfaces:
        return
    kinds = [k for k in subject.model.interfaces if child(subject.root, k, "SourceFiles", "File") is not None]
    if subject.major == 3 and BUILD not in subject.files:
        text = f"is missing next to {join_names(code, 2)}; FMI 3 tools cannot compile them"
        yield _severity(subject)(f"{BUILD} {text}")
    elif subject.major == 2 and BUILD not in subject.files and not kinds:
        yield warning(f"{DESCRIPTION}: no SourceFiles for {join_names(code, 2)}")
    elif subject.major == 2 and kinds and len(kinds) < len(subject.model.interfaces):
        yield warning(f"{DESCRIPTION}: expected SourceFiles for each interface, got {kinds[0]} only")


def source_description(subject: Subject) -> Iterator[Finding]:
    """buildDescription.xml is valid against its schema and consistent with modelDescription.xml."""
    finding, (root, wrong) = _severity(subject), read_xml(subject.folder, BUILD)
    if wrong:
        yield finding(wrong)
    if root is None:
        return
    for line, message in violations(root, "fmi3/fmi3BuildDescription.xsd"):
        yield finding(f"{BUILD} line {line}: {message}")
    if subject.major == 3 and (got := root.get("fmiVersion")) != subject.version:
        yield finding(f"{BUILD}: fmiVersion: expected {subject.version} as in {DESCRIPTION}, got {got}")
    configurations = list(children(root, "BuildConfiguration"))
    for c in configurations:
        name, platform = c.get("modelIdentifier"), c.get("platform")
        if name not in subject.model.identifiers:
            expected = ", ".join(subject.model.identifiers) or "none"
            yield finding(f"{BUILD} line {c.sourceline}: modelIdentifier: expected {expected}, got {name!r}")
        if platform and not TUPLE.fullmatch(platform):
            yield note(f"{BUILD} line {c.sourceline}: {platform} is not a platform of the standard")
    generic = Counter(c.get("modelIdentifier") for c in configurations if not c.get("platform"))
    if (most := max(generic.values(), default=0)) > 1:
        yield finding(f"{BUILD}: expected one BuildConfiguration without platform, got {most}")
