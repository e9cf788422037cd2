"""What the libraries export: every function of the version, on every platform."""

from __future__ import annotations

import re
from collections.abc import Iterator

from orchestrator.check.binary import Binary
from orchestrator.check.finding import Finding, error, note, some, warning
from orchestrator.check.functions import required
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject

RULES = Table()


def models(subject: Subject) -> Iterator[tuple[Binary, list[str]]]:
    """The libraries that bear a model identifier, with the kinds that they serve."""
    for b in subject.binaries:
        kinds = [k for k, e in subject.model.interfaces.items() if e.get("modelIdentifier") == b.stem]
        if b.format and kinds:
            yield b, kinds


@RULES.rule(
    "binary.functions",
    "Every library exports all functions of its FMI version and kinds, whatever the FMU can do",
    "FMPy#545 FMPy#642 FMPy#552 FMPy#700 fmi-standard#1868",
)
def functions(subject: Subject) -> Iterator[Finding]:
    for b, kinds in models(subject):
        missing = [f for f in required(subject.major, kinds) if f not in b.exports]
        if not missing:
            continue
        prefixed = f"{b.stem}_{missing[0]}"
        hint = f"; it exports {prefixed}, which is for static linking" if prefixed in b.exports else ""
        yield error(f"{_at(b)}: does not export {some(missing)}{hint}")


def _at(b: Binary) -> str:
    return f"{b} ({b.machine})" if b.format == "Mach-O" else str(b)


@RULES.rule("binary.version", "The libraries export functions of their FMI version only")
def version(subject: Subject) -> Iterator[Finding]:
    own = f"fmi{subject.major}"
    for b, _ in models(subject):
        foreign = sorted(e for e in b.exports if re.match(r"fmi[123][A-Z]", e) and not e.startswith(own))
        if foreign:
            yield note(f"{_at(b)}: exports functions of another FMI version: {some(foreign, 2)}")


@RULES.rule(
    "binary.symbols",
    "All that a library needs is in the libraries that it names",
    "PythonFMU#192 PythonFMU#110",
)
def symbols(subject: Subject) -> Iterator[Finding]:
    for b, _ in models(subject):
        if b.unsupplied:
            yield error(
                f"{b}: needs {some(b.unsupplied, 3)}, which none of {', '.join(b.libraries)} has;"
                " it loads only inside a program that brings them"
            )


@RULES.rule("binary.private", "A library keeps its own names to itself")
def private(subject: Subject) -> Iterator[Finding]:
    for b, _ in models(subject):
        own = [
            e
            for e in b.exports
            if not re.search(r"fmi[123][A-Z]", e) and not e.startswith(("_init", "_fini"))
        ]
        if len(own) > 20:
            yield note(f"{_at(b)}: exports more than the functions of FMI: {some(sorted(own), 2)}")


@RULES.rule("binary.debug", "Libraries carry no debug information")
def debug(subject: Subject) -> Iterator[Finding]:
    for b in subject.binaries:
        if b.debug:
            yield note(
                f"{b}: {b.debug / 1e3:.0f} kB of debug information, with paths and names of the sources"
            )


@RULES.rule(
    "binary.traits",
    "Libraries have no code that can be written and no stack that can be executed",
    "melonDS#217",
)
def traits(subject: Subject) -> Iterator[Finding]:
    why = {
        "executable stack": "Linux with glibc 2.41 and newer does not load it",
        "writable code": "hardened systems do not load it",
        "text relocations": "hardened systems do not load it",
        "unsigned": "Macs with Apple processors do not run unsigned code",
    }
    for b in subject.binaries:
        for trait in b.traits:
            yield warning(f"{b}: {trait}; {why[trait]}")
