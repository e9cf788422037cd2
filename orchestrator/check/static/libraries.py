"""What a library needs from the machine it will run on."""

from __future__ import annotations

import re
from collections.abc import Iterator

from orchestrator.check.binary import Binary
from orchestrator.check.finding import Finding, error, note, warning
from orchestrator.check.registry import Table
from orchestrator.check.subject import Subject

RULES = Table()
SYSTEM = {  # what every machine of the system has
    "ELF": r"lib(c|m|dl|pthread|rt|util)\.so\.\d|ld-linux.*\.so\.\d|linux-vdso\.so\.1",
    "PE": r"(?i)(kernel32|user32|advapi32|gdi32|shell32|ole32|oleaut32|ws2_32|wsock32|msvcrt|ucrtbase|ntdll"
    r"|shlwapi|version|winmm|psapi|dbghelp|secur32|crypt32|bcrypt|bcryptprimitives|iphlpapi|userenv|rpcrt4"
    r"|api-ms-win-[a-z0-9-]+|ext-ms-win-[a-z0-9-]+)\.dll",
    "Mach-O": r"/usr/lib/lib(System|c\+\+|c\+\+abi|objc|iconv|z|resolv)\b.*|/System/Library/.*",
}
COMMON = {  # libraries that are often there, and what to say
    r"libgcc_s\.so\.\d": "on all usual Linux systems, missing in small containers",
    r"libstdc\+\+\.so\.\d+": "on most Linux systems; the newest symbols need a new one",
}
KNOWN = {  # others that were seen, and what the user has to install
    r"(?i)(vcruntime|msvcp|concrt)\d+(_\d)?\.dll|msvcr\d+\.dll": "the Visual C++ runtime; link with /MT",
    r"(?i)(vcruntime\d+|msvcp\d+|ucrtbase|msvcr\d+)d\.dll": "the debug runtime, which must not be passed on",
    r"(?i)lib(gcc_s|winpthread|stdc\+\+|gomp).*\.dll": "the MinGW runtime; link it statically",
    r"(?i)libgfortran.*|libquadmath.*|libifcore.*": "the Fortran runtime",
    r"(?i)lib(blas|lapack|openblas|mkl).*": "a linear algebra library",
    r"(?i)libgomp.*|libomp.*|libiomp.*": "the OpenMP runtime",
    r"(?i)libmw.*": "the MATLAB runtime",
    r"(?i)(lib)?jvm\..*|libjvm.*": "Java",
    r"(?i)lib(sundials).*": "SUNDIALS",
}
PYTHON = re.compile(r"(?i)(lib)?python\d?.*\.(so|dll|dylib).*|.*/Python\.framework/.*")
# newest version that Linux distributions still in use have, and one that lacks it
GLIBC = ((2, 34), "RHEL 8 and Ubuntu 20.04 lack it", (2, 28), "RHEL 8 has 2.28, CentOS 7 has 2.17")
GLIBCXX = (3, 4, 28)  # Ubuntu 20.04
MACOS = (13,)


def _beside(b: Binary, library: str, subject: Subject) -> bool:
    """True when the library lies beside this one in the archive."""
    return f"binaries/{b.platform}/{library.rpartition('/')[2]}" in subject.files


@RULES.rule(
    "binary.libraries",
    "Libraries need only what every machine of the platform has, or what lies beside them",
    "OpenModelica#11856 OpenModelica#7895 fmi-cross-check#57",
)
def libraries(subject: Subject) -> Iterator[Finding]:
    for b in subject.binaries:
        needs: dict[tuple[str, bool], list[str]] = {}
        for library in b.libraries:
            if not (
                re.fullmatch(SYSTEM[b.format], library)
                or PYTHON.fullmatch(library)
                or _beside(b, library, subject)
            ):
                needs.setdefault(_known(b, library), []).append(library)
        for (what, usual), names in needs.items():
            say = note if usual else warning
            yield say(f"{b}: needs {', '.join(names)} on the target machine: {what}")


def _known(b: Binary, library: str) -> tuple[str, bool]:
    """What a library is, and whether most machines have it."""
    common = next((t for p, t in COMMON.items() if re.fullmatch(p, library)), "")
    if common and b.format == "ELF":
        return common, True
    return next((t for p, t in KNOWN.items() if re.fullmatch(p, library)), "another library"), False


@RULES.rule("binary.loader", "Libraries find the libraries beside them", "OpenModelica#11856")
def loader(subject: Subject) -> Iterator[Finding]:
    for b in subject.binaries:
        beside = [n for n in b.libraries if b.format == "ELF" and _beside(b, n, subject)]
        if beside and not any("$ORIGIN" in p for p in b.rpaths):
            yield warning(
                f"{b}: needs {beside[0]} beside it, but its rpath lacks $ORIGIN; the loader will not find it"
            )


@RULES.rule("binary.path", "Libraries do not look into folders of the machine they were built on")
def path(subject: Subject) -> Iterator[Finding]:
    for b in subject.binaries:
        for found in b.rpaths:
            if not found.startswith(("$ORIGIN", "@loader_path", "@rpath", "@executable_path")):
                yield warning(f"{b}: looks for libraries in {found}, expected $ORIGIN or none")
        for library in b.libraries:
            if library.startswith("/") and not re.fullmatch(SYSTEM[b.format], library):
                yield warning(f"{b}: needs {library} at this absolute path")


@RULES.rule(
    "binary.glibc", "Libraries for Linux run with the C library of older distributions", "FMIZoo.jl#3"
)
def glibc(subject: Subject) -> Iterator[Finding]:
    new, lacking, old, still = GLIBC
    for b in subject.binaries:
        found = b.versions.get("GLIBC", ())
        if found >= new:
            yield warning(f"{b}: needs glibc {_dotted(found)}, expected at most {_dotted(old)}; {lacking}")
        elif found > old:
            yield note(f"{b}: needs glibc {_dotted(found)}; {still}")
        plus = b.versions.get("GLIBCXX", ())
        if plus > GLIBCXX:
            yield warning(
                f"{b}: needs GLIBCXX {_dotted(plus)} of libstdc++, expected at most {_dotted(GLIBCXX)};"
                " Ubuntu 20.04 lacks it, and MATLAB brings its own"
            )


def _dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))


@RULES.rule("binary.macos", "Libraries for macOS run on versions in use")
def macos(subject: Subject) -> Iterator[Finding]:
    for b in subject.binaries:
        if b.minimum[:1] > MACOS:
            yield warning(f"{b}: needs macOS {_dotted(b.minimum)}, expected at most {_dotted(MACOS)}")


@RULES.rule("binary.documented", "What the FMU needs from outside is documented in externalDependencies")
def documented(subject: Subject) -> Iterator[Finding]:
    foreign = [f.text for f in libraries(subject) if f.severity == "warning"]
    told = any(re.match(r"documentation/externalDependencies\.(txt|html)", f) for f in subject.files)
    if foreign and not told:
        say = error if subject.major == 3 else note
        yield say(
            "documentation/externalDependencies.txt or .html is missing, though the FMU needs other libraries"
        )
