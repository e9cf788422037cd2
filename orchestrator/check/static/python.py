"""FMUs that need an interpreter on the target machine: Python above all."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator

from orchestrator.check.finding import Finding, error, note, some, warning
from orchestrator.check.registry import Table
from orchestrator.check.static.libraries import PYTHON
from orchestrator.check.subject import Subject

RULES = Table()
SCRIPTS = "resources/"
FMU_PACKAGES = ("pythonfmu", "pythonfmu3", "unifmu_fmi2", "unifmu")


def _scripts(subject: Subject) -> list[str]:
    return sorted(f for f in subject.files if f.startswith(SCRIPTS) and f.endswith(".py"))


def _evidence(subject: Subject) -> Iterator[str]:
    """Why Python is needed."""
    for b in subject.binaries:
        named = [n for n in b.libraries if PYTHON.fullmatch(n)]
        calls = sorted(i for i in b.imports if re.match(r"_?Py_?[A-Z]", i))
        if named:
            yield f"{b} needs {named[0]}"
        elif len(calls) > 2:
            yield f"{b} calls {calls[0]} and {len(calls) - 1} more of Python, and names no libpython"
    maker = "resources/slavemodule.txt" in subject.files or (
        subject.root is not None and "pythonfmu" in str(subject.root.get("generationTool", "")).lower()
    )
    if maker:
        yield "PythonFMU made it"
    launcher = "resources/launch.toml"
    if launcher in subject.files and "python" in (subject.folder / launcher).read_text("utf-8", "replace"):
        yield f"{launcher} starts Python"


@RULES.rule(
    "python.needed",
    "The FMU runs without Python on the target machine",
    "PythonFMU#110 PythonFMU#192 PythonFMU#202 PythonFMU#222 FMPy#348 Hopsan#2187",
)
def needed(subject: Subject) -> Iterator[Finding]:
    why = list(_evidence(subject))
    if why:
        yield warning(
            f"needs Python on the target: {'; '.join(why[:2])}; the target machine needs the same Python"
            " on its path, with all packages"
        )


@RULES.rule("python.packages", "Scripts need no package beside the standard library", "PythonFMU#152")
def packages(subject: Subject) -> Iterator[Finding]:
    if not any(_evidence(subject)):
        return
    scripts = _scripts(subject)
    own = {s.removeprefix(SCRIPTS).partition("/")[0].removesuffix(".py") for s in scripts} | set(FMU_PACKAGES)
    found: dict[str, str] = {}
    for script in scripts:
        for name in _imports((subject.folder / script).read_text("utf-8", "replace")):
            if name not in sys.stdlib_module_names and name not in own:
                found.setdefault(name, script)
    for name, script in found.items():
        yield warning(f"{script}: imports {name}, which the target's Python must have")


def _imports(text: str) -> set[str]:
    """The top packages that a script imports; none when it cannot be read."""
    try:
        nodes = list(ast.walk(ast.parse(text)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return set()
    plain = {a.name for n in nodes if isinstance(n, ast.Import) for a in n.names}
    given = {n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.module and not n.level}
    return {name.partition(".")[0] for name in plain | given}


@RULES.rule("python.syntax", "Scripts can be read by the target's Python")
def syntax(subject: Subject) -> Iterator[Finding]:
    for script in _scripts(subject):
        try:
            ast.parse((subject.folder / script).read_text("utf-8", "replace"))
        except (SyntaxError, ValueError) as problem:
            yield error(f"{script}: this Python cannot read it: {problem}")
        except (RecursionError, MemoryError):
            yield note(f"{script}: is nested too deep to be read")


@RULES.rule("runtime.java", "The FMU runs without a Java machine on the target")
def java(subject: Subject) -> Iterator[Finding]:
    jars = sorted(f for f in subject.files if f.endswith(".jar"))
    if jars:
        yield warning(f"{some(jars)}: Java; the target machine may need a Java machine")
