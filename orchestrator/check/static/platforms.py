"""Platforms: folders with the names of the version, with a library of the right name and machine inside."""

from __future__ import annotations

import re
from collections.abc import Iterator

from orchestrator.check.binary import SUFFIXES, Binary
from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject

RULES = Table()
TUPLES = {  # FMI 2 name -> FMI 3 tuple
    "win32": "x86-windows",
    "win64": "x86_64-windows",
    "linux32": "x86-linux",
    "linux64": "x86_64-linux",
    "darwin32": "x86-darwin",
    "darwin64": "x86_64-darwin",
}
NAMES = {tuple_: name for name, tuple_ in TUPLES.items()}
TUPLE = re.compile(
    r"(aarch32|aarch64|riscv32|riscv64|x86|x86_64|ppc32|ppc64)-(darwin|linux|windows)(-[a-z][a-z0-9_]*)?"
)
FORMATS = {"linux": "ELF", "windows": "PE", "darwin": "Mach-O"}
THREADS = "PyFMI#61 PythonFMU#106 FMPy#51 FMPy#322 FMPy#576 FMI.jl#47"


def folders(subject: Subject) -> list[str]:
    """The folders below binaries/ that hold files."""
    return sorted({n.split("/")[1] for n in subject.files if n.startswith("binaries/") and n.count("/") > 1})


def as_tuple(folder: str) -> tuple[str, str]:
    """Machine and system of a folder of either version; empty when it is not standard."""
    machine, _, rest = TUPLES.get(folder, folder).partition("-")
    return (machine, rest.partition("-")[0]) if TUPLE.fullmatch(TUPLES.get(folder, folder)) else ("", "")


def _legal(folder: str, major: int) -> bool:
    if major == 2:
        return folder in TUPLES or (bool(TUPLE.fullmatch(folder)) and folder not in NAMES)
    return bool(TUPLE.fullmatch(folder))


@RULES.rule("platform.some", "The FMU has a binary for some platform", THREADS)
def some(subject: Subject) -> Iterator[Finding]:
    if not subject.model.interfaces or any(_legal(b.platform, subject.major) for b in subject.binaries):
        return
    where = folders(subject)
    found = f"found folders {', '.join(where)}" if where else "found no binaries"
    if any(f.startswith("sources/") for f in subject.files):
        yield warning(f"{found}, only sources: few tools compile them")
    else:
        yield error(
            f"{found}, expected binaries/{'linux64' if subject.major == 2 else 'x86_64-linux'} or another"
        )


def _lacks(subject: Subject, system: str) -> bool:
    offered = {as_tuple(b.platform) for b in subject.binaries}
    return bool(offered) and ("x86_64", system) not in offered


@RULES.rule("platform.windows", "The FMU runs on 64-bit Windows", THREADS)
def windows(subject: Subject) -> Iterator[Finding]:
    if _lacks(subject, "windows"):
        name = "win64" if subject.major == 2 else "x86_64-windows"
        yield note(f"no binaries/{name}: no tool on Windows can run it")


@RULES.rule("platform.linux", "The FMU runs on 64-bit Linux", THREADS)
def linux(subject: Subject) -> Iterator[Finding]:
    if _lacks(subject, "linux"):
        name = "linux64" if subject.major == 2 else "x86_64-linux"
        yield note(f"no binaries/{name}: no tool on Linux can run it")


@RULES.rule("platform.macos", "The FMU runs on macOS, on Intel and Apple machines")
def macos(subject: Subject) -> Iterator[Finding]:
    machines = {b.machine for b in subject.binaries if as_tuple(b.platform)[1] == "darwin"}
    if subject.binaries and not machines:
        yield note("no binary for macOS")
    elif machines and "aarch64" not in machines:
        yield note("no binary for Macs with Apple processors; a universal one or aarch64-darwin")


@RULES.rule("platform.folder", "Platform folders have the names of the FMI version", "FMPy#671")
def folder(subject: Subject) -> Iterator[Finding]:
    for name in folders(subject) if subject.major else ():
        if _legal(name, subject.major):
            continue
        other = TUPLES.get(name) if subject.major == 3 else NAMES.get(name)
        if other:
            yield warning(f"binaries/{name} is the name of the other FMI version, expected binaries/{other}")
        else:
            yield note(f"binaries/{name} is no platform of the standard; tools pass it over")


@RULES.rule("platform.format", "Each library is of the format, machine and kind that its folder says")
def format_(subject: Subject) -> Iterator[Finding]:
    for b in subject.binaries:
        machine, system = as_tuple(b.platform)
        if not b.format:
            what = b.damage or "something else"
            what = "a Git LFS pointer" if b.head.startswith(b"version https://git-lfs") else what
            yield error(f"{b}: expected a shared library, got {what if b.size else 'an empty file'}")
        elif system and FORMATS[system] != b.format:
            yield error(f"{b}: expected {FORMATS[system]} for {system}, got {b.format}")
        elif not b.is_library:
            yield error(f"{b}: expected a shared library, got an executable")
        elif machine and not _right(b, machine, subject):
            yield error(f"{b}: expected code for {machine}, got {b.machine}")


def _right(b: Binary, machine: str, subject: Subject) -> bool:
    """True for the right machine; a universal library needs it in one of its parts."""
    return any(o.machine == machine for o in subject.binaries if o.file == b.file)


@RULES.rule("platform.name", "Each platform has a library with the name of the model identifier")
def name(subject: Subject) -> Iterator[Finding]:
    for folder_ in (f for f in folders(subject) if _legal(f, subject.major)):
        system = as_tuple(folder_)[1]
        for kind, element in subject.model.interfaces.items():
            expected = f"{element.get('modelIdentifier', '')}{SUFFIXES[FORMATS[system]]}"
            if f"binaries/{folder_}/{expected}" in subject.files:
                continue
            static = [
                f
                for f in subject.files
                if f.startswith(f"binaries/{folder_}/") and f.endswith((".a", ".lib"))
            ]
            there = sorted(b.name for b in subject.binaries if b.platform == folder_)
            if not (static and not there):
                found = ", ".join(there[:4]) or "no library"
                yield error(f"binaries/{folder_}: expected {expected} for {kind}, found {found}")
